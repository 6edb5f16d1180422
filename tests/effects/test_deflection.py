"""An added mass acts on every compliant site: against a heavier tool, which the statics know."""

from dataclasses import replace

import numpy as np
import pytest
from cases import cases
from sessions import circumstances, with_columns

from bayescal.arm.chain import Robot, chain_of, link_angles
from bayescal.arm.statics import Stance, gravity_loads
from bayescal.effects import EFFECTS, Circumstances, location, parameters_of
from bayescal.effects.by_time import PAUSES, heated
from bayescal.effects.gravity import MASS_SHARE, masses
from bayescal.effects.location import ARM, KINDS, PLAIN, PROBE, Driver, Site, face, joint, link
from bayescal.effects.location import BASE as BASE_SITE
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated, linearise, unit_weights
from bayescal.estimate.estimate import acts
from bayescal.gap.search.cells import cells
from bayescal.gap.search.unknown import Pool
from bayescal.model import Scene, build
from bayescal.model.options import FitOptions, Part
from bayescal.simulation import Options, World, simulate

YIELDING = ("geometry", "compliance", "bending", "base-compliance")
MORE = 0.4  # kg


def values(model, mass):
    """Deviations of a simulated arm: the prior means of its compliances, and a payload error."""
    out = model.shift.copy()
    for k, p in enumerate(model.parameters):
        out[k] = mass if p.effect == "payload" else 3e-7 if "slide" in p.name else out[k]
    return out


def ball(dataset, effects, mass=0.0):
    """Ball centres (3, N) of the simulated arm at the equilibrium of its statics, m."""
    model = World(effects, lambda model: values(model, mass), dataset.targets).model(dataset)
    return model.motion(np.arange(len(dataset.measurements.readings))).points(values(model, mass))


def unloaded(dataset):
    """The session without payload."""
    return with_columns(dataset, payload=None)


@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_a_payload_error_is_a_heavier_tool(cube, convention, stated):
    """With and without compliances that the robot file states, whose deflection is nominal."""
    dataset = cube(seed=3, count=24).dataset
    known = np.array([0.0, 2e-5, 1e-4, 1e-3, 1e-3, 1e-3]) if stated else None
    dataset = replace(dataset, robot=replace(dataset.robot, convention=convention, compliance=known))
    (tool,) = dataset.tools
    heavier = replace(dataset, tools=(replace(tool, mass=tool.mass + MORE),))
    before, moved = ball(dataset, YIELDING), ball(dataset, (*YIELDING, "payload"), MORE)
    expected = ball(heavier, YIELDING)
    assert np.max(np.linalg.norm(expected - before, axis=0)) > 1e-4
    np.testing.assert_allclose(moved, expected, atol=2e-7 if stated else 1e-9)


def test_a_payload_that_hangs_elsewhere_is_a_tool_with_another_centre_of_mass(cube):
    """The heavier tool has the first moment of both masses."""
    dataset, off = unloaded(cube(seed=3, count=24).dataset), np.array([0.03, -0.05, 0.08])
    (tool,) = dataset.tools
    total = tool.mass + MORE
    other = replace(tool, mass=total, centre_of_mass=tool.centre_of_mass + MORE / total * off)
    moments = {f"payload moment {a}": MORE * v for a, v in zip("xyz", off, strict=True)}
    given = moments | {"payload mass": MORE}

    def found(model):
        out = values(model, 0.0)
        return np.array([given.get(p.name, v) for p, v in zip(model.parameters, out, strict=True)])

    model = World((*YIELDING, "payload@elsewhere"), found, dataset.targets).model(dataset)
    moved = model.motion(np.arange(24)).points(found(model))
    assert set(given) <= set(model.names)
    assert np.max(np.linalg.norm(moved - ball(dataset, (*YIELDING, "payload"), MORE), axis=0)) > 2e-5
    np.testing.assert_allclose(moved, ball(replace(dataset, tools=(other,)), YIELDING), atol=1e-9)


