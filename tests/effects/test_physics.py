"""What each effect does to the arm: one short check of its physics."""

from dataclasses import replace

import numpy as np
import pytest
from sessions import circumstances, with_columns

from bayescal.arm.chain import chain_of, frames, points
from bayescal.arm.motion import CONTACT
from bayescal.arm.transforms import AXES
from bayescal.dataset import Certificate, Target
from bayescal.effects import EFFECTS, Driver
from bayescal.effects.common import usual
from bayescal.effects.compliance import typical
from bayescal.model import Scene, build
from bayescal.statistics import grouped


def drivers(dataset, effect):
    """Drivers (N,) by parameter, frame and axis."""
    c = circumstances(dataset)
    assert not EFFECTS[effect].missing(c)
    terms = ((p.name, t) for p in EFFECTS[effect].parameters(c) for t in p.terms)
    return {(name, t.frame, t.axis): np.broadcast_to(t.driver, len(c.q)) for name, t in terms}


def displacements(dataset, effect, **values):
    """Displacements (N, n + 2, 6) of all frames at some values, the others nominal."""
    scene = Scene(dataset)
    out = np.zeros((len(scene.q), scene.chain.n + 2, 6))
    for (name, frame, axis), driver in drivers(dataset, effect).items():
        out[:, frame, AXES.index(axis)] += values.get(name.replace(" ", "_").replace("-", "_"), 0.0) * driver
    return out


def ball_centres(dataset, effect, **values):
    """Ball centres (N, 3) at some values, the others nominal."""
    scene = Scene(dataset)
    return points(scene.chain, scene.q, scene.tools, displacements(dataset, effect, **values))


@pytest.fixture(scope="module")
def dataset(cube):
    return cube(seed=1).dataset


@pytest.fixture(scope="module")
def moments(dataset):
    return Scene(dataset).moments


@pytest.mark.parametrize(("effect", "order"), [("eccentricity", 1), ("second-harmonic", 2)])
def test_waves_of_a_turn(dataset, effect, order):
    """Two waves a joint that repeat with the link-relative angle: of J3 that is J2 + J3 on the pendant."""
    now = drivers(dataset, effect)
    assert len(now) == 12
    on = dataset.measurements.readings.copy()
    on[:, 1] += 0.4
    on[:, 2] -= 0.4  # the elbow stays as it is
    moved = drivers(with_columns(dataset, readings=on), effect)
    for key in now:
        assert np.allclose(moved[key], now[key]) == (key[1] != 2)
    again = drivers(with_columns(dataset, readings=dataset.measurements.readings + np.pi / order), effect)
    for key in now:
        # the third link turns twice as far, the other way
        np.testing.assert_allclose(again[key], now[key] if key[1] == 3 else -now[key], atol=1e-12)


def test_gear_mesh_repeats_every_tooth(dataset):
    now = drivers(dataset, "gear-mesh")
    assert len(now) == 4 * 6
    reading = dataset.measurements.readings.copy()
    reading[:, 3] += 2 * np.pi / 100
    whole = drivers(with_columns(dataset, readings=reading), "gear-mesh")
    reading[:, 3] += np.pi / 100
    half = drivers(with_columns(dataset, readings=reading), "gear-mesh")
    for key in now:
        np.testing.assert_allclose(whole[key], now[key], atol=1e-9)
        sign = -1 if key[0].startswith("gear-mesh 100 J4") else 1
        np.testing.assert_allclose(half[key], sign * now[key], atol=1e-9)
    none = replace(dataset, robot=replace(dataset.robot, reductions=None))
    assert "reductions" in EFFECTS["gear-mesh"].missing(circumstances(none))


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_gravity_or_motion_decides_the_flank(dataset, share):
    """Above the friction a lag (a negative value) is along the torque, below it along the motion."""
    c = circumstances(dataset)
    (p,) = (p for p in EFFECTS["backlash"].at(c, f"held-{100 * share:.0f}") if p.name == "backlash J3")
    lag = -np.asarray(p.terms[0].driver)
    torque, speed = c.torques[:, 2], c.velocity @ c.robot.link_from_reading[2]
    pull = torque / usual(c, torque)
    heavy, light = np.abs(pull) > share + 0.15, np.abs(pull) < share - 0.12
    np.testing.assert_allclose(lag[heavy], np.sign(torque[heavy]), atol=1e-3)
    np.testing.assert_allclose(lag[light], -np.sign(speed[light]), atol=1e-3)
    assert not EFFECTS["backlash"].at(replace(c, loads=None), "held-30")


