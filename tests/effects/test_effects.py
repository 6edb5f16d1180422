"""One oracle for every effect: honest parameters, finite drivers, columns that are slopes."""

from dataclasses import replace

import numpy as np
import pytest
from camera_sessions import camera_session
from cases import cases, refused
from rails import moving_session
from sessions import circumstances, with_columns

from bayescal.arm import statics
from bayescal.arm.chain import chain_of, link_angles
from bayescal.arm.motion import CERTIFICATE, CONTACT, IMAGE, TURN
from bayescal.arm.statics import gravity_loads
from bayescal.arm.transforms import AXES
from bayescal.dataset import Noise, Tool
from bayescal.effects import EFFECTS, UNITS, Effect, confusable, parameters_of
from bayescal.effects.location import joint
from bayescal.model import ARM, Scene, build

CAMERAS = {"focal-length", "image-centre", "lens-distortion", "board-scale", "board-bow"}
SLIDES = {"straightness", "angular-motion", "positioning", "axis-bending"}
TOUCHING = {"artefact", "ball-radius", "latency", "lobing", "plane-form"}
LACKING = {
    "planes": CAMERAS | SLIDES,
    "points": {"gear-mesh"} | TOUCHING | CAMERAS | SLIDES,
    "two tools": CAMERAS | SLIDES,
    "camera": {"artefact", "ball-radius", "gear-mesh", "lobing", "plane-form"} | SLIDES,
    "rail": TOUCHING | CAMERAS,
}
"""Effects that a session has no data for."""


SESSIONS = {session: tuple(e for e in EFFECTS if e not in lacks) for session, lacks in LACKING.items()}
"""Effects of a session: each parameter is judged beside all others."""


def two_tools(session):
    """The session with every other row touched by a longer probe."""
    dataset = session.dataset
    probe = Tool("probe", np.array([0.0, 0.05, 0.18]), 2e-3, 0.5, np.array([0.0, 0.02, 0.08]))
    tool = np.arange(len(dataset.measurements.ids)) % 2
    return with_columns(replace(dataset, tools=(*dataset.tools, probe)), tool=tool)


@pytest.fixture(scope="module")
def sessions(cube, tracker):
    return {
        "planes": cube(seed=1).dataset,
        "points": tracker(seed=1).dataset,
        "two tools": two_tools(cube(seed=1)),
        "camera": camera_session(images=12),
        "rail": moving_session(),
    }


@pytest.fixture(
    scope="module",
    params=[*((session, effects) for session, effects in SESSIONS.items()), ("planes", ())],
    ids=[*SESSIONS, "tool alone"],
)
def model(request, sessions):
    session, effects = request.param
    return build(Scene(sessions[session]), effects)


@pytest.mark.parametrize("session", ["points", "camera", "rail"])
def test_what_a_session_lacks(sessions, session):
    c = circumstances(sessions[session])
    assert {e for e in EFFECTS if EFFECTS[e].missing(c)} == LACKING[session]


def test_parameters(model):
    effects = model.effects
    names = [p.name for p in model.parameters]
    assert len(set(names)) == len(names)
    assert {p.effect for p in model.parameters} - {"camera"} == {*effects, "tool"}
    for p in model.parameters:
        assert p.unit in UNITS
        assert np.isfinite(p.sd)
        assert p.sd > 0
        assert np.isfinite(p.nominal)
        assert p.centre > 0 if p.positive else p.centre == p.nominal
        assert p.terms
        assert p.fault(len(model.scene.q)) == ""


@pytest.mark.parametrize("session", SESSIONS)
def test_an_effect_alone_has_the_parameters_that_it_has_beside_others(sessions, session):
    c = circumstances(sessions[session])
    every = {p.name for p in parameters_of(SESSIONS[session], c)}
    for name in SESSIONS[session]:
        own = [p for p in parameters_of((name,), c) if p.effect == name]
        assert own
        assert {p.name for p in own} <= every


