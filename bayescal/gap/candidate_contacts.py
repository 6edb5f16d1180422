"""Candidate contacts of advice: contacts of a session repeated under other conditions, linearised.

Of a point that is measured with its orientation, only the point is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from bayescal.arm.chain import by_joints, wrenches
from bayescal.arm.statics import Stance
from bayescal.dataset import Dataset, Measurements
from bayescal.dataset.write import appended
from bayescal.effects import EFFECTS, Parameter, parameters_of
from bayescal.effects.gravity import masses
from bayescal.effects.selection import in_proportion
from bayescal.effects.vocabulary import Setting
from bayescal.estimate import Estimate
from bayescal.estimate.families import with_compliances
from bayescal.gap.linear.evidence import project
from bayescal.gap.search.beam import COMPLIANCE, Hypothesis, Member
from bayescal.gap.search.candidates import Candidates, Variant
from bayescal.gap.settings import DESIGN
from bayescal.model import ARM, Block, Model
from bayescal.model.model import length_blocks, main_group
from bayescal.model.scene import Scene
from bayescal.predict.locate import Rows, locate
from bayescal.predict.targets import as_certified, centre_of
from bayescal.statistics import grouped

AGAIN = "the same poses again"


@dataclass(frozen=True)
class Intervention:
    """Candidate contacts: rows of the session with the same poses (C,), their own rows (C,)."""

    what: str
    source: np.ndarray
    rows: np.ndarray


def widened(scene: Scene, rows: np.ndarray) -> tuple[Dataset, list[Intervention]]:
    """The session with candidate contacts appended, by intervention, at the poses of some rows.

    The first intervention, `AGAIN`, repeats the poses without a change. All except those from a cold start
    are at the end of the session. They stay within its times and temperatures, whose range defines drifts.
    Their role is not to calibrate, so that results from the fitted measurements do not change.
    """
    m = scene.dataset.measurements
    late = {k: getattr(m, k)[-1] for k in ("time", "temperature") if getattr(m, k) is not None}
    if m.time is not None:
        late["time"] = m.time.max()
    choices: list[tuple[str, np.ndarray, Mapping[str, Any]]] = [(AGAIN, rows, late)]
    if scene.dataset.robot.masses is not None and scene.measured_torques is None:  # these would not be known
        load = DESIGN.payload + (0.0 if m.payload is None else m.payload[rows])
        what = f"the same poses with {DESIGN.payload:g} kg additional payload"
        choices.append((what, rows, late | {"payload": load}))
    if m.velocity is not None:
        ways = turns(scene, rows)
        if ways:
            what = "the same poses, approached with joint motion in both directions about the stylus tip"
            velocity = np.concatenate([m.velocity[rows] + way for way in ways])
            choices.append((what, np.tile(rows, len(ways)), late | {"velocity": velocity}))
        what = f"the same poses at {DESIGN.faster:g} times the speed of contact"
        choices.append((what, rows, late | {"velocity": DESIGN.faster * m.velocity[rows]}))
    if m.time is not None and np.ptp(m.time) > 0:
        time = np.random.default_rng(0).uniform(m.time.min(), m.time.max(), len(rows))
        mixed = {"time": time}
        if m.temperature is not None:
            mixed["temperature"] = np.interp(time, m.time, m.temperature)
        choices.append(("the same poses in random order, from a cold start", rows, mixed))
    every = np.concatenate([source for _, source, _ in choices])
    further = len(m.role) + np.arange(len(every))
    each = np.split(further, np.cumsum([len(source) for _, source, _ in choices])[:-1])
    interventions = [Intervention(*of[:2], rows) for of, rows in zip(choices, each, strict=True)]
    columns = {name for _, _, changed in choices for name in changed} | {"payload"}
    changed = {name: np.concatenate([_values(m, name, *c[1:]) for c in choices]) for name in columns}
    ids = [f"possible {k}" for k in further]
    return replace(scene.dataset, measurements=appended(m, every, changed, ids)), interventions


def _values(m: Measurements, name: str, source: np.ndarray, changed: Mapping[str, Any]) -> np.ndarray:
    """A column of some rows of a session, with new values where they are given."""
    column = getattr(m, name)
    values = np.zeros(len(source)) if column is None else column[source]
    return np.broadcast_to(changed[name], values.shape) if name in changed else values


def turns(scene: Scene, rows: np.ndarray) -> list[np.ndarray]:
    """Velocities of the readings (C, n), rad/s, that rotate the arm about a resting ball, where possible.

    Two motions, each in both directions: that which reverses most of the recorded velocities, and another.
    A mere reversal of the velocities is not possible: the ball would leave the surface.
    """
    m, robot = scene.dataset.measurements, scene.dataset.robot
    assert m.velocity is not None
    q, tools = scene.q[rows], scene.tools[rows]
    still = np.zeros((len(rows), robot.n + 2, 6))
    along = [np.broadcast_to(u, (len(rows), 3)) for u in np.eye(3)]
    every = (wrenches(scene.chain, q, tools, still, u) for u in along)
    by = [by_joints(scene.chain, w) @ robot.link_from_reading for w in every]
    jacobian = np.stack(by, axis=1)  # (C, 3, n)
    free = np.eye(robot.n) - np.linalg.pinv(jacobian) @ jacobian
    recorded = m.velocity[rows]
    size = DESIGN.turning * np.linalg.norm(recorded, axis=1, keepdims=True)
    out: list[np.ndarray] = []
    for wish in (-np.sign(recorded), np.random.default_rng(1).standard_normal(recorded.shape)):
        way = (free @ wish[..., None])[..., 0]
        length = np.linalg.norm(way, axis=1, keepdims=True)
        if np.median(length) < DESIGN.still:
            return []
        way = size * way / np.maximum(length, DESIGN.still)
        out += [way, -way]
    return out


SPHERES = "no new contacts: fit those on the certified spheres too (role calibrate)"


@dataclass
class PairSide:
    """A pair of hypotheses: the first is true, its rival is the model; lambda grows contact by contact.

    `design` (R, D) and `x` (R,), whitened, are columns of the rival and the true residuals at the contacts.
    """

    strength: float  # lambda
    covariance: np.ndarray  # (D, D)
    absorbed: np.ndarray  # (D,) part of the true residuals that the rival absorbs
    design: np.ndarray
    x: np.ndarray

    def __post_init__(self) -> None:
        self.variance = np.sum(self.design @ self.covariance * self.design, axis=1)
        self.error = self.x - self.design @ self.absorbed

    def add(self, rows: np.ndarray) -> None:
        """Add the residuals of a contact."""
        gain = self.covariance @ self.design[rows].T
        by = np.linalg.cholesky(np.eye(len(rows)) + self.design[rows] @ gain)
        white = solve_triangular(by, gain.T, lower=True)
        wrong, across = solve_triangular(by, self.error[rows], lower=True), self.design @ white.T
        self.strength += float(wrong @ wrong)
        self.error -= across @ wrong
        self.variance -= np.sum(across**2, axis=1)
        self.covariance = self.covariance - white.T @ white


@dataclass(frozen=True)
class Possible:
    """The contacts of an intervention, linearised: R residuals whitened by their stated noise.

    `by_targets` (R, E) are slopes by the states of targets that are not in the fitted model, `spread` (E, E)
    is the prior of these states.
    """

    what: str
    pose: np.ndarray  # (contacts,) row of the session
    contact: np.ndarray  # (R,)
    design: np.ndarray  # (R, D) by the fitted model, and by the stated masses
    used: np.ndarray  # (K,) candidates, ascending
    pool: np.ndarray  # (R, K)
    by_targets: np.ndarray
    spread: np.ndarray
    velocity: np.ndarray | None = None  # (contacts, n) rad/s
    payload: np.ndarray | None = None  # (contacts,) kg
    measured: bool = False  # already: only to be fitted

    def side(self, true: Hypothesis, rival: Hypothesis) -> PairSide | None:
        """The effects of `true` that its rival lacks, as the truth; None without such effects."""
        beyond = [m.variant.columns for m in true.members if m.effect not in rival.names]
        if not beyond:
            return None
        columns, state = np.concatenate(beyond), rival.state
        amplitude = true.state.amplitudes_of(columns)
        seen = project(state, state.problem.pool[:, columns])
        rivals = self.pool[:, np.searchsorted(self.used, state.columns)] * state.scales
        return PairSide(
            float(amplitude @ seen.information(np.arange(len(columns))) @ amplitude),
            block_diag(state.covariance, self.spread),
            np.append(seen.solved @ amplitude, np.zeros(len(self.spread))),
            np.column_stack([self.design, rivals, self.by_targets]) / state.kappa,
            self.pool[:, np.searchsorted(self.used, columns)] @ amplitude / state.kappa,
        )

    def differs(self, other: Possible, a: Hypothesis, b: Hypothesis) -> bool:
        """Whether the columns of a pair differ between an intervention and the same contacts of another."""
        count = len(other.contact)
        if len(self.spread) or len(self.contact) < count:
            return True
        columns = np.searchsorted(self.used, np.union1d(a.state.columns, b.state.columns))
        changed = (self.pool[:count] - other.pool)[:, columns], self.design[:count] - other.design
        return any(np.max(np.abs(d), initial=0.0) > DESIGN.changed for d in changed)


def located(
    fitted: Estimate, wide: Model, target: int, values: np.ndarray
) -> tuple[Block, np.ndarray] | None:
    """A validation sphere or socket as a block of its own contacts, and its part of z at the solution.

    A certified diameter is fixed. None if it was touched by a tool that was not fitted, or has no contact.
    """
    scene = fitted.model.scene
    validated = scene.rows_of(target, scene.rows("validate"))  # without any, its rows may not locate it
    rows = scene.rows_of(target, scene.rows("validate", "locate")) if len(validated) else validated
    m = scene.dataset.measurements
    if not len(rows) or not np.isin(m.tool[rows], m.tool[scene.rows("calibrate")]).all():
        return None
    block = wide.block(target, rows)
    if not scene.declared[target].centred or not np.all(block.kind.sd[:3] > 0):
        return None
    block = as_certified(scene, block)
    sigma = np.tile(block.sigma, (block.kind.rows, 1))
    location, _ = locate(block.target, Rows(block.kind, block.motion.points(values), sigma))
    return block, location.x[0, block.free] / block.sd


def stated_masses(fitted: Estimate) -> list[Parameter]:
    """Errors of the stated masses that every hypothesis about the fitted rows may use, as in the search."""
    model = fitted.model
    if COMPLIANCE not in model.effects:
        return []
    return masses(with_compliances(model.scene.circumstances(model.scene.rows("calibrate")), fitted))


def possibilities(fitted: Estimate, candidates: Candidates, members: Sequence[Member]) -> list[Possible]:
    """All interventions, linearised at the estimate; the first is `AGAIN`."""
    model = fitted.model
    dataset, interventions = widened(model.scene, _poses(fitted))
    scene = Scene(dataset, _stands(model.scene, interventions), model.scene.oriented)
    c = with_compliances(scene.circumstances(scene.rows("calibrate")), fitted)
    parameters = _again(model.parameters, parameters_of(model.effects, c))
    fresh: dict[int, Parameter] = {}
    parts = (part for m in members for part in _parts(m.variant, candidates))
    for (effect, setting), mine in grouped(parts).items():
        columns = np.unique(np.concatenate(mine)).tolist()
        of_effect = EFFECTS[effect].at(c, setting)
        now = _again([candidates.pool[k] for k in columns], [*of_effect, *in_proportion(effect, of_effect)])
        fresh |= dict(zip(columns, now, strict=True))
    used, stated = np.array(sorted(fresh)), _again(stated_masses(fitted), masses(c))
    further = (*stated, *(fresh[k] for k in sorted(fresh)))
    wide = Model(scene, model.effects, (*parameters, *further), (), ())
    values = np.append(model.deviations(fitted.z[model.slices[ARM]]), np.zeros(len(further)))
    main = main_group(model)
    return [
        *(_linear(fitted, wide, values, intervention, used, main) for intervention in interventions),
        *_spheres(fitted, wide, values, used, main),
    ]


def _parts(v: Variant, candidates: Candidates) -> list[tuple[tuple[str, Setting], np.ndarray]]:
    """The effect with each single setting of a variant, and the columns of it."""
    if not isinstance(v.setting, tuple):
        return [((v.effect, v.setting), v.columns)]
    single = (one for one in candidates.variants[v.effect] if not isinstance(one.setting, tuple))
    return [((v.effect, o.setting), o.columns) for o in single if np.isin(o.columns, v.columns).all()]


def _linear(
    fitted: Estimate, wide: Model, values: np.ndarray, intervention: Intervention, used: np.ndarray, main: str
) -> Possible:
    model, target = fitted.model, wide.scene.dataset.measurements.target
    number, first = contacts_of(model.scene, intervention.source)
    count, contact, designs, pools = len(model.parameters), [], [], []
    for fit in length_blocks(model):
        candidates = np.flatnonzero(np.isin(intervention.source, fit.rows))
        if not len(candidates):
            continue
        rows = intervention.rows[candidates]
        block = wide.block(int(target[rows[0]]), rows)
        _, by_arm, by_target = block.linearise(values, fitted.z[model.slices[fit.target]])
        sigma = fitted.weights.sigma[fit.name].reshape(fit.kind.rows, -1)
        sigma = sigma[:, np.searchsorted(fit.rows, intervention.source[candidates])].reshape(-1, 1)
        sigma = sigma * fitted.weights.scale[fit.group] / fitted.weights.scale[main]
        by_arm = by_arm * wide.sd / sigma
        design, pool = _divided(by_arm, count, len(fitted.z), len(used))
        design[:, model.slices[fit.target]] = by_target / sigma
        contact.append(np.tile(number[candidates], block.kind.rows))
        designs.append(design)
        pools.append(pool)
    none = np.zeros((sum(map(len, contact)), 0)), np.zeros((0, 0))
    designs_of_all, pool = np.concatenate(designs), np.concatenate(pools)
    m, stated = wide.scene.dataset.measurements, model.scene.dataset.measurements
    first_rows = intervention.rows[first]
    loaded = m.payload is not None and (stated.payload is not None or np.any(m.payload[first_rows]))
    return Possible(
        intervention.what, intervention.source[first], np.concatenate(contact), designs_of_all, used, pool,
        *none,
        None if m.velocity is None else m.velocity[first_rows],
        m.payload[first_rows] if m.payload is not None and loaded else None,
    )  # fmt: skip


def _divided(by_arm: np.ndarray, count: int, size: int, used: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns (R, D) of the fitted model with the stated masses behind, and (R, K) of candidates."""
    masses = by_arm.shape[1] - count - used
    design = np.zeros((len(by_arm), size + masses))
    design[:, :count], design[:, size:] = by_arm[:, :count], by_arm[:, count : count + masses]
    return design, by_arm[:, count + masses :]


