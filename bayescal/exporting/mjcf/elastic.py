"""The fitted parameters of an arm by their drivers, and the springs of those that gravity drives.

Springs stand at the joints, in bearings and links, and under the base. A torsional spring of any odd
characteristic is made of springs that simulators have: the torque is a polygon of the deflection. Where the
stiffness increases, a tendon with a dead band -w ... w adds a spring beyond it. Where it decreases, two
tendons under tension, each slack on one side, release each other at -w and w: together they have twice their
stiffness within, and once their stiffness beyond. All stiffnesses are positive: an implicit integrator can
use them, and the arm comes to rest in few steps.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import nnls

from bayescal.arm.statics import Loads
from bayescal.arm.transforms import AXES
from bayescal.effects import named
from bayescal.effects.common import alone, tilts, vertical
from bayescal.effects.compliance import BASE_COMPLIANCE
from bayescal.effects.gravity import BENDING, across, ends
from bayescal.effects.vocabulary import Circumstances, Parameter
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import at_state
from bayescal.fitted.arm import FittedArm

STATE = ("constant", "time", "temperature", "event")
"""Drivers that are constant while an arm moves: a file has their values in one row, its state."""
UNHELD = ("late", "level", "uneven", "smooth")
"""Forms of a dependence that no element of MuJoCo has: a memory of earlier rows, a curve of an angle,
a spring that differs between the signs of the torque, an error of a carriage by its position."""


@dataclass(frozen=True)
class Content:
    """Parameters of an arm with their values, as they apply in one row of its session.

    A common factor of several parameters is resolved into these. Parameters of other sessions are left out.
    """

    arm: FittedArm
    row: int

    @cached_property
    def circumstances(self) -> Circumstances:
        """The circumstances of the session's fitted measurements."""
        scene = self.arm.model.scene
        c = scene.circumstances(scene.rows("calibrate"))
        session = next((s for s in c.sessions if s.rows[self.row]), None)
        return c if session is None else alone(c, session)

    @cached_property
    def valued(self) -> tuple[tuple[Parameter, float], ...]:
        """Parameters and their deviations from nominal, SI."""
        scene, out = self.arm.model.scene, list[tuple[Parameter, float]]()
        sessions = scene.circumstances(np.zeros(0, int)).sessions if scene.dataset.sessions else ()
        others = tuple(f"{s.name}:" for s in sessions if not s.rows[self.row])
        for p, value in zip(self.arm.model.parameters, self.arm.values.tolist(), strict=True):
            if not p.name.startswith(others):
                out += [(part, value * part.centre) for part in p.stands_for] or [(p, value)]
        return tuple(out)

    def driven(self, *kinds: str) -> Iterator[tuple[Parameter, float]]:
        """Parameters with a driver of some kinds, and their values; none of a form in `UNHELD`."""
        held = ((p, value) for p, value in self.valued if p.driver.form not in UNHELD)
        return ((p, value) for p, value in held if p.driver.kind in kinds)

    def at(self, c: Circumstances, effects: Collection[str]) -> Iterator[Parameter]:
        """Parameters of some effects of the model in other circumstances."""
        for effect, setting in map(named, self.arm.effects):
            yield from effect.at(c, setting) if effect.name in effects else ()

    def constants(self, row: int | None = None) -> np.ndarray:
        """Constant displacements of the frames, (n + 2, 6), rad and m, in a row; default: the state."""
        state = self.row if row is None else row
        out = np.zeros((self.arm.model.scene.chain.n + 2, 6))
        for p, value in self.driven(*STATE):
            for term in at_state(p, state).terms:
                if term.frame >= 0:
                    out[term.frame, AXES.index(term.axis)] += value * float(term.driver)
        return out


KNOTS = (4, 8, 12, 16, 24, 32)
"""Numbers of corners that are tried in turn."""
CLOSE = 1.5e-7
"""Largest error, rad, of a deflection: 0.15 µm at one metre."""
LINEAR = 1e-12
"""Relative deviation from a straight line below which a characteristic is linear."""
SLACK = 1e3
"""rad: an edge that no deflection reaches."""


