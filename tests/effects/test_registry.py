"""A user's own effect: registered by a program or by an installed package, then like any other."""

import re
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from cases import cases, refused
from scipy.spatial.transform import Rotation
from sessions import circumstances, with_columns

from bayescal import effects
from bayescal.arm.chain import frames, link_angles, points
from bayescal.arm.transforms import AXES, rigid, rpy_matrix
from bayescal.effects import EFFECTS, MODELS, Effect, Parameter, Term, confusable, parameters_of, selection
from bayescal.effects.gravity import compliances
from bayescal.effects.location import Driver, face, joint, link
from bayescal.effects.selection import Selection
from bayescal.effects.vocabulary import same_terms
from bayescal.errors import BayescalError
from bayescal.estimate import calibrated
from bayescal.exporting.robot import calibrated_robot
from bayescal.gap.search.candidates import candidates
from bayescal.model import Scene, build, check_asked
from bayescal.model.options import Part

AT_WRIST = {"site": joint(6), "driver": Driver("angle", 1)}
OWN = Effect(
    "cable-drag",
    "a cable that pulls the last joint round as the first one turns",
    lambda c: [Parameter("cable-drag", "rad", (Term(6, "rz", np.cos(c.q[:, 0])),), 1e-4, **AT_WRIST)],
    phrase=("the last joint", "is pulled by its cable"),
    confusable_with=("coupling",),
)


@pytest.fixture
def own():
    effects.register(OWN)
    yield OWN
    effects.unregister(OWN.name)


def test_a_registered_effect_is_in_models_and_diagnoses(own, cube):
    scene = Scene(cube(seed=1).dataset)
    model = build(scene, ("geometry", own.name))
    assert [p.name for p in model.parameters if p.effect == own.name] == ["cable-drag"]
    assert own.name in MODELS
    assert own.name in effects.names()
    assert effects.describe(own.name) == own.summary
    found = candidates(circumstances(scene.dataset), ("geometry", "compliance"))
    assert [v.effect for v in found.variants[own.name]] == [own.name]
    assert confusable("coupling", own.name)
    assert confusable(own.name, "coupling")


def test_an_unregistered_effect_is_gone():
    before = list(EFFECTS)
    effects.register(OWN)
    effects.unregister(OWN.name)
    assert list(EFFECTS) == before
    refused("`cable-drag` was not registered", lambda: effects.unregister(OWN.name))
    refused("`backlash` was not registered", lambda: effects.unregister("backlash"))


@pytest.mark.parametrize("name", ["backlash", "joint", "tool", "null", "unknown", "nominal", "cable-drag"])
def test_a_name_that_is_taken_is_refused(own, name):
    refused(f"the name `{name}` is in use", lambda: effects.register(replace(own, name=name)))
    assert EFFECTS[own.name] is own


@pytest.mark.parametrize("name", ["", "a,b", "step@3", "Cable", "cable drag", "-x"])
def test_a_name_that_no_option_could_give_is_refused(name):
    refused("cannot name an effect", lambda: effects.register(replace(OWN, name=name)))


@pytest.mark.parametrize("field", ["confusable_with", "requires", "part_of"])
def test_a_relation_to_no_effect_is_refused(field):
    with pytest.raises(BayescalError, match=f"{field} of cable-drag names `backlsh`"):
        effects.register(replace(OWN, **{field: ("backlsh",)}))
    assert OWN.name not in EFFECTS


def test_what_is_no_effect_is_refused():
    refused("str is not an Effect", lambda: effects.register("backlash"))


@pytest.mark.parametrize(("change", "words"), [
    ({"unit": "mm"}, "the unit `mm` is unknown"),
    ({"sd": 0.0}, "is not normal"),
    ({"mean": np.nan}, "is not normal"),
    ({"terms": (Term(6, "rz", np.ones(3)),)}, "one value per row"),
    ({"terms": (Term(6, "rz", np.nan),)}, "not finite"),
])  # fmt: skip
def test_a_parameter_that_no_model_can_hold_is_refused(cube, change, words):
    effects.register(replace(OWN, parameters=lambda c: [replace(p, **change) for p in OWN.parameters(c)]))
    try:
        with pytest.raises(BayescalError, match=f"parameter `cable-drag` of cable-drag: .*{words}"):
            parameters_of((OWN.name,), circumstances(cube(seed=1).dataset))
    finally:
        effects.unregister(OWN.name)


