"""Least squares without priors: rows of a model as equations, and two ways to solve them.

The unknowns x are the arm's deviations from its drawing (SI), then the targets' parts of z. Certificates
and stated places are rows among others, each over its standard uncertainty: they are data. The tolerance
priors of the arm, and the loose ones of targets that state nothing, are not.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares

from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.estimate.estimate import check_within_reach
from bayescal.model import ARM, Block, Model
from bayescal.statistics import rms

Rows = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Residuals (R,), their gradients by the arm's deviations (R, P) and by the target's part of z (R, T)."""
RowsOf = Callable[[Block, np.ndarray, np.ndarray], Rows]
"""Rows of a block, at the arm's deviations (P,) and the target's part of z."""


def contacts(block: Block, values: np.ndarray, z: np.ndarray) -> Rows:
    """The residuals of a target's contacts, each over its stated noise."""
    r, by_arm, by_target = block.linearise(values, z)
    sigma = np.tile(block.sigma, block.kind.rows)
    return r / sigma, by_arm / sigma[:, None], by_target / sigma[:, None]


@dataclass(frozen=True)
class System:
    """A model's blocks as rows; with `fixed` targets stay where they are stated to be.

    `rows` makes those of a block.
    """

    model: Model
    rows: RowsOf = contacts
    fixed: bool = False

    @property
    def arm(self) -> int:
        """Number of the arm's unknowns."""
        return len(self.model.parameters)

    @cached_property
    def size(self) -> int:
        """Number of all unknowns."""
        return self.arm if self.fixed else self.model.size

    @cached_property
    def _stated(self) -> np.ndarray:
        """Unknowns of targets whose places are stated: indices of x."""
        model, targets = self.model, self.model.scene.dataset.targets
        stated = {t.name for t in targets if t.u is not None or t.u_angle is not None}
        unknowns = np.arange(self.size)
        parts = [unknowns[model.slices[b.target]] for b in model.blocks if b.target in stated]
        return np.concatenate([unknowns[:0], *parts])

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (R,) and their Jacobian (R, size) at x (size,)."""
        model, values = self.model, x[: self.arm]
        residuals, slopes = [], []
        for block in model.blocks:
            part = model.slices[block.target]
            r, by_arm, by_target = self.rows(block, values, np.zeros(block.size) if self.fixed else x[part])
            slope = np.zeros((len(r), self.size))
            slope[:, : self.arm] = by_arm
            if not self.fixed:
                slope[:, part] = by_target
            residuals.append(r)
            slopes.append(slope)
        if not self.fixed:
            for r, slope in (*self._certified(x), self._placed(x)):
                residuals.append(r)
                slopes.append(slope)
        return np.concatenate(residuals), np.concatenate(slopes)

    def _certified(self, x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        model, out = self.model, []
        parts = {name: x[part] for name, part in model.slices.items()}
        parts[ARM] = (x[: self.arm] - model.shift) / model.sd
        for constraint in model.constraints:
            r, by = model.linearised(constraint, parts)
            slope = np.zeros((len(r), self.size))
            for name, columns in by.items():
                slope[:, model.slices[name]] = columns / model.sd if name == ARM else columns
            out.append((r, slope))
        return out

    def _placed(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x[self._stated], np.eye(self.size)[self._stated]


def part(model: Model, wanted: Callable[[Block], bool]) -> Model:
    """A model with some of its blocks only, and the certificates between those."""
    blocks = tuple(block for block in model.blocks if wanted(block))
    names = {block.target for block in blocks}
    constraints = tuple(t for t in model.constraints if names.issuperset(t.targets))
    return replace(model, blocks=blocks, constraints=constraints)


SAME = 1e-6
"""Share of a target's column that no other explains, below which it counts as rounding."""
CONDITION = 1e3
"""Largest condition number of the scaled columns: ten times what Schroeer et al. allow for good results."""
UNSEEN = 1e-3
"""Residual standard deviations, over all rows, by which a parameter moves them if off by its tolerance."""
ROUNDS = 60
RESTED = 1e-5
"""Residual standard deviations that the last step of an iteration may still move the rows, rms."""


@dataclass(frozen=True)
class Solution:
    """What a method makes of a session, in the parameters of a model.

    `values` (P,) are deviations from nominal, SI. `held` names the parameters kept nominal because the
    rows do not tell them, `condition` is that of the scaled Jacobian of all others. `estimate` is there where
    the method predicts uncertainties.
    """

    model: Model
    values: np.ndarray
    held: tuple[str, ...] = ()
    condition: float | None = None
    estimate: Estimate | None = None
    settled: bool = False  # the gravity moments are those of the fitted poses already

    @property
    def free(self) -> int:
        """Number of the arm's parameters that the method moved."""
        return len(self.values) - len(self.held)


@dataclass(frozen=True)
class Estimable:
    """Identifiable unknowns: `kept` (K,) indices of the arm's unknowns, and the condition number."""

    kept: np.ndarray
    condition: float