def test_backlash_turns_with_the_velocity(dataset):
    now = drivers(dataset, "backlash")
    velocity = dataset.measurements.velocity
    back = drivers(with_columns(dataset, velocity=-velocity), "backlash")
    fast = drivers(with_columns(dataset, velocity=1000 * velocity), "backlash")
    for key in now:
        np.testing.assert_array_equal(back[key], -now[key])
        np.testing.assert_array_equal(np.sign(fast[key]), np.sign(now[key]))
    some = np.abs(velocity[:, 0]) > np.radians(0.001)
    np.testing.assert_allclose(fast["backlash J1", 1, "rz"][some], np.sign(velocity[some, 0]), atol=1e-3)
    still = with_columns(dataset, velocity=np.where(np.arange(6) == 4, 0.0, velocity))
    assert "backlash J5" not in {name for name, *_ in drivers(still, "backlash")}
    assert "j1_degps" in EFFECTS["backlash"].missing(circumstances(with_columns(dataset, velocity=None)))


def test_a_joint_that_hardly_turns_stands_in_its_play(dataset):
    """Nothing at rest, half of the play's square at 0.03 deg/s, all of it from ten times that on."""
    speed = np.radians(np.resize([0.0, 1e-4, 0.03, 0.3, 1.0], len(dataset.measurements.ids)))
    slow = with_columns(dataset, velocity=np.tile(speed[:, None], 6))
    found = drivers(slow, "backlash")["backlash J1", 1, "rz"][:5]
    np.testing.assert_allclose(found, [0.0, 1 / 300, np.sqrt(0.5), 0.995, 0.9996], rtol=1e-4)


def test_hysteresis_changes_flank_with_gravity(dataset, moments):
    up = drivers(dataset, "hysteresis")
    down = drivers(replace(dataset, gravity=-dataset.gravity), "hysteresis")
    assert {name for name, *_ in up} == {f"hysteresis J{j}" for j in range(2, 7)}
    for key in up:
        np.testing.assert_allclose(down[key], -up[key], atol=1e-12)
        assert np.all(np.abs(up[key]) <= 1)
        assert np.all(up[key] * moments[:, key[1], 2] >= 0)
    assert np.all(np.abs(up["hysteresis J2", 2, "rz"][np.abs(moments[:, 2, 2]) > 5]) > 0.99)


@pytest.mark.parametrize("effect", ["hysteresis", "hardening"])
def test_knees_are_shares_of_the_usual_torque(dataset, moments, effect):
    """Of the torque that nine contacts in ten stay below: a heavier world changes nothing."""
    knee = 0.2
    light, heavy = circumstances(dataset), circumstances(replace(dataset, gravity=3 * dataset.gravity))
    one, three = (EFFECTS[effect].scan.parameters(c, knee) for c in (light, heavy))
    assert [p.name for p in one] == [f"{effect} J{j}" for j in range(2, 7)]
    for p, q in zip(one, three, strict=True):
        (term,), (same,) = p.terms, q.terms
        np.testing.assert_allclose(term.driver, same.driver, atol=1e-12)
        torque = moments[:, term.frame, 2]
        assert np.mean(np.abs(torque) <= usual(light, torque)) == pytest.approx(0.9, abs=0.01)
        share = torque / usual(light, torque)
        np.testing.assert_allclose(term.driver, np.tanh(share / knee), atol=1e-12)
        assert np.all(np.abs(term.driver[np.abs(share) > 3 * knee]) > 0.99)  # beyond, a flank
        soft = np.abs(share) < 0.1 * knee  # below, a compliance
        np.testing.assert_allclose(term.driver[soft], share[soft] / knee, rtol=4e-3)
        if effect == "hardening":  # the wind-up at the knee changes by the same share as without one
            compliance = typical(6)[term.frame - 1]
            assert p.sd == pytest.approx(0.3 * compliance * knee * usual(light, torque))