def offered(monkeypatch, tmp_path, source, *names):
    """A vocabulary beside which a package with that source offers entry points."""
    module = f"offered_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{module}.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, module, raising=False)
    calls = []

    def found(group):
        calls.append(group)
        return [EntryPoint(name, f"{module}:{name}", group) for name in names]

    monkeypatch.setattr(selection, "entry_points", found)
    return selection.Vocabulary(EFFECTS.values(), ("tool",)), calls


OFFER = """
from bayescal.effects import Effect, EFFECTS
count = len(EFFECTS)  # reading the vocabulary while it is read
DRAG = Effect("drag", "drag", lambda c: [], requires=("sag",))
SAG = Effect("sag", "sag", lambda c: [])
WRONG = 3
TAKEN = Effect("backlash", "mine", lambda c: [])
"""


def test_entry_points_are_read_once_and_at_first_use(monkeypatch, tmp_path):
    table, calls = offered(monkeypatch, tmp_path, OFFER, "DRAG", "SAG")
    assert calls == []
    assert list(table)[-2:] == ["drag", "sag"]
    assert table["drag"].summary == "drag"
    assert calls == ["bayescal.effects"]


@pytest.mark.parametrize(("names", "words"), [
    (("WRONG",), "entry point WRONG = .*: int is not an Effect"),
    (("TAKEN",), "the name `backlash` is in use"),
    (("DRAG",), "requires of drag names `sag`"),
    (("SAG", "ABSENT"), "entry point ABSENT = .*: cannot be loaded: AttributeError"),
])  # fmt: skip
def test_an_entry_point_that_offers_no_effect_is_refused_each_time(monkeypatch, tmp_path, names, words):
    table, _ = offered(monkeypatch, tmp_path, OFFER, *names)
    for _ in range(2):
        refused(words, lambda: len(table))


# --- Names of effects in a model: what a text selects, and what is refused.


@pytest.fixture(scope="module")
def c(cube):
    return circumstances(cube(seed=1).dataset)


@pytest.mark.parametrize("asked", [
    Selection("backlash"),
    Selection("step", "212"),
    Selection("backlash", "reading", (joint(3),), factor=4.0),
    Selection("bending", None, (link(2), joint(4)), factor=0.125),
    Selection(
        "gear-mesh",
        "50",
        (joint(3),),
        ("angle 3 100 times a turn", "angle 3 200 times a turn"),
        factor=0.1 + 0.2,
    ),
    Selection("compliance", together=True, factor=1.0),
    Selection("compliance", factor=1e-5),
    Selection("plane-form", None, (face("plate x#2"),)),
])  # fmt: skip
def test_a_name_reads_as_it_is_written(asked):
    assert Selection.read(str(asked)) == asked
    assert "," not in str(asked)


@pytest.mark.parametrize("name", ["plate x2", "plate x#2", "plate x_1"])
def test_a_target_whose_name_ends_as_a_factor(cube, name):
    session = cube(seed=1).dataset
    first = next(t for t in session.targets if t.kind == "plane")
    targets = tuple(replace(t, name=name) if t is first else t for t in session.targets)
    faces, text = circumstances(replace(session, targets=targets)), f"plane-form at {name}"
    every = (parameters_of((words,), faces) for words in (text, f"{text} x3"))
    own, wide = ([p for p in parameters if p.effect == "plane-form"] for parameters in every)
    assert own
    assert {p.site for p in own} == {face(name)} == {Part.of(text).site}
    assert [p.sd for p in wide] == pytest.approx([3.0 * p.sd for p in own])