def test_the_centre_of_an_added_load_acts_in_the_rows_that_carry_it(cube):
    dataset = cube(seed=3, count=24).dataset
    payload = np.where(np.arange(24) % 3 == 0, 2.0, 0.0)
    c = circumstances(with_columns(dataset, payload=payload))
    by = {p.name: p for s in ("payload@elsewhere", "payload@added") for p in parameters_of((s,), c)}
    for axis in "xyz":
        whole, own = by[f"payload moment {axis}"].terms, by[f"payload added centre {axis}"].terms
        assert len(whole) == len(own) > 0
        for a, b in zip(whole, own, strict=True):
            np.testing.assert_allclose(payload * a.driver, b.driver, rtol=1e-9, atol=1e-15)
    for a, b in zip(by["payload mass"].terms, by["payload added share"].terms, strict=True):
        np.testing.assert_allclose(payload * a.driver, b.driver, rtol=1e-9, atol=1e-15)
    with pytest.raises(BayescalError, match="has no parameters here"):
        parameters_of(("payload@added",), circumstances(unloaded(dataset)))


def test_what_holds_the_loads_acts_alike_under_each_of_them(cube):
    """With loads of one size it is a share of them, and no form of its own."""
    dataset = cube(seed=3, count=24).dataset
    payload = np.array([0.0, 2.0, 5.0])[np.arange(24) % 3]
    c = circumstances(with_columns(dataset, payload=payload))
    settings = ("payload", "payload@holder")
    whole, held = ({p.effect: p for p in parameters_of((s,), c)}["payload"] for s in settings)
    for a, b in zip(whole.terms, held.terms, strict=True):
        np.testing.assert_allclose((payload > 0) * a.driver, b.driver, rtol=1e-9, atol=1e-15)
    assert acts((held,))  # a fit moves compliances with it
    with pytest.raises(BayescalError, match="has no parameters here"):
        parameters_of(("payload@holder",), circumstances(with_columns(dataset, payload=payload % 3)))


def test_an_error_of_a_mass_moves_every_compliant_site(cube):
    """By differences of the gravity moments of all frames, times the compliances of the sites."""
    scene = Scene(cube(seed=3, count=24).dataset)
    stance = Stance(*1e-3 * np.random.default_rng(0).standard_normal((2, 24, 8, 6)))
    c = circumstances(scene)
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
        found = masses(circumstances(Scene(replace(dataset, tools=(on_axis,), measurements=rows))))
        names.append([p.name for p in found])
        terms.append({p.name: len(p.terms) for p in found})
    assert names[0] == names[1]
    assert terms[0]["centre of load z"] > terms[1]["centre of load z"]


@pytest.mark.parametrize(("more", "options", "lighter", "most"), [
    (("base-compliance",), {"contacts": 160, "payload": 2.0}, 0.3, 0.04), ((), {"contacts": 120}, 0.5, 0.5),
])  # fmt: skip
def test_a_fit_finds_a_mass_that_was_not_stated(more, options, lighter, most):
    """On a base that deflects too, beside rows with 2 kg more; and where the tool alone loads a joint.

    There fits alternate between its compliance and the mass.
    """
    effects = ("geometry", "compliance", *more)
    usual = {"seed": 2, "repeats": 0, "later": 0, "placements": 0, "noise": 2e-6}
    dataset = simulate(Options(**usual, **options, effects=effects)).dataset
    (tool,) = dataset.tools
    stated = replace(dataset, tools=(replace(tool, mass=tool.mass - lighter),))
    found = calibrated(Scene(stated), (*effects, "payload"))
    k = found.model.names.index("payload mass")
    sd = found.sd[k] * found.model.sd[k]
    assert abs(found.model.physical(found.z)[k] - lighter) < 4 * sd < most
    assert found.weights.scale["contact"] < 1.15


# --- Which parameters exist, and that what is left of them the contacts can tell.

LOOSE = {
    *(f"a{i}" for i in range(1, 6)), *(f"alpha{i}" for i in range(1, 6)), *(f"theta{i}" for i in range(2, 6)),
    *(f"d{i}" for i in range(2, 6)), "beta2",
}  # fmt: skip
BASE = {"base x", "base y", "base z", "base rx", "base ry", "base rz"}
WRIST = {"theta6", "d6"}
TOOL = {"ball x", "ball y", "ball z"}


