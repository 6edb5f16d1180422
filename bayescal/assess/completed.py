"""The last level of a fit, complete: the form of uneven faces, and the rejected rows that share a cause.

`fit`, the baseline of `gap` and its refits are completed by the same rule, and differ in effects alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from bayescal.assess.shared_causes import SharedCause, judged_complete
from bayescal.estimate import Estimate
from bayescal.estimate.unexplained import FaceCheck, check_faces, with_uneven_faces


@dataclass(frozen=True)
class Completed:
    """A fit with what it decided about faces and rows."""

    fitted: Estimate
    faces: tuple[FaceCheck, ...]  # tests of the forms, before any was added
    causes: tuple[SharedCause, ...]  # of rows that the level rejects and that are used all the same


def completed(level: Estimate, robust: bool = True, seed: int = 0, *, flat: bool = False) -> Completed:
    """Fit the form of uneven faces, then judge the outliers.

    Parameters
    ----------
    level : Estimate
        As `calibrated` returns it.
    robust : bool
        Reject outliers. Those that share a cause are fitted.
    seed : int
        Of the permutations that the test of shared causes uses.
    flat : bool
        Faces stay flat, as those of a level without effects do.
    """
    faces = check_faces(level)
    if level.model.effects and not flat:
        level = with_uneven_faces(level, faces, robust)
    level, causes = judged_complete(level, seed) if robust else (level, ())
    return Completed(level, faces, causes)