def coupled(dataset, coupling):
    """The same arm, its axes coupled by the display alone or by a linkage."""
    return replace(dataset, robot=replace(dataset.robot, coupling=coupling))


def wrong_by(dataset, coupling, joint, error):
    """Ball centres where the encoder of `joint` errs by some angles (N,), of a FANUC's coupled axes.

    The pendant shows J3 as minus the elbow's angle, less J2. Where the display does that, encoders sit
    between links: of J2 between turret and upper arm, of J3 between upper arm and forearm. Where a linkage
    does it, they sit at the motors, which turn as shown: the elbow's angle is minus the sum of both.
    """
    scene = Scene(dataset)
    angles = scene.q.copy()
    angles[:, joint - 1] += np.array([1, 1, -1, -1, -1, -1.0])[joint - 1] * error
    if coupling == "mechanical" and joint == 2:
        angles[:, 2] -= error
    return points(scene.chain, angles, scene.tools)


def shown_or_between(dataset, side, joint, values):
    """What the pendant shows of a joint, or what passes between its links in the reading's sense."""
    return values[:, 1] + values[:, 2] if (side, joint) == ("link", 3) else values[:, joint - 1]


@pytest.mark.parametrize("joint", [1, 2, 3, 5])
@pytest.mark.parametrize(("coupling", "side"), [("display", "link"), ("mechanical", "reading")])
def test_errors_of_coupled_axes_go_by_what_their_encoder_and_gear_carry(dataset, coupling, side, joint):
    """Of coupled axes an encoder between links turns its own link alone, one at a motor what that moves."""
    arm = coupled(dataset, coupling)
    angle = shown_or_between(dataset, side, joint, dataset.measurements.readings)
    expected = wrong_by(dataset, coupling, joint, 1e-3 * angle)
    now = ball_centres(arm, "encoder-scale", **{f"encoder_scale_J{joint}": 1e-3})
    np.testing.assert_allclose(now, expected, atol=1e-14)
    assert np.max(np.abs(expected - Scene(arm).points)) > 1e-6
    # backlash goes by what passes the gear
    speed = shown_or_between(dataset, side, joint, dataset.measurements.velocity)
    fast = np.abs(speed) > np.radians(0.3)
    expected = wrong_by(dataset, coupling, joint, 1e-4 * np.sign(speed))
    moved = ball_centres(arm, "backlash", **{f"backlash_J{joint}": 1e-4})
    np.testing.assert_allclose(moved[fast], expected[fast], atol=5e-7)
    assert np.count_nonzero(fast) > 10


@pytest.mark.parametrize("effect", ["encoder-scale", "backlash"])
def test_forms_are_the_two_sides_of_coupled_axes(dataset, effect):
    """A form is the other coupling's usual one, whatever this robot's coupling is."""
    for coupling in ("display", "mechanical"):
        c = circumstances(coupled(dataset, coupling))
        for side, like in (("link", "display"), ("reading", "mechanical")):
            other = EFFECTS[effect].parameters(circumstances(coupled(dataset, like)))
            mine = EFFECTS[effect].at(c, side)
            assert [p.name for p in mine] == [p.name for p in other]
            for p, q in zip(mine, other, strict=True):
                for s, t in zip(p.terms, q.terms, strict=True):
                    assert (s.frame, s.axis) == (t.frame, t.axis)
                    np.testing.assert_array_equal(s.driver, t.driver)


