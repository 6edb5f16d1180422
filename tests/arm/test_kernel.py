"""The fast kernel, held to the NumPy reference."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.chain import chain_of, frames
from bayescal.arm.kernel import MAX_ANGLE, WIDTH, _cos, _sin
from bayescal.arm.motion import CERTIFICATE, CONTACT, Motion, Term
from bayescal.arm.transforms import AXES

COUNTS = (1, 127, 128, 129, 500)


def lean(n, count, rng):
    """Geometry, compliance and one tool: nothing but joints varies from contact to contact."""
    terms = [Term(i, axis) for i in range(1, n + 1) for axis in ("rz", "tz", "tx", "rx")]
    terms += [Term(2, "ry"), Term(n + 1, "tx"), Term(n + 1, "ty"), Term(n + 1, "tz")]
    terms += [Term(i, "rz", rng.standard_normal(count)) for i in range(2, n + 1)]
    return list(enumerate(terms))


def everywhere(n, count, rng):
    """A constant and a varying term at every site, base and tool included."""
    sites = [(frame, axis) for frame in range(n + 2) for axis in AXES]
    terms = [Term(*site) for site in sites]
    terms += [Term(*site, rng.standard_normal(count)) for site in sites]
    return list(enumerate(terms))


def shared(n, count, rng):
    """Parameters of several terms, drivers used twice, tools of their own rows, terms that do nothing."""
    drift, sign = rng.uniform(-1, 1, count), rng.choice([-1.0, 1.0], count)
    tool = rng.integers(0, 2, count)
    return [
        (0, Term(0, "tx", drift)), (0, Term(2, "tx", drift)), (0, Term(3, "tz", drift)),
        (0, Term(3, "rz", drift)),
        (1, Term(2, "rz", sign)), (1, Term(2, "rz", 0.5)), (1, Term(2, "rz")), (1, Term(3, "rx")),
        (2, Term(n + 1, "tx", (tool == 0) * 1.0)), (3, Term(n + 1, "tx", (tool == 1) * 1.0)),
        (4, Term(n + 1, "ty", (tool == 0) * 1.0)), (5, Term(n, "rz")), (5, Term(n, "rz", sign)),
        (6, Term(1, "ry", np.zeros(count))), (7, Term(CONTACT, "normal", drift)),
        (8, Term(1, "tz", drift)), (8, Term(1, "tz")), (9, Term(4, "ty")), (9, Term(4, "ty")),
        (10, Term(CERTIFICATE, "0", np.array([0.0, 0.0, 1.0]))),
    ]  # fmt: skip


def turning_tool(n, count, rng):
    """The tool frame turned before it slides."""
    return list(enumerate([Term(n + 1, axis) for axis in AXES] + [Term(0, axis) for axis in AXES]))


def nothing(n, count, rng):
    return []


PROGRAMS = (lean, everywhere, shared, turning_tool, nothing)


def motion_of(robot, program, count, seed=0):
    rng = np.random.default_rng(seed)
    terms = program(robot.n, count, rng)
    size = 1 + max((k for k, _ in terms), default=-1)
    tool = np.where(rng.integers(0, 2, (count, 1)) == 0, [0.06, 0.0, 0.12], [-0.02, 0.05, 0.2])
    return Motion(chain_of(robot), rng.uniform(-3, 3, (count, robot.n)), tool, terms, size), rng


@pytest.mark.parametrize("count", [1, 129])
@pytest.mark.parametrize("program", [lean, shared])
def test_turns_of_the_flange(lrmate, program, count):
    """Orientations are those of the frames, and a couple's columns are their slopes about its axis."""
    motion, rng = motion_of(lrmate, program, count)
    walkers = 5e-3 * rng.standard_normal((2, motion.size))
    turns = motion.turns(walkers)
    for values, found in zip(walkers, turns, strict=True):
        flange = frames(motion.chain, motion.q, motion.displacements(values))[:, -1, :3, :3]
        np.testing.assert_allclose(np.moveaxis(found, -1, 0), flange, atol=1e-12, rtol=0)
        axis = rng.standard_normal((3, count))
        columns, h = motion.turning_columns(values, axis), 1e-6
        for k in range(motion.size):
            step = h * np.eye(motion.size)[k]
            slope = (motion.turns(values + step) - motion.turns(values - step)) / (2 * h)
            spin = np.einsum("ikc,jkc->ijc", slope, found)  # dR R' = [w] x
            w = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            np.testing.assert_allclose(columns[k], np.sum(w * axis, axis=0), atol=1e-8)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("program", PROGRAMS)