def test_sites_drivers_and_priors(c):
    whole = {p.name: p for p in parameters_of(("backlash",), c) if p.effect == "backlash"}
    (one,) = (p for p in parameters_of(("backlash  at joint 3 x4",), c) if p.effect == "backlash")
    usual = whole[one.name]
    assert (one.site, one.sd, one.mean) == (joint(3), 4 * usual.sd, 0.0)
    assert same_terms(one.terms, usual.terms)
    both = parameters_of(("backlash at joint 3 and joint 4",), c)
    assert [p.site for p in both if p.effect == "backlash"] == [joint(3), joint(4)]
    of_angle = [p for p in parameters_of(("coupling at joint 5 by angle 4",), c) if p.effect == "coupling"]
    assert [(str(p.site), str(p.driver)) for p in of_angle] == [("joint 5", "angle 4")]
    own = [p for p in parameters_of(("compliance at joint 2",), c) if p.effect == "compliance"]
    assert own[0].mean > 0  # the usual prior
    (wide,) = (p for p in parameters_of(("compliance at joint 2 x1",), c) if p.effect == "compliance")
    assert (wide.sd, wide.mean) == (own[0].sd, own[0].nominal)


@pytest.mark.parametrize(("name", "words"), cases("selection_refusals"))
def test_names_that_cannot_be(name, words, c):
    refused(re.escape(words), lambda: parameters_of((name,), c))


def test_an_effect_is_named_once():
    with pytest.raises(BayescalError, match=r"named twice.*'backlash at joint 2 and joint 3'"):
        check_asked(("backlash at joint 2", "backlash at joint 3"), 1.0)


def test_compliance_in_proportion_is_the_same_stiffness_everywhere(cube):
    """Statics and robot.yaml have the compliances that the common factor stands for."""
    found = calibrated(Scene(cube(seed=1).dataset), ("geometry", "compliance in proportion"))
    model = found.model
    k = next(k for k, p in enumerate(model.parameters) if p.effect == "compliance")
    factor = model.deviations(found.z[: len(model.parameters)])[k]
    usual = {p.site.number: p.centre for p in model.parameters[k].stands_for}
    assert factor > 0.2
    robot = calibrated_robot(found.model, found.arm)
    expected = {j: factor * v for j, v in usual.items()}
    assert {j: robot.compliance[j - 1] for j in usual} == pytest.approx(expected)
    known = compliances(model.parameters, model.deviations(found.z[: len(model.parameters)]))
    np.testing.assert_allclose(list(known.values()), [factor * v for v in usual.values()])


# --- Stands that yield under arms on the floor, a wall, a ceiling, a slope: finite rotation about the hinge.

PLACE = np.array([0.2, -0.1, 0.3])
MOUNTS = {
    "floor": ((0, 0, 0), (0, 0, -9.81)),
    "turned floor": ((0, 0, 30), (0, 0, -9.81)),
    "ceiling": ((180, 0, 0), (0, 0, -9.81)),
    "wall": ((0, 90, 0), (0, 0, -9.81)),
    "wall by gravity": ((0, 0, 0), (-9.81, 0, 0)),
    "ceiling by gravity": ((0, 0, 0), (0, 0, 9.81)),
    "slope": ((0, 40, 0), (0, 0, -9.81)),
}


def mounted(dataset, mount):
    """The session with its arm and its instrument turned as one, under the gravity of a mount."""
    rpy, gravity = MOUNTS[mount]
    turn = rigid(rpy_matrix(np.radians(rpy)), PLACE)
    (target,) = dataset.targets
    frame = turn @ rigid(rpy_matrix(np.asarray(target.values["rpy"])), np.asarray(target.values["xyz"]))
    rpy = Rotation.from_matrix(frame[:3, :3]).as_euler("xyz")
    target = replace(target, values={"xyz": frame[:3, 3], "rpy": rpy})
    robot = replace(dataset.robot, base=turn)
    return replace(dataset, robot=robot, gravity=np.array(gravity, float), targets=(target,))


def weights(scene):
    """Every body's weight (N, 3), N, and where it acts (N, 3) in F0: links in their frames, the load."""
    robot, pose = scene.dataset.robot, frames(scene.chain, scene.q)
    tool, count = scene.dataset.tools[0], len(scene.q)
    bodies = [(pose[:, i], robot.masses[i - 1], robot.centres_of_mass[i - 1]) for i in range(1, robot.n + 1)]
    bodies.append((pose[:, -1], tool.mass, tool.centre_of_mass))
    gravity = scene.dataset.gravity
    return [
        (np.tile(mass * gravity, (count, 1)), place[:, :3, :3] @ centre + place[:, :3, 3])
        for place, mass, centre in bodies
    ]