@pytest.mark.parametrize("coupling", ["display", "mechanical"])
@pytest.mark.parametrize(("of", "to"), [(2, 3), (1, 2), (4, 6), (2, 1)])
def test_coupling_is_an_error_by_the_reading_of_another_joint(dataset, of, to, coupling):
    arm = coupled(dataset, coupling)
    expected = wrong_by(dataset, coupling, to, 1e-3 * dataset.measurements.readings[:, of - 1])
    now = ball_centres(arm, "coupling", **{f"coupling_J{of}_to_J{to}": 1e-3})
    np.testing.assert_allclose(now, expected, atol=1e-14)


def test_coupling_is_with_the_two_joints_before_and_the_one_after(dataset):
    pairs = ["12", "13", "23", "24", "34", "35", "45", "46", "56", "21", "32", "43", "54", "65"]
    expected = {f"coupling J{of} to J{to}" for of, to in pairs}
    assert {name for name, *_ in drivers(dataset, "coupling")} == expected
    still = dataset.measurements.readings * (np.arange(6) != 3)
    left = {name for name, *_ in drivers(with_columns(dataset, readings=still), "coupling")}
    assert left == {name for name in expected if "J4 to" not in name}


def test_coupling_levels_off_away_from_the_middle_of_the_session(dataset):
    moved = with_columns(dataset, readings=dataset.measurements.readings + 1.0)
    (a, *_), (b, *_) = (EFFECTS["coupling"].at(circumstances(d), "levels-off") for d in (dataset, moved))
    q = circumstances(dataset)
    mine = q.q[q.fitted, int(a.name.split()[1][1:]) - 1]
    np.testing.assert_allclose(a.terms[0].driver, b.terms[0].driver, atol=1e-12)
    assert np.median(a.terms[0].driver[q.fitted]) == pytest.approx(0.0, abs=1e-2 * np.std(mine))


def test_hardening_grows_with_the_square_of_the_torque(dataset, moments):
    once = drivers(dataset, "hardening")
    twice = drivers(replace(dataset, gravity=2 * dataset.gravity), "hardening")
    for key in once:
        np.testing.assert_allclose(twice[key], 4 * once[key], rtol=1e-9)
        assert np.all(once[key] * moments[:, key[1], 2] >= 0)
    sd = {p.name: p.sd for p in EFFECTS["hardening"].parameters(circumstances(dataset))}
    assert sd["hardening J3"] * 8.0 == pytest.approx(0.3 * 2e-4)


def test_a_bearing_yields_across_its_axis(dataset, moments):
    """All behind the joint turns about its frame by the moment, except for the component about the axis."""
    scene, found = Scene(dataset), drivers(dataset, "bending")
    pose = frames(scene.chain, scene.q)
    assert "bending J1 bearing" not in {name for name, *_ in found}  # the base's
    for j in range(2, 7):
        assert {axis for name, _, axis in found if name == f"bending J{j} bearing"} == {"rx", "ry"}
        across = 1e-6 * moments[:, j] * [1, 1, 0]
        turn = (pose[:, j, :3, :3] @ across[..., None])[..., 0]
        moved = scene.points + np.cross(turn, scene.points - pose[:, j, :3, 3])
        now = ball_centres(dataset, "bending", **{f"bending_J{j}_bearing": 1e-6})
        np.testing.assert_allclose(now, moved, atol=1e-9)


