"""One oracle for every certificate: nothing left where it holds, its share where not, slopes, draws."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from factors.camera import Instrument
from factors.certificate import CORRELATION, Certificate, again, diameter, join
from factors.contacts import Cylinder, Distance, FixedPoint, Plane, Sphere
from factors.kind import tangents
from factors.kind import turned as rotation

U_ANGLE, U_DISTANCE, SIDE = 1.2e-5, 3e-6, 0.2286
RADIUS = np.zeros(0)


def face(normal, point) -> Plane:
    n = np.array(normal, float) / np.linalg.norm(normal)
    return Plane(n, np.array(point, float), RADIUS, np.array([0.2, 0.2, 0.05]))


RIGHT = face([0, 1, 0], [0.45, SIDE / 2, 0.1])
LEFT = face([0, -1, 0], [0.40, -SIDE / 2, 0.2])  # its contacts lay elsewhere
LOW = face([0, 0, 1], [0.45, 0.02, 0.1])
HIGH = face([0, 0, 1], [0.40, -0.05, 0.15])
FRONT = face([-1, 0, 0], [0.3357, 0.0, 0.15])
A = Sphere(np.array([0.43, -0.06, 0.09]), 50.8e-3, RADIUS, np.full(4, 0.05))
B = Sphere(np.array([0.53, 0.05, 0.11]), 50.8e-3, RADIUS, np.full(4, 0.05))
PIN = Cylinder(np.array([0.5, -0.1, 0.1]), np.array([0.0, 0.0, 1.0]), 0.02, RADIUS, np.full(5, 0.05))
ROD = Cylinder(np.array([0.4, 0.1, 0.2]), np.array([0.0, 0.0, -1.0]), 0.03, RADIUS, np.full(5, 0.05))
BEAM = Cylinder(np.array([0.45, 0.0, 0.3]), np.array([1.0, 0.0, 0.0]), 0.02, RADIUS, np.full(5, 0.05))
CONE = FixedPoint(np.array([0.42, 0.05, 0.2]), np.full(3, 0.05))
PIVOT = Distance(np.array([0.5, 0.1, -0.4]), RADIUS, np.full(3, 0.05))
FRAME = np.block([[rotation(np.array([0.3, -0.2, 1.0])), np.array([[0.9], [0.2], [0.3]])], [np.eye(4)[3:]]])
TRACKER = Instrument(FRAME, np.array([0.45, 0.0, 0.3]), np.zeros((0, 3)), np.full(6, 0.05))
FORM = {Plane: "plane", Cylinder: "axis"}
APART = float(np.linalg.norm(A.centre - B.centre))


def leaning(plane: Plane, normal: np.ndarray, offset: float) -> np.ndarray:
    """The state (3,) of a face whose unit normal and offset are these."""
    n = normal / (normal @ plane.normal)
    return np.append(plane.tangents @ n, offset - normal @ plane.pivot)


def turned(*planes: Plane) -> tuple[np.ndarray, ...]:
    """States of faces that turned and moved together, as a rigid body."""
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(np.eye(3) + 0.005 * rng.standard_normal((3, 3)))[0]
    turn *= np.sign(np.diag(turn))
    shift = 2e-3 * rng.standard_normal(3)
    return tuple(leaning(p, turn @ p.normal, turn @ p.normal @ (turn @ p.pivot + shift)) for p in planes)


def shifted(a: Sphere, b: Sphere) -> tuple[np.ndarray, ...]:
    """States of spheres moved as one, their diameters too, which does not matter."""
    return np.array([1e-3, -2e-3, 3e-3, 4e-4]), np.array([1e-3, -2e-3, 3e-3, -1e-4])


def forms(a, b) -> tuple[str, str]:
    return FORM.get(type(a), "point"), FORM.get(type(b), "point")


def parallel(a, b, length):
    return join("parallel", forms(a, b), (a, b), length, U_DISTANCE, U_ANGLE)


def perpendicular(a, b):
    return join("perpendicular", forms(a, b), (a, b), u_angle=U_ANGLE)


def between(a, b, length, u=U_DISTANCE):
    return join("distance", forms(a, b), (a, b), length, u)


def placed(kind, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The state of a target that turned and moved with all others, as a rigid body."""
    to = lambda p: turn @ p + shift  # noqa: E731
    if isinstance(kind, Plane):
        return leaning(kind, turn @ kind.normal, turn @ kind.normal @ to(kind.pivot))
    if isinstance(kind, Cylinder):
        axis, basis = turn @ kind.axis, kind.tangents
        on = to(kind.point) - axis * (kind.axis @ (to(kind.point) - kind.point)) / (kind.axis @ axis)
        return np.concatenate([basis @ axis / (kind.axis @ axis), basis @ (on - kind.point), [1e-4]])
    if isinstance(kind, Instrument):
        return np.concatenate([TURN, to(kind.pivot) - kind.pivot])
    return np.append(to(kind.centre) - kind.centre, np.full(len(kind.sd) - 3, 1e-4))