def moment_about(scene, point):
    return sum(np.cross(where - point, weight) for weight, where in weights(scene))


def turned_about(point, turn, x):
    """Points (N, 3) after finite rotations by vectors (N, 3) about a point."""
    return Rotation.from_rotvec(turn).apply(x - point) + point


def displaced(dataset, parameters, values):
    """Ball centres displaced by parameters at some values, the others at 0."""
    scene = Scene(dataset)
    assert set(values) <= {p.name for p in parameters}
    delta = np.zeros((len(scene.q), scene.chain.n + 2, 6))
    for p in parameters:
        for t in p.terms:
            delta[:, t.frame, AXES.index(t.axis)] += values.get(p.name, 0.0) * t.driver
    return points(scene.chain, scene.q, scene.tools, delta)


def yielding(dataset, yields, form=None):
    """The same by the effect, or by a form of it."""
    return displaced(dataset, EFFECTS["base-compliance"].at(circumstances(dataset), form), yields)


def horizontal(gravity):
    """Axes of F0 across gravity, and their names, where gravity is along an axis of F0."""
    return [("xyz"[k], np.eye(3)[k]) for k in range(3) if not gravity[k]]


@pytest.fixture(scope="module")
def session(tracker):
    return tracker(seed=1).dataset


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_stand_turns_about_a_hinge_below_it(session, mount):
    """By the arm's moment about the hinge, half as much one way as the other, however the arm hangs on it."""
    dataset = mounted(session, mount)
    scene, depth = Scene(dataset), 0.35
    down = dataset.gravity / 9.81
    hinge = PLACE + depth * down
    (a, first), (b, second) = horizontal(dataset.gravity)
    compliance = {a: 2e-6, b: 1e-6}
    moment = moment_about(scene, hinge)
    turn = sum(compliance[k] * np.outer(moment @ axis, axis) for k, axis in ((a, first), (b, second)))
    expected = turned_about(hinge, turn, scene.points)
    values = {f"base-compliance {k}": value for k, value in compliance.items()}
    for k, axis, across in ((a, first, second), (b, second, first)):
        slide = np.cross(axis, -depth * down) @ across  # of the base's origin, a turn about the hinge
        values[f"base-compliance slide {k}"] = slide * compliance[k]
    np.testing.assert_allclose(yielding(dataset, values), expected, atol=2e-8)
    assert np.max(np.abs(expected - scene.points)) > 5e-6
    # Its stiffest axis is at 30 degrees to the axes of F0
    scene, depth, angle = Scene(dataset), 0.35, np.radians(30)
    down = dataset.gravity / 9.81
    (a, first), (b, second) = horizontal(dataset.gravity)
    own = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    give = own.T @ np.diag([2e-6, 5e-7]) @ own
    plane = np.stack([first, second])
    turn = moment_about(scene, PLACE) @ plane.T @ give @ plane
    expected = turned_about(PLACE + depth * down, turn, scene.points)
    values = {f"base-compliance {name}": give[k, k] for k, name in enumerate((a, b))}
    values["base-compliance cross"] = give[0, 1]
    for k, (axis, across) in enumerate(((first, second), (second, first))):
        values[f"base-compliance slide {(a, b)[k]}"] = np.cross(axis, -depth * down) @ across * give[k, k]
    lever = np.cross(second, -depth * down) @ first  # of the first axis' moment, by the turn about the second
    values["base-compliance slide cross"] = lever * give[0, 1]
    np.testing.assert_allclose(yielding(dataset, values, "turned"), expected, atol=2e-8)
    straight = yielding(dataset, values | {"base-compliance cross": 0.0}, "turned")
    assert np.max(np.abs(expected - straight)) > 1e-6


