"""The fast kernel, held to the NumPy reference."""

import re
import runpy
from dataclasses import replace

import numpy as np
import pytest
from cases import ROOT
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from numba.core import caching
from test_pinocchio import robots

from analysis.benchmarks.reference import columns_reference, points_reference
from bayescal.arm.chain import chain_of, frames, link_angles, points
from bayescal.arm.kernel import MAX_ANGLE, WIDTH, _cos, _sin, columns
from bayescal.arm.motion import CERTIFICATE, CONTACT, Motion, Term
from bayescal.arm.transforms import AXES, rigid, rotation, rpy_matrix, rpy_of

COUNTS = (1, WIDTH, WIDTH + 1)


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


def test_a_direction_that_may_not_be_written_is_not_compiled_for(lrmate):
    """That of a single contact of a plane is such a view; the kernel takes seconds to compile."""
    motion, _ = motion_of(lrmate, lean, 1)
    values, u = np.zeros(motion.size), np.ones((3, 1))
    usual = motion.columns(values, motion.points(values), u)
    compiled = len(columns.signatures)
    fixed = np.broadcast_to(u, u.shape)
    assert not fixed.flags.writeable
    np.testing.assert_array_equal(motion.columns(values, motion.points(values), fixed), usual)
    assert len(columns.signatures) == compiled


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
    np.testing.assert_allclose(p, points_reference(motion, walkers), atol=1e-12, rtol=0)
    for values in walkers:
        at = motion.points(values)
        u = rng.standard_normal((3, count))
        found = motion.columns(values, at, u)
        assert found.shape == (motion.size, count)
        np.testing.assert_allclose(found, columns_reference(motion, values, u), atol=1e-12, rtol=0)


@pytest.mark.parametrize("varies", [False, True])
def test_any_site_alone_beside_slides_of_the_tool(lrmate, varies):
    """No site is exact only because another one needs the general path."""
    n, rng = lrmate.n, np.random.default_rng(3)
    slides = [Term(n + 1, axis) for axis in ("tx", "ty", "tz")]
    q, tool = rng.uniform(-3, 3, (4, n)), rng.uniform(-0.1, 0.1, (4, 3))
    for frame in range(n + 2):
        for axis in AXES:
            site = Term(frame, axis, rng.standard_normal(4)) if varies else Term(frame, axis)
            motion = Motion(chain_of(lrmate), q, tool, list(enumerate([site, *slides])), 4)
            values = 2e-2 * rng.standard_normal((1, 4))
            found, u = motion.points(values), rng.standard_normal((3, 4))
            np.testing.assert_allclose(found, points_reference(motion, values), atol=1e-12, err_msg=f"{site}")
            columns = motion.columns(values[0], found[0], u)
            np.testing.assert_allclose(columns, columns_reference(motion, values[0], u), atol=1e-12)


def test_series():
    for angle in np.linspace(-MAX_ANGLE, MAX_ANGLE, 201):
        assert _sin(angle) == pytest.approx(np.sin(angle), abs=1.1e-13)
        assert _cos(angle) == pytest.approx(np.cos(angle), abs=2e-15)
        assert _sin(angle / 3) == pytest.approx(np.sin(angle / 3), abs=2e-17, rel=3e-16)


@pytest.mark.parametrize(("frame", "axis"), [(f, axis) for f in (0, 3, 7) for axis in ("rz", "rx", "ry")])
def test_largest_angle(lrmate, frame, axis):
    """The series hold up to their bound, with levers of less than a metre."""
    count = 300
    rng = np.random.default_rng(1)
    terms = [(0, Term(frame, axis, np.linspace(-1, 1, count))), (1, Term(7, "ty"))]
    q, tool = rng.uniform(-3, 3, (count, 6)), np.tile([0.06, 0, 0.12], (count, 1))
    motion = Motion(chain_of(lrmate), q, tool, terms, 2)
    values = np.array([MAX_ANGLE, 0.01])
    assert np.max(np.abs(motion.points(values) - points_reference(motion, values))) < 2e-13
    u = rng.standard_normal((3, count))
    found = motion.columns(values, motion.points(values), u)
    np.testing.assert_allclose(found, columns_reference(motion, values, u), atol=1e-12)


def test_constant_angles_have_no_bound(lrmate):
    """Angles that do not vary are taken exactly, however large."""
    terms = list(enumerate([Term(f, axis) for f in range(1, 7) for axis in ("rz", "rx", "ry")]))
    motion = Motion(chain_of(lrmate), np.zeros((2, 6)), np.tile([0.06, 0, 0.12], (2, 1)), terms, len(terms))
    values = np.full(len(terms), 0.7)
    np.testing.assert_allclose(motion.points(values), points_reference(motion, values), atol=1e-14)


