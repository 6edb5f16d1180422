"""The estimate: Levenberg-Marquardt on the factor graph, robust weights, noise, covariance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from bayescal.arm.chain import link_angles
from bayescal.arm.kernel import MAX_ANGLE
from bayescal.errors import BayescalError
from bayescal.model import ARM, Block, Model, Tie, build
from bayescal.parts import Part
from bayescal.scene import Scene

if TYPE_CHECKING:
    from factors.graph import Function, Graph

STATED_WORTH = 8.0
"""Contacts that the stated noise is worth, as a prior of the noise scale (inverse gamma)."""
TAIL = 4.0
"""Degrees of freedom of the Student t that weighs rows while outliers are sought."""
LARGEST_SCALE_SD = 5e-3
"""Relative standard deviation of the arm's size beyond which no length counts as known."""
LARGEST_STEP = 0.1
"""Posterior standard deviations that a converged solution may be off its optimum."""
ROUNDS = 25
"""At most so many reweightings."""
MEDIAN_SIZE = {1: 0.6745, 3: 0.8881}
"""Median of the root mean square of one, or three, standard normal residuals."""
FALSE_REJECTIONS = 0.01
"""Contacts of clean normal noise that a session loses as outliers on average."""


@dataclass(frozen=True)
class Weights:
    """How much each residual counts, by block: `sigma` (R,) m at noise scale 1, row weights (C,)."""

    sigma: Mapping[str, np.ndarray]
    row: Mapping[str, np.ndarray]
    scale: Mapping[str, float]  # by noise group

    def whitening(self, block: Block) -> np.ndarray:
        """Factors (R,) that whiten a block's residuals."""
        row = np.tile(self.row[block.name], block.kind.rows)
        return np.sqrt(row) / (self.sigma[block.name] * self.scale[block.group])


@dataclass(frozen=True)
class Linear:
    """The problem linearised at z, whitened, without the prior: contacts block after block, then ties."""

    residual: np.ndarray  # (R,)
    jacobian: np.ndarray  # (R, D)
    of_block: Mapping[str, slice]  # rows of each block's contacts, by its name


@dataclass(frozen=True)
class Estimate:
    """The most probable parameters, their covariance, and what became of every contact."""

    model: Model
    z: np.ndarray  # (D,)
    covariance: np.ndarray  # (D, D), of z
    weights: Weights
    linear: Linear
    iterations: int
    rejected: np.ndarray  # rows of the session left out as outliers
    dof: Mapping[str, float]  # degrees of freedom left to each noise group

    @property
    def sd(self) -> np.ndarray:
        """Posterior standard deviations of z, (D,)."""
        return np.sqrt(np.diag(self.covariance))

    def residuals(self, block: Block, z: np.ndarray | None = None) -> np.ndarray:
        """Residuals (..., rows, C), m, of a block, at the estimate or at other z (..., D)."""
        z = self.z if z is None else z
        slices = self.model.slices
        return block.residual(self.model.deviations(z[..., slices[ARM]]), z[..., slices[block.target]])


def calibrated(
    scene: Scene,
    effects: tuple[str, ...],
    prior_width: float = 1.0,
    robust: bool = True,
    without: Sequence[Part] = (),
) -> Estimate:
    """Fit a model, and once more with the gravity moments where the arm was found to stand.

    With moments of the drawing a compliance comes out several standard deviations off, while the residuals
    hide it; the more so with a payload.
    """
    found = estimate(build(scene, effects, prior_width, without), robust=robust)
    if not effects or scene.moments is None:
        return found
    model = build(settled(found), effects, prior_width, without)
    # a joint that leans may carry what an upright one does not: start by name
    known = dict(zip(found.model.names, found.z.tolist(), strict=True))
    return estimate(model, robust=robust, start=np.array([known.get(name, 0.0) for name in model.names]))


def settled(fitted: Estimate) -> Scene:
    """The scene with its gravity moments where the arm was found to stand, sag included."""
    model = fitted.model
    return standing(model, model.deviations(fitted.z[model.slices[ARM]]))


