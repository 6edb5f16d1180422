"""One oracle for every measurement kind: a true contact, slopes, draws, its own description, noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import chi2

from factors.camera import FISHEYE, PINHOLE, Camera, Instrument, Lens, Orientation
from factors.contacts import Cylinder, Distance, FixedPoint, Plane, Sphere
from factors.kind import (
    Kind,
    dot,
    inverse_left_jacobian,
    left_jacobian,
    rotation_vector,
    tangents,
    tilted,
    turned,
)

COUNT = 40
RADIUS = np.where(np.arange(COUNT) % 2 == 0, 3e-3, 1.5e-3)  # two tools


def unit(*v: float) -> np.ndarray:
    return np.array(v) / np.linalg.norm(v)


def directions(rng: np.random.Generator) -> np.ndarray:
    """(3, C) unit vectors all over the sphere."""
    v = rng.standard_normal((3, COUNT))
    return v / np.linalg.norm(v, axis=0)


def on_plane(true: dict, gap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    across = rng.uniform(-0.1, 0.1, (3, COUNT))
    across -= np.outer(true["normal"], true["normal"] @ across)
    return true["normal"][:, None] * (true["offset"] + RADIUS + gap[0]) + across


def on_sphere(true: dict, gap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return true["centre"][:, None] + directions(rng) * (true["diameter"] / 2 + RADIUS + gap[0])


def on_cylinder(true: dict, gap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    axis = true["axis"]
    out = directions(rng)
    out -= np.outer(axis, axis @ out)
    out /= np.linalg.norm(out, axis=0)
    along = np.outer(axis, rng.uniform(-0.05, 0.05, COUNT))
    return true["point"][:, None] + along + out * (true["diameter"] / 2 + RADIUS + gap[0])


def at_point(true: dict, gap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return true["centre"][:, None] + gap


LENGTHS = np.linspace(0.25, 0.35, COUNT)


def at_length(true: dict, gap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return true["centre"][:, None] + directions(rng) * (LENGTHS + gap[0])


XYZ = np.random.default_rng(9).uniform(-0.3, 0.3, (COUNT, 3)) + np.array([1.5, 0, 0])


def as_read(true: dict, gap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return true["frame"][:3, :3] @ (XYZ.T + gap) + true["frame"][:3, 3:]


TURNS = turned(np.random.default_rng(8).uniform(-1.5, 1.5, (COUNT, 3)))  # (C, 3, 3), any way round


def as_turned(true: dict, gap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.moveaxis(true["frame"][:3, :3] @ TURNS @ turned(gap.T), 0, -1)


FRAME = np.eye(4)
FRAME[:3, :3] = np.array([unit(0.1, -1, 0.2), unit(1, 0.1, 0), np.cross(unit(0.1, -1, 0.2), unit(1, 0.1, 0))])
FRAME[:3, :3] = np.linalg.qr(FRAME[:3, :3])[0]
FRAME[:3, :3] *= np.linalg.det(FRAME[:3, :3])
FRAME[:3, 3] = [2.0, 0.1, 0.5]


def shifted(p: np.ndarray, step: np.ndarray) -> np.ndarray:
    return p + step


def turned_by(turns: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Turns (3, 3, C) turned once more in F0, by rotation vectors (..., 3, C)."""
    return np.moveaxis(turned(np.swapaxes(step, -1, -2)) @ np.moveaxis(turns, -1, -3), -3, -1)