@dataclass(frozen=True)
class Band:
    """A spring that is slack from `lower` to `upper`, rad, and has a stiffness beyond, N m/rad."""

    lower: float
    upper: float
    stiffness: float

    def torque(self, x: np.ndarray) -> np.ndarray:
        """Restoring torque, N m, at deflections x, rad."""
        return self.stiffness * (np.maximum(x - self.upper, 0.0) - np.maximum(self.lower - x, 0.0))


@dataclass(frozen=True)
class Spring:
    """A linear spring, N m/rad, with further ones in parallel."""

    stiffness: float
    bands: tuple[Band, ...] = ()

    def torque(self, x: np.ndarray) -> np.ndarray:
        """Restoring torque, N m, at deflections x, rad."""
        return np.sum([self.stiffness * x, *(b.torque(x) for b in self.bands)], axis=0)

    @property
    def slope(self) -> float:
        """Stiffness at zero, N m/rad."""
        return self.stiffness + sum(b.stiffness for b in self.bands if not b.lower <= 0.0 <= b.upper)


def spring_of(torque: np.ndarray, deflection: np.ndarray) -> Spring:
    """The spring of a characteristic: deflections (G,), rad, at increasing torques (G,) above zero, N m.

    The deflection must increase with the torque: no spring has another characteristic.
    """
    assert np.all(np.diff(np.append(0.0, deflection)) > 0)
    if np.ptp(deflection / torque) <= LINEAR * deflection[-1] / torque[-1]:
        return Spring(1.0 / float(deflection[-1] / torque[-1]))
    slope = np.gradient(deflection, torque)
    for count in KNOTS:
        spring = _polygon(torque, deflection, slope, count)
        if np.max(np.abs(spring.torque(deflection) - torque) * slope) <= CLOSE:
            break
    return spring


def _polygon(torque: np.ndarray, deflection: np.ndarray, slope: np.ndarray, count: int) -> Spring:
    """Least squares in the deflection, with `count` corners where the characteristic bends most."""
    bend = np.sqrt(np.abs(np.gradient(slope, torque)))
    bend += 1e-3 * bend.max()
    spent = np.concatenate([[0.0], np.cumsum(0.5 * (bend[1:] + bend[:-1]) * np.diff(torque))])
    w = np.interp((np.arange(count) + 0.5) / count * spent[-1], spent, deflection)
    groups: list[tuple[Band, ...]] = [(Band(-half, half, 1.0),) for half in w]
    groups += [(Band(half, SLACK, 1.0), Band(-SLACK, -half, 1.0)) for half in w]
    columns = [deflection, *(sum(b.torque(deflection) for b in group) for group in groups)]
    a = np.array(columns).T * slope[:, None]
    scale = np.linalg.norm(a, axis=0)
    k = (nnls(a / scale, torque * slope)[0] / scale).tolist()
    each = zip(groups, k[1:], strict=True)
    used = ((b, stiffness) for group, stiffness in each for b in group if stiffness)
    return Spring(k[0], tuple(replace(b, stiffness=stiffness) for b, stiffness in used))


DAMPING = 0.02
"""Damping of a spring, s times its stiffness."""
BEYOND = 2.0
"""A spring holds up to this multiple of the largest torque of the session; beyond, it is extrapolated."""
LEAST = 0.05
"""Share of the compliance without load below which a nonlinear stiffness is not extrapolated further."""
STEPS = 1500
"""Torques at which a characteristic is evaluated."""


