"""Targets that were not fitted, located from their own rows, with their uncertainty.

All is linear at the estimate: a located target depends on the posterior of the arm, the noise of its rows
and its prior by constant slopes. Draws (`validation`) and covariances (`crossvalidation`) both use them.
Effects that act on a contact itself (lobing, the radius of the ball) are corrected.

Residuals of rows that were not fitted, and their slopes by the unknowns.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects.geometry import LOOSE
from bayescal.estimate import Estimate, unfitted, unit_weights
from bayescal.estimate.solver import factored, shared_errors, solved
from bayescal.model import ARM, Block, Model, with_parameters
from bayescal.model.scene import Scene
from bayescal.predict.locate import NO_SHIFTS, AmbiguousPositionError, Rows, UnlocatedError, locate

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class LocatedTarget:
    """A target located from R residuals of its own rows.

    Its m unknowns are its own part of z and, where unknown, the three shifts of the centre of the tool, all
    normalised by the prior standard deviation; P is the number of parameters of the arm.
    """

    block: Block  # of the rows that located it
    z: np.ndarray  # (size,)
    tool: np.ndarray  # (3,) m, shift of the tool's centre, where it is unknown
    tool_sd: float  # m, its prior; 0 where the tool is known
    noise: np.ndarray  # (R,) m, of the residuals
    gain: np.ndarray  # (m, R) 1/m, by an error of each residual
    by_arm: np.ndarray  # (m, P) by the arm's z
    by_prior: np.ndarray  # (m, m) by standard normals: uncertainty that remains from the prior
    by_shift: np.ndarray  # (m, 3) 1/m, by one shift of all ball centres in F0

    @property
    def by_noise(self) -> np.ndarray:
        """Slopes (m, R) by the noise of the rows, as standard normals."""
        return self.gain * self.noise

    @property
    def scatter(self) -> np.ndarray:
        """Factor (m, R + m) of the covariance of the unknowns at a known arm."""
        return np.column_stack([self.by_noise, self.by_prior])

    @property
    def state(self) -> np.ndarray:
        """State of the target (kind size,), m and rad."""
        return self.block.state(self.z)

    @property
    def centre(self) -> np.ndarray:
        """Position of its centre, (3,), m; of kinds that are declared `centred`."""
        return centre_of(self.block, self.state)

    @property
    def to_state(self) -> np.ndarray:
        """Slopes (kind size, m) of the state by the unknowns, m and rad."""
        out = np.zeros((len(self.block.kind.sd), len(self.by_arm)))
        out[self.block.free, np.arange(self.block.size)] = self.block.sd
        return out


def located_target(estimate: Estimate, block: Block, strict: bool = True) -> LocatedTarget:
    """Locate a target, and its tool where no fitted row used that tool.

    Parameters
    ----------
    estimate : Estimate
    block : Block
        The rows of the target that locate it.
    strict : bool
        As for `locate`.

    Raises
    ------
    BayescalError
        If the target cannot be located from these rows.
    """
    model = estimate.model
    tool_sd = unknown_tool(model.scene, block.rows)
    values = estimate.arm
    p, kind = block.seen(values), block.touched(values)
    noise = noise_of(estimate, block, np.zeros(block.size))
    shifts = by_tool(block, values, block.points(values)) if tool_sd else NO_SHIFTS
    rows = Rows(kind, p, noise.reshape(kind.rows, -1), shifts, tool_sd)
    solution, keep = locate(block.target, rows, strict)
    z, tool = solution.x[0, block.free] / block.sd, solution.tool[0]
    block = carrying(block, tool) if tool_sd else block
    return linearised_target(estimate, block, z, noise, np.tile(keep, kind.rows), tool, tool_sd)


def linearised_target(
    estimate: Estimate,
    block: Block,
    z: np.ndarray,
    noise: np.ndarray,
    keep: np.ndarray | float = 1.0,
    tool: np.ndarray | None = None,
    tool_sd: float = 0.0,
) -> LocatedTarget:
    """A target at a known state, with the slopes of that state by the arm, the noise and its prior.

    Parameters
    ----------
    estimate : Estimate
    block : Block
        Its rows, with the tool at its place.
    z : np.ndarray, shape (size,)
        The target's part of z.
    noise : np.ndarray, shape (R,)
        Of its residuals, m.
    keep : np.ndarray, shape (R,), optional
        1 for residuals that locate the target, 0 for others.
    tool, tool_sd
        Shift (3,) of the tool's centre and its prior standard deviation, m; not given where it is known.
    """
    _, by_arm, design, by_point = slopes_of(estimate, block, z, tool_sd)
    weighted = design.T * (keep / noise**2)
    factor = factored(weighted @ design + np.eye(design.shape[1]))
    gain = -solved(factor, weighted)
    by_prior = solved(factor, np.eye(len(weighted)))
    tool = np.zeros(3) if tool is None else tool
    return LocatedTarget(block, z, tool, tool_sd, noise, gain, gain @ by_arm, by_prior, gain @ by_point)


def slopes_of(
    estimate: Estimate, block: Block, z: np.ndarray, tool_sd: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Residuals of a target's rows at its z (size,), and their slopes.

    Returns
    -------
    residual : np.ndarray, shape (R,)
        m, or rad for orientations.
    by_arm : np.ndarray, shape (R, P)
        By the z of the arm.
    by_target : np.ndarray, shape (R, m)
        By the unknowns of the target, including those of its tool.
    by_point : np.ndarray, shape (R, 3)
        By a common shift of all ball centres in F0, m; zeros for orientations.
    """
    values = estimate.arm
    r, by_arm, by_target = block.linearise(values, z)
    seen = block.seen(values)
    u = block.by_point(block.state(z), seen)
    by_point = np.swapaxes(u, -1, -2).reshape(len(r), 3)
    if tool_sd:
        moved = by_tool(block, values, block.points(values))
        shifts = np.einsum("rkc,jkc->rcj", u, moved).reshape(len(r), 3)
        by_target = np.column_stack([by_target, shifts * tool_sd])
    return r, by_arm * estimate.model.sd, by_target, by_point


