"""Fits of the model levels: nominal, the baseline effect by effect, then each named effect."""

from __future__ import annotations

from collections.abc import Sequence

from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.gap.explain import Explained
from bayescal.gap.search.beam import COMPLIANCE
from bayescal.gap.search.refit import model_name, refit
from bayescal.model import with_parameters
from bayescal.model.parts import Part
from bayescal.model.scene import Scene


def fitted_levels(
    scene: Scene, effects: tuple[str, ...], width: float, robust: bool, without: Sequence[Part],
    found: Explained,
) -> list[tuple[tuple[str, ...], Estimate]]:  # fmt: skip
    """Nominal, each effect of the baseline, then each named effect in the order of the search."""
    out: list[tuple[tuple[str, ...], Estimate]]
    out = [(("nominal",), estimate(with_parameters(scene, (), ()), robust=robust))]
    if effects[:1] == ("geometry",):
        out.append((("joint",), calibrated(scene, ("joint",), width, robust)))
    for k in range(1, len(effects)):
        out.append((effects[:k], calibrated(scene, effects[:k], width, robust, without)))
    last, members = found.last, found.last.decision.members
    if effects:
        out.append((effects, found.first.fitted))
    if found.promoted:
        out.append(((*effects, COMPLIANCE), last.fitted))
    for k in range(1, len(members) + 1):
        e = (
            found.final
            if k == len(members)
            else refit(last.fitted, last.candidates, members[:k], robust, width, without)
        )
        names = (model_name(m, last.candidates) for m in members[:k])
        out.append(((*last.fitted.model.effects, *names), e))
    return out