def test_points_and_columns(lrmate, program, count):
    motion, rng = motion_of(lrmate, program, count)
    walkers = 5e-3 * rng.standard_normal((3, motion.size))
    p = motion.points(walkers)
    assert p.shape == (3, 3, count)
    np.testing.assert_allclose(p, motion.points_reference(walkers), atol=1e-12, rtol=0)
    for values in walkers:
        at = motion.points(values)
        u = rng.standard_normal((3, count))
        found = motion.columns(values, at, u)
        assert found.shape == (motion.size, count)
        np.testing.assert_allclose(found, motion.columns_reference(values, u), atol=1e-12, rtol=0)


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_seven_joints_any_table(program, convention):
    robot = _seven(convention)
    motion, rng = motion_of(robot, program, 60)
    values = 5e-3 * rng.standard_normal((2, 2, motion.size))
    np.testing.assert_allclose(motion.points(values), motion.points_reference(values), atol=1e-12, rtol=0)
    u = rng.standard_normal((3, 60))
    found = motion.columns(values[0, 0], motion.points(values[0, 0]), u)
    np.testing.assert_allclose(found, motion.columns_reference(values[0, 0], u), atol=1e-12, rtol=0)


def _seven(convention):
    from bayescal.arm.chain import Robot

    rng = np.random.default_rng(7)
    return Robot(
        "seven", convention, tuple("ABCDEFG"), rng.uniform(-3, 3, 7), rng.uniform(-0.5, 0.5, 7),
        rng.uniform(-0.5, 0.5, 7), np.zeros(7), 0.1 * rng.standard_normal(7), np.zeros((7, 2)), np.eye(7),
    )  # fmt: skip


@pytest.mark.parametrize("program", PROGRAMS)
def test_columns_are_slopes(lrmate, program):
    """The kernel's own two passes agree, whatever the reference says."""
    motion, rng = motion_of(lrmate, program, 40)
    values, u, h = 5e-3 * rng.standard_normal(motion.size), rng.standard_normal((3, 40)), 1e-5
    found = motion.columns(values, motion.points(values), u)
    step = h * np.eye(motion.size)
    slope = (motion.points(values + step) - motion.points(values - step)) / (2 * h)
    np.testing.assert_allclose(found, np.sum(slope * u, axis=1), atol=1e-8)


def test_padding_is_not_seen(lrmate):
    """A row's answer does not depend on the rows beside it."""
    motion, rng = motion_of(lrmate, everywhere, WIDTH + 3)
    values = 5e-3 * rng.standard_normal(motion.size)
    last = slice(WIDTH + 1, WIDTH + 2)
    terms = [
        (k, Term(t.frame, t.axis, t.driver if np.ndim(t.driver) == 0 else t.driver[last]))
        for k, t in motion.terms
    ]
    alone = Motion(motion.chain, motion.q[last], motion.tool[last], terms, motion.size)
    np.testing.assert_allclose(alone.points(values), motion.points(values)[:, last], atol=1e-15)


def test_series():
    for angle in np.linspace(-MAX_ANGLE, MAX_ANGLE, 201):
        assert _sin(angle) == pytest.approx(np.sin(angle), abs=1.1e-13)
        assert _cos(angle) == pytest.approx(np.cos(angle), abs=2e-15)
        assert _sin(angle / 3) == pytest.approx(np.sin(angle / 3), abs=2e-17, rel=3e-16)


@pytest.mark.parametrize(
    ("frame", "axis"), [(f, axis) for f in (0, 1, 3, 6, 7) for axis in ("rz", "rx", "ry")]
)
def test_largest_angle(lrmate, frame, axis):
    """The series hold up to their bound, with levers of less than a metre."""
    count = 300
    rng = np.random.default_rng(1)
    terms = [(0, Term(frame, axis, np.linspace(-1, 1, count))), (1, Term(7, "ty"))]
    motion = Motion(
        chain_of(lrmate), rng.uniform(-3, 3, (count, 6)), np.tile([0.06, 0, 0.12], (count, 1)), terms, 2
    )
    values = np.array([MAX_ANGLE, 0.01])
    off = motion.points(values) - motion.points_reference(values)
    assert np.max(np.abs(off)) < 2e-13
    u = rng.standard_normal((3, count))
    found = motion.columns(values, motion.points(values), u)
    np.testing.assert_allclose(found, motion.columns_reference(values, u), atol=1e-12)


def test_constant_angles_have_no_bound(lrmate):
    """Angles that do not vary are taken exactly, however large."""
    terms = list(enumerate([Term(f, axis) for f in range(1, 7) for axis in ("rz", "rx", "ry")]))
    motion = Motion(chain_of(lrmate), np.zeros((2, 6)), np.tile([0.06, 0, 0.12], (2, 1)), terms, len(terms))
    values = np.full(len(terms), 0.7)
    np.testing.assert_allclose(motion.points(values), motion.points_reference(values), atol=1e-14)


def test_columns_beside_many_walkers(lrmate):
    """Walkers do not leak into each other."""
    motion, rng = motion_of(lrmate, shared, 200)
    walkers = 5e-3 * rng.standard_normal((7, motion.size))
    alone = np.stack([motion.points(w) for w in walkers])
    np.testing.assert_array_equal(motion.points(walkers), alone)


def test_no_rows(lrmate):
    motion, _ = motion_of(replace(lrmate), lean, 0)
    values = np.zeros(motion.size)
    assert motion.points(values).shape == (3, 0)
    assert motion.columns(values, np.zeros((3, 0)), np.zeros((3, 0))).shape == (motion.size, 0)
