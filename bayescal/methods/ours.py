"""Ours: tolerance priors, certificates, unknown targets, outliers left out, in one factor graph."""

from __future__ import annotations

from bayescal.effects.selection import plain
from bayescal.estimate import calibrated
from bayescal.estimate.unexplained import FORM, check_faces, with_form
from bayescal.methods.method import Method, Solution
from bayescal.model import ARM
from bayescal.model.scene import Scene


def solve(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """The estimate of `bayescal fit`, the form of uneven faces with it."""
    found = calibrated(scene, effects)
    uneven = tuple(face.target for face in check_faces(found) if face.uneven)
    if uneven and FORM not in map(plain, effects):
        found = with_form(found.model.scene, found, uneven)
    values = found.model.deviations(found.z[found.model.slices[ARM]])
    return Solution(found.model, values, estimate=found)


OURS = Method(
    "bayescal",
    "",
    "maximum a posteriori with tolerance priors and certificates, without outliers; predicts uncertainties",
    lambda model: "",
    solve,
)