def stating(dataset, target=None, angle=None, tool=None):
    """The session with a stated uncertainty of its first target and of its tool."""
    first = replace(dataset.targets[0], u=target, u_angle=angle)
    tools = tuple(replace(t, u=tool) for t in dataset.tools)
    return replace(dataset, targets=(first, *dataset.targets[1:]), tools=tools)


def names_of(dataset, effects=("geometry",)):
    return {p.name for p in parameters_of(effects, circumstances(dataset))}


@pytest.mark.parametrize(("stated", "expected"), [
    ({}, LOOSE | TOOL),
    ({"target": 1e-3}, LOOSE | TOOL | BASE),
    ({"angle": 1e-3}, LOOSE | TOOL | BASE),
    ({"target": 0.0, "angle": 0.0}, LOOSE | TOOL | BASE),
    ({"tool": 1e-3}, LOOSE | TOOL | WRIST),
    ({"tool": 0.0}, LOOSE | WRIST),
    ({"target": 1e-3, "tool": 1e-3}, LOOSE | TOOL | BASE | WRIST),
])  # fmt: skip
def test_lrmate(cube, stated, expected):
    assert names_of(stating(cube(seed=1).dataset, **stated)) == expected
    assert len(LOOSE) == 19  # eighteen, and d3 beside d2


def test_stated_width_is_the_prior(cube):
    scene = Scene(stating(cube(seed=1).dataset, target=2e-4, angle=3e-4, tool=1e-4))
    model = build(scene, ("geometry",))
    sd = {p.name: p.sd for p in model.parameters}
    assert sd["ball x"] == 1e-4
    assert (sd["a1"], sd["alpha1"], sd["theta2"], sd["d2"], sd["beta2"]) == (3e-4, 1e-3, 2e-3, 3e-4, 1e-3)
    np.testing.assert_array_equal(model.blocks[0].kind.sd, [3e-4, 3e-4, 2e-4])
    np.testing.assert_array_equal(model.blocks[1].kind.sd, [0.2, 0.2, 0.05])
    wide = build(scene, ("geometry",), FitOptions(prior_width=10.0))
    assert {p.name: p.sd for p in wide.parameters}["a1"] == pytest.approx(3e-3)
    np.testing.assert_array_equal(wide.blocks[0].kind.sd, [3e-4, 3e-4, 2e-4])


def test_a_target_or_tool_that_is_not_fitted_ties_nothing(cube):
    """Stated by `validate` rows alone, a place says nothing of the base."""
    dataset = stating(cube(seed=1).dataset, target=1e-3)
    role = np.where(dataset.measurements.target == 0, "validate", "calibrate")
    assert names_of(with_columns(dataset, role=role)) == LOOSE | TOOL


def test_one_direction_is_left_to_the_prior(cube):
    """Of a LR Mate by four loose planes: d2 and d3 are told only as a sum, all else is told."""
    model = build(Scene(cube(seed=1, count=300).dataset), ("geometry", "compliance"))
    z = np.zeros(model.size)
    jacobian = linearise(model, z, unit_weights(model, z)).jacobian
    _, size, directions = np.linalg.svd(jacobian, full_matrices=False)
    assert size[-1] < 1e-9 * size[0]
    assert size[-2] > 1.0  # one standard deviation of the prior or better
    left = dict(zip(model.names, directions[-1], strict=True))
    assert abs(left["d2"]) == pytest.approx(np.sqrt(0.5))
    assert left["d2"] == pytest.approx(-left["d3"])