def centre_of(block: Block, state: np.ndarray) -> np.ndarray:
    """Centre (3,), m, of a `centred` target at a state (size,)."""
    return np.asarray(block.kind.describe(state)["centre"], float)


def as_certified(scene: Scene, block: Block) -> Block:
    """A block whose diameter has the standard uncertainty of its certificate; unchanged without one."""
    parts, u = [name for name, _ in block.kind.parts], certified_diameters(scene).get(block.target)
    if u is None or "diameter" not in parts:
        return block
    sd = np.array(block.kind.sd, float)
    sd[parts.index("diameter")] = u
    return replace(block, kind=replace(block.kind, sd=sd))  # type: ignore[type-var]


def noise_of(estimate: Estimate, block: Block, z: np.ndarray) -> np.ndarray:
    """Noise (R,) of a block that is not fitted, by the scale of its noise group; stated noise without one."""
    sub = replace(estimate.model, blocks=(block,), constraints=())
    z = np.concatenate([estimate.z[estimate.model.slices[ARM]], z])
    scale = {block.group: estimate.weights.scale.get(block.group, 1.0)}
    return 1.0 / replace(unit_weights(sub, z), scale=scale).whitening(block)


def by_readings(estimate: Estimate, block: Block) -> np.ndarray:
    """Residuals (R, n) by the standard errors that those of an image share, m; (R, 0) of other rows."""
    model = estimate.model
    if not model.scene.in_images[block.rows].all() or block.target not in model.slices:
        return np.zeros((block.residuals, 0))
    return estimate.weights.scale[block.group] * shared_errors(model, estimate.z, block)


