"""The arm at rest under gravity, against MuJoCo: every spring carries what hangs on it."""

import re
import sys
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from spring_arm import Errors, MuJoCoArm, Springs, X, Z, parts, tool_points

from bayescal.arm.chain import link_angles
from bayescal.effects import parameters_of
from bayescal.effects.compliance import typical
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated, settled
from bayescal.model import Model, Scene, build, equilibrium
from bayescal.model.equilibrium import STILL, by_name, moved
from bayescal.model.equilibrium import tool_points as our_points
from bayescal.robots import load_robot
from bayescal.simulation import Options, simulate

POSES = 10
DEPTH = 0.35
"""m: how far below the origin the stand's hinges are."""
ROBOTS = ("fanuc-lrmate200ic mdh", "fanuc-lrmate200ic dh", "universal-robots-ur5e mdh")
DOWN = {"floor": -Z, "wall": X, "ceiling": Z}  # in F0
AXES = {"floor": "xy", "wall": "zy", "ceiling": "xy"}  # horizontal ones, in the order in which a base yields
MORE = 0.4
"""kg that are not stated."""

NAMES = {
    "joint": ("compliance {}",),
    "bearing": ("bending {} bearing",),
    "y": ("bending {} link y",),
    "other": ("bending {} link x", "bending {} link z"),
}


@cache
def any_session():
    return simulate(Options(contacts=60, repeats=0, later=0, placements=0)).dataset


@cache
def session(robot, mounting):
    """A session of an arm in random poses, on the floor or hanging."""
    dataset, (name, convention) = any_session(), robot.split()
    robot, m = replace(load_robot(name)[0], convention=convention), dataset.measurements
    rows = {f.name: v[:POSES] for f in fields(m) if (v := getattr(m, f.name)) is not None}
    rows["readings"] = np.random.default_rng(1).uniform(-2.6, 2.6, (POSES, robot.n))
    return replace(dataset, robot=robot, gravity=9.81 * DOWN[mounting], measurements=replace(m, **rows))


def drawn(dataset, mounting, effects):
    """Springs and errors of a table, of usual size, for those effects."""
    robot, rng = dataset.robot, np.random.default_rng(2)
    n, usual = robot.n, typical(robot.n)
    link = 0.3 * np.minimum(usual, usual[-4])
    geometry = [s * rng.standard_normal(n) * ("geometry" in effects) for s in (2e-3, 3e-4, 1e-3, 3e-4, 1e-3)]
    factor = np.exp(0.5 * rng.standard_normal((4, n)))
    give = {
        "joint": factor[0] * usual * ("compliance" in effects),
        "bearing": 0.3 * factor[1] * usual * ("bearing" in effects),
        "y": factor[2] * link * ("link" in effects),
        "other": factor[3] * link * ("link" in effects),
    }
    stand = {axis: c * ("base" in effects) for axis, c in zip(AXES[mounting], (1.2e-5, 0.8e-5), strict=True)}
    return give, Errors(*geometry), stand


def bare(effects):
    """Models of some effects without blocks."""

    def make(scene):
        c = scene.circumstances(scene.rows("calibrate"))
        return Model(scene, effects, parameters_of(effects, c), (), ())

    return make


def ours(dataset, mounting, effects, mass=0.0):
    """TCP positions (N, 3), m, of the model of bayescal, and the names of its parameters."""
    give, errors, stand = drawn(dataset, mounting, effects)
    known = {"payload mass": mass}
    for kind, patterns in NAMES.items():
        for name, c in zip(dataset.robot.joint_names, give[kind], strict=True):
            known |= {pattern.format(name): c for pattern in patterns}
    for f in fields(errors):
        known |= {f"{f.name}{i}": value for i, value in enumerate(getattr(errors, f.name), start=1)}
    for axis, c in stand.items():
        (across,) = set(AXES[mounting]) - {axis}
        way = np.cross(unit(axis), -DOWN[mounting]) @ unit(across)
        known |= {f"base-compliance {axis}": c, f"base-compliance slide {axis}": DEPTH * c * way}
    models = ("geometry", "compliance", "bending", "base-compliance", "payload")

    def values(model):
        return np.array([known.get(p.name, 0.0) for p in model.parameters])

    model = equilibrium(Scene(dataset), bare(models), values)
    return our_points(model, values(model)).T, {p.name for p in model.parameters}


def unit(axis):
    return np.eye(3)["xyz".index(axis)]


