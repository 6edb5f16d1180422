"""What an import says: what was found, and which numbers are in another unit than was said."""

from __future__ import annotations

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.checks.misfit import away
from bayescal.dataset.checks.units import Suspicion
from bayescal.importing.log import Columns
from bayescal.importing.units import UNITS, meant
from bayescal.importing.unplaced import Loose


def accusation(found: Suspicion, columns: Columns) -> str:
    """One line: what was said, what the numbers look like, and by what the rows are off in either case."""
    first, last = found.quantities[0], found.quantities[-1]
    noun = f"`{first}`" if first == last else f"`{first}` to `{last}`"
    unit = columns.unit(first) or UNITS["deg" if first.startswith("j") else "mm"]
    other = meant(unit, found.factor)
    ratio = max(found.factor, 1 / found.factor)
    size = f"{ratio:.0f} times too {'small' if found.factor > 1 else 'large'}"
    fits = f"as {other} they fit" if other else "corrected they fit"
    return (
        f"{noun} cannot be in {unit.name}: the numbers are {size}; "
        f"{fits} the arm to {1e3 * found.other:.2g} mm, as {unit.name} to {1e3 * found.stated:.0f} mm"
    )


def found_words(dataset: Dataset, loose: Loose) -> tuple[str, ...]:
    """Where instruments and reflectors were found, and how well the nominal arm explains the rows."""
    told = [
        f"reflector `{tool.name}` found at {_mm(tool.centre)} mm in the flange frame"
        for tool in dataset.tools
        if tool.name in loose.tools
    ]
    for target in dataset.targets:
        if target.name in loose.targets:
            turn = ", ".join(f"{v:.3f}" for v in np.rad2deg(target.values["rpy"]))
            told.append(f"instrument `{target.name}` found at {_mm(target.values['xyz'])} mm, rpy {turn} deg")
    off = 1e3 * away(dataset, dataset.measurements.readings)
    told.append(
        f"the nominal arm is off its rows by {np.median(off):.2g} mm (median), {off.max():.2g} at most"
    )
    return tuple(told)


def _mm(point: np.ndarray | float) -> str:
    return ", ".join(f"{1e3 * v:.2f}" for v in np.atleast_1d(point))
