"""What a fit leaves beyond the noise of a single contact, and what that does to its promises.

An error that the model leaves out (the form of a table, play, a soft base) does not average away:
it is there again in every prediction. So where the residuals are larger than repeated contacts
scatter, the excess is added to every prediction of a point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.distributions import chi2_isf, chi2_sf, f_isf, f_sf
from bayescal.estimate import Estimate
from bayescal.model.scene import Scene

FEWEST_REPEATS = 5  # degrees of freedom that make a noise floor
FINEST = 1e-9  # m: repeats that scatter less were read too coarsely to tell a noise
P_VALUE = 1e-2
STATED_FACTOR = 1.4  # without repeats: how far the stated noise may be off before it is contradicted


@dataclass(frozen=True)
class Unexplained:
    """Noise of one contact, what the fit leaves, and what of it no noise explains; all m, 1 sigma."""

    group: str  # contact or point: whose noise this is
    stated: float
    repeats: float | None  # scatter of repeated contacts; None without enough of them
    repeats_dof: int
    fitted: float  # of the residuals that the fit keeps
    excess: float  # root of the difference of squares where significant, else 0
    p_value: float  # that the noise of one contact alone explains the residuals
    dof: float = 1.0  # degrees of freedom of `fitted`

    @property
    def floor(self) -> float:
        """The noise of one contact as best known."""
        return self.stated if self.repeats is None else self.repeats

    def limit(self, chance: float) -> float:
        """Ratio of what the fit leaves to the noise that noise alone exceeds with a chance."""
        if self.repeats is None:
            return STATED_FACTOR * float(np.sqrt(chi2_isf(chance, self.dof) / self.dof))
        return float(np.sqrt(f_isf(chance, self.dof, self.repeats_dof)))


def repeat_scatter(scene: Scene, fitted: Estimate) -> tuple[float | None, int]:
    """Standard deviation of repeated contacts about their mean, m, and its degrees of freedom.

    Of `calibrate` and `validate` rows of fitted surfaces; a group counts by its median absolute
    deviation, so that a contact that slipped does not. None without enough of them, or where most read
    identically: an encoder coarser than the noise hides it.
    """
    repeat = scene.dataset.measurements.repeat
    if repeat is None:
        return None, 0
    index = {t.name: k for k, t in enumerate(scene.dataset.targets)}
    groups: dict[tuple[str, str], list[float]] = {}
    for name, block in fitted.model.block_of.items():
        rows = scene.rows_of(index[name], scene.rows("calibrate", "validate"))
        rows = rows[repeat[rows] != ""]
        if not len(rows) or block.kind.rows > 1:
            continue
        for row, r in zip(rows, fitted.residuals(fitted.model.block(index[name], rows))[0], strict=True):
            groups.setdefault((name, str(repeat[row])), []).append(float(r))
    deviations, dof = [], 0
    for values in groups.values():
        if len(values) > 1:
            # freed of the mean that it had to find, a deviation has the scatter of one contact
            free = np.sqrt(len(values) / (len(values) - 1))
            deviations.append(np.abs(np.asarray(values) - np.mean(values)) * free)
            dof += len(values) - 1
    if dof < FEWEST_REPEATS:
        return None, dof
    size = np.concatenate(deviations)
    robust = float(np.median(size)) / 0.6745
    scatter = float(np.sqrt(np.mean(size[size <= 4.0 * robust] ** 2)))
    return (scatter if scatter > FINEST else None), dof


def _rms(values: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(values) ** 2)))


def unexplained(fitted: Estimate) -> Unexplained:
    """Compare what a fit leaves with the noise of one contact."""
    scene = fitted.model.scene
    scales = fitted.weights.scale
    kind_of = {name: name.partition(" of ")[0] for name in scales}  # one a session where several are fitted
    group = "contact" if "contact" in kind_of.values() else "point"
    blocks = [b for b in fitted.model.blocks if kind_of[b.group] == group]
    stated = _rms([fitted.weights.sigma[b.name] for b in blocks])
    left = _rms([scales[b.group] * fitted.weights.sigma[b.name] for b in blocks])
    scale = left / stated
    dof = max(sum(fitted.dof[name] for name, kind in kind_of.items() if kind == group), 1.0)
    repeats, repeats_dof = repeat_scatter(scene, fitted)
    if repeats is None:
        floor, p = stated, float(chi2_sf(dof * (scale / STATED_FACTOR) ** 2, dof))
    else:
        floor = repeats
        p = float(f_sf((scale * stated / repeats) ** 2, dof, repeats_dof))
    square = (scale * stated) ** 2 - floor**2
    excess = float(np.sqrt(max(square, 0.0))) if p < P_VALUE else 0.0
    return Unexplained(group, stated, repeats, repeats_dof, scale * stated, excess, p, dof)