def theirs(dataset, mounting, effects, names, mass=0.0):
    """TCP positions (N, 3), m, of the springs in MuJoCo, of those that are parameters of the model."""
    give, errors, stand = drawn(dataset, mounting, effects)
    (tool,), robot = dataset.tools, dataset.robot
    point = DEPTH * DOWN[mounting]
    springs = Springs(**give, base=[(unit(axis), point, c) for axis, c in stand.items() if c])
    for i, name in enumerate(robot.joint_names):
        for kind, patterns in NAMES.items():
            give[kind][i] *= any(pattern.format(name) in names for pattern in patterns)
        for f in fields(errors):
            getattr(errors, f.name)[i] *= f"{f.name}{i + 1}" in names
    chain = list(parts(robot, springs, errors, tool.mass + mass, tool.centre_of_mass))
    arm = MuJoCoArm(chain, dataset.gravity)
    return tool_points(arm, link_angles(robot, dataset.measurements.readings), tool.centre)


def apart(robot, mounting, effects, mass=0.0):
    """Largest distance of the TCP positions of MuJoCo and the model, and the effect of gravity, in um."""
    dataset = session(robot, mounting)
    found, names = ours(dataset, mounting, effects, mass)
    stiff, _ = ours(dataset, mounting, ("geometry",))
    off = found - theirs(dataset, mounting, effects, names, mass)
    return 1e6 * np.max(np.linalg.norm(off, axis=1)), 1e6 * np.max(np.linalg.norm(found - stiff, axis=1))


@pytest.mark.parametrize(("effects", "limit", "mass"), [
    (("compliance",), 1e-3, 0.0),
    (("compliance", "bearing"), 1e-3, 0.0),
    (("compliance", "base"), 0.1, 0.0),
    (("compliance", "link"), 0.6, 0.0),
    (("compliance", "bearing", "base"), 0.15, MORE),
], ids=["joints", "bearings", "base", "links", "payload"])  # fmt: skip
@pytest.mark.parametrize(("robot", "mounting"), [*zip(ROBOTS, DOWN, strict=True)])
def test_an_arm_rests_where_its_springs_hold_it(robot, mounting, effects, limit, mass):
    """With errors of the table too. Bases and links turn beside their frames: with first-order slides."""
    off, size = apart(robot, mounting, ("geometry", *effects), mass)
    assert off < limit
    assert size > 500


# --- The arm of a fit, and the true arm of a simulated session, are at rest under gravity.

EVERY = ("geometry", "compliance", "bending", "base-compliance")


@pytest.fixture(scope="module")
def loaded():
    """A session with two kilograms on half of its contacts, of an arm that yields everywhere."""
    options = Options(seed=2, contacts=120, repeats=0, later=0, placements=0, noise=2e-6, payload=2.0)
    return simulate(Options(**{**vars(options), "effects": EVERY}))


def test_a_fitted_arm_is_at_rest(loaded):
    """Moments computed again at its pose do not move a TCP; after two fits they moved it by 6 um."""
    found = calibrated(Scene(loaded.dataset), EVERY)
    again = build(settled(found), EVERY)
    values = by_name(again, found.arm, found.model)
    assert moved(our_points(found.model, found.arm), our_points(again, values)) < STILL


def test_every_start_comes_to_the_same_rest(loaded):
    """From nominal moments and from those of an arm that yields three times as much."""
    values = loaded.world.deviations

    def soft(model):
        return 3.0 * values(model)

    scene, make = Scene(loaded.dataset), bare(EVERY)
    here = equilibrium(scene, make, values, 1e-13)
    far = equilibrium(scene, make, soft, 1e-13)
    back = equilibrium(far.scene, make, values, 1e-13)
    nominal = make(scene)
    points = [our_points(m, values(m)) for m in (nominal, here, back)]
    assert moved(points[1], points[2]) < 1e-12
    assert moved(points[0], points[1]) > 5e-5


def test_an_arm_that_falls_is_refused(loaded):
    scene = Scene(loaded.dataset)

    def limp(model):
        return np.array([0.3 if p.name == "compliance J3" else 0.0 for p in model.parameters])

    with pytest.raises(BayescalError, match=re.escape("the arm does not come to rest under gravity")):
        equilibrium(scene, bare(("compliance",)), limp)


def test_fits_that_do_not_come_to_rest_are_refused(loaded, monkeypatch):
    monkeypatch.setattr(sys.modules["bayescal.estimate.estimate"], "FITS", 2)
    with pytest.raises(BayescalError, match="between fits, after 2 of them"):
        calibrated(Scene(loaded.dataset), ("geometry", "compliance"))


def test_fits_that_come_to_rest_slowly_are_not_refused(loaded, monkeypatch):
    """A tenth of the noise is enough after the last fit."""
    found = calibrated(Scene(loaded.dataset), ("geometry", "compliance"))
    for name, value in (("AT_REST", 0.0), ("STILL", 0.0), ("FITS", 4)):
        monkeypatch.setattr(sys.modules["bayescal.estimate.estimate"], name, value)
    last = calibrated(Scene(loaded.dataset), ("geometry", "compliance"))
    assert np.max(np.abs(last.z - found.z) / found.sd) < 0.1