def _spheres(
    fitted: Estimate, wide: Model, values: np.ndarray, used: np.ndarray, main: str
) -> list[Possible]:
    """The validation contacts on spheres whose distances are certified, if any."""
    model, scene = fitted.model, fitted.model.scene
    certified = [c for c in scene.dataset.certificates if c.kind == "distance"]
    names = {name for c in certified for name in c.targets} - set(model.block_of)
    tried = ((name, located(fitted, wide, k, values)) for name, k in scene.index.items() if name in names)
    blocks = {name: of for name, of in tried if of is not None}
    if not blocks:
        return []
    starts = dict(zip(blocks, np.cumsum([0, *(b.size for b, _ in blocks.values())]), strict=False))
    size, count = sum(b.size for b, _ in blocks.values()), len(model.parameters)
    ratio = {g: s / fitted.weights.scale[main] for g, s in fitted.weights.scale.items()}
    rows: list[np.ndarray] = []
    contact, by_targets, arms, information = [], [], [], np.eye(size)
    for name, (block, z) in blocks.items():
        _, by_arm, by_target = block.linearise(values, z)
        sigma = np.tile(block.sigma, block.kind.rows)[:, None] * ratio.get(block.group, 1.0)
        by_state = np.zeros((block.residuals, size))
        by_state[:, starts[name] : starts[name] + block.size] = by_target / sigma * _tighter(block)
        contact.append(sum(map(len, rows)) + np.tile(np.arange(len(block.rows)), block.kind.rows))
        rows.append(block.rows)
        by_targets.append(by_state)
        arms.append(by_arm * wide.sd / sigma)
    for c in certified:
        if all(name in blocks for name in c.targets):
            apart = np.subtract(*(centre_of(b, b.state(z)) for b, z in (blocks[n] for n in c.targets)))
            constraint = np.zeros(size)
            for name, way in zip(c.targets, (1.0, -1.0), strict=True):
                sd = (blocks[name][0].sd * _tighter(blocks[name][0]))[:3]
                constraint[starts[name] : starts[name] + 3] = way * apart / np.linalg.norm(apart) * sd
            information += np.outer(constraint, constraint) / max(c.u_distance or 0.0, DESIGN.least_u) ** 2
    design, pool = _divided(np.concatenate(arms), count, len(fitted.z), len(used))
    return [
        Possible(
            SPHERES, np.concatenate(rows), np.concatenate(contact), design, used, pool,
            np.concatenate(by_targets), np.linalg.inv(information), measured=True,
        )
    ]  # fmt: skip


