"""Effects of the list that act on load, base and transmission; each has several forms."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from analysis.world.motion.dynamics import PARTS, about_origin, regressor
from analysis.world.motion.log import GRAVITY, Act, Change, Log


def place(site: str, driver: str, name: str) -> list[dict]:
    """Return the location of an effect, as the ground truth states it."""
    return [{"site": site, "driver": driver, "effect": name}]


def direction(rng: np.random.Generator) -> np.ndarray:
    """Draw a unit vector (3,)."""
    v = rng.standard_normal(3)
    return v / np.linalg.norm(v)


def alone(log: Log, j: int, values: np.ndarray) -> np.ndarray:
    """Return values (rows,) at a joint, 0 at the others (rows, n)."""
    out = np.zeros_like(log.torque)
    out[:, j] = values
    return out


def scaled(
    name: str,
    form: str,
    where: list[dict],
    unit: str,
    most: float,
    shape: np.ndarray,
    log: Log,
    **detail: object,
) -> Act:
    """Return an effect whose torque is its size times a shape (rows, n), of either sign."""
    usual = float(np.min(log.noise.rms[None] / np.maximum(np.sqrt(np.mean(shape**2, axis=0)), 1e-12))) * 0.2
    return Act(
        name, form, where, unit, min(usual, most), most, lambda size: Change(size * shape), dict(detail)
    )


def of_joint(
    log: Log, j: int, name: str, driver: str, unit: str, most: float, shape: np.ndarray, form: str = "",
    **detail: object,
) -> Act:  # fmt: skip
    """Return `scaled` of a joint, with a shape (rows,)."""
    where, shape = place(f"joint {j + 1}", driver, name), alone(log, j, shape)
    return scaled(name, form, where, unit, most, shape, log, joint=int(j + 1), **detail)


def payload(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A mass at the tool that is not stated: of payload or gripper, or in proportion to the payload."""
    s, arm = log.session, log.arm
    loaded = s.payload > 0
    sign = -1.0 if rng.random() < 0.4 and loaded.any() else 1.0
    if form == "relative" and loaded.any():
        kilos = s.payload
        shape = log.of_load(arm.payload(1.0), loaded) * kilos[:, None]
        return scaled(
            "payload", form, place("tool", "payload", "payload"), "1", 0.6, sign * shape, log, sign=sign
        )
    rows = loaded if form == "stated mass" and loaded.any() else None
    shape = sign * log.of_load(arm.payload(1.0), rows)
    form = form if rows is not None else "every motion"
    most = 3 * arm.load if sign > 0 else 0.8 * float(s.payload[loaded].min())
    return scaled("payload", form, place("tool", "payload", "payload"), "kg", most, shape, log, sign=sign)


def payload_offset(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A payload whose centre is elsewhere: in any direction, along the axis, or with another inertia."""
    arm, rows = log.arm, log.session.payload > 0
    way = np.array([0.0, 0.0, 1.0]) if form == "axial" else direction(rng)
    kilos = np.where(rows, log.session.payload, 1.0)[:, None]

    def turned(shift: float, wide: float = 1.0) -> np.ndarray:
        body = arm.payload(1.0, way * shift, arm.load_gyration * wide) - arm.payload(1.0)
        return log.of_load(body, rows) * kilos

    one, two = turned(0.04), turned(0.08)
    curve = (two - 2 * one) / (2 * 0.04**2)  # exact: a parallel axis is of second order
    slope = one / 0.04 - curve * 0.04
    if form == "wider body":
        slope = slope + turned(0.0, 1.4) / 0.03

    def apply(size: float) -> Change:
        return Change(size * slope + size**2 * curve)

    where = place("tool", "centre of mass", "payload-offset")
    return Act("payload-offset", form, where, "m", 0.01, 0.25, apply, {"direction": way.tolist()})


def base_tilt(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A base that is not level: at rest as set up, or more with each loaded motion, or since one time."""
    s, bearing = log.session, rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(bearing), np.sin(bearing), 0.0])
    side = Rotation.from_rotvec(axis * 0.01).apply(GRAVITY) - GRAVITY
    at_rest = np.zeros_like(s.q)
    columns = regressor(log.arm.chain, s.q, at_rest, at_rest, side)
    shape = columns @ log.arm.parameters
    shape += (columns[:, :, -PARTS:] @ log.arm.payload(1.0)) * s.payload[:, None]
    if form == "since a time":
        begin = s.time[0] + rng.uniform(0.3, 0.6) * np.ptp(s.time)
        shape = shape * (s.time >= begin)[:, None]
    if form == "grows":
        shape = shape * ((s.time - s.time[0]) / np.ptp(s.time))[:, None]
    where = place("base", "gravity direction", "base-tilt")
    return scaled("base-tilt", form, where, "rad", 0.3, shape / 0.01, log, direction=(axis[0], axis[1]))


