"""Distances that must be accurate: their slopes by z, and the variance that no contact of a plan changes."""

from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.inverse import descend, to_points
from bayescal.dataset.types import Box
from bayescal.dataset.write import appended
from bayescal.effects import parameters_of
from bayescal.errors import BayescalError
from bayescal.model import ARM, Model
from bayescal.planning.pool import Linearised, Pool
from bayescal.predict import targets
from bayescal.predict.errors import evenly, far_pairs, slopes
from bayescal.probing.motions import Arm

CERTIFIED, VOLUME = "certified distances", "volume of interest"
REGION, POSES = "region of the contacts", "given poses"
"""What distances are between."""
POINTS = 40
"""Number of points of a volume between which distances are assessed."""
DRAWN = 400
"""Number of positions of a volume for which the arm is asked."""
VARIED = 0.3
"""Standard deviation, rad, of the joints about the poses of contacts, where a search of a pose begins."""
ASKED_SHARE = 0.5
"""Share of a volume out of reach, from which on it is noted."""


@dataclass(frozen=True)
class Goal:
    """K distances that must be accurate.

    Attributes
    ----------
    over : str
        `CERTIFIED`, `VOLUME`, `REGION` or `POSES`.
    slopes : np.ndarray, shape (K, D)
        m, by z of the model.
    probing : np.ndarray, shape (K,)
        m2: variance by the noise of the contacts that locate the ends, and by what remains of their priors.
    certificate : np.ndarray, shape (K,)
        m2: variance of the certified values with which the distances are compared.
    note : str
        What a user should know of them, or "".
    readings : np.ndarray, shape (N, n), optional
        rad, of the poses between which they are, if they are not between centres.
    pairs : np.ndarray, shape (K, 2), optional
        Of these poses.
    """

    over: str
    slopes: np.ndarray
    probing: np.ndarray
    certificate: np.ndarray
    note: str = ""
    readings: np.ndarray | None = None
    pairs: np.ndarray | None = None

    @property
    def fixed_variance(self) -> float:
        """Mean variance, m2, that does not depend on the plan."""
        return float(np.mean(self.probing + self.certificate))


def goals(pool: Pool, linear: Linearised) -> tuple[Goal, ...]:
    """The goals of a plan; the first is the one to report first.

    Certified distances between centres that validation contacts locate, if there are any; distances in the
    volume of interest or, without one, in the region of the candidates; distances between the given poses of
    the setup, with the tool of most candidates.

    Parameters
    ----------
    pool : Pool
    linear : Linearised

    Raises
    ------
    BayescalError
        If the volume is out of reach, or the poses are fewer than two positions.
    """
    box, session = pool.setup.volume, pool.session.measurements
    tool = int(np.bincount(session.tool[pool.candidates]).argmax())
    if box is not None:
        readings, note = _inside(pool, box, tool)
        volume = _between(VOLUME, linear, readings, note)
    else:
        rows = pool.candidates[session.tool[pool.candidates] == tool]
        volume = _between(REGION, linear, session.readings[rows[evenly(len(rows), POINTS)]])
    every = [certified(linear), volume]
    if len(pool.setup.poses):
        every.append(_between(POSES, linear, pool.setup.poses))
        if every[-1] is None:
            what, where = "the given poses are at a single position", "dataset.yaml: plan: poses_deg"
            raise BayescalError(what, where, "give poses at two positions or more")
    out = tuple(goal for goal in every if goal is not None)
    if not out:
        what = "all candidates are at a single position"
        raise BayescalError(what, pool.session.name, "enlarge the targets")
    return out


def certified(linear: Linearised) -> Goal | None:
    """Certified distances between centres, except those that the fit uses; None without any.

    A centre that is not calibrated on follows from its validation contacts: by the arm, their noise and the
    target's prior. Contacts are taken at the nominal target, so that none is an outlier.
    """
    model, scene = linear.model, linear.model.scene
    index = {t.name: k for k, t in enumerate(scene.dataset.targets)}
    used = [set(c.targets) for c in model.constraints]
    slopes_by, probing, certificate = [], [], []
    centres: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray] | None] = {}
    for c in scene.dataset.certificates:
        if c.kind != "distance" or any({*c.targets} <= pair for pair in used):
            continue
        for name in c.targets:
            if name not in centres:
                centres[name] = _centre(linear, index[name])
        a, b = (centres[name] for name in c.targets)
        if a is None or b is None:
            continue
        along = (a[0] - b[0]) / np.linalg.norm(a[0] - b[0])
        slopes_by.append(along @ (a[1] - b[1]))
        probing.append(along @ (a[2] + b[2]) @ along)
        certificate.append((c.u_distance or 0.0) ** 2)
    if not slopes_by:
        return None
    return Goal(CERTIFIED, np.array(slopes_by), np.array(probing), np.array(certificate))