@pytest.mark.parametrize("mount", ["wall", "wall by gravity", "slope"])
def test_a_bracket_turns_about_a_hinge_behind_its_plate(session, mount):
    """By the moment about the plate: what is missing to that about the hinge is the same in every pose."""
    dataset = mounted(session, mount)
    scene, depth = Scene(dataset), 0.2
    behind = -dataset.robot.base[:3, 2]
    hinge = PLACE + depth * behind
    names = dict(horizontal(dataset.gravity))
    axis = names["y"]  # across the wall
    expected = turned_about(hinge, 2e-6 * np.outer(moment_about(scene, PLACE) @ axis, axis), scene.points)
    (other,) = (v for k, v in names.items() if k != "y")
    moved = np.cross(axis, -depth * behind)
    values = {"base-compliance y": 2e-6, "base-compliance slide y": 2e-6 * (moved @ other)}
    values["base-compliance rise y"] = 2e-6 * (moved @ (-dataset.gravity / 9.81))
    np.testing.assert_allclose(yielding(dataset, values), expected, atol=2e-8)
    assert abs(values["base-compliance rise y"]) > 1e-7


@pytest.mark.parametrize(("mount", "names"), [
    ("floor", {"x", "slide x", "y", "slide y"}),
    ("ceiling", {"x", "slide x", "y", "slide y"}),
    ("wall", {"x", "slide x", "y", "slide y", "rise y"}),
    ("wall by gravity", {"y", "slide y", "rise y", "z", "slide z"}),
])  # fmt: skip
def test_no_parameter_without_a_moment(session, mount, names):
    """None about the vertical, and none that raises the base of an upright arm."""
    c = circumstances(mounted(session, mount))
    found = EFFECTS["base-compliance"].parameters(c)
    assert {p.name.removeprefix("base-compliance ") for p in found} == names
    assert not EFFECTS["base-compliance"].parameters(replace(c, gravity=np.zeros(3)))


def test_the_first_bearing_bends_where_its_axis_neither_stands_nor_lies(session):
    for mount in MOUNTS:
        names = {p.name for p in EFFECTS["bending"].parameters(circumstances(mounted(session, mount)))}
        assert ("bending J1 bearing" in names) == (mount == "slope"), mount


def measured(dataset, arm, depth, compliance, noise, seed=0):
    """The session as an instrument saw it, of an arm on a stand that yields: by frames alone."""
    scene = Scene(dataset)
    gravity, m = dataset.gravity, dataset.measurements
    q = scene.q
    pose, bodies = frames(scene.chain, q), weights(scene)
    sag = np.zeros_like(q)
    for j in range(1, arm.robot.n + 1):  # of what a joint carries: the links from its own on, and the load
        about = sum(np.cross(where - pose[:, j, :3, 3], weight) for weight, where in bodies[j - 1 :])
        sag[:, j - 1] = arm.compliance[j - 1] * np.sum(about * pose[:, j, :3, 2], axis=1)
    robot = replace(arm.robot, base=dataset.robot.base)
    ball = points(Scene(replace(dataset, robot=robot)).chain, link_angles(robot, m.readings) + sag, arm.tool)
    hinge = dataset.robot.base[:3, 3] + depth * gravity / 9.81
    moment = moment_about(scene, hinge)
    turn = sum(compliance[k] * np.outer(moment @ axis, axis) for k, axis in horizontal(gravity))
    ball = turned_about(hinge, turn, ball)
    target = dataset.targets[0]
    frame = rigid(rpy_matrix(np.asarray(target.values["rpy"])), np.asarray(target.values["xyz"]))
    xyz = (ball - frame[:3, 3]) @ frame[:3, :3]
    xyz = xyz + noise * np.random.default_rng(seed).standard_normal(xyz.shape)
    return with_columns(dataset, xyz=xyz, torque=None, temperature=None)


def test_a_fit_finds_how_far_a_stand_yields(tracker):
    """Of an arm on a wall, whose stand yields half as much one way as the other."""
    session = tracker(seed=2, count=90, noise=5e-6)
    truth = {"x": 2e-5, "y": 4e-5}
    dataset = measured(mounted(session.dataset, "wall"), session.arm, 0.35, truth, 5e-6)
    found = calibrated(Scene(dataset), ("geometry", "compliance", "base-compliance"))
    values = dict(zip(found.model.names, found.model.physical(found.z), strict=True))
    wide = dict(zip(found.model.names, found.sd * _scale(found.model), strict=True))
    for axis, value in truth.items():
        name = f"base-compliance {axis}"
        assert abs(values[name] - value) < 4 * wide[name], axis
    assert wide["base-compliance y"] < 4e-6


def _scale(model):
    return model.physical(np.ones(model.size)) - model.physical(np.zeros(model.size))