def test_beta_where_axes_are_parallel():
    """A UR-like table, in standard DH: axes 2, 3 and 4 are parallel, 1 and 2 are not."""
    robot = Robot(
        "ur", "dh", tuple(f"J{i}" for i in range(1, 7)), np.radians([90.0, 0, 0, 90, -90, 0]),
        np.array([0, -0.425, -0.392, 0, 0, 0]), np.array([0.089, 0, 0, 0.109, 0.095, 0.082]), np.zeros(6),
        np.zeros(6), np.tile([-6.0, 6.0], (6, 1)), np.eye(6),
    )  # fmt: skip
    circumstances = Circumstances(
        robot, chain_of(robot), np.zeros((1, 6)), None, np.zeros(1, int), ("t",), np.zeros((1, 3)), (None,),
        (0,), np.zeros(1, int), False, False, np.zeros((1, 6)), np.zeros(3), np.zeros(1), np.zeros((1, 3)),
        np.full((1, 3), np.nan), (None,),
    )  # fmt: skip
    found = {p.name: p.nominal for p in EFFECTS["geometry"].parameters(circumstances)}
    assert {name for name in found if name.startswith("beta")} == {"beta2", "beta3"}
    # named by the link that joint i moves, whatever the convention
    assert (found["a2"], found["a3"], found["d4"], found["alpha1"]) == (-0.425, -0.392, 0.109, np.pi / 2)


def test_craig_names(cube):
    """In modified DH a_i and alpha_i stand in row i + 1: the LR Mate's upper arm of 300 mm is a2."""
    nominal = {p.name: p.nominal for p in build(Scene(cube(seed=1).dataset), ("geometry",)).parameters}
    assert [nominal[f"a{i}"] for i in range(1, 6)] == pytest.approx([0.075, 0.3, 0.075, 0, 0])
    assert [nominal[f"alpha{i}"] for i in range(1, 6)] == pytest.approx(np.radians([-90, 0, -90, 90, -90]))
    assert [nominal[f"d{i}"] for i in range(2, 6)] == pytest.approx([0, 0, 0.32, 0])
    assert nominal["theta2"] == pytest.approx(-np.pi / 2)


# --- Sites and drivers: their words in files, their text, what counts as one coordinate, and its values.


@pytest.fixture
def given(cube):
    return circumstances(cube(seed=1).dataset)


@pytest.mark.parametrize(("driver", "words", "text"), cases("drivers"))
def test_words_of_files_and_text_for_people(driver, words, text):
    driver = Driver(**driver)
    assert (str(driver), driver.text) == (words, text)


def test_sites_are_read_as_they_are_written():
    for site in (*map(Site, PLAIN), joint(4), link(11), face("cube.+y"), face("joint"), face("joint x")):
        assert Site.read(str(site)) == site
    assert [s.text for s in (joint(4), BASE_SITE, face("cube.+y"))] == ["joint 4", "the base", "cube.+y"]
    assert link(2).also == (joint(2), link(2))


@pytest.mark.parametrize(("driver", "course"), [
    (Driver("angle", 4, 2.0), Driver("angle", 4)),
    (Driver("torque", 4, form="sign"), Driver("torque", 4)),
    (Driver("torque", 4, form="past"), Driver("torque", 4, form="past")),
    (Driver("time", form="to and fro"), Driver("time")),
    (Driver("contact speed"), Driver("contact speed")),
])  # fmt: skip
def test_forms_of_one_coordinate(driver, course):
    assert driver.course == course


def test_coordinates_are_those_of_the_session(given):
    c = given
    row = np.arange(1.0, len(c.q) + 1)
    for driver, site, label, values in (
        (Driver("angle", 4, 2.0), joint(4), "reading of joint 4 (deg)", np.degrees(c.readings[:, 3])),
        (Driver("angle", 4, 160.0), joint(4), "phase of joint 4, 160 periods per revolution (deg)",
         np.degrees(160.0 * c.readings[:, 3]) % 360.0),
        (Driver("direction", 2), joint(2), "speed of joint 2 (deg/s)", np.degrees(c.velocity[:, 1])),
        (Driver("torque", 3, form="sign"), joint(3), "gravity torque on joint 3 (N m)", c.moments[:, 3, 2]),
        (Driver("torque", 3, form="past"), joint(3), "", row),
        (Driver("torque"), ARM, "", row),  # it was called that of joint 0
        (Driver("contact speed"), PROBE, "speed of contact (mm/s)", 1e3 * c.speed),
        (Driver("face", form="one spot"), face(c.faces[1].name), "place along the face (-1 to 1)",
         c.faces[1].place[:, 0]),
        (Driver("humidity"), ARM, "", row),
    ):  # fmt: skip
        found = driver.coordinate(site, c)
        assert found.label == label
        np.testing.assert_allclose(found.values, values)


