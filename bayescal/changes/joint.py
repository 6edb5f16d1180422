"""Sessions of one arm as one problem: what they share, and what may differ, as further parameters.

Targets and tools with equal entries are one target and one tool. A change is a parameter that acts in the
rows of one later session only: of the arm, an effect, the base against all targets, a target, a tool. The
estimate of all of them is the point of linearisation, so that no session is taken for outliers of another.
What changes do to distances and at given poses follows from slopes of the TCP.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.inverse import nearest, solutions
from bayescal.arm.motion import CERTIFICATE, Term
from bayescal.arm.transforms import AXES
from bayescal.dataset import Certificate, Dataset
from bayescal.dataset.join import joined
from bayescal.dataset.write import appended
from bayescal.effects import EFFECTS, Circumstances, Parameter, Session, parameters_of
from bayescal.effects.common import within
from bayescal.effects.location import ARM as WHOLE
from bayescal.effects.location import BASE, NUMBERED, PLACEMENT, TOOL, Site, face, joint
from bayescal.effects.vocabulary import Effect
from bayescal.errors import FAILURES, BayescalError
from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.estimate.estimate import settled
from bayescal.estimate.families import families, model_with, with_compliances
from bayescal.estimate.widths import with_widths
from bayescal.model import with_parameters
from bayescal.model.options import FitOptions
from bayescal.model.scene import Scene
from bayescal.programs.text import Target
from bayescal.programs.tools import nominal_arm
from bayescal.statistics import grouped

ZERO = {"rz": ("theta", "rad", 2e-3), "tz": ("d", "m", 1e-3)}
"""Zero of a joint that no parameter of the model has: name, unit, standard deviation (as of other joints)."""
MOVED = {"t": 1e-3, "r": 2e-3}
"""m and rad: usual change of a base or target (assumed); far smaller than the prior of its place."""
SCATTERED = 0.2
"""Share of outliers among the rows of a target in a session from which on it is not compared (assumed)."""
POSES = 4
"""Fits with gravity at the pose of the fit before."""


@dataclass(frozen=True)
class Item:
    """Something that may differ between sessions: parameters that change together."""

    name: str
    effect: str
    site: Site
    kind: str  # arm, effect, setup or unknown
    parameters: tuple[Parameter, ...]  # with the prior of a change


@dataclass(frozen=True)
class Joint:
    """Sessions fitted together, each later one with changes of its own, and all items that may change."""

    dataset: Dataset
    sessions: tuple[Session, ...]
    estimate: Estimate
    circumstances: Circumstances  # of the estimate, with sessions
    items: tuple[Item, ...]
    placed: frozenset[str]  # names of targets that sessions share
    scattered: frozenset[str]  # those of them of which many rows are outliers: they moved within a session

    @property
    def names(self) -> tuple[str, ...]:
        """Of the sessions."""
        return tuple(s.name for s in self.sessions)


def tied(dataset: Dataset) -> tuple[Dataset, frozenset[str]]:
    """Sessions joined, with targets of one name that all entries describe alike as one target.

    Returns
    -------
    Dataset
    frozenset of str
        Names of the targets that were made one.
    """
    names = [t.name.partition(":")[2] for t in dataset.targets]
    stated = {name: [k for k, other in enumerate(names) if other == name] for name in names}
    first, shared = list(range(len(dataset.targets))), dict[str, str]()
    for name, places in stated.items():
        one, *others = (dataset.targets[k] for k in places)
        if others and all(_same(one, t) for t in others):
            first = [places[0] if k in places else f for k, f in enumerate(first)]
            shared |= {dataset.targets[k].name: name for k in places}
    kept = sorted(set(first))
    targets = tuple(replace(t, name=shared.get(t.name, t.name)) for k in kept for t in [dataset.targets[k]])
    certificates: dict[tuple[object, ...], Certificate] = {}
    for session in dataset.sessions:
        for c in session.certificates:  # of one target in several sessions, one counts once
            names_of = tuple(shared.get(f"{session.name}:{t}", f"{session.name}:{t}") for t in c.targets)
            certificates.setdefault((c.kind, names_of, c.distance), replace(c, targets=names_of))
    m = dataset.measurements
    index = np.array([kept.index(f) for f in first])
    every, measured = tuple(certificates.values()), replace(m, target=index[m.target])
    alike = replace(dataset, targets=targets, certificates=every, measurements=measured)
    return alike, frozenset(shared.values())


def _same(one: object, other: object) -> bool:
    keys = ("kind", "u", "u_angle", "texts")
    a, b = one.values, other.values  # type: ignore[attr-defined]
    return all(getattr(one, k) == getattr(other, k) for k in keys) and all(
        np.array_equal(np.asarray(a[k]), np.asarray(b[k]), equal_nan=True) for k in a
    )


def prepared(
    sessions: Sequence[Dataset], effects: tuple[str, ...], remounted: bool = False, robust: bool = True
) -> Joint:
    """Fit sessions of one arm together, with every change that a later session may have.

    Parameters
    ----------
    sessions : sequence of Dataset
        Two or more, in the order of time.
    effects : tuple of str
        The model that they share.
    remounted : bool
        Every session has tools of its own.
    robust : bool
        Exclude outliers.

    Raises
    ------
    BayescalError
        If they are not of one arm, or the model cannot be fitted.
    """
    if len(sessions) < 2:
        remedy = "name two dataset folders or more, in the order of time"
        raise BayescalError("a change needs two sessions", "", remedy)
    dataset, placed = tied(joined(sessions, remounted, own_noise=False))
    ends = np.cumsum([len(s.measurements.ids) for s in dataset.sessions])
    row = np.arange(ends[-1])
    parts = tuple(
        Session(s.name, (row < end) & (row >= end - len(s.measurements.ids)), False)
        for s, end in zip(dataset.sessions, ends, strict=True)
    )
    m = dataset.measurements
    fitted = [set(m.target[s.rows & (m.role == "calibrate")].tolist()) for s in parts]
    placed = frozenset(
        t.name
        for k, t in enumerate(dataset.targets)
        if t.name in placed and sum(k in targets for targets in fitted) > 1
    )
    scene, values, rejected = Scene(dataset, oriented=True), dict[str, float](), None
    options = _with_fitted_widths(scene, effects, FitOptions(robust=robust))
    for _ in range(POSES):
        c = replace(scene.circumstances(scene.rows("calibrate")), sessions=())
        shared = parameters_of(effects, c)
        compared = [p for p in shared if _sessions(p, parts, c.fitted) != 1]
        items = list(_of_model(c, compared, dataset, placed))
        model = with_parameters(scene, effects, (*map(options.wider, shared), *changes(items, parts)))
        start = np.array([values.get(name, 0.0) for name in model.names])
        fit = estimate(model, robust, start if values else None, rejected)
        values, rejected = dict(zip(model.names, fit.z.tolist(), strict=True)), fit.rejected
        if scene.moments is None:
            break
        scene = settled(fit)
    c = replace(with_compliances(scene.circumstances(scene.rows("calibrate")), fit), sessions=parts)
    items += _of_effects(replace(c, sessions=()), {p.name for p in shared}, effects)
    items += _unknown(c)
    out = np.isin(np.arange(len(row)), fit.rejected)
    scattered = {
        t.name
        for k, t in enumerate(dataset.targets)
        for s, targets in zip(parts, fitted, strict=True)
        if k in targets and np.mean(out[s.rows & (m.target == k) & (m.role == "calibrate")]) > SCATTERED
    }
    return Joint(dataset, parts, fit, c, tuple(items), placed, placed & scattered)


def _with_fitted_widths(scene: Scene, effects: tuple[str, ...], options: FitOptions) -> FitOptions:
    """Options with the prior widths that a fit of all sessions tells; those of changes stay.

    What the parameters of the arm may not explain is a model error, which differs where poses do.
    """
    try:
        return with_widths(calibrated(scene, effects, options), scene, effects, options)[1]
    except FAILURES:  # without changes the sessions may not be fitted together
        return options


def changes(items: Sequence[Item], parts: Sequence[Session]) -> list[Parameter]:
    """Parameters of changes, session after session without the first."""
    return [within(p, s) for s in parts[1:] for item in items for p in item.parameters]


def _sessions(p: Parameter, parts: Sequence[Session], fitted: np.ndarray) -> int:
    """Number of sessions in whose fitted rows a parameter acts: of one alone it is no change."""
    acts = np.any([np.broadcast_to(t.driver, parts[0].rows.shape) != 0 for t in p.terms], axis=0)
    return sum(bool(np.any((acts & s.rows)[fitted])) for s in parts)


def _change(p: Parameter) -> Parameter:
    """A parameter as a change of its value: zero without one."""
    return replace(p, nominal=0.0, mean=None, positive=False, effect="change")


def _of_model(
    c: Circumstances, shared: Sequence[Parameter], dataset: Dataset, placed: frozenset[str]
) -> Iterator[Item]:
    """Parameters of the model, joint zeros that it does not have, base, targets and tools."""
    constant = {(t.frame, t.axis) for p in shared for t in p.terms if np.ndim(t.driver) == 0}
    several = len({p.name.rpartition(" ")[0] for p in shared if p.site == TOOL}) > 1

    def label(p: Parameter) -> str:
        if p.site.kind in NUMBERED:
            return p.name
        return p.name.rpartition(" ")[0] if p.site == TOOL and several else str(p.site)

    for (name, effect), group in grouped(((label(p), p.effect), p) for p in shared).items():
        if group[0].site == BASE and group[0].driver.kind != "moment":
            continue
        kind = "arm" if group[0].site.kind in NUMBERED else "setup"
        yield Item(name, effect, group[0].site, kind, tuple(map(_change, group)))
    of = next((p.effect for p in shared if p.site.kind == "joint" and p.unit == "rad"), "")
    for j, axis in enumerate(c.robot.axes, start=1):
        if (j, axis) not in constant:
            letter, unit, sd = ZERO[axis]
            zero = Parameter(f"{letter}{j}", unit, (Term(j, axis),), sd, site=joint(j))
            yield Item(zero.name, of, joint(j), "arm", (_change(zero),))
    if placed:
        yield Item("base", PLACEMENT, BASE, "setup", tuple(_rigid("base", BASE, 1.0)))
    for k, t in enumerate(dataset.targets):
        if t.name in placed and len(placed) > 1:
            rows = (dataset.measurements.target == k).astype(float)
            yield Item(t.name, PLACEMENT, face(t.name), "setup", tuple(_rigid(t.name, face(t.name), rows)))


def _rigid(name: str, site: Site, rows: np.ndarray | float) -> Iterator[Parameter]:
    """A displacement of the base in some rows: that of the targets of these, reversed."""
    for axis in AXES:
        unit, sd = "m" if axis[0] == "t" else "rad", MOVED[axis[0]]
        label = f"{name} {axis.removeprefix('t')}"
        yield Parameter(label, unit, (Term(0, axis, rows),), sd, site=site, effect=PLACEMENT)


def listed(c: Circumstances, effects: tuple[str, ...]) -> Iterator[tuple[Effect, list[Parameter]]]:
    """Effects of the list that a model does not have and that an arm keeps from session to session."""
    for effect in EFFECTS.values():
        if effect.name in effects or effect.of_session or effect.missing(c):
            continue
        parameters = [p for p in effect.at(c) if all(t.frame != CERTIFICATE for t in p.terms)]
        if parameters:
            yield effect, parameters


def _of_effects(c: Circumstances, model_names: set[str], effects: tuple[str, ...]) -> Iterator[Item]:
    for effect, parameters in listed(c, effects):
        others = (p for p in parameters if p.name not in model_names)
        for site, group in grouped((WHOLE if effect.whole else p.site, p) for p in others).items():
            yield Item(f"{effect.name} {site}", effect.name, site, "effect", tuple(map(_change, group)))


def _unknown(c: Circumstances) -> Iterator[Item]:
    """Smooth functions of generic drivers: a change that no parameter or effect has."""
    for family in families(replace(c, sessions=())):
        by_driver = grouped(((p.site, str(p.driver)), p) for p in family.parameters)
        for (site, driver), group in by_driver.items():
            if "time" not in driver and "temperature" not in driver:
                yield Item(f"{driver} at {site}", "unknown", site, "unknown", tuple(map(_change, group)))


AT = "at"
"""Role of poses that are given: they are neither fitted nor validated."""
STEP = 1e-2
"""Of a parameter, in prior standard deviations, for its slopes."""
PAIRS, DRAWS = 3000, 400
"""Pairs of poses whose distances are compared, and draws for their u."""


@dataclass(frozen=True)
class DistanceChange:
    """Change of the distances between poses; m."""

    rms: float
    u_rms: float
    largest: float
    u_largest: float


@dataclass(frozen=True)
class Shift:
    """Displacement of the TCP in F0 at a given pose, m; `reason` why there is none."""

    where: str
    shift: np.ndarray | None = None  # (3,)
    covariance: np.ndarray | None = None
    reason: str = ""


def tcp_slopes(joint: Joint, parameters: Sequence[tuple[Parameter, bool]]) -> np.ndarray:
    """Displacements (K, 3, N), m, of the TCP in all rows by a prior standard deviation of parameters.

    Zero for parameters of which they are not wanted.
    """
    wanted = [p for p, used in parameters if used]
    wide, _, _ = model_with(joint.estimate.model, wanted)
    motion = wide.motion(np.arange(len(joint.estimate.model.scene.q)))
    values = np.append(joint.estimate.arm, np.zeros(len(wanted)))
    out, still = np.zeros((len(parameters), 3, len(joint.estimate.model.scene.q))), motion.points(values)
    places = np.flatnonzero([used for _, used in parameters])
    for k, (index, p) in enumerate(zip(places, wanted, strict=True), start=len(joint.estimate.arm)):
        step = STEP * p.sd * np.eye(len(values))[k]
        out[index] = (motion.points(values + step) - still) / STEP
    return out


def distance_slopes(points: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Changes (K, pairs), m, of distances between random pairs of points (3, N) moved by `by` (K, 3, N)."""
    a, b = np.random.default_rng(0).integers(points.shape[1], size=(2, PAIRS))
    apart = points[:, a] - points[:, b]
    size = np.linalg.norm(apart, axis=0)
    a, b, apart = a[size > 0], b[size > 0], apart[:, size > 0] / size[size > 0]
    return np.einsum("kcp,cp->kp", by[:, :, a] - by[:, :, b], apart)