def posed_by(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Poses (3, 4, C) shifted and turned about their origin in F0, by steps (..., 6, C)."""
    axes = turned_by(pose[..., :3, :], step[..., 3:, :])
    return np.concatenate([axes, (pose[..., 3, :] + step[..., :3, :])[..., None, :]], axis=-2)


@dataclass(frozen=True)
class Case:
    kind: Kind
    # (what `describe` says, gap (rows, C), rng) -> (3, C), turns (3, 3, C), poses (3, 4, C)
    contacts: Callable
    rebuild: Callable  # what `describe` says -> the kind nominally there
    size: int
    moved: Callable = shifted  # a contact by small steps (..., steps, C)
    steps: int = 3


def plane_case(normal: np.ndarray) -> Case:
    kind = Plane(normal, normal * 0.56 + 0.2 * tangents(normal)[0], RADIUS, np.array([0.2, 0.2, 0.05]))

    def rebuild(d: dict) -> Plane:
        return replace(kind, normal=d["normal"], pivot=d["normal"] * d["offset"])

    return Case(kind, on_plane, rebuild, 3)


_sphere = Sphere(np.array([0.43, -0.06, 0.09]), 50.8e-3, RADIUS, np.array([0.05] * 3 + [1e-3]))
SD = np.array([0.2, 0.2, 0.05, 0.05, 1e-3])
_cylinder = Cylinder(np.array([0.4, 0.1, 0.2]), unit(0.2, 0.3, 1), 20e-3, RADIUS, SD)
_cone = FixedPoint(np.array([0.4, 0.0, 0.05]), np.full(3, 0.05))
_bar = Distance(np.array([0.4, 0.0, 0.05]), LENGTHS, np.full(3, 0.05))
_tracker = Instrument(FRAME, np.array([0.5, 0.0, 0.3]), XYZ, np.array([0.2] * 3 + [0.05] * 3))
_turns = Orientation(FRAME, TURNS, _tracker.sd)

CORNER = np.column_stack([np.random.default_rng(5).uniform(-0.1, 0.1, (COUNT, 2)), np.zeros(COUNT)])
PIXEL = np.random.default_rng(6).uniform([100, 100], [1180, 620], (COUNT, 2))
DEPTH = np.linspace(0.3, 0.7, COUNT)
CENTRE = np.array([645.0, 355.0])
LENSES = {
    PINHOLE: Lens(PINHOLE, np.array([910.0, 905.0]), CENTRE, np.array([-0.2, 0.05, 1e-3, -5e-4, 0.01])),
    FISHEYE: Lens(FISHEYE, np.array([510.0, 505.0]), CENTRE, np.array([0.03, -0.01, 4e-3, -1e-3])),
}


def camera_case(lens: Lens, carried: bool) -> Case:
    frame = FRAME.copy()
    frame[:3, 3] = [0.5, 0.1, 0.4]
    pivot = np.array([0.45, 0.0, 0.3])
    kind = Camera(frame, pivot, CORNER, PIXEL, lens, DEPTH / lens.focal[0], _tracker.sd, carried)

    def as_seen(true: dict, gap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        at, axes = true["frame"], turned(rng.uniform(-1, 1, (COUNT, 3)))
        local = np.vstack([lens.directions(PIXEL.T + gap / kind.scale), np.ones(COUNT)]) * DEPTH
        if carried:
            origin = at[:3, :3] @ CORNER.T + at[:3, 3:] - np.einsum("cjk,kc->jc", axes, local)
        else:
            origin = at[:3, :3] @ local + at[:3, 3:] - np.einsum("cjk,ck->jc", axes, CORNER)
        return np.concatenate([np.moveaxis(axes, 0, -1), origin[:, None]], axis=1)

    return Case(kind, as_seen, lambda d: replace(kind, frame=d["frame"]), 6, posed_by, 6)


CASES = {
    **{
        f"{name} camera, {'carried' if on else 'fixed'}": camera_case(lens, on)
        for name, lens in LENSES.items()
        for on in (False, True)
    },
    "plane": plane_case(unit(1, 0, 0)),
    "slanted plane": plane_case(unit(-1, 2, 0.5)),
    "sphere": Case(_sphere, on_sphere, lambda d: replace(_sphere, **d), 4),
    "cylinder": Case(_cylinder, on_cylinder, lambda d: replace(_cylinder, **d), 5),
    "fixed point": Case(_cone, at_point, lambda d: replace(_cone, **d), 3),
    "distance": Case(_bar, at_length, lambda d: replace(_bar, **d), 3),
    "instrument": Case(_tracker, as_read, lambda d: replace(_tracker, frame=d["frame"]), 6),
    "orientation": Case(_turns, as_turned, lambda d: replace(_turns, frame=d["frame"]), 6, turned_by),
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request) -> Case:
    return request.param


def states(case: Case, *lead: int, seed: int = 0) -> np.ndarray:
    """States as far off as tilts of 0.1 rad and shifts of millimetres."""
    scale = np.array([0.1 if unit == "rad" else 3e-3 for _, unit in case.kind.parts])
    return scale * np.random.default_rng(seed).uniform(-1, 1, (*lead, case.size))


def touching(case: Case, x: np.ndarray, noise: float = 0.0, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    gap = noise * rng.standard_normal((case.kind.rows, COUNT))
    return case.contacts(case.kind.describe(x), gap, rng)


def nearby(case: Case, *lead: int) -> np.ndarray:
    """Points (..., 3, C) some millimetres off the nominal surface, or turns some milliradians off."""
    p = touching(case, np.zeros(case.size))
    return case.moved(p, 3e-3 * np.random.default_rng(2).standard_normal((*lead, case.steps, COUNT)))


def test_declared_parts(case):
    assert len(case.kind.parts) == len(case.kind.sd) == case.size
    assert {unit for _, unit in case.kind.parts} <= {"m", "rad"}
    assert len({name for name, _ in case.kind.parts}) == case.size


def test_zero_at_a_true_contact(case):
    for x in (np.zeros(case.size), states(case)):
        r = case.kind.residual(x, touching(case, x))
        assert r.shape == (case.kind.rows, COUNT)
        np.testing.assert_allclose(r, 0, atol=1e-14)


def test_residual_is_a_length(case):
    """A contact off by a signed gap has that residual: outward is positive."""
    x = states(case)
    rng = np.random.default_rng(3)
    gap = 1e-3 * rng.standard_normal((case.kind.rows, COUNT))
    p = case.contacts(case.kind.describe(x), gap, rng)
    np.testing.assert_allclose(case.kind.residual(x, p), gap, atol=1e-14)


def test_state_zero_is_the_drawing(case):
    told = case.rebuild(case.kind.describe(np.zeros(case.size)))
    p = nearby(case)
    zero = np.zeros(case.size)
    np.testing.assert_allclose(told.residual(zero, p), case.kind.residual(zero, p), atol=1e-14)


def test_description_has_the_same_residuals(case):
    x, p = states(case), nearby(case)
    told = case.rebuild(case.kind.describe(x))
    np.testing.assert_allclose(told.residual(np.zeros(case.size), p), case.kind.residual(x, p), atol=1e-14)


def test_residual_is_that_of_linearise(case):
    x, p = states(case, 5), nearby(case, 5)
    r, u, dx = case.kind.linearise(x, p)
    np.testing.assert_allclose(r, case.kind.residual(x, p), atol=1e-15)
    assert u.shape == (5, case.kind.rows, case.steps, COUNT)
    assert dx.shape == (5, case.kind.rows, COUNT, case.size)


@pytest.mark.parametrize("far", [0.0, 1e-7, 1.0, 10.0])
def test_slopes(case, far):
    """Gradients by the point and by the state, at the drawing, a hair off it and well off it."""
    x, p, h = far * states(case), nearby(case), 1e-6
    _, u, dx = case.kind.linearise(x, p)
    for k in range(case.steps):
        step = np.broadcast_to(h * np.eye(case.steps)[k][:, None], (case.steps, COUNT))
        there, back = case.moved(p, step), case.moved(p, -step)
        slope = (case.kind.residual(x, there) - case.kind.residual(x, back)) / (2 * h)
        np.testing.assert_allclose(u[:, k], slope, atol=2e-9)
    for k in range(case.size):
        step = h * np.eye(case.size)[k]
        slope = (case.kind.residual(x + step, p) - case.kind.residual(x - step, p)) / (2 * h)
        np.testing.assert_allclose(dx[..., k], slope, atol=2e-9)


@pytest.mark.parametrize("lead", [(4,), (2, 3)])
@pytest.mark.parametrize("of", ["state and points", "state", "points"])
def test_draws(case, lead, of):
    """Leading axes give what a loop gives, of both or of one alone."""
    x = states(case, *lead) if "state" in of else states(case)
    p = nearby(case, *lead) if "points" in of else nearby(case)
    r, u, dx = case.kind.linearise(x, p)
    alone = case.kind.residual(x, p)
    shape = touching(case, np.zeros(case.size)).shape
    xs, ps = np.broadcast_to(x, (*lead, case.size)), np.broadcast_to(p, (*lead, *shape))
    for at in np.ndindex(*lead):
        one = case.kind.linearise(xs[at], ps[at])
        np.testing.assert_allclose(alone[at], one[0], atol=1e-15)
        np.testing.assert_allclose(r[at], one[0], atol=1e-15)
        # a gradient that does not vary may lack the axis and broadcast instead
        np.testing.assert_allclose(np.broadcast_to(u, (*lead, *one[1].shape))[at], one[1], atol=1e-14)
        np.testing.assert_allclose(np.broadcast_to(dx, (*lead, *one[2].shape))[at], one[2], atol=1e-14)


def test_whitened_residuals_are_standard_normal(case):
    """At the truth, of noise along the contact: a wrong factor in a residual shows here."""
    noise, total, count = 5e-6, 0.0, 0
    for seed in range(25):
        x = states(case, seed=seed)
        r = case.kind.residual(x, touching(case, x, noise, seed)) / noise
        total += float(np.sum(r**2))
        count += r.size
        assert abs(r.mean()) < 5 / np.sqrt(r.size)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], count)
    assert low < total < high


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 2e-4, 0.5, 3.0, np.pi - 1e-9])
def test_rotation_vectors(angle):
    """Logarithm and slopes undo what they are the inverse of, up to half a turn."""
    v = angle * directions(np.random.default_rng(4)).T
    np.testing.assert_allclose(rotation_vector(turned(v)), v, atol=1e-8 if angle > 3.1 else 1e-14)
    both = left_jacobian(v) @ inverse_left_jacobian(v)
    np.testing.assert_allclose(both, np.broadcast_to(np.eye(3), both.shape), atol=1e-12)


def test_far_turns_of_an_instrument():
    """Its turn is a rotation vector, of any size."""
    case = CASES["instrument"]
    x = np.array([1.0, -2.0, 0.5, 0.1, 0.2, -0.3])
    np.testing.assert_allclose(case.kind.residual(x, touching(case, x)), 0, atol=1e-14)
    frame = case.kind.describe(x)["frame"]
    np.testing.assert_allclose(frame[:3, :3] @ frame[:3, :3].T, np.eye(3), atol=1e-14)
    angle = np.arccos((np.trace(frame[:3, :3] @ FRAME[:3, :3].T) - 1) / 2)
    assert angle == pytest.approx(np.linalg.norm(x[:3]), abs=1e-12)


@pytest.mark.parametrize("normal", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (1, 2, -3), (1, 1, 1)])
def test_tangents(normal):
    n = unit(*normal)
    basis = np.vstack([tangents(n), n])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(basis) == pytest.approx(1.0)
    tilt = np.array([[0.2, -0.3], [0.0, 0.0]])
    turned, slopes = tilted(n, tangents(n), tilt)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(turned[1], n, atol=1e-15)
    h = 1e-6
    for k in range(2):
        step = h * np.eye(2)[k]
        slope = (tilted(n, tangents(n), tilt + step)[0] - tilted(n, tangents(n), tilt - step)[0]) / (2 * h)
        np.testing.assert_allclose(slopes[:, k], slope, atol=1e-9)


def test_dot():
    rng = np.random.default_rng(0)
    v, p = rng.standard_normal((4, 3)), rng.standard_normal((4, 3, 5))
    np.testing.assert_allclose(dot(v, p), np.einsum("sk,skc->sc", v, p), atol=1e-15)


@pytest.mark.parametrize("made", [
    Sphere(np.zeros(3), 0.05, np.full(2, 0.003), np.ones(4)),
    Distance(np.zeros(3), np.full(2, 0.3), np.ones(3)),
    Cylinder(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.02, np.full(2, 0.003), np.ones(5)),
], ids=lambda kind: type(kind).__name__)  # fmt: skip
def test_a_ball_at_the_centre_has_no_direction(made):
    p = np.array([[0.0, 0.1], [0.0, 0.0], [0.0, 0.2]])
    with np.errstate(all="raise"):
        r, slopes, dx = made.linearise(np.zeros(len(made.sd)), p)
    assert np.isfinite(r).all()
    assert np.isfinite(dx).all()
    np.testing.assert_array_equal(slopes[..., 0], 0.0)