def standing(model: Model, values: np.ndarray) -> Scene:
    """The scene with its gravity moments where the arm stands at deviations (P,), SI."""
    scene = model.scene
    delta = model.motion(np.arange(len(scene.q))).displacements(values)
    # the model starts from the drawing with the sag that the robot file knows, the statics from the drawing
    delta[:, 1:-1, 0] += scene.q - link_angles(scene.dataset.robot, scene.dataset.measurements.readings)
    return replace(scene, delta=delta)


def unit_weights(model: Model, z: np.ndarray) -> Weights:
    """Every contact fully, at its stated noise; that of the readings enters through the Jacobian at z."""
    joint = model.scene.dataset.noise.joint
    sigma = {}
    for block in model.blocks:
        own = np.tile(block.sigma, block.kind.rows)
        if joint > 0:
            coupling = model.scene.dataset.robot.link_from_reading
            slices = model.slices
            by = block.by_readings(model.deviations(z[slices[ARM]]), z[slices[block.target]], coupling)
            own = np.sqrt(own**2 + joint**2 * np.sum(by**2, axis=1))
        sigma[block.name] = own
    row = {block.name: np.ones(len(block.rows)) for block in model.blocks}
    return Weights(sigma, row, {block.group: 1.0 for block in model.blocks})


def linearise(model: Model, z: np.ndarray, weights: Weights) -> Linear:
    """Whitened residuals and Jacobian at z, in NumPy arrays."""
    count = sum(b.residuals for b in model.blocks) + sum(t.rows for t in model.ties)
    residual, jacobian, of_block, at = np.empty(count), np.zeros((count, model.size)), {}, 0
    arm = model.slices[ARM]
    values = model.deviations(z[arm])
    for block in model.blocks:
        own, mine = model.slices[block.target], slice(at, at + block.residuals)
        r, by_arm, by_target = block.linearise(values, z[own])
        whiten = weights.whitening(block)
        residual[mine] = r * whiten
        jacobian[mine, arm] = by_arm * model.sd * whiten[:, None]
        jacobian[mine, own] = by_target * whiten[:, None]
        of_block[block.name] = mine
        at = mine.stop
    for tie in model.ties:
        mine = slice(at, at + tie.rows)
        residual[mine], by = model.tied(tie, {name: z[model.slices[name]] for name in tie.variables})
        for name, slope in by.items():
            jacobian[mine, model.slices[name]] = slope
        at = mine.stop
    return Linear(residual, jacobian, of_block)


def solve(
    model: Model, weights: Weights, start: np.ndarray
) -> tuple[np.ndarray, Callable[[], np.ndarray], int]:
    """Levenberg-Marquardt on the factor graph: a factor a target, a prior a variable, the certificates.

    Returns
    -------
    z : np.ndarray, shape (D,)
    covariance : callable
        Computes the covariance of z, (D, D), from the graph's marginals.
    iterations : int
    """
    from factors.graph import Graph

    slices = model.slices
    graph = Graph()
    for name, own in slices.items():
        if own.stop > own.start:
            graph.variable(name, own.stop - own.start)
    variables = [name for name, own in slices.items() if own.stop > own.start]
    for block in model.blocks:
        add_block(graph, model, block, weights.whitening(block))
    add_ties(graph, model, variables)
    found, iterations = graph.solve({name: start[slices[name]] for name in variables})
    z = np.zeros(model.size)
    for name, value in found.items():
        z[slices[name]] = value
    return z, lambda: graph.covariance(variables), iterations


def add_block(graph: Graph, model: Model, block: Block, whiten: np.ndarray) -> None:
    """Add the stacked contacts of one target to a graph."""
    across = whiten[:, None]

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        arm = parts[0] if model.parameters else np.zeros(0)
        own = parts[-1] if block.size else np.zeros(0)
        r, by_arm, by_target = block.linearise(model.deviations(arm), own)
        slopes = []
        if model.parameters:
            by_arm *= model.sd
            by_arm *= across
            slopes.append(by_arm)
        if block.size:
            by_target *= across
            slopes.append(by_target)
        return r * whiten, slopes

    names = ([ARM] if model.parameters else []) + ([block.target] if block.size else [])
    graph.factor(names, block.residuals, function)