TURN, SHIFT = np.array([4e-3, -6e-3, 5e-3]), np.array([1e-3, -2e-3, 3e-3])


def moved(a, b) -> tuple[np.ndarray, ...]:
    """States of two targets moved as one."""
    return tuple(placed(kind, rotation(TURN), SHIFT) for kind in (a, b))


def off(a: np.ndarray, axis: np.ndarray, b: np.ndarray) -> float:
    """Distance of two places across an axis, m."""
    return float(np.linalg.norm(np.cross(axis, a - b)))


@dataclass(frozen=True)
class Case:
    """A certificate, states where it holds, and the residuals it should have."""

    function: Certificate
    holds: tuple[np.ndarray, ...]
    rows: int
    atol: float = 1e-7  # rounding of the angles over U_ANGLE


CASES = {
    "block": Case(parallel(RIGHT, LEFT, SIDE), turned(RIGHT, LEFT), 3),
    "block, named the other way": Case(parallel(LEFT, RIGHT, SIDE), turned(LEFT, RIGHT), 3),
    "step": Case(parallel(LOW, HIGH, 0.05), turned(LOW, HIGH), 3),
    "step, named the other way": Case(parallel(HIGH, LOW, 0.05), turned(HIGH, LOW), 3),
    "square": Case(perpendicular(RIGHT, FRONT), turned(RIGHT, FRONT), 1),
    "centres": Case(between(A, B, APART), shifted(A, B), 1),
    "pin and face": Case(parallel(PIN, FRONT, 0.1643), moved(PIN, FRONT), 2),
    "pins": Case(parallel(PIN, ROD, off(PIN.point, PIN.axis, ROD.point)), moved(PIN, ROD), 3),
    "pin upright": Case(perpendicular(PIN, LOW), moved(PIN, LOW), 2),
    "pins square": Case(perpendicular(PIN, BEAM), moved(PIN, BEAM), 1),
    "pins apart": Case(between(ROD, PIN, off(PIN.point, PIN.axis, ROD.point)), moved(ROD, PIN), 1),
    "ball over face": Case(between(LOW, CONE, 0.1), moved(LOW, CONE), 1),
    "ball under face": Case(between(A, HIGH, 0.06), moved(A, HIGH), 1),
    "seat and pin": Case(between(CONE, PIN, off(CONE.centre, PIN.axis, PIN.point)), moved(CONE, PIN), 1),
    "pivot and tracker": Case(
        between(PIVOT, TRACKER, float(np.linalg.norm(PIVOT.centre - FRAME[:3, 3]))), moved(PIVOT, TRACKER), 1
    ),
    "tracker and face": Case(between(TRACKER, FRONT, 0.5643), moved(TRACKER, FRONT), 1),
    "diameter of a pin": Case(diameter(PIN, 20.01e-3, U_DISTANCE), (np.array([1e-3, 0, 0, 0, 1e-5]),), 1),
    "diameter": Case(diameter(A, 50.81e-3, U_DISTANCE), (np.array([1e-3, 0, 0, 1e-5]),), 1),
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request) -> Case:
    return request.param