def test_drivers(model):
    count = len(model.scene.q)
    for p in model.parameters:
        for term in p.terms:
            assert np.all(np.isfinite(term.driver))
            assert np.any(np.asarray(term.driver) != 0)
            if term.frame == CERTIFICATE:
                assert np.shape(term.driver) in ((1,), (3,))
                assert model.scene.dataset.certificates[int(term.axis)].kind != "flat"
                continue
            assert np.shape(term.driver) in ((), (count,))
            if term.frame == CONTACT:
                assert term.axis == "normal"
            elif term.frame in (IMAGE, TURN):
                assert term.axis in ("u", "v", "rx", "ry", "rz")
            else:
                assert 0 <= term.frame <= model.scene.chain.n + 1
                assert term.axis in AXES


def test_whitening(model):
    """Values and deviations: linear in z, from the prior's mean, in units of its standard deviation."""
    rng = np.random.default_rng(0)
    count = len(model.parameters)
    z = rng.standard_normal((3, model.size))
    physical = model.physical(z)
    for k, p in enumerate(model.parameters):
        np.testing.assert_allclose(physical[:, k], p.centre + p.sd * z[:, k], atol=1e-15)
        off = model.deviations(z[:, :count])[:, k]
        np.testing.assert_allclose(off, physical[:, k] - p.nominal, atol=1e-15)
    at = count
    for block in model.blocks:
        own = physical[:, at : at + block.size]
        np.testing.assert_allclose(own, block.state(z[:, model.slices[block.target]])[:, block.free])
        at += block.size
    assert len(model.names) == len(model.units) == model.size == at


def test_columns_are_slopes(model):
    """The Jacobian of every block by every parameter, in the model, away from zero."""
    rng = np.random.default_rng(0)
    z = rng.standard_normal(model.size)
    values = model.deviations(z[model.slices[ARM]])
    scale = np.array([p.sd for p in model.parameters])
    h = 1e-3
    felt = np.zeros(len(model.parameters))
    for block in model.blocks:
        own = 0.1 * rng.standard_normal(block.size)
        r, by_arm, by_target = block.linearise(values, own)
        np.testing.assert_allclose(r, block.residual(values, own).ravel(), atol=1e-15)
        step = h * np.diag(scale)
        many = np.broadcast_to(own, (len(scale), block.size))
        slope = (block.residual(values + step, many) - block.residual(values - step, many)) / (2 * h)
        curved = {"rtol": 1e-5} if block.group == "pixel" else {}
        slope = slope.reshape(len(scale), -1).T
        np.testing.assert_allclose(by_arm * scale, slope, atol=1e-9 if curved else 1e-10, **curved)
        step = 1e-4 * np.eye(block.size)
        alone = np.broadcast_to(values, (block.size, len(values)))
        slope = (block.residual(alone, own + step) - block.residual(alone, own - step)) / 2e-4
        np.testing.assert_allclose(by_target, slope.reshape(block.size, -1).T, atol=1e-9)
        felt = np.maximum(felt, np.max(np.abs(by_arm * scale), axis=0))
    for constraint in model.constraints:
        _, by = model.linearised(constraint, {name: z[own] for name, own in model.slices.items()})
        felt = np.maximum(felt, np.max(np.abs(by.get(ARM, 0.0)), axis=0))
    assert np.all(felt > 1e-9), "a parameter that moves nothing"


def test_ties_have_their_slopes(model):
    """The Jacobian of every certificate, and that draws are worked on as one by one."""
    assert bool(model.constraints) == bool(model.scene.dataset.certificates)
    rng = np.random.default_rng(0)
    parts = {name: rng.standard_normal(own.stop - own.start) for name, own in model.slices.items()}
    for constraint in model.constraints:
        r, by = model.linearised(constraint, parts)
        assert r.shape == (constraint.rows,)
        assert set(by) == set(constraint.variables)
        for name, slope in by.items():
            steps = 1e-4 * np.eye(len(parts[name]))
            moved = ([parts | {name: parts[name] + way * s} for s in steps] for way in (1, -1))
            up, down = (np.array([model.linearised(constraint, p)[0] for p in each]) for each in moved)
            atol = 1e-6 * max(1.0, np.max(np.abs(r)))
            np.testing.assert_allclose(slope, (up - down).T / 2e-4, rtol=1e-5, atol=atol)
        draws = {name: part + 0.1 * rng.standard_normal((4, len(part))) for name, part in parts.items()}
        states = [model.block_of[name].state(draws[name]) for name in constraint.targets]
        many, _ = constraint.linearise(model.deviations(draws[ARM]), *states)
        for k in range(4):
            one, _ = model.linearised(constraint, {name: part[k] for name, part in draws.items()})
            np.testing.assert_allclose(many[k], one, rtol=1e-12)


