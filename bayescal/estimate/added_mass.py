"""Compliances through which an added mass acts, from fit to fit.

The deflection by a payload that was not stated is the product of its mass and a compliance. A fit takes the
compliance of the fit before. Where the tool alone loads a joint, both are confounded: the more compliance
is taken, the less is found, by the mass in units of the tool's. Fits alternate, and diverge for a payload
that is heavier than the tool. Anderson's acceleration (several secants at once) of this iteration converges
in a few fits: D. G. Anderson, Iterative procedures for nonlinear integral equations, J. ACM 12 (1965)
547-560.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.effects import Parameter
from bayescal.model.scene import Scene


def acts(parameters: Sequence[Parameter]) -> bool:
    """Whether a parameter is an added mass."""
    return any(p.driver.kind == "mass" for p in parameters)


@dataclass(frozen=True)
class Secants:
    """Compliances, SI, by parameter, that each fit took and found."""

    history: tuple[tuple[Mapping[str, float], Mapping[str, float]], ...] = ()

    def next(self, scene: Scene, took: Mapping[str, float]) -> tuple[Scene, Secants]:
        """The scene of a further fit, from the scene with the compliances that the last fit found.

        Parameters
        ----------
        scene : Scene
        took : mapping
            Compliances that the last fit took; none if it took typical ones.
        """
        found = scene.compliances
        kept = [(a, b) for a, b in (*self.history, (took, found)) if a.keys() >= found.keys() <= b.keys()]
        now = Secants(tuple(kept))
        if len(kept) < 2:
            return scene, now
        x, g = (np.array([[pair[k][name] for name in found] for pair in kept]) for k in (0, 1))
        size = np.max(np.abs(g), axis=0) + np.finfo(float).tiny
        left = (g - x) / size
        share = np.linalg.lstsq(np.diff(left, axis=0).T, left[-1], rcond=1e-6)[0]
        mixed = g[-1] - share @ np.diff(g, axis=0)
        assert scene.stance is not None
        known = dict(zip(found, mixed.tolist(), strict=True))
        return scene.posed_at(scene.stance, known), now
