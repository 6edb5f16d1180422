"""A plan for a controller: tables of its motions, and probing programs.

Every contact is three motions: to its approach, along a line to the contact, and back. Where nothing is
touched (a tracker's point), it is one. The contacts are those of the nominal arm with the nominal targets:
the arm itself can touch some mm before or behind them, where the probe of a program stops it. Motions from
one approach to the next are by joint angles, past further points where they would collide.
"""

from __future__ import annotations

from collections.abc import Sequence

from bayescal.errors import BayescalError
from bayescal.exporting.plan.format import Format, Probe
from bayescal.exporting.plan.probing import CSV, POSES, ROBODK
from bayescal.exporting.plan.program import PROGRAMS

__all__ = ["FORMATS", "Format", "Probe", "formats_of"]

FORMATS: dict[str, Format] = {f.name: f for f in (CSV, *PROGRAMS, ROBODK, POSES)}
"""Formats by their names."""


def formats_of(names: Sequence[str], probe: Probe | None = None) -> tuple[Format, ...]:
    """Formats with these names, each once.

    Raises
    ------
    BayescalError
        For a name that is not known, or a probe that a format cannot use.
    """
    for name in names:
        if name not in FORMATS:
            raise BayescalError(f"there is no format `{name}`", "--to", f"known: {', '.join(FORMATS)}")
    found = tuple(FORMATS[name] for name in dict.fromkeys(names))
    for form in found:
        form.check(probe or Probe())
    return found