def joint_springs(content: Content) -> Mapping[int, Spring]:
    """Springs about the joint axes, by index: compliance, nonlinear stiffness and hysteresis together.

    Raises
    ------
    BayescalError
        For a deflection that does not increase with the torque.
    """
    scene, robot = content.arm.model.scene, content.arm.model.scene.dataset.robot
    if scene.moments is None:
        return {}
    nominal = np.zeros(robot.n) if robot.compliance is None else robot.compliance
    assert scene.loads is not None
    largest = BEYOND * np.max(np.abs(scene.loads.torques(robot.slides)), axis=0)
    share = np.linspace(0.0, 1.0, STEPS + 1)[1:] ** 2  # denser at small torques
    bent = [nominal[j] * largest[j] * share for j in range(robot.n)]
    for p, value in content.driven("torque"):
        j = p.site.number - 1
        torques = np.zeros((STEPS, robot.n))
        torques[:, j] = largest[j] * share
        bent[j] = bent[j] + value * _response(content, p, torques)
    out = {}
    for j, name in enumerate(robot.joint_names):
        if not np.any(bent[j]):
            continue
        torque = largest[j] * share
        slope = np.gradient(bent[j], torque)
        count = int(np.argmax(slope <= LEAST * slope[0])) if np.any(slope <= LEAST * slope[0]) else STEPS
        if slope[0] <= 0 or BEYOND * torque[count - 1] < largest[j]:
            parts = [p.name for p, _ in content.driven("torque") if p.site.number == j + 1]
            what = f"{name} turns against its torque, as fitted: {' + '.join(parts)}"
            remedy = f"no simulator has such a spring; leave a part out: --without '{parts[-1]}'"
            raise BayescalError(what, "export", remedy)
        out[j] = spring_of(torque[:count], bent[j][:count])
    return out


def _response(content: Content, p: Parameter, torques: np.ndarray) -> np.ndarray:
    """Driver (G,) of a parameter at torques (G, n), N m, of the joints.

    A joint that carries a torque only while the arm was deflected otherwise has no such parameter: zeros.
    """
    grid = appended(content.circumstances, torques)
    same = [q.terms for q in content.at(grid, {p.effect}) if q.name == p.name]
    if not same:
        return np.zeros(len(torques))
    (term,) = same[0]
    return np.asarray(term.driver)[-len(torques) :]


def appended(c: Circumstances, torques: np.ndarray) -> Circumstances:
    """The circumstances with rows of given torques (G, n), N m, that are not fitted; for torque drivers."""
    more = (0, len(torques))
    c = replace(c, q=np.pad(c.q, [more, (0, 0)]))
    if c.measured_torques is not None:
        return replace(c, measured_torques=np.vstack([c.measured_torques, torques]))
    assert c.loads is not None
    columns = [np.pad(column, [more, (0, 0), (0, 0)]) for column in (c.loads.moments, c.loads.weights)]
    for column in columns:  # torques about a joint, or forces along it
        column[-len(torques) :, 1:, 2] = torques
    return replace(c, loads=Loads(*columns))


ELASTIC = ("torque", "bending moment", "base moment")
"""Drivers of springs."""
CROSS = "cross"
"""The last word of a parameter that joins the tilts of the stand."""


def springless(arm: FittedArm) -> np.ndarray:
    """Parameters (P,) that no spring has: a negative compliance, and what else acts at its place.

    A rigid joint or stand has no spring either: what acts beside its compliance is left out.
    """
    values = zip(arm.model.parameters, arm.values.tolist(), strict=True)
    compliances = [(p, p.nominal + value) for p, value in values if p.positive]

    def least(p: Parameter) -> float:
        """The smallest compliance where a parameter acts; above zero if there is none."""
        here = (p.driver.kind, p.site)
        beside = [(q, v) for q, v in compliances if (q.driver.kind, q.site) == here]
        return min((v for q, v in beside if _spring(p) in (_spring(q), CROSS)), default=1.0)

    return np.array([
        p.driver.kind in ELASTIC and (least(p) < 0 or (least(p) == 0 and not p.positive))
        for p in arm.model.parameters
    ], bool)  # fmt: skip


def sprung(arm: FittedArm) -> FittedArm:
    """The arm without the parameters that no spring has."""
    off = springless(arm)
    return replace(arm, values=np.where(off, 0.0, arm.values)) if np.any(off) else arm


def _spring(p: Parameter) -> str:
    """What tells several springs at one site: the axis of a tilt of the stand, else the whole name."""
    if p.driver.kind == "base moment":
        return p.name.split()[-1]
    return "" if p.driver.kind == "torque" else p.name


def bearings(content: Content) -> Mapping[int, Spring]:
    """Springs transverse to the axes of the joints, by their index; those of both directions are equal."""
    driven = content.driven("bending moment")
    given = [(p, value) for p, value in driven if p.name.endswith("bearing") and value]
    return {p.site.number - 1: _positive(value, p.name) for p, value in given}


