"""Sessions of every kind at once, left behind by the arm of a cube session whose errors are known."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from bayescal.arm.chain import chain_of, frames
from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.dataset import Measurements, Noise, Target, Tool
from factors.contacts import Cylinder, Distance, FixedPoint, Sphere
from factors.kind import turned

MIDDLE = np.array([0.45, 0.0, 0.3])
CONTACT, POINT, TURN = 5e-6, 10e-6, 2e-4  # m, m, rad: noise
BALL = 0
REFLECTORS = {"north": [0.05, 0.03, 0.10], "east": [-0.04, 0.05, 0.12], "south": [0.02, -0.06, 0.08]}


@dataclass(frozen=True)
class Piece:
    """Rows of one target: what the session says of it, where it truly is, which tools touch it."""

    target: Target
    true: object  # the kind at its true place; of an instrument its true frame (4, 4)
    tools: tuple[int, ...] = (BALL,)
    count: int = 40
    poses: bool = False
    held: int = 0  # how many of them are kept back
    spread: float = 0.12  # m, of the goals about `about`
    about: np.ndarray = None


def sphere(name, centre, off, radius=3e-3, **rest) -> Piece:
    """A ball of 30 mm."""
    centre = np.asarray(centre, float)
    target = Target(name, "sphere", {"centre": centre, "diameter": 0.03})
    kind = Sphere(centre + off, 0.03, np.full(1, radius), np.ones(4))
    return Piece(target, kind, about=centre, spread=0.03, **rest)


def cone(name, centre, off, **rest) -> Piece:
    """A seat."""
    centre = np.asarray(centre, float)
    kind = FixedPoint(centre + off, np.ones(3))
    return Piece(Target(name, "fixed-point", {"centre": centre}), kind, about=centre, spread=0.0, **rest)


def bar(name, centre, off, length=0.3, **rest) -> Piece:
    """A ball bar about a pivot."""
    centre = np.asarray(centre, float)
    kind = Distance(centre + off, np.full(1, length), np.ones(3))
    return Piece(Target(name, "distance", {"centre": centre, "length": length}), kind, about=MIDDLE, **rest)


def pin(name, point, axis, off, radius=3e-3, **rest) -> Piece:
    """A cylinder of 20 mm."""
    point, axis = np.asarray(point, float), np.asarray(axis, float)
    target = Target(name, "cylinder", {"point": point, "axis": axis, "diameter": 0.02})
    kind = Cylinder(point + off, axis, 0.02, np.full(1, radius), np.ones(5))
    return Piece(target, kind, about=point, spread=0.03, **rest)


def tracker(name, xyz, rpy, off, tools=(1, 2, 3), **rest) -> Piece:
    """An instrument whose frame is off by a rotation vector and a shift, (6,)."""
    xyz, rpy = np.asarray(xyz, float), np.radians(rpy)
    frame = rigid(rpy_matrix(rpy), xyz)
    frame = rigid(turned(np.asarray(off[:3])) @ frame[:3, :3], xyz + off[3:])
    target = Target(name, "instrument", {"xyz": xyz, "rpy": rpy})
    return Piece(target, frame, tools=tools, about=MIDDLE, spread=0.2, **rest)


def reached(arm, piece, rng):
    """Readings of the true arm that satisfy a piece, with the noise of its contacts."""
    number = 3 * piece.count + 20
    low, high = np.radians([-30, -10, -60, -170, -110, -170]), np.radians([30, 40, 0, 170, 110, 170])
    readings, payload = rng.uniform(low, high, (number, 6)), np.zeros(number)
    goals = piece.about + piece.spread * rng.uniform(-1, 1, (number, 3))
    towards = np.broadcast_to(np.eye(3), (number, 3, 3))
    readings, met = arm.driven(readings, payload, lambda p, which: (p - goals[which], towards[which]))
    kind = piece.true
    if not isinstance(kind, np.ndarray):
        gap = CONTACT * rng.standard_normal((number, kind.rows))
        rowwise = [name for name in ("radius", "length") if hasattr(kind, name)]
        each = {name: np.full(number, getattr(kind, name)[0]) for name in rowwise}

        def touch(p, which):
            own = replace(kind, **{name: value[which] for name, value in each.items()})
            r, u, _ = own.linearise(np.zeros(len(kind.sd)), p.T)
            return r.T - gap[which], np.moveaxis(u, -1, 0)

        readings, met = arm.driven(readings, payload, touch)
    angle = readings @ arm.drawing.link_from_reading.T * np.sign(np.diag(arm.drawing.link_from_reading))
    inside = np.all((angle > arm.drawing.limits[:, 0]) & (angle < arm.drawing.limits[:, 1]), axis=1)
    good = np.flatnonzero(met & inside)[: piece.count]
    assert len(good) == piece.count, f"{piece.target.name}: {len(good)} of {piece.count} found"
    return readings[good]


def of_pieces(base, pieces, certificates=(), seed=0, planes=True) -> SimpleNamespace:
    """The session of a cube's arm with rows of further targets.

    `base` is a cube session. Returns `dataset`, `arm`, true `tools` by name (centre, rotation).
    """
    rng = np.random.default_rng(seed)
    old, arm = base.dataset, base.arm
    ball = old.tools[0]
    tools, true = [ball], {ball.name: (arm.tool, np.eye(3))}
    for name, centre in REFLECTORS.items():
        centre = np.array(centre)
        tools.append(Tool(name, centre, None, ball.mass, ball.centre_of_mass))
        true[name] = centre + 1e-3 * rng.standard_normal(3), turned(rng.uniform(-1.5, 1.5, 3))
    parts = [(old.measurements.target, np.zeros(len(old.measurements.ids), int), old.measurements.readings)]
    parts = parts if planes else []
    targets = list(old.targets) if planes else []
    roles = [np.full(len(p[0]), "calibrate") for p in parts]
    payload = [old.measurements.payload] if planes else []
    xyz = [np.full((len(p[0]), 3), np.nan) for p in parts]
    rpy = [np.full((len(p[0]), 3), np.nan) for p in parts]
    for piece in pieces:
        tool = np.resize(piece.tools, piece.count)
        names = [tools[k].name for k in piece.tools]
        share = {n: int(np.sum(tool == k)) for n, k in zip(names, piece.tools, strict=True)}
        readings = np.zeros((piece.count, 6))
        points, turns = np.full((2, piece.count, 3), np.nan)
        for name, k in zip(names, piece.tools, strict=True):
            mine = np.flatnonzero(tool == k)
            own, (centre, stands) = None, true[name]
            own = replace(arm, tool=centre)
            readings[mine] = reached(own, replace(piece, count=share[name]), rng)
            if isinstance(piece.true, np.ndarray):
                still = np.zeros(len(mine))
                p = own.points(readings[mine], still)
                home = piece.true[:3, :3]
                points[mine] = (p - piece.true[:3, 3]) @ home + POINT * rng.standard_normal(p.shape)
                q = own.angles(readings[mine], still)
                flange = frames(chain_of(own.robot), q, own._delta(len(q)))[:, -1, :3, :3]
                seen = home.T @ flange @ stands @ turned(TURN * rng.standard_normal((len(q), 3)))
                turns[mine] = np.array([rpy_of(m) for m in seen]) if piece.poses else np.nan
        parts.append((np.full(piece.count, len(targets)), tool, readings))
        targets.append(piece.target)
        roles.append(np.where(np.arange(piece.count) < piece.count - piece.held, "calibrate", "validate"))
        payload.append(np.zeros(piece.count))
        xyz.append(points)
        rpy.append(turns)
    target, tool, readings = (np.concatenate(column) for column in zip(*parts, strict=True))
    count, order = len(target), rng.permutation(len(target))
    spread, angles = np.concatenate(xyz)[order], np.concatenate(rpy)[order]
    rows = Measurements(
        tuple(f"r{k}" for k in range(count)), np.concatenate(roles)[order], target[order], tool[order],
        readings[order], np.arange(2, count + 2), payload=np.concatenate(payload)[order],
        xyz=None if np.isnan(spread).all() else spread, rpy=None if np.isnan(angles).all() else angles,
    )  # fmt: skip
    assert set(np.unique(target)) == set(range(len(targets)))
    certificates = (*(old.certificates if planes else ()), *certificates)
    about = {"name": "kinds", "noise": Noise(CONTACT, POINT), "measurements": rows, "temperature_of": None}
    dataset = replace(old, tools=tuple(tools), targets=tuple(targets), certificates=certificates, **about)
    return SimpleNamespace(dataset=dataset, arm=arm, tools=true)