@pytest.mark.parametrize("convention", ["mdh", "dh"])
@pytest.mark.parametrize(("j", "near", "far"), [(2, [0, 0, 0], [0.3, 0, 0]), (4, [0, 0, -0.32], [0, 0, 0])])
def test_a_link_bends_as_a_uniform_beam(dataset, j, near, far, convention):
    """Against 2000 pieces of a cantilever that carries what is beyond it: turn and shift of the tool."""
    robot, count, give = dataset.robot, 2000, 1e-6
    if convention == "dh":
        robot = replace(robot, convention="dh", a=np.roll(robot.a, -1), alpha=np.roll(robot.alpha, -1))
    masses = robot.masses * (np.arange(1, 7) != j)  # a beam without a mass of its own
    dataset = replace(dataset, robot=replace(robot, masses=masses))
    scene = Scene(dataset)
    pose = frames(scene.chain, scene.q)[:, j]
    root, weight = scene.loads.moments[:, j], scene.loads.weights[:, j]
    ball = np.einsum("cji,cj->ci", pose[:, :3, :3], scene.points - pose[:, :3, 3])  # in the link's frame
    near, far = np.array(near), np.array(far)
    along = (far - near) / np.linalg.norm(far - near)
    moved = np.zeros_like(ball)
    for share in (np.arange(count) + 0.5) / count:
        at = near + share * (far - near)
        moment = root - np.cross(at, weight)
        across = moment - np.outer(moment @ along, along)
        moved += np.cross(give / count * across, ball - at)
    other = "z" if j == 2 else "x"
    names = {name for name, *_ in drivers(dataset, "bending") if f"J{j} link" in name}
    assert names == {f"bending J{j} link {axis}" for axis in ("y", other)}
    values = {f"bending_J{j}_link_{axis}": give for axis in ("y", other)}
    found = ball_centres(dataset, "bending", **values) - scene.points
    found = np.einsum("cji,cj->ci", pose[:, :3, :3], found)
    # a beam sinks by F L^3 / (12 EI) more than two hinges at its middle
    sunk = give * np.sum((far - near) ** 2) / 12 * (weight - np.outer(weight @ along, along))
    np.testing.assert_allclose(found + sunk, moved, atol=2e-9)
    assert np.max(np.abs(moved)) > 1e-6
    assert np.max(np.abs(sunk)) > 1e-8


def test_a_link_without_length_does_not_bend(dataset):
    """The wrist of this arm has two axes that meet; behind its last joint there is no link."""
    links = {name[8:] for name, *_ in drivers(dataset, "bending") if "link" in name}
    others = {f"J{j} link {axis}" for j, axis in ((2, "z"), (3, "z"), (4, "x"))}  # about J1 is no moment
    assert links == others | {f"J{j} link y" for j in range(1, 5)}


@pytest.mark.parametrize("convention", ["mdh", "dh"])
def test_thermal_growth_makes_the_table_longer(dataset, convention):
    """Of either convention: all lengths of the table grow by the strain at each row's temperature."""
    dataset = replace(dataset, robot=replace(dataset.robot, convention=convention, d=dataset.robot.d + 0.01))
    scene, warm = Scene(dataset), dataset.measurements.temperature
    moved = ball_centres(dataset, "thermal-drift", thermal_drift_growth_by_temperature=1e-3)
    for row, strain in ((np.argmin(warm), -1e-3), (np.argmax(warm), 1e-3)):
        r = dataset.robot
        grown = chain_of(replace(r, a=r.a * (1 + strain), d=r.d * (1 + strain)))
        expected = points(grown, scene.q[[row]], scene.tools[[row]])
        np.testing.assert_allclose(moved[[row]], expected, atol=1e-14)


