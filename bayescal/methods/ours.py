"""Ours: tolerance priors, certificates, unknown targets, outliers left out, in one factor graph."""

from __future__ import annotations

from bayescal.estimate import calibrated
from bayescal.estimate.unexplained import check_faces, with_uneven_faces
from bayescal.methods.method import Method, Solution
from bayescal.model import ARM
from bayescal.model.scene import Scene


def solve(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """The estimate of `bayescal fit`, the form of uneven faces with it."""
    found = calibrated(scene, effects)
    found = with_uneven_faces(found, check_faces(found))
    values = found.model.deviations(found.z[found.model.slices[ARM]])
    return Solution(found.model, values, estimate=found)


OURS = Method(
    "bayescal",
    "",
    "maximum a posteriori with tolerance priors and certificates, without outliers; predicts uncertainties",
    lambda model: "",
    solve,
)