def test_effects_and_cells_are_told_in_known_kinds(given):
    """A misspelt kind would have neither text nor a coordinate."""
    lacking = {name for name, effect in EFFECTS.items() if effect.missing(given)}
    places = [(p.site, p.driver) for p in parameters_of(tuple(set(EFFECTS) - lacking), given)]
    places += [(cell.site, cell.driver) for cell in cells(given)]
    for site, driver in places:
        assert driver.kind in KINDS
        assert site.kind in (*PLAIN, *location.NUMBERED, "face")


def test_a_face_that_is_called_like_a_joint_is_a_face(given):
    """Cells are weighed by the kind of their site, whatever the user's targets are called."""
    of = [cell for cell in cells(given) if cell.site.kind in ("joint", "face")]
    renamed = [
        replace(cell, site=face(f"joint {cell.site.name}")) if cell.site.kind == "face" else cell
        for cell in of
    ]  # fmt: skip
    nothing = np.zeros((3, 0)), (), 3
    weights = [Pool(*nothing, cells=tuple(some), owner=np.zeros(0, int)).log_prior for some in (of, renamed)]
    np.testing.assert_array_equal(*weights)


def test_a_part_at_a_face_is_that_of_the_face(given):
    name = given.faces[0].name
    own = parameters_of(("plane-form",), given)
    part = Part.of(f"plane-form at {name}")
    assert {str(p.site) for p in own if part.holds(p)} == {name}


# --- Drift of an arm that cools for a while: its course against an integration in small steps.


def test_a_body_that_is_heated_cools_and_is_heated_again():
    """Newton's law, integrated in 200,000 steps."""
    begin, end, constant = 0.4, 0.7, 0.3
    time = np.linspace(0.0, 1.0, 200_001)
    state, course = 0.0, []
    for t in time:
        course.append(state)
        goal = 0.0 if begin <= t < end else 1.0
        state += (goal - state) / constant * (time[1] - time[0])
    some = slice(None, None, 4000)
    np.testing.assert_allclose(heated(time, begin, end, constant)[some], np.array(course)[some], atol=2e-5)


@pytest.mark.parametrize("pause", PAUSES[::5])
def test_a_paused_drift_covers_the_session(cube, pause):
    c = circumstances(cube(seed=1).dataset)
    name = f"thermal-drift@paused-{pause[0]}-{pause[1]}-{pause[2]}"
    own = [p for p in parameters_of((name,), c) if p.effect == "thermal-drift"]
    assert [(p.name, p.sd) for p in own] == [(p.name, p.sd) for p in EFFECTS["thermal-drift"].at(c, 600.0)]
    (term,) = next(p for p in own if p.name.startswith("thermal-drift base")).terms
    assert (np.min(term.driver), np.max(term.driver)) == (-1.0, 1.0)
    assert np.any(np.diff(term.driver) < 0)
    assert np.any(np.diff(term.driver) > 0)


def test_a_load_is_added_to_the_tool_that_carries_it(cube):
    """Of two tools the heavier one is no load: what differs in the rows of a tool is."""
    dataset = cube(seed=2, count=30).dataset
    count = len(dataset.measurements.ids)
    second = np.arange(count) % 3 == 0
    tools = (dataset.tools[0], replace(dataset.tools[0], name="other"))
    payload = np.where(np.arange(count) % 2, 1.5, 0.0)

    def drivers(more, payload):
        own = (tools[0], replace(tools[1], mass=tools[0].mass + more))
        c = circumstances(with_columns(replace(dataset, tools=own), tool=second * 1, payload=payload))
        added = (p for p in parameters_of(("payload@added",), c) if p.effect == "payload")
        return [np.asarray(t.driver) for p in added for t in p.terms]

    light, heavy = drivers(0.0, payload), drivers(3.0, payload)
    assert len(light) == len(heavy) > 0
    for a, b in zip(light, heavy, strict=True):
        assert not np.any(b[payload == 0.0])
        np.testing.assert_allclose(a[~second], b[~second], rtol=1e-9, atol=1e-15)
    with pytest.raises(BayescalError):
        drivers(3.0, np.zeros(count))