def unknown_tool(scene: Scene, rows: np.ndarray) -> float:
    """Prior standard deviation of the tool centre, m; 0 if the arm has it, or it is known or not unique."""
    used = np.unique(scene.dataset.measurements.tool[rows])
    fitted = scene.rows("calibrate")
    of_arm = {*scene.dataset.measurements.tool[fitted].tolist(), *scene.tools_predicted(fitted)}
    if len(used) != 1 or used[0] in of_arm:
        return 0.0
    return tool_u(scene, used[0])


def tool_u(scene: Scene, tool: int) -> float:
    """Prior standard deviation of the centre of a tool, m."""
    stated = scene.dataset.tools[tool].u
    return LOOSE if stated is None else stated


def carrying(block: Block, shift: np.ndarray) -> Block:
    """A block with its tools shifted by (3,) m in the flange frame."""
    return replace(block, motion=block.motion.carrying(block.motion.tool + shift))


def by_tool(block: Block, values: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Change (3, 3, C) of the ball centres (axis 1) by the three shifts of the tool (axis 0)."""
    return np.stack([carrying(block, axis).motion.points(values) - p for axis in np.eye(3)])


@dataclass(frozen=True)
class RowPrediction:
    """R residuals of rows of one target, and the slopes from which they are predicted.

    In the order of `Block.linearise`; m, or rad for orientations.
    """

    block: Block
    residual: np.ndarray  # (R,) at the estimate
    noise: np.ndarray  # (R,) standard uncertainty of the measurement
    by_z: np.ndarray  # (R, D) slopes by the estimate's z
    target: LocatedTarget | None  # None where the target was fitted
    by_target: np.ndarray  # (R, m) slopes by the unknowns of a located target
    by_point: np.ndarray  # (R, 3) slopes by one shift of all ball centres, m

    @property
    def locates_target(self) -> bool:
        """Whether these rows located the target, so that its position depends on their noise."""
        t = self.target
        return t is not None and (self.block.name, *self.block.rows) == (t.block.name, *t.block.rows)

    @property
    def in_rows(self) -> np.ndarray:
        """The residuals as (rows of the kind, C)."""
        return self.residual.reshape(self.block.kind.rows, -1)


def predicted_rows(estimate: Estimate, block: Block, target: LocatedTarget | None = None) -> RowPrediction:
    """Rows (contacts, points or orientations) of a fitted target, or of the located `target`."""
    model = estimate.model
    arm = model.slices[ARM]
    if target is None:
        columns = model.slices[block.target]
        z, tool_sd = estimate.z[columns], 0.0
    else:
        z, tool_sd = target.z, target.tool_sd
        block = carrying(block, target.tool) if tool_sd else block
    r, by_arm, by_target, by_point = slopes_of(estimate, block, z, tool_sd)
    by_z = np.zeros((len(r), len(estimate.z)))
    by_z[:, arm] = by_arm
    if target is None:
        by_z[:, columns] = by_target
        by_target = by_target[:, :0]
    return RowPrediction(block, r, noise_of(estimate, block, z), by_z, target, by_target, by_point)


@dataclass(frozen=True)
class Prepared:
    """Linearised validation measurements and located targets of a session."""

    rows: tuple[RowPrediction, ...]  # of contacts and points, without spheres that were located
    located: Mapping[str, LocatedTarget]  # by name; spheres with their certified diameter
    loose: Mapping[str, LocatedTarget]  # spheres with their diameter as an unknown


def prepared(estimate: Estimate, loose: bool = False, strict: bool = True) -> Prepared:
    """Locate targets that were not fitted, and linearise all validation measurements.

    Parameters
    ----------
    estimate : Estimate
    loose : bool
        Also locate spheres with their diameter as an unknown.
    strict : bool
        Refuse a target with another position that is nearly as probable. A model level that only serves for
        comparison, such as the nominal arm, has errors of millimetres: there the most probable one is taken.

    Raises
    ------
    BayescalError
        If a target cannot be located from its rows.
    """
    scene, model = estimate.model.scene, estimate.model
    certified = certified_diameters(scene)
    rows = scene.rows("validate")
    by = dict(_located_apart(scene, model))
    out, located, free = [], {}, {}
    for t in map(int, np.unique(scene.dataset.measurements.target[rows])):
        name, target_rows = scene.dataset.targets[t].name, scene.rows_of(t, rows)
        if t not in by:
            out.append(predicted_rows(estimate, model.block(t, target_rows)))
            continue
        block = model.block(t, target_rows)
        apart = block if np.array_equal(by[t], target_rows) else model.block(t, by[t])
        located[name] = located_target(estimate, as_certified(scene, apart), strict)
        if not scene.declared[t].located:
            out.append(predicted_rows(estimate, block, located[name]))
        elif loose:
            free[name] = located_target(estimate, block, strict) if name in certified else located[name]
    return Prepared(tuple(out), located, free)


def leaving_out(dataset: Dataset, compute: Callable[[Dataset], Result]) -> tuple[Result, dict[str, str]]:
    """A result without the validation targets that cannot be located, and why, by target.

    Only the fitted arm shows most of these: the result is then computed again. Their rows get the role
    `locate`, which a target without validation rows does not use; numbers of rows are kept.

    Raises
    ------
    UnlocatedError
        If the target is needed: other rows are fitted to it, or it remains after that.
    """
    reasons: dict[str, str] = {}
    while True:
        try:
            return compute(dataset), reasons
        except UnlocatedError as error:
            m = dataset.measurements
            of_target = m.target == [t.name for t in dataset.targets].index(error.target)
            if error.target in reasons or np.any(m.role[of_target] == "calibrate"):
                raise
            reasons[error.target] = f"{error.what}: it validates nothing; {error.remedy}"
            dataset = replace(dataset, measurements=replace(m, role=np.where(of_target, "locate", m.role)))


def unlocated(estimate: Estimate) -> Iterator[UnlocatedError]:
    """Validation targets that cannot be located with the arm of an estimate, as errors."""
    scene, model = estimate.model.scene, estimate.model
    for t, rows in _located_apart(scene, model):
        try:
            located_target(estimate, as_certified(scene, model.block(t, rows)))
        except UnlocatedError as error:
            yield error


def check_located(scene: Scene) -> None:
    """Refuse targets whose rows leave two positions equally probable for any arm, before the arm is fitted.

    Only targets with no more values than unknowns are looked at: their residuals vanish whatever the arm, and
    the prior alone decides between two positions. All others are decided with the fitted arm.

    Raises
    ------
    AmbiguousPositionError
        With the target and the distance of the two positions.
    """
    model = with_parameters(scene, (), ())
    nominal = unfitted(model, np.zeros(model.size))
    for t, rows in _located_apart(scene, model):
        block = model.block(t, rows)
        if block.residuals > block.size:
            continue
        try:
            located_target(nominal, as_certified(scene, block))
        except AmbiguousPositionError:
            raise
        except UnlocatedError:  # a search that does not converge with the nominal arm may do so when fitted
            continue


def _located_apart(scene: Scene, model: Model) -> Iterator[tuple[int, np.ndarray]]:
    """Targets with validation measurements that are not fitted, and the rows that locate them."""
    rows = scene.rows("validate")
    for t in map(int, np.unique(scene.dataset.measurements.target[rows])):
        if scene.dataset.targets[t].name not in model.block_of:
            target_rows, apart = scene.rows_of(t, rows), scene.rows_of(t, scene.rows("locate"))
            yield t, target_rows if scene.declared[t].located or not len(apart) else apart


def certified_diameters(scene: Scene) -> dict[str, float]:
    """Standard uncertainty, m, of every diameter that a certificate states, by target."""
    stated = (c for c in scene.dataset.certificates if c.kind == "diameter")
    return {c.targets[0]: c.u_distance or 0.0 for c in stated}