def add_ties(graph: Graph, model: Model, variables: list[str]) -> None:
    """Add the certificates that join at least one variable of the graph."""
    for tie in model.ties:
        free = [name for name in tie.variables if name in variables]
        if free:
            graph.factor(free, tie.rows, _tie_function(model, tie, free))


def _tie_function(model: Model, tie: Tie, free: list[str]) -> Function:
    known = dict.fromkeys(tie.targets, np.zeros(0))  # but for those that are free

    def function(*parts: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        r, by = model.tied(tie, known | dict(zip(free, parts, strict=True)))
        return r, [by[name] for name in free]

    return function


def estimate(model: Model, robust: bool = True, start: np.ndarray | None = None) -> Estimate:
    """Fit a model to its contacts.

    Parameters
    ----------
    model : Model
    robust : bool
        Leave outliers out.
    start : np.ndarray, shape (D,), optional
        Where to start; the drawing where not given.

    Outliers are sought with Student t weights, row by row, and then left out entirely, so that the
    covariance is that of the contacts that count. The noise scale of each group is estimated with the
    fit; the stated noise is worth `STATED_WORTH` contacts.

    Raises
    ------
    BayescalError
        Where no length is known, or the solution lies outside of what the model can say.
    """
    check_length(model)
    z = np.zeros(model.size) if start is None else start
    weights = unit_weights(model, z)
    z, covariance, iterations = solve(model, weights, z)
    weights = replace(unit_weights(model, z), scale=weights.scale)
    if robust:
        z, weights, more = _without_outliers(model, z, weights)
        iterations += more
    for _ in range(ROUNDS):
        z, covariance, more = solve(model, weights, z)
        iterations += more
        linear = linearise(model, z, weights)
        cov = covariance()
        rescaled, dof = _rescaled(model, weights, linear, cov)
        if max(abs(np.log(rescaled.scale[g] / weights.scale[g])) for g in weights.scale) < 1e-4:
            break
        weights = rescaled
    check_converged(linear, cov, z)
    check_within_reach(model, z)
    rejected = np.concatenate([b.rows[weights.row[b.name] == 0.0] for b in model.blocks])
    return Estimate(model, z, cov, weights, linear, iterations, np.unique(rejected), dof)


def leverages(linear: Linear, covariance: np.ndarray) -> np.ndarray:
    """Share of each residual's variance that the fit takes up, (R,)."""
    return np.einsum("ij,jk,ik->i", linear.jacobian, covariance, linear.jacobian, optimize=True)


def _groups(model: Model) -> dict[str, list[Block]]:
    out: dict[str, list[Block]] = {}
    for block in model.blocks:
        out.setdefault(block.group, []).append(block)
    return out


def _rescaled(
    model: Model, weights: Weights, linear: Linear, covariance: np.ndarray
) -> tuple[Weights, dict[str, float]]:
    """Noise scales that agree with the residuals, and the degrees of freedom they stand on."""
    taken = leverages(linear, covariance)
    scale, dof = {}, {}
    for group, blocks in _groups(model).items():
        at = [linear.of_block[b.name] for b in blocks]
        chi2 = sum(float(np.sum(linear.residual[s] ** 2)) for s in at) * weights.scale[group] ** 2
        count = sum(float(np.sum(weights.row[b.name])) * b.kind.rows for b in blocks)
        dof[group] = max(count - sum(float(np.sum(taken[s])) for s in at), 0.0)
        scale[group] = float(np.sqrt((STATED_WORTH + chi2) / (STATED_WORTH + dof[group])))
    return replace(weights, scale=scale), dof


def _row_sizes(model: Model, weights: Weights, z: np.ndarray) -> dict[str, np.ndarray]:
    """Residuals over the stated noise, one size a row (C,): the root mean square over a row's residuals."""
    out = {}
    arm = model.deviations(z[model.slices[ARM]])
    for block in model.blocks:
        r = block.residual(arm, z[model.slices[block.target]])
        r = r / weights.sigma[block.name].reshape(r.shape)
        out[block.name] = np.sqrt(np.mean(r**2, axis=0))
    return out


def _scatter(model: Model, sizes: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Robust noise scales by group: the median size of a row over that of normal noise."""
    out, every = {}, sum(b.residuals for b in model.blocks)  # a group has its share of the parameters
    for group, blocks in _groups(model).items():
        size = np.concatenate([sizes[b.name] / MEDIAN_SIZE[b.kind.rows] for b in blocks])
        count = sum(b.residuals for b in blocks)
        spare = max(count - model.size * count / every, 0.25 * count)
        out[group] = max(float(np.median(size)) * np.sqrt(count / spare), 1e-3)
    return out


def _without_outliers(model: Model, z: np.ndarray, weights: Weights) -> tuple[np.ndarray, Weights, int]:
    """Student t reweighting until the fit rests, then the rows beyond what their number explains left out."""
    iterations = 0
    count = sum(len(b.rows) for b in model.blocks)
    for _ in range(ROUNDS):
        sizes = _row_sizes(model, weights, z)
        scale = _scatter(model, sizes)
        row = {
            b.name: (TAIL + b.kind.rows) / (TAIL + b.kind.rows * (sizes[b.name] / scale[b.group]) ** 2)
            for b in model.blocks
        }
        weights = replace(weights, row=row, scale=scale)
        before = z
        z, _, more = solve(model, weights, z)
        iterations += more
        if np.max(np.abs(z - before)) < 1e-3:
            break
    for _ in range(4):
        sizes = _row_sizes(model, weights, z)
        scale = _scatter(model, sizes)
        limit = -ndtri(FALSE_REJECTIONS / 2 / count)
        row = {}
        for b in model.blocks:
            row[b.name] = (sizes[b.name] <= limit * scale[b.group]).astype(float)
        if all(np.array_equal(row[k], weights.row[k]) for k in row):
            break
        weights = replace(weights, row=row, scale=scale)
        z, _, more = solve(model, weights, z)
        iterations += more
    return z, weights, iterations


def check_length(model: Model) -> None:
    """Refuse a model in which nothing fixes the arm's size: it would shrink to fit, and report no error."""
    lengths = [p for p in model.parameters if p.unit == "m" and p.effect == "geometry" and p.nominal]
    if model.knows_length or not lengths:
        return
    # least squares of a common factor on the lengths, by their priors alone: a ball's radius is no yardstick
    size = sum(p.nominal**2 for p in lengths)
    sd = float(np.sqrt(sum((p.nominal * p.sd) ** 2 for p in lengths)) / size)
    if not sd < LARGEST_SCALE_SD:
        raise BayescalError(
            f"no length is known: the priors leave the size of the arm uncertain to {100 * sd:.2g} %, "
            "and a fit would shrink it",
            "dataset.yaml",
            "certify a distance between two fitted targets (certificates: parallel or distance), "
            "or keep the priors (--prior-width 1)",
        )


def check_converged(linear: Linear, covariance: np.ndarray, z: np.ndarray) -> None:
    """Refuse a solution that a Newton step would still move by a tenth of a standard deviation."""
    step = covariance @ (linear.jacobian.T @ linear.residual + z)
    left = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance)), initial=0.0))
    if not left < LARGEST_STEP:
        raise BayescalError(
            f"the fit stopped {left:.2g} standard deviations short of its optimum",
            "Levenberg-Marquardt",
            "check the robot file, the units of the readings and the targets' nominal places",
        )


def check_within_reach(model: Model, z: np.ndarray) -> None:
    """Refuse a solution with frames turned further than the chain's series, and any sane drawing, allow."""
    values = model.deviations(z[model.slices[ARM]])
    for value, p in zip(values, model.parameters, strict=True):
        if p.unit == "rad" and abs(value) > MAX_ANGLE and p.effect == "geometry":
            raise BayescalError(
                f"{p.name} would have to be {np.degrees(value):.0f} deg off its drawing",
                "robot",
                "check offset_deg, the signs of link_from_reading and the units of the readings",
            )