def _centre(linear: Linearised, target: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Centre (3,), m, of a target, its slopes (3, D) by z, and its covariance (3, 3) at a known arm."""
    model, scene = linear.model, linear.model.scene
    name, kind = scene.dataset.targets[target].name, scene.declared[target]
    if not kind.centred:
        return None
    by = np.zeros((3, len(linear.z)))
    if name in model.block_of:
        block, part = model.block_of[name], model.slices[name]
        state = np.zeros((len(block.kind.sd), block.size))
        state[block.free, np.arange(block.size)] = block.sd
        by[:, part] = state[:3]
        return targets.centre_of(block, block.state(linear.z[part])), by, np.zeros((3, 3))
    rows, apart = (scene.rows_of(target, scene.rows(role)) for role in ("validate", "locate"))
    rows = apart if len(apart) and not kind.located else rows
    if not len(rows):
        return None
    block = targets.as_certified(scene, model.block(target, rows))
    z = np.zeros(block.size)
    noise = targets.noise_of(linear.estimate, block, z)
    t = targets.linearised_target(linear.estimate, block, z, noise, tool_sd=targets.unknown_tool(scene, rows))
    to_centre = t.to_state[:3]
    by[:, model.slices[ARM]] = to_centre @ t.by_arm
    scatter = to_centre @ t.scatter
    return t.centre, by, scatter @ scatter.T


def _between(over: str, linear: Linearised, readings: np.ndarray, note: str = "") -> Goal | None:
    """Distances between the TCP positions at some readings (N, n), rad; None if all are at one position."""
    model = _with_readings(linear.model, readings)
    motion = model.motion(len(model.scene.q) - len(readings) + np.arange(len(readings)))
    values = model.deviations(linear.z[linear.model.slices[ARM]])
    positions = motion.points(values)
    pairs = far_pairs(positions)
    if len(readings) < 2 or np.max(np.ptp(positions, axis=1)) < 1e-6:
        return None
    by = np.zeros((len(pairs), len(linear.z)))
    by[:, linear.model.slices[ARM]] = slopes(model, motion, values, pairs)
    none = np.zeros(len(pairs))
    return Goal(over, by, none, none, note, readings, pairs)


def _with_readings(model: Model, readings: np.ndarray) -> Model:
    """The model of the session with rows at some readings (N, n), rad, appended: at rest, without payload.

    All other columns are those of the first row to calibrate, so that a drift is the same in all of them.
    """
    scene, count = model.scene, len(readings)
    first = scene.rows("calibrate")[0]
    tools = scene.dataset.measurements.tool[scene.rows("calibrate")]
    tool, names = np.bincount(tools).argmax(), [f"goal {k}" for k in range(count)]
    changed = {"readings": readings, "velocity": 0.0, "payload": 0.0, "tool": tool}
    rows = appended(scene.dataset.measurements, np.full(count, first), changed, names)
    wide = replace(scene, dataset=replace(scene.dataset, measurements=rows))
    terms = {p.name: p.terms for p in parameters_of(model.effects, wide.circumstances())}
    parameters = tuple(replace(p, terms=terms[p.name]) for p in model.parameters)
    return Model(wide, model.effects, parameters, (), ())


def _inside(pool: Pool, box: Box, tool: int) -> tuple[np.ndarray, str]:
    """Readings (N, n), rad, at random positions of a volume that the arm reaches, and a note.

    Each search begins near the pose of a random candidate, so that the orientation varies as in probing.
    """
    rng = np.random.default_rng(0)
    dataset = pool.session
    arm = Arm(dataset.robot, dataset.tools[tool].centre)
    points = box.centre + rng.uniform(-0.5, 0.5, (DRAWN, 3)) * box.size
    starts = dataset.measurements.readings[rng.choice(pool.candidates, DRAWN)]
    starts = starts + VARIED * rng.standard_normal(starts.shape)
    angles, solved = descend(to_points(arm, points), arm.angles_of(starts), *arm.range)
    reached = arm.readings_of(angles[solved])[:POINTS]
    if len(reached) < 2:
        raise BayescalError("the volume of interest is out of reach", "dataset.yaml", "move or enlarge it")
    share = float(np.mean(solved))
    if share > ASKED_SHARE:
        return reached, ""
    return reached, f"the arm was found to reach only {100 * share:.0f} % of the volume of interest"