def _tighter(block: Block) -> np.ndarray:
    """Factors (size,) on a target's prior standard deviations, so that none exceeds `DESIGN.roughly`."""
    return np.minimum(block.sd, DESIGN.roughly) / block.sd


def _stands(scene: Scene, interventions: Sequence[Intervention]) -> Stance | None:
    """Stances in the rows of a session and of all interventions."""
    if scene.stance is None:
        return None
    return scene.stance.at_rows(np.concatenate([np.arange(len(scene.q)), *(v.source for v in interventions)]))


def _again(old: Sequence[Parameter], new: Sequence[Parameter]) -> list[Parameter]:
    """The same parameters with their drivers in the extended session."""
    terms = {p.name: p.terms for p in new}
    return [replace(p, terms=terms[p.name]) for p in old]


def _poses(fitted: Estimate) -> np.ndarray:
    """Fitted rows without outliers, each pose once, evenly over the session, at most `DESIGN.poses`.

    Of a camera all corners of these images.
    """
    scene = fitted.model.scene
    rows = np.setdiff1d(scene.rows("calibrate"), fitted.rejected)
    readings = scene.dataset.measurements.readings[rows].round(3)
    _, first, pose = np.unique(readings, axis=0, return_index=True, return_inverse=True)
    pose = pose.ravel()
    chosen = np.sort(first)
    chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, DESIGN.poses).round().astype(int))]
    kept = np.isin(np.arange(len(rows)), chosen)
    kept |= scene.in_images[rows] & np.isin(pose, pose[chosen])
    return rows[kept][np.argsort(first[pose[kept]], kind="stable")]  # all rows of an image together


def contacts_of(scene: Scene, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The contact of each row (C,), and the first row of each: successive rows of one image are one."""
    m = scene.dataset.measurements
    new = np.any(m.readings[rows[1:]] != m.readings[rows[:-1]], axis=1) | (rows[1:] <= rows[:-1])
    new |= ~scene.in_images[rows[1:]]
    first = np.append(True, new)[: len(rows)]
    return np.cumsum(first) - 1, np.flatnonzero(first)