def test_no_rows(lrmate):
    motion, _ = motion_of(replace(lrmate), lean, 0)
    values = np.zeros(motion.size)
    assert motion.points(values).shape == (3, 0)
    assert motion.columns(values, np.zeros((3, 0)), np.zeros((3, 0))).shape == (motion.size, 0)


# --- The readable chain against finite differences and its own conventions.

ANGLES = st.floats(-3.14, 3.14)


@given(st.tuples(ANGLES, st.floats(-1.57, 1.57), ANGLES))
def test_rpy_round_trip(rpy):
    np.testing.assert_allclose(rpy_of(rpy_matrix(rpy)), rpy, atol=1e-9)


@given(st.tuples(ANGLES, st.sampled_from((-np.pi / 2, np.pi / 2)), ANGLES))
def test_rpy_at_gimbal_lock(rpy):
    matrix = rpy_matrix(rpy)
    np.testing.assert_allclose(rpy_matrix(rpy_of(matrix)), matrix, atol=1e-12)


def test_rpy_is_about_fixed_axes():
    """Roll first, about F0's x; then pitch about F0's y; then yaw about F0's z."""
    turned = rpy_matrix(np.radians([90, 0, 90])) @ [0, 1, 0]  # y to z by the roll, where it stays
    np.testing.assert_allclose(turned, [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(rpy_matrix(np.radians([0, 90, 0])) @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    turned = rigid(rotation(2, np.pi / 2), [1, 2, 3]) @ [1, 0, 0, 1]
    np.testing.assert_allclose(turned, [1, 3, 3, 1], atol=1e-15)


def test_readings_to_link_angles(lrmate):
    """The pendant's J3 is taken against the floor: J2 alone turns link 3 back."""
    at = link_angles(lrmate, np.radians([[10.0, 20, 30, 40, 50, 60], [0, 20, -20, 0, 0, 0]]))
    expected = [[10, -70, -50, -40, -50, -60], [0, -70, 0, 0, 0, 0]]
    np.testing.assert_allclose(np.degrees(at), expected, atol=1e-12)


def by_hand(chain, q, tool, delta):
    """One point by 4 x 4 matrices, in the order that the chain's docstring gives."""

    def displaced(x):
        out = np.eye(4)
        for k, name in enumerate(AXES):
            axis = "xyz".index(name[1])
            slide = rigid(None, x[k] * np.eye(3)[axis])
            out = out @ (rigid(rotation(axis, x[k])) if name[0] == "r" else slide)
        return out

    pose = chain.base @ displaced(delta[0]) @ chain.link[0]
    for i in range(1, chain.n + 1):
        joint = rigid(rotation(2, q[i - 1]), [0, 0, chain.d[i - 1]])
        pose = pose @ joint @ displaced(delta[i]) @ chain.link[i]
    return (pose @ rigid(None, tool) @ displaced(delta[-1]))[:3, 3]


@given(robots(), st.integers(0, 2**32 - 1))
def test_displaced_points(robot, seed):
    rng = np.random.default_rng(seed)
    chain = chain_of(robot)
    q, tool = rng.uniform(-3, 3, (3, robot.n)), rng.uniform(-0.2, 0.2, (3, 3))
    delta = rng.uniform(-0.1, 0.1, (2, 3, robot.n + 2, 6))
    found = points(chain, q, tool, delta)
    assert found.shape == (2, 3, 3)
    for walker in range(2):
        for k in range(3):
            expected = by_hand(chain, q[k], tool[k], delta[walker, k])
            np.testing.assert_allclose(found[walker, k], expected, atol=1e-13)


# --- Compiled functions work where no folder for compiled code can be written.

FILES = [path for package in ("bayescal", "factors") for path in (ROOT / package).rglob("*.py")]
COMPILED = sorted(p for p in FILES if re.search("import (numba|compiled)", p.read_text(encoding="utf-8")))


@pytest.mark.parametrize("path", COMPILED, ids=lambda p: p.stem)
def test_no_folder_for_compiled_code(path, monkeypatch):
    """Installed in a folder that the user cannot write, without a home: numba finds no place and raises."""

    def refused(self):
        raise OSError("read-only")

    for locator in caching.CompileResultCacheImpl._locator_classes:
        monkeypatch.setattr(locator, "ensure_cache_path", refused, raising=False)
    with pytest.raises(RuntimeError, match="no locator"):
        njit(cache=True)(doubled)
    assert runpy.run_path(str(path))


def doubled(x):
    return 2.0 * x


def test_modules_with_compiled_functions_are_found():
    assert {"kernel", "evidence"} <= {path.stem for path in COMPILED}