def test_drift_goes_by_temperature_else_by_time(dataset):
    key = "thermal-drift J3 by {}", 3, "rz"
    by = drivers(dataset, "thermal-drift")[key[0].format("temperature"), *key[1:]]
    assert (by.min(), by.max()) == (-1, 1)
    by = drivers(replace(dataset, temperature_of="artefact"), "thermal-drift")
    np.testing.assert_allclose(by[key[0].format("time"), *key[1:]], np.linspace(-1, 1, len(Scene(dataset).q)))
    neither = with_columns(dataset, temperature=None, time=np.zeros(len(dataset.measurements.ids)))
    assert "temperature_c" in EFFECTS["thermal-drift"].missing(circumstances(neither))
    unclocked = with_columns(dataset, temperature=None, time=None)
    by = drivers(unclocked, "thermal-drift")
    np.testing.assert_allclose(by[key[0].format("row"), *key[1:]], np.linspace(-1, 1, len(Scene(dataset).q)))
    c = replace(circumstances(unclocked), fitted=np.arange(10, 31))
    (row,) = (p for p in EFFECTS["thermal-drift"].at(c) if p.name == "thermal-drift J3 by row")
    np.testing.assert_allclose(row.terms[0].driver, np.clip((np.arange(len(c.q)) - 20) / 10, -1, 1))
    assert row.driver.coordinate(row.site, c).label == "row"
    assert not len(EFFECTS["thermal-drift"].scan.values(c))  # no time constant without times


def test_step_moves_the_base_from_the_middle_on(cube):
    """The middle is that of the fitted measurements; every joint keeps its place in the base."""
    dataset = cube(seed=1).dataset
    count = len(dataset.measurements.ids)
    role = np.where(np.arange(count) < 60, "calibrate", "validate")
    found = drivers(with_columns(dataset, role=role), "step")
    assert {frame for _, frame, _ in found} == {0}
    assert {axis for *_, axis in found} == set(AXES)
    for driver in found.values():
        np.testing.assert_array_equal(driver, np.arange(count) >= 30)
    scene = Scene(dataset)
    moved = ball_centres(dataset, "step", step_x=1e-3)
    np.testing.assert_allclose((moved - scene.points)[:60], 0.0, atol=1e-15)
    np.testing.assert_allclose((moved - scene.points)[60:], [[1e-3, 0, 0]] * (count - 60), atol=1e-12)


def test_a_step_splits_at_its_row(dataset):
    """The row of that number, counted from 1, is the first that the bumped base carries."""
    c = circumstances(dataset)
    count = len(c.q)
    for row in (2, 43, count):
        for p in EFFECTS["step"].scan.parameters(c, row):
            (term,) = p.terms
            np.testing.assert_array_equal(term.driver, np.arange(1, count + 1) >= row)
    role = np.where(np.arange(count) % 3 == 0, "calibrate", "validate")
    rows = EFFECTS["step"].scan.values(circumstances(with_columns(dataset, role=role)))
    assert np.all((rows - 1) % 3 == 0)  # only a fitted row can tell when it was
    assert rows.min() > 1