def test_any_rows(model):
    """Blocks of some rows are those rows of the whole."""
    rng = np.random.default_rng(0)
    block = model.blocks[-1]
    values, own = 1e-4 * rng.standard_normal(len(model.parameters)), rng.standard_normal(block.size)
    some = block.rows[3:17]
    part = model.block(int(model.scene.dataset.measurements.target[some[0]]), some)
    np.testing.assert_allclose(part.residual(values, own), block.residual(values, own)[:, 3:17], atol=1e-15)


@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_missing_is_told(name, cube):
    """A robot without masses and a session of bare readings: words, or the effect does without."""
    dataset = cube(seed=1).dataset
    m = dataset.measurements
    robot = replace(dataset.robot, masses=None, centres_of_mass=None, reductions=None)
    rows = type(m)(m.ids, m.role, m.target, m.tool, m.readings, m.line)
    c = circumstances(replace(dataset, robot=robot, measurements=rows))
    words = EFFECTS[name].missing(c)
    if words:
        refused(name, lambda: parameters_of((name,), c))
    else:
        assert parameters_of((name,), c)
    if name == "compliance":
        assert "mass" in words


SCANNED = [name for name, effect in EFFECTS.items() if effect.scan]


@pytest.fixture(params=SCANNED)
def scanned(request, cube):
    """An effect with a setting, and a session that leaves it open."""
    dataset = cube(seed=1).dataset
    bare = replace(dataset, robot=replace(dataset.robot, reductions=None))
    return EFFECTS[request.param], circumstances(bare)


def test_settings_worth_trying(scanned):
    """Each is a finite number with the same parameters, their drivers finite and none of them empty."""
    effect, c = scanned
    values = effect.scan.values(c)
    assert len(values) > 1
    assert np.all(np.isfinite(values))
    assert np.all(np.diff(np.sort(values)) > 0)
    if effect.name == "gear-mesh":
        values = values[::30]
    told = []
    for value in values:
        found = effect.scan.parameters(c, float(value))
        double, once = f"{2 * value:g} ", f"{value:g} "
        told.append([(p.name.replace(double, "").replace(once, ""), p.unit) for p in found])
        for p in found:
            for term in p.terms:
                assert np.all(np.isfinite(term.driver))
                assert np.any(term.driver)
    assert told[0]
    assert all(names == told[0] for names in told)
    # a setting is named behind its effect
    value = float(effect.scan.values(c)[1])
    named = parameters_of((f"{effect.name}@{value!r}",), c)
    assert {p.effect for p in named} == {effect.name, "tool"}
    for p, q in zip(named, effect.scan.parameters(c, value), strict=False):
        assert (p.name, p.unit, p.sd, p.nominal) == (q.name, q.unit, q.sd, q.nominal)
        for a, b in zip(p.terms, q.terms, strict=True):
            assert (a.frame, a.axis) == (b.frame, b.axis)
            np.testing.assert_array_equal(a.driver, b.driver)
    assert len(named) == len(effect.scan.parameters(c, value)) + 3  # the tool


def told(parameters):
    terms = ([(t.frame, t.axis, np.asarray(t.driver).tolist()) for t in p.terms] for p in parameters)
    return [(p.name, p.sd, own) for p, own in zip(parameters, terms, strict=True)]


def test_without_a_setting_it_is_the_usual_one(cube):
    """What an effect is where none is named: the middle of the rows, 6 % of the usual torque."""
    c = circumstances(cube(seed=1).dataset)
    for name, setting in (("step", "61"), ("hysteresis", "0.06")):
        assert told(parameters_of((name,), c)) == told(parameters_of((f"{name}@{setting}",), c))