@dataclass(frozen=True)
class Hinge:
    """A hinge: unit axis and a point of it (3,), m, in the frame of what it carries, at zero.

    Without a spring it is a joint that the readings command, with limits, rad, if it has any. A spring has
    its zero at `reference`, rad. One that `slides` moves along its axis: m and N in place of rad and N m.
    """

    name: str
    axis: np.ndarray
    pos: np.ndarray
    spring: Spring | None = None
    reference: float = 0.0
    limits: tuple[float, float] | None = None
    slides: bool = False

    @property
    def damping(self) -> float:
        """Damping of the spring, N m s/rad."""
        return DAMPING * self.spring.slope if self.spring else 0.0

    @property
    def passed(self) -> Hinge:
        """The hinge between the same bodies, of which the other one is the parent."""
        return replace(self, axis=-self.axis)

    def seen(self, pose: np.ndarray, name: str = "") -> Hinge:
        """The hinge in another frame, in which its own has a pose (4, 4), and with another name."""
        axis, pos = pose[:3, :3] @ self.axis, pose[:3, :3] @ self.pos + pose[:3, 3]
        return replace(self, name=name or self.name, axis=axis, pos=pos)


def link_hinges(content: Content) -> Mapping[int, tuple[Hinge, ...]]:
    """Hinges at the middle of links that bend, called by their nearest axis, by the joint before the link."""
    chain = content.arm.model.scene.chain
    out: dict[int, tuple[Hinge, ...]] = {}
    compliances = {p.name: value for p, value in content.driven("bending moment") if value}
    for j, name in enumerate(content.arm.dataset.robot.joint_names):
        two = ends(chain, j + 1)
        out[j] = tuple(
            Hinge(axis, way, two.mean(axis=0), _positive(compliances[label], label))
            for axis, way in across(two).items()
            if (label := f"{BENDING.name} {name} link {axis}") in compliances
        )
    return out


def stand_hinges(content: Content) -> tuple[Hinge, ...]:
    """Hinges of the stand in F0, relative to the base's origin.

    A tilt with a slide is a rotation about an axis away from the origin.
    """
    values = {p.name.rpartition(":")[2]: value for p, value in content.driven("base moment")}
    if not any(values.values()):
        return ()
    c, e = content.circumstances, BASE_COMPLIANCE.name
    pair, up = tilts(c), vertical(c)
    axes = np.array([tilt.axis for tilt in pair])
    give = np.diag([values.get(f"{e} {tilt.name}", 0.0) for tilt in pair])
    moved = np.array([
        values.get(f"{e} slide {t.name}", 0.0) * t.across + values.get(f"{e} rise {t.name}", 0.0) * up
        for t in pair
    ])  # fmt: skip
    names = [tilt.name for tilt in pair]
    if cross := values.get(f"{e} cross", 0.0):
        give += cross * (1.0 - np.eye(2))
        moved += values.get(f"{e} slide cross", 0.0) * axes * [[1.0], [-1.0]]
        sizes, principal = np.linalg.eigh(give)
        # a moment about a principal axis tilts the stand about this axis alone
        axes, moved, give, names = principal.T @ axes, principal.T @ moved, np.diag(sizes), ["1", "2"]
    masses = 0.0 if c.robot.masses is None else float(np.sum(c.robot.masses))
    weight = (masses + float(c.load_mass[content.row])) * c.gravity
    out = []
    for name, axis, slide, compliance in zip(names, axes, moved, np.diag(give).tolist(), strict=True):
        if compliance == 0:  # rigid
            continue
        spring = _positive(compliance, f"{e} {name}")
        pos = -np.cross(slide / compliance, axis)  # axis x (origin - pos) is the slide per radian
        # the moment that acts is that about the base's origin, not about the hinge
        reference = compliance * float(axis @ np.cross(pos, weight))
        out.append(Hinge(f"stand_{name}", axis, pos, spring, reference))
    return tuple(out)


def _positive(compliance: float, name: str) -> Spring:
    if compliance <= 0:
        what = f"{name} is {1e6 * compliance:.3g} µrad/(N m): no spring has a compliance that is not positive"
        raise BayescalError(what, "export", "leave the effect out with --without")
    return Spring(1.0 / compliance)