def armature(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A rotor heavier than its uncertainty allows: at one joint, at joints of a type, or a lighter one."""
    n = log.arm.size
    j = int(rng.integers(n))
    joints = [j]
    if form == "drives of a type":
        joints = [k for k in range(n) if log.arm.rated[k] == log.arm.rated[j]]
    shape = np.zeros_like(log.torque)
    shape[:, joints] = log.session.ddq[:, joints] * log.arm.armature[joints]
    where = [w for k in joints for w in place(f"joint {k + 1}", "acceleration", "armature")]
    sign = 1.0
    if form == "lighter":
        sign = -1.0
    return scaled(
        "armature", form, where, "1", 2.5 if sign > 0 else 0.9, sign * shape, log, joint=j + 1, sign=sign
    )


def inertia(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A link whose mass, centre of mass or inertia is off by far more than its uncertainty."""
    s, arm = log.session, log.arm
    k = int(rng.integers(1, arm.size))
    extra = np.zeros((1, 3))
    about = np.zeros((1, 3, 3))
    kilos = np.array([arm.mass[k]])
    centre = arm.centre[k : k + 1]
    if form == "mass":
        body, unit, most = about_origin(kilos, centre, arm.inertia[k : k + 1])[0], "1", 2.0
    elif form == "centre":
        extra[0] = direction(rng) * 0.1
        body = (about_origin(kilos, centre + extra, about) - about_origin(kilos, centre, about))[0]
        unit, most = "0.1 m", 1.2
    else:  # a body on the link, for example a valve
        spot = centre + rng.uniform(-0.5, 0.5, (1, 3)) * np.abs(centre).max()
        body, unit, most = about_origin(np.ones(1), spot, about)[0], "kg", 5 * float(kilos[0])
    shape = regressor(arm.chain, s.q, s.dq, s.ddq, log.gravity, [k]) @ body
    where = place(f"joint {k + 1}", "inertial parameters", "inertia")
    return scaled("inertia", form, where, unit, most, shape, log, joint=k + 1)


def _transmitted(log: Log, j: int, moved: np.ndarray) -> np.ndarray:
    """Return the torque (rows, n) of gravity that a link makes whose angle is off its motor's (rows,)."""
    s, step = log.session, np.zeros_like(log.torque)
    step[:, j] = 1e-4
    still = np.zeros_like(s.q)
    there = regressor(log.arm.chain, s.q + step, still, still, log.gravity) @ log.arm.parameters
    here = regressor(log.arm.chain, s.q, still, still, log.gravity) @ log.arm.parameters
    return (there - here) / 1e-4 * moved[:, None]


def elasticity(rng: np.random.Generator, log: Log, form: str) -> Act:
    """A transmission that winds up under torque: in proportion, soft near zero, or with a lag."""
    s = log.session
    j = int(rng.integers(log.arm.size))
    load = log.rigid[:, j]
    one = log.arm.rated[j]
    if form == "soft near zero":
        knee = rng.uniform(0.05, 0.2) * one
        wound = load + knee * np.tanh(load / knee)
    elif form == "creeps":
        keep = np.exp(-s.step / rng.uniform(0.3, 2.0))
        late = np.concatenate(
            [lfilter([1 - keep], [1, -keep], load[r], zi=[keep * load[r][0]])[0] for r in s.runs]
        )
        wound = 0.7 * load + 0.3 * late
    else:
        wound = load
    wound = -wound / one
    link, torque = alone(log, j, wound), _transmitted(log, j, wound)
    where = place(f"joint {j + 1}", "torque", "elasticity")

    def apply(size: float) -> Change:
        return Change(size * torque, link=size * link)

    return Act("elasticity", form, where, "rad at rated torque", 1e-4, 0.05, apply, {"joint": j + 1})


def backlash(rng: np.random.Generator, log: Log, form: str) -> Act:
    """Lost motion: the link lies at one side of the gap by the torque, by the motion, or between."""
    j = int(rng.integers(log.arm.size))
    load, dq = log.rigid[:, j], log.session.dq[:, j]
    soft = rng.uniform(0.01, 0.04) * log.arm.rated[j]
    if form == "by motion":
        side, state = np.empty(len(dq)), 1.0
        for k, v in enumerate(dq):
            state = np.sign(v) if abs(v) > 2e-3 else state
            side[k] = state
        side = -side
    else:
        side = -np.tanh(load / soft * (1 if form == "soft" else 8))
    link, torque = alone(log, j, side), _transmitted(log, j, side)
    where = place(f"joint {j + 1}", "side of the torque", "backlash")

    def apply(size: float) -> Change:
        return Change(size * torque, link=size * link)

    return Act("backlash", form, where, "rad", 1e-4, 0.01, apply, {"joint": j + 1})


BODY = {
    "payload": (payload, ("stated mass", "every motion", "relative")),
    "payload-offset": (payload_offset, ("any", "axial", "wider body")),
    "armature": (armature, ("one", "drives of a type", "lighter")),
    "base-tilt": (base_tilt, ("as set up", "grows", "since a time")),
    "inertia": (inertia, ("mass", "centre", "body on the link")),
    "elasticity": (elasticity, ("linear", "soft near zero", "creeps")),
    "backlash": (backlash, ("by torque", "by motion", "soft")),
}
"""Effects by name: their function, and their forms; the last form is reserved."""