def strayed(case: Case, *lead: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(4)
    return tuple(x + 1e-3 * rng.standard_normal((*lead, len(x))) for x in case.holds)


def test_zero_where_it_holds(case):
    r, _ = case.function(*case.holds)
    assert r.shape == (case.rows,)
    np.testing.assert_allclose(r, 0, atol=case.atol)


def test_slopes(case):
    x, h = strayed(case), 1e-7
    r, slopes = case.function(*x)
    assert len(slopes) == len(x)
    assert np.max(np.abs(r)) > 1
    for k, part in enumerate(x):
        assert slopes[k].shape == (case.rows, len(part))
        for i in range(len(part)):
            step = h * np.eye(len(part))[i]
            up, _ = case.function(*x[:k], part + step, *x[k + 1 :])
            down, _ = case.function(*x[:k], part - step, *x[k + 1 :])
            slope, atol = (up - down) / (2 * h), 1e-3 + 1e-6 * abs(r).max()
            np.testing.assert_allclose(slopes[k][:, i], slope, atol=atol)


@pytest.mark.parametrize("lead", [(4,), (2, 3)])
def test_draws(case, lead):
    x = strayed(case, *lead)
    r, slopes = case.function(*x)
    for at in np.ndindex(*lead):
        one, own = case.function(*(part[at] for part in x))
        np.testing.assert_allclose(r[at], one, atol=1e-9)
        for many, single in zip(slopes, own, strict=True):
            np.testing.assert_allclose(many[at], single, rtol=1e-12)


def test_one_uncertainty_off_is_one(case):
    """Of each residual by itself: further apart by u, or turned by u about either direction."""
    name = next(key for key, value in CASES.items() if value is case)
    for row, move in enumerate(MOVES[name]):
        r, _ = case.function(*move(case.holds))
        np.testing.assert_allclose(np.abs(r[row]), 1, rtol=1e-3)


def shift(part: int, step: np.ndarray) -> Callable:
    """The state of one target moved by a step."""
    return lambda holds: tuple(x + step if k == part else x for k, x in enumerate(holds))


def push(part: int, component: int, by: float) -> Callable:
    return lambda holds: shift(part, by * np.eye(len(holds[part]))[component])(holds)


def turn_by(part: int, plane: Plane, tangent: int) -> Callable:
    """The face's present normal turned by U_ANGLE towards a nominal tangent of the other one or itself."""

    def move(holds: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        x = holds[part]
        normal, _ = plane.normal_and_offset(x)
        towards = tangents(plane.normal)[tangent]
        towards = towards - normal * (normal @ towards)
        new = normal + U_ANGLE * towards / np.linalg.norm(towards)
        new /= np.linalg.norm(new)
        moved = np.append(leaning(plane, new, 0.0)[:2], x[2])
        return tuple(moved if k == part else value for k, value in enumerate(holds))

    return move


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def lean_along(pin: Cylinder, part: int, other, tangent: int | None = None) -> Callable:
    """A pin turned by U_ANGLE towards another direction, or towards a tangent of its own."""
    towards = getattr(other, "normal", getattr(other, "axis", None))
    towards = towards if tangent is None else pin.tangents[tangent]
    return shift(part, np.append(U_ANGLE * pin.tangents @ towards, np.zeros(3)))


def away(pin: Cylinder, part: int, other) -> Callable:
    """A pin moved by U_DISTANCE away from a point, or from another pin's axis."""
    out = pin.tangents @ (pin.point - getattr(other, "centre", getattr(other, "point", None)))
    return shift(part, np.concatenate([[0, 0], U_DISTANCE * unit(out), [0]]))


MOVES = {
    "block": [turn_by(0, RIGHT, 0), turn_by(0, RIGHT, 1), push(0, 2, U_DISTANCE)],
    "block, named the other way": [turn_by(0, LEFT, 0), turn_by(0, LEFT, 1), push(1, 2, U_DISTANCE)],
    "step": [turn_by(0, LOW, 0), turn_by(0, LOW, 1), push(0, 2, -U_DISTANCE)],
    "step, named the other way": [turn_by(0, HIGH, 0), turn_by(0, HIGH, 1), push(0, 2, U_DISTANCE)],
    "square": [lambda holds: (holds[0], lean_towards(RIGHT, FRONT, *holds))],
    "centres": [shift(0, np.append(U_DISTANCE * unit(A.centre - B.centre), 0))],
    "pin and face": [lean_along(PIN, 0, FRONT), push(1, 2, U_DISTANCE)],
    "pins": [lean_along(PIN, 0, PIN, 0), lean_along(PIN, 0, PIN, 1), away(PIN, 0, ROD)],
    "pin upright": [lean_along(PIN, 0, PIN, 0), lean_along(PIN, 0, PIN, 1)],
    "pins square": [lean_along(PIN, 0, BEAM)],
    "pins apart": [away(ROD, 0, PIN)],
    "ball over face": [push(0, 2, -U_DISTANCE)],
    "ball under face": [push(1, 2, U_DISTANCE)],
    "seat and pin": [away(PIN, 1, CONE)],
    "pivot and tracker": [shift(0, U_DISTANCE * unit(PIVOT.centre - FRAME[:3, 3]))],
    "tracker and face": [push(1, 2, U_DISTANCE)],
    "diameter of a pin": [push(0, 4, U_DISTANCE)],
    "diameter": [push(0, 3, U_DISTANCE)],
}


def lean_towards(a: Plane, b: Plane, xa: np.ndarray, xb: np.ndarray) -> np.ndarray:
    """The state of b turned by U_ANGLE towards a."""
    new = b.normal_and_offset(xb)[0] + U_ANGLE * a.normal_and_offset(xa)[0]
    return np.append(leaning(b, new / np.linalg.norm(new), 0.0)[:2], xb[2])


def placed_again(*x: np.ndarray):
    """A block at two placements."""
    return again([parallel(RIGHT, LEFT, SIDE)] * 2, 2)(*x)


def test_an_error_of_an_artefact_is_its_error_at_every_placement():
    """Its uncertainty does not fall with the number of placements, as that of as many artefacts would."""
    holds = turned(RIGHT, LEFT)
    for signs in ((1.0, 1.0), (1.0, -1.0)):
        off = [x for sign in signs for x in push(0, 2, sign * U_DISTANCE)(holds)]
        square = float(np.sum(placed_again(*off)[0] ** 2))
        alike = signs[0] == signs[1]
        assert square == pytest.approx(2 / (1 + CORRELATION if alike else 1 - CORRELATION), rel=1e-3)
    one = again([parallel(RIGHT, LEFT, SIDE)], 2)
    np.testing.assert_allclose(one(*off[:2])[0], parallel(RIGHT, LEFT, SIDE)(*off[:2])[0])


@pytest.mark.parametrize("lead", [(), (4,), (2, 3)])
def test_slopes_and_draws_of_placements(lead):
    case = Case(placed_again, turned(RIGHT, LEFT) * 2, 6)
    if not lead:
        test_slopes(case)
        return
    test_draws(case, lead)


@pytest.mark.parametrize(("further", "a", "b", "length"), [(0, RIGHT, LEFT, SIDE), (1, HIGH, LOW, 0.05)])
def test_too_far_apart_is_positive(further, a, b, length):
    r, _ = parallel(a, b, length)(np.array([0, 0, 2 * U_DISTANCE]), np.zeros(3))
    np.testing.assert_allclose(r, [0, 0, 2], atol=1e-9)


def test_distance_of_faces_is_taken_at_their_middle():
    """Two faces leaning in opposite ways about the middle are as far apart there as before."""
    a, b = face([0, 1, 0], [0.5, 0.1, 0.1]), face([0, -1, 0], [0.3, -0.1, 0.1])
    middle = np.array([0.4, 0.0, 0.1])
    lean = np.array([1e-3, 1, 0]) / np.sqrt(1 + 1e-6)
    other, shift = -lean * [-1, 1, 1], np.array([0, 0.1, 0])
    states = [leaning(a, lean, lean @ (middle + shift)), leaning(b, other, other @ (middle - shift))]
    r, _ = parallel(a, b, 0.2)(*states)
    assert r[2] == pytest.approx(0, abs=0.05)  # 0.1 um of a cosine over 3 um
    assert np.max(np.abs(r[:2])) == pytest.approx(2e-3 / U_ANGLE, rel=1e-3)


def test_a_certificate_of_another_length_pulls():
    r, _ = between(A, B, APART + 5e-6, 1e-6)(*CASES["centres"].holds)
    np.testing.assert_allclose(r, -5, rtol=1e-6)
    r, _ = diameter(A, 50.8e-3 + 5e-6, 1e-6)(np.zeros(4))
    np.testing.assert_allclose(r, -5, rtol=1e-6)