def test_gear_mesh_without_reductions_needs_a_ratio(cube):
    dataset = cube(seed=1).dataset
    c = circumstances(replace(dataset, robot=replace(dataset.robot, reductions=None)))
    refused("gear-mesh@100", lambda: parameters_of(("gear-mesh",), c))
    names = [p.name for p in parameters_of(("gear-mesh@100",), c)]
    assert len([n for n in names if n.startswith("gear-mesh 100 ")]) == 12
    assert len([n for n in names if n.startswith("gear-mesh 200 ")]) == 12
    each = parameters_of(("gear-mesh@100/50 at joint 5 and joint 1",), c)
    found = {(str(p.site), p.driver.order) for p in each if p.effect == "gear-mesh"}
    assert found == {("joint 5", 100), ("joint 5", 200), ("joint 1", 50), ("joint 1", 100)}


def test_settings_of_several_sites_are_told_once_each():
    words = EFFECTS["gear-mesh"].words(((joint(1), 26.0), (joint(2), 26.0), (joint(3), 23.0)))
    assert words == "26 motor revolutions per joint revolution at joint 1 and joint 2, 23 at joint 3"


@pytest.mark.parametrize(("name", "words"), cases("setting_refusals"))
def test_settings_that_cannot_be(name, words, cube):
    refused(words, lambda: parameters_of((name,), circumstances(cube(seed=1).dataset)))


def test_a_time_constant_needs_the_time(cube):
    c = circumstances(with_columns(cube(seed=1).dataset, time=None))
    assert parameters_of(("thermal-drift",), c)
    refused("time_s", lambda: parameters_of(("thermal-drift@600",), c))


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_says_what_it_is(name):
    """A summary, a sentence of its own, and relations to effects that exist; confusion is mutual."""
    effect = EFFECTS[name]
    assert effect.name == name
    assert effect.summary
    assert effect.phrase != Effect.phrase
    assert 40 < len(effect.remedy) < 320
    assert effect.remedy.endswith(".")
    assert "  " not in effect.remedy
    for other in effect.confusable_with:
        assert name in EFFECTS[other].confusable_with
        assert confusable(name, other)
    assert name not in (*effect.confusable_with, *effect.requires, *effect.part_of)
    assert {*effect.requires, *effect.part_of} <= set(EFFECTS)


def test_compliance_is_that_of_the_drawing(cube):
    """Compliances known to the robot file bend the arm as the same ones estimated."""
    dataset = cube(seed=1).dataset
    known = np.array([1e-5, 3e-5, 2e-4, 1e-3, 2e-3, 3e-3])
    drawn = build(Scene(replace(dataset, robot=replace(dataset.robot, compliance=known))), ("compliance",))
    found = build(Scene(dataset), ("compliance",))
    rigid = build(Scene(dataset), ())
    values = found.deviations(np.zeros(len(found.parameters)))
    for k, p in enumerate(found.parameters):
        if p.effect == "compliance":
            values[k] = known[dataset.robot.joint_names.index(p.name.split()[1])]
    for a, b, c in zip(drawn.blocks, found.blocks, rigid.blocks, strict=True):
        at_rest = a.motion.points(drawn.deviations(np.zeros(len(drawn.parameters))))
        np.testing.assert_allclose(at_rest, b.motion.points(values), atol=1e-13)
        assert np.max(np.abs(at_rest - c.motion.points(np.zeros(3)))) > 1e-4
    # first joint carries no torque
    names = [p.name for p in parameters_of(("compliance",), circumstances(dataset))]
    assert names[:5] == [f"compliance J{j}" for j in range(2, 7)]
    leaning = replace(dataset, gravity=np.array([0.0, 3.0, -9.0]))
    names = [p.name for p in build(Scene(leaning), ("compliance",)).parameters]
    assert names[0] == "compliance J1"


