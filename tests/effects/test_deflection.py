"""An added mass acts on every compliant site: against a heavier tool, which the statics know."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.arm.chain import link_angles
from bayescal.arm.statics import Stance, gravity_loads
from bayescal.effects import parameters_of
from bayescal.effects.gravity import MASS_SHARE, masses
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate
from bayescal.simulation.touch import World

EFFECTS = ("geometry", "compliance", "bending", "base-compliance")
MORE = 0.4  # kg


def values(model, mass):
    """Deviations of a simulated arm: the prior means of its compliances, and a payload error."""
    out = model.shift.copy()
    for k, p in enumerate(model.parameters):
        out[k] = mass if p.effect == "payload" else 3e-7 if "slide" in p.name else out[k]
    return out


def ball(dataset, effects, mass=0.0):
    """Ball centres (3, N) of the simulated arm at the equilibrium of its statics, m."""
    world = World(effects, lambda model: values(model, mass), dataset.targets)
    model = world.model(dataset)
    return model.motion(np.arange(len(dataset.measurements.readings))).points(values(model, mass))


def unloaded(dataset):
    """The session without payload."""
    return replace(dataset, measurements=replace(dataset.measurements, payload=None))


@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_a_payload_error_is_a_heavier_tool(cube, convention, stated):
    """With and without compliances that the robot file states, whose deflection is nominal."""
    dataset = cube(seed=3, count=24).dataset
    known = np.array([0.0, 2e-5, 1e-4, 1e-3, 1e-3, 1e-3]) if stated else None
    dataset = replace(dataset, robot=replace(dataset.robot, convention=convention, compliance=known))
    (tool,) = dataset.tools
    heavier = replace(dataset, tools=(replace(tool, mass=tool.mass + MORE),))
    before, moved = ball(dataset, EFFECTS), ball(dataset, (*EFFECTS, "payload"), MORE)
    expected = ball(heavier, EFFECTS)
    assert np.max(np.linalg.norm(expected - before, axis=0)) > 1e-4
    np.testing.assert_allclose(moved, expected, atol=2e-7 if stated else 1e-9)


def test_a_payload_that_hangs_elsewhere_is_a_tool_with_another_centre_of_mass(cube):
    """The heavier tool has the first moment of both masses."""
    dataset, off = unloaded(cube(seed=3, count=24).dataset), np.array([0.03, -0.05, 0.08])
    (tool,) = dataset.tools
    total = tool.mass + MORE
    other = replace(tool, mass=total, centre_of_mass=tool.centre_of_mass + MORE / total * off)
    given = {"payload mass": MORE} | {
        f"payload moment {a}": MORE * v for a, v in zip("xyz", off, strict=True)
    }

    def found(model):
        out = values(model, 0.0)
        return np.array([given.get(p.name, v) for p, v in zip(model.parameters, out, strict=True)])

    world = World((*EFFECTS, "payload@elsewhere"), found, dataset.targets)
    model = world.model(dataset)
    moved = model.motion(np.arange(24)).points(found(model))
    assert set(given) <= set(model.names)
    assert np.max(np.linalg.norm(moved - ball(dataset, (*EFFECTS, "payload"), MORE), axis=0)) > 2e-5
    np.testing.assert_allclose(moved, ball(replace(dataset, tools=(other,)), EFFECTS), atol=1e-9)


def test_the_centre_of_an_added_load_acts_in_the_rows_that_carry_it(cube):
    dataset = cube(seed=3, count=24).dataset
    payload = np.where(np.arange(24) % 3 == 0, 2.0, 0.0)
    scene = Scene(replace(dataset, measurements=replace(dataset.measurements, payload=payload)))
    c = scene.circumstances(scene.rows("calibrate"))
    by = {p.name: p for s in ("payload@elsewhere", "payload@added") for p in parameters_of((s,), c)}
    for axis in "xyz":
        whole, own = by[f"payload moment {axis}"].terms, by[f"payload added centre {axis}"].terms
        assert len(whole) == len(own) > 0
        for a, b in zip(whole, own, strict=True):
            np.testing.assert_allclose(payload * a.driver, b.driver, rtol=1e-9, atol=1e-15)
    for a, b in zip(by["payload mass"].terms, by["payload added share"].terms, strict=True):
        np.testing.assert_allclose(payload * a.driver, b.driver, rtol=1e-9, atol=1e-15)
    even = Scene(unloaded(dataset))
    with pytest.raises(BayescalError, match="has no parameters here"):
        parameters_of(("payload@added",), even.circumstances(even.rows("calibrate")))


def test_an_error_of_a_mass_moves_every_compliant_site(cube):
    """By differences of the gravity moments of all frames, times the compliances of the sites."""
    scene = Scene(cube(seed=3, count=24).dataset)
    stance = Stance(*1e-3 * np.random.default_rng(0).standard_normal((2, 24, 8, 6)))
    c = scene.circumstances(scene.rows("calibrate"))
    rigid = {f"compliance {name}": 0.0 for name in c.robot.joint_names}
    q = link_angles(c.robot, c.readings)
    heavier = c.robot.masses.copy()
    heavier[2] *= 1 + MASS_SHARE

    def moments(kilograms):
        robot = replace(c.robot, masses=kilograms)
        return gravity_loads(robot, c.chain, q, c.gravity, c.load_mass, c.load_centre, stance).moments

    added = moments(heavier) - moments(c.robot.masses)
    for site, frame, axis in (("base-compliance x", 0, "rx"), ("bending J2 bearing", 2, "ry")):
        now = replace(c, stance=stance, compliances=rigid | {site: 2e-5})
        (p,) = (p for p in masses(now) if p.name == "mass of link 3")
        driver = {(t.frame, t.axis): p.sd * t.driver for t in p.terms}[frame, axis]
        component = "xyz".index(axis[1])
        np.testing.assert_allclose(driver, 2e-5 * added[:, frame, component], atol=1e-12, err_msg=site)
        assert np.max(np.abs(driver)) > 1e-8


def test_errors_of_masses_are_the_same_at_all_poses(cube):
    """An export takes those of a fit to poses that load other joints: here the TCP positions down."""
    dataset = cube(seed=3, count=24).dataset
    (tool,) = dataset.tools
    on_axis = replace(tool, centre_of_mass=np.array([0.0, 0.0, 0.05]))
    names, terms = [], []
    for readings in (dataset.measurements.readings, np.radians([[0.0, 0.0, 0.0, 0.0, -90.0, 0.0]] * 24)):
        rows = replace(dataset.measurements, readings=readings)
        scene = Scene(replace(dataset, tools=(on_axis,), measurements=rows))
        found = masses(scene.circumstances(scene.rows("calibrate")))
        names.append([p.name for p in found])
        terms.append({p.name: len(p.terms) for p in found})
    assert names[0] == names[1]
    assert terms[0]["centre of load z"] > terms[1]["centre of load z"]


def test_a_fit_finds_a_mass_that_was_not_stated():
    """A tool 0.3 kg heavier than stated, on an arm whose base deflects too, beside rows with 2 kg more."""
    effects = ("geometry", "compliance", "base-compliance")
    options = Options(seed=2, contacts=160, repeats=0, later=0, placements=0, noise=2e-6, payload=2.0)
    dataset = simulate(replace(options, effects=effects)).dataset
    (tool,) = dataset.tools
    stated = replace(dataset, tools=(replace(tool, mass=tool.mass - 0.3),))
    found = calibrated(Scene(stated), (*effects, "payload"))
    k = found.model.names.index("payload mass")
    sd = found.sd[k] * found.model.sd[k]
    assert sd < 0.01
    assert abs(found.model.physical(found.z)[k] - 0.3) < 4 * sd
    assert found.weights.scale["contact"] < 1.15


def test_a_fit_finds_a_mass_heavier_than_the_stated_tool():
    """Where the tool alone loads a joint, fits alternate between its compliance and the mass."""
    effects = ("geometry", "compliance")
    options = Options(seed=2, contacts=120, repeats=0, later=0, placements=0, noise=2e-6)
    dataset = simulate(replace(options, effects=effects)).dataset
    (tool,) = dataset.tools
    stated = replace(dataset, tools=(replace(tool, mass=tool.mass - 0.5),))
    found = calibrated(Scene(stated), (*effects, "payload"))
    k = found.model.names.index("payload mass")
    sd = found.sd[k] * found.model.sd[k]
    assert abs(found.model.physical(found.z)[k] - 0.5) < 4 * sd < 0.5
    assert found.weights.scale["contact"] < 1.15