def without(columns: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
    """What is left of columns (R, ...) once those of other unknowns (R, T) are taken out."""
    if not nuisance.shape[1]:
        return columns
    scale = np.linalg.norm(nuisance, axis=0)
    u, size, _ = np.linalg.svd(nuisance / np.where(scale > 0, scale, 1.0), full_matrices=False)
    basis = u[:, size > SAME * size[0]]
    return columns - basis @ (basis.T @ columns)


def estimable(system: System, x: np.ndarray) -> Estimable:
    """Which unknowns of the arm are identifiable, with unknown targets.

    QR of the scaled columns with pivoting, as base parameters are found (Khalil and Gautier): the largest
    remaining column is kept while the condition number allows; the others stay nominal.
    """
    if not system.arm:
        return Estimable(np.zeros(0, int), float("nan"))
    _, jacobian = system(x)
    scale = np.linalg.norm(jacobian, axis=0)
    columns = without(jacobian[:, : system.arm], jacobian[:, system.arm :])
    seen = scale[: system.arm] * system.model.sd > UNSEEN
    columns = np.where(seen, columns / np.where(seen, scale[: system.arm], 1.0), 0.0)
    _, order = qr(columns, mode="r", pivoting=True)
    for count in range(min(columns.shape), 0, -1):
        kept = np.sort(order[:count])
        length = np.linalg.norm(columns[:, kept], axis=0)
        if length.min() > SAME and (condition := np.linalg.cond(columns[:, kept] / length)) < CONDITION:
            return Estimable(kept, float(condition))
    return Estimable(np.zeros(0, int), float("nan"))


def solution(system: System, x: np.ndarray, identifiable: Estimable) -> Solution:
    """What was found, in the model's parameters.

    Raises
    ------
    BayescalError
        Where that is no arm any more.
    """
    model, values = system.model, x[: system.arm]
    check_within_reach(model, (values - model.shift) / model.sd)
    held = tuple(p.name for k, p in enumerate(model.parameters) if k not in identifiable.kept)
    return Solution(model, values, held, identifiable.condition)


def levenberg(system: System) -> Solution:
    """Non-linear least squares of all identifiable unknowns (MINPACK, columns scaled by their length).

    Raises
    ------
    BayescalError
        Where it does not come to rest.
    """
    start = np.zeros(system.size)
    identifiable = estimable(system, start)
    moved = np.concatenate([identifiable.kept, np.arange(system.arm, system.size)])

    def expanded(part: np.ndarray) -> np.ndarray:
        x = start.copy()
        x[moved] = part
        return x

    def residual(part: np.ndarray) -> np.ndarray:
        return system(expanded(part))[0]

    def slopes(part: np.ndarray) -> np.ndarray:
        return system(expanded(part))[1][:, moved]

    check_enough(system, len(moved))
    minimum = least_squares(
        residual, start[moved], slopes,
        method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=40 * ROUNDS,
    )  # fmt: skip
    if minimum.status == 0 or not np.all(np.isfinite(minimum.x)):
        raise BayescalError("the least squares did not converge")
    return solution(system, expanded(minimum.x), identifiable)


def linear_steps(system: System) -> Solution:
    """Linear least squares step by step: the arm by its scaled identification Jacobian, then the targets.

    What the targets take up is taken out of residuals and Jacobian before the arm's step; after it the
    targets are found again with the arm held. No step is damped.

    Raises
    ------
    BayescalError
        Where the steps do not shrink.
    """
    x = _targets(system, np.zeros(system.size))
    identifiable = estimable(system, x)
    check_enough(system, len(identifiable.kept) + system.size - system.arm)
    for _ in range(ROUNDS):
        r, jacobian = system(x)
        stacked = without(np.column_stack([jacobian[:, identifiable.kept], r]), jacobian[:, system.arm :])
        columns, residual = stacked[:, :-1], stacked[:, -1]
        scale = np.linalg.norm(columns, axis=0)
        step = np.linalg.lstsq(columns / scale, residual, rcond=None)[0] / scale
        if not np.all(np.isfinite(step)):
            break
        x = x.copy()
        x[identifiable.kept] -= step
        x = _targets(system, x)
        if rms(columns @ step) < RESTED:
            return solution(system, x, identifiable)
    raise BayescalError("the linear steps do not converge")


def _targets(system: System, x: np.ndarray) -> np.ndarray:
    """The targets found from their rows with the arm held."""
    for _ in range(ROUNDS if system.size > system.arm else 0):
        r, jacobian = system(x)
        step = np.linalg.lstsq(jacobian[:, system.arm :], r, rcond=None)[0]
        x = np.concatenate([x[: system.arm], x[system.arm :] - step])
        if rms(jacobian[:, system.arm :] @ step) < RESTED:
            break
    return x


def check_enough(system: System, unknowns: int) -> None:
    """Refuse fewer rows than unknowns.

    Raises
    ------
    BayescalError
        With both numbers.
    """
    rows = len(system(np.zeros(system.size))[0])
    if rows < unknowns:
        raise BayescalError(f"{rows} equations are too few for {unknowns} unknowns")