def test_each_tool_has_its_rows(sessions):
    """A tool's centre moves the rows that use it, and no others."""
    dataset = sessions["two tools"]
    model = build(Scene(dataset), ())
    names = [p.name for p in model.parameters]
    assert names == [f"{tool} {axis}" for tool in ("ball", "probe") for axis in "xyz"]
    for block in model.blocks:
        _, by_arm, _ = block.linearise(np.zeros(6), np.zeros(block.size))
        uses = dataset.measurements.tool[block.rows]
        for k in range(6):
            np.testing.assert_array_equal(np.abs(by_arm[:, k]) > 0, uses == k // 3)


def test_material_that_stands_out_is_met_early(cube):
    """A face whose middle stands out holds the ball off there: its form takes that off the residual."""
    scene = Scene(cube(seed=1).dataset)
    model = build(scene, ("plane-form",))
    (face,) = [f for f in circumstances(scene).faces if f.name == "cube.-x"]
    k = next(k for k, p in enumerate(model.parameters) if p.name == "cube.-x form uu")
    values = np.zeros(len(model.parameters))
    values[k] = -5e-6  # the polynomial of degree two is lowest in the middle
    for block in model.blocks:
        own = np.zeros(block.size)
        change = (block.residual(values, own) - block.residual(0 * values, own)).ravel()
        if block.target == "cube.-x":
            assert np.all(change[np.abs(face.place[block.rows, 0]) < 0.5] < 0)
            assert np.all(change[np.abs(face.place[block.rows, 0]) > 0.6] > 0)
        else:
            assert not change.any()


def test_payload_and_tool_weigh(cube, monkeypatch):
    """Moments grow by the payload's weight at the tool's centre of mass, in the rows that carry it."""
    dataset = cube(seed=1).dataset
    m = dataset.measurements
    loaded = Scene(dataset).moments
    empty = Scene(with_columns(dataset, payload=None)).moments
    heavier = replace(dataset.tools[0], mass=dataset.tools[0].mass + 0.5)
    both = Scene(replace(dataset, tools=(heavier,), measurements=replace(m, payload=None))).moments
    carries = m.payload > 0
    assert carries.any()
    tool, chain, q = dataset.tools[0], chain_of(dataset.robot), link_angles(dataset.robot, m.readings)
    at = np.tile(tool.centre_of_mass, (len(q), 1))
    load = np.full(len(q), tool.mass)
    alone = gravity_loads(dataset.robot, chain, q, dataset.gravity, load, at).moments
    np.testing.assert_allclose(empty, alone, atol=1e-14)
    monkeypatch.setattr(statics, "AT_ONCE", 7)
    parts = gravity_loads(dataset.robot, chain, q, dataset.gravity, load, at).moments
    np.testing.assert_array_equal(parts, alone)
    np.testing.assert_allclose(loaded[~carries], empty[~carries], atol=1e-14)
    np.testing.assert_allclose(loaded[carries], both[carries], atol=1e-13)
    assert np.max(np.abs(loaded - empty)) > 1.0


def test_stated_noise_of_a_row(cube, tracker):
    dataset = cube(seed=1).dataset
    u = np.where(np.arange(len(dataset.measurements.ids)) < 5, 2e-5, np.nan)
    scene = Scene(replace(dataset, measurements=replace(dataset.measurements, u=u), noise=Noise(7e-6, 9e-6)))
    np.testing.assert_array_equal(scene.sigma(np.arange(8)), [2e-5] * 5 + [7e-6] * 3)
    assert Scene(tracker(seed=1).dataset).sigma(np.arange(2)).tolist() == [1e-5, 1e-5]


@pytest.mark.parametrize("effect", ["compliance", "bending", "base-compliance"])
def test_a_compliance_three_times_the_usual_is_no_surprise(effect, cube):
    """Published arms spread by a factor of 3 about the usual: the prior takes less than a nat for it."""
    model = build(Scene(cube(seed=1).dataset), (effect,))
    mine = [k for k, p in enumerate(model.parameters) if p.effect == effect and p.mean]
    assert mine
    for factor in (1 / 3, 3.0):
        z = factor * np.array([model.parameters[k].mean for k in mine])
        at_zero = model.deviations(np.zeros(len(model.parameters)))[mine]
        slope = model.deviations(np.ones(len(model.parameters)))[mine] - at_zero
        nats = 0.5 * ((z - at_zero) / slope) ** 2
        assert np.all(nats < 1.0)
        assert np.all(nats > 0.05)