def distance_change(by: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> DistanceChange:
    """Change of distances with slopes (K, pairs) by K amplitudes of a mean (K,) and covariance (K, K)."""
    draws = drawn(mean, covariance) @ by
    value = mean @ by
    most = int(np.argmax(np.abs(value)))
    rms, spread = np.sqrt(np.mean(value**2)), np.std(np.sqrt(np.mean(draws**2, axis=1)))
    return DistanceChange(float(rms), float(spread), float(value[most]), float(np.std(draws[:, most])))


def drawn(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Draws (DRAWS, K) of amplitudes."""
    return np.random.default_rng(0).multivariate_normal(mean, covariance, DRAWS, method="eigh")


def with_poses(dataset: Dataset, targets: Sequence[Target]) -> tuple[Dataset, list[str]]:
    """A session with rows at given poses, by the nominal arm; and for each of these why it has no row, or "".

    Raises
    ------
    BayescalError
        For a tool that the session does not have.
    """
    if not targets:
        return dataset, []
    m, names = dataset.measurements, [t.name for t in dataset.tools]
    readings, tools, kept, reasons = [], [], [], []
    for target in targets:
        if target.tool is not None and target.tool not in names:
            what = f"there is no tool `{target.tool}`"
            raise BayescalError(what, target.where, f"known: {', '.join(names)}")
        tool = names.index(target.tool) if target.tool else int(np.bincount(m.tool).argmax())
        reading = target.readings
        if target.pose is not None:
            arm = nominal_arm(dataset.robot, dataset.tools[tool])
            near = m.readings[:1] if reading is None else reading[None]
            every = solutions(arm, target.pose[None], near[None, :1])[0]
            reading = nearest(arm, every, m.readings if reading is None else near)
        reasons.append("" if reading is not None else "the nominal arm does not reach it")
        if reading is not None:
            readings.append(reading)
            tools.append(tool)
            kept.append(target)
    if not kept:
        return dataset, reasons
    still = np.zeros(dataset.robot.n)
    velocity = [still if t.velocity is None else t.velocity for t in kept]
    given = {"readings": readings, "tool": tools, "velocity": velocity, "repeat": "", "stop": ""}
    if m.payload is not None:
        given["payload"] = [t.payload for t in kept]
    ids = [f"{AT} {k}" for k in range(1, len(kept) + 1)]
    longer = appended(m, np.full(len(kept), len(m.ids) - 1), given, ids)
    role = np.append(m.role, [AT] * len(kept))
    return replace(dataset, measurements=replace(longer, role=role)), reasons
