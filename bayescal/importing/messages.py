"""Messages of an import: located instruments and tools, and numbers in a wrong unit."""

from __future__ import annotations

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.checks.misfit import away
from bayescal.dataset.checks.units import Suspicion
from bayescal.importing.columns import Columns
from bayescal.importing.units import UNITS, meant
from bayescal.importing.unplaced import Loose


def accusation(found: Suspicion, columns: Columns) -> str:
    """A message: the stated unit, the probable unit, and the errors of the rows with both."""
    first, last = found.quantities[0], found.quantities[-1]
    noun = f"`{first}`" if first == last else f"`{first}` to `{last}`"
    unit = columns.unit(first) or UNITS["deg" if first.startswith("j") else "mm"]
    other = meant(unit, found.factor)
    ratio = max(found.factor, 1 / found.factor)
    size = f"{ratio:.0f} times too {'small' if found.factor > 1 else 'large'}"
    fits = f"in {other} they agree with" if other else "corrected, they agree with"
    return (
        f"{noun} cannot be in {unit.name}: the numbers are {size}; "
        f"{fits} the nominal arm within {1e3 * found.other:.2g} mm, "
        f"in {unit.name} within {1e3 * found.stated:.0f} mm"
    )


def found_words(dataset: Dataset, loose: Loose) -> tuple[str, ...]:
    """Located instruments and reflectors, and the error of the nominal arm."""
    lines = [
        f"reflector `{tool.name}` located at {_mm(tool.centre)} mm in the flange frame"
        for tool in dataset.tools
        if tool.name in loose.tools
    ]
    for target in dataset.targets:
        if target.name in loose.targets:
            turn = ", ".join(f"{v:.3f}" for v in np.rad2deg(target.values["rpy"]))
            lines.append(
                f"instrument `{target.name}` located at {_mm(target.values['xyz'])} mm, rpy {turn} deg"
            )
    off = 1e3 * away(dataset, dataset.measurements.readings)
    lines.append(f"error of the nominal arm: median {np.median(off):.2g} mm, maximum {off.max():.2g} mm")
    return tuple(lines)


def _mm(point: np.ndarray | float) -> str:
    return ", ".join(f"{1e3 * v:.2f}" for v in np.atleast_1d(point))