def test_an_arm_that_warms_up_slows_down(dataset):
    """From -1 to 1 over the session, ever slower, and the faster over the smaller the time constant."""
    c = circumstances(dataset)
    halfway = []
    for constant in EFFECTS["thermal-drift"].scan.values(c):
        drifts = EFFECTS["thermal-drift"].scan.parameters(c, constant)
        courses = [p.terms[0].driver for p in drifts if "growth" not in p.name]
        assert len(courses) == 3 + 6
        for course in courses:
            assert (course[0], course[-1]) == (-1, pytest.approx(1))
            assert np.all(np.diff(course) > 0)
            assert np.all(np.diff(course, 2) < 0)
        halfway.append(courses[0][len(c.q) // 2])
    assert np.all(np.diff(halfway) < 0)
    assert halfway[-1] == pytest.approx(0.0, abs=0.1)  # a straight line
    assert EFFECTS["thermal-drift"].scan.parameters(c, 600.0)[-1].driver == Driver("time")


def test_approach_of_round_targets(dataset):
    """A sphere is met towards its centre, a cylinder towards its axis; points are met by no surface."""
    centre = np.array([0.4, 0.1, 0.1])
    sphere = Target("s", "sphere", {"centre": centre, "diameter": 0.05})
    pin = Target("p", "cylinder", {"point": centre, "axis": np.array([0.0, 0, 1]), "diameter": 0.05})
    cone = Target("c", "fixed-point", {"centre": centre})
    for target, across in ((sphere, np.ones(3)), (pin, np.array([1.0, 1, 0]))):
        scene = Scene(replace(dataset, targets=(target,) * 4, certificates=()))
        inward = (centre - scene.points) * across
        inward /= np.linalg.norm(inward, axis=1)[:, None]
        # a step of the tool along it leads to the centre
        stepped = points(scene.chain, scene.q, scene.tools + circumstances(scene.dataset).approach)
        np.testing.assert_allclose(stepped - scene.points, inward, atol=1e-9)
    c = circumstances(replace(dataset, targets=(cone,) * 4, certificates=()))
    assert np.all(np.isnan(c.approach))
    assert not c.touching.any()
    assert "surface" in EFFECTS["lobing"].missing(c)


def test_lobing_has_three_lobes(dataset):
    now = drivers(dataset, "lobing")
    assert {(frame, axis) for _, frame, axis in now} == {(CONTACT, "normal")}
    readings = dataset.measurements.readings
    for turn, sign in ((2 * np.pi / 3, 1), (np.pi / 3, -1)):
        turned = readings + np.where(np.arange(6) == 5, turn, 0.0)
        again = drivers(with_columns(dataset, readings=turned), "lobing")
        for key in now:
            np.testing.assert_allclose(again[key], sign * now[key], atol=1e-9)
    across = np.hypot(*(now[f"lobing {wave}", CONTACT, "normal"] for wave in ("sin", "cos")))
    axial = circumstances(dataset).approach[:, 2]
    np.testing.assert_allclose(across, np.sqrt(1 - axial**2), atol=1e-9)


def test_latency_is_the_way_gone_since(dataset):
    """Readings a moment late lie deeper by speed times delay: the effect takes that back."""
    delay = 1e-4
    m = dataset.measurements
    late = with_columns(dataset, readings=m.readings + delay * m.velocity)
    model, plain = build(Scene(dataset), ("latency",)), build(Scene(dataset), ())
    moved = build(Scene(late), ())
    values = np.array([delay if p.name == "latency" else 0.0 for p in model.parameters])
    for with_delay, before, after in zip(model.blocks, plain.blocks, moved.blocks, strict=True):
        own = np.zeros(before.size)
        # a plane's pivot goes along with the late contacts: hold their balls against the plane of before
        touching = before.residual(np.zeros(3), own)
        deeper = before.kind.residual(own, after.motion.points(np.zeros(3))) - touching
        np.testing.assert_allclose(with_delay.residual(values, own) - touching, -deeper, atol=1e-9)
        assert np.max(np.abs(deeper)) > 1e-7
    assert "j1_degps" in EFFECTS["latency"].missing(circumstances(with_columns(dataset, velocity=None)))


def test_a_larger_ball_touches_further_out(dataset):
    ball = dataset.tools[0]
    larger = replace(dataset, tools=(replace(ball, ball_radius=ball.ball_radius + 1e-5),))
    model, other = build(Scene(dataset), ("ball-radius",)), build(Scene(larger), ())
    (p, *_) = model.parameters
    assert (p.name, p.nominal) == ("ball-radius ball", ball.ball_radius)
    values = np.where(np.arange(len(model.parameters)) == 0, 1e-5, 0.0)
    for a, b in zip(model.blocks, other.blocks, strict=True):
        own = np.zeros(a.size)
        np.testing.assert_allclose(a.residual(values, own), b.residual(np.zeros(3), own), atol=1e-15)


def spheres(dataset, length, diameter):
    """Contacts with four spheres instead, two of them of one artefact: its length and a diameter."""
    places = [[0.4, -0.1, 0.1], [0.4, 0.1, 0.1], [0.45, -0.1, 0.2], [0.45, 0.1, 0.2]]
    values = [{"centre": np.array(place), "diameter": diameter} for place in places]
    targets = tuple(Target(f"s{k}", "sphere", v) for k, v in enumerate(values))
    papers = (
        Certificate("flat", ("s3",), u_form=1e-6),
        Certificate("diameter", ("s0",), u_distance=1e-6),
        Certificate("distance", ("s0", "s1"), length, 2e-6),
        Certificate("distance", ("s0", "nowhere"), length, 2e-6),
    )
    return replace(dataset, targets=targets, certificates=papers)


def test_a_paper_that_is_wrong_by_so_much_is_one_that_is_right(dataset):
    """Said too short by 40 um, with 40 um added, pulls as one that says the truth."""
    parallel, *square = dataset.certificates
    said = replace(parallel, distance=parallel.distance - 40e-6)
    cases = [
        (dataset, replace(dataset, certificates=(said, *square)), "cube.+y cube.-y distance"),
        (spheres(dataset, 0.2, 0.05), spheres(dataset, 0.2 - 40e-6, 0.05), "s0 s1 distance"),
    ]
    rng = np.random.default_rng(0)
    for right, wrong, name in cases:
        plain, free = build(Scene(right), ()), build(Scene(wrong), ("artefact",))
        value = np.array([40e-6 if p.name == f"artefact {name}" else 0.0 for p in free.parameters])
        assert np.count_nonzero(value) == 1
        for honest, loose in zip(plain.constraints, free.constraints, strict=True):
            states = [1e-3 * rng.standard_normal(len(plain.block_of[t].kind.sd)) for t in honest.targets]
            expected, _ = honest.linearise(np.zeros(3), *states)
            np.testing.assert_allclose(loose.linearise(value, *states)[0], expected, atol=1e-9)


def test_every_paper_between_fitted_targets_may_be_wrong(dataset):
    def told(dataset):
        parameters = EFFECTS["artefact"].parameters(circumstances(dataset))
        return {p.name.removeprefix("artefact "): (p.unit, p.sd) for p in parameters}

    turn, length = ("rad", pytest.approx(1.2e-4)), ("m", pytest.approx(9e-6))
    opposite = {f"cube.+y cube.-y parallel {k}": turn for k in (1, 2)} | {"cube.+y cube.-y distance": length}
    square = {f"cube.{pair} square": turn for pair in ("+y cube.-x", "+y cube.+z", "-x cube.+z")}
    assert told(dataset) == opposite | square
    ball = {"s0 diameter": ("m", pytest.approx(3e-6)), "s0 s1 distance": ("m", pytest.approx(6e-6))}
    assert told(spheres(dataset, 0.2, 0.05)) == ball
    role = np.where(dataset.measurements.target == 1, "validate", "calibrate")  # cube.-y is held out
    assert told(with_columns(dataset, role=role)) == square
    assert "certificate" in EFFECTS["artefact"].missing(circumstances(replace(dataset, certificates=())))


@pytest.mark.parametrize("coupling", [None, "display", "mechanical"])
def test_waves_of_a_gear_are_shown_over_their_phase(dataset, coupling):
    """Of coupled axes too, where the angle between the links is no function of one reading."""
    d = coupled(dataset, coupling) if coupling else dataset
    c = circumstances(d)
    waves = grouped(((p.site, p.driver), p) for p in EFFECTS["gear-mesh"].at(c, 50.0))
    for place, (sine, cosine) in waves.items():
        (one,), (other,) = sine.terms, cosine.terms
        shown = np.radians(sine.driver.coordinate(sine.site, c).values)
        off = np.exp(1j * (np.arctan2(one.driver, other.driver) - shown))
        against = np.exp(1j * (np.arctan2(one.driver, other.driver) + shown))
        assert min(np.ptp(off.real), np.ptp(against.real)) < 1e-9, place
