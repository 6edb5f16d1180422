"""Blind worlds: readable, reproducible, silent about what they hide, and honest where they hide nothing."""

import hashlib
import importlib
import json
import pkgutil
import subprocess
import sys
from itertools import chain

import numpy as np
import pytest

import analysis.world
from analysis.blind.make import CONTACTS
from analysis.blind.make import GENERATORS as VERSIONS
from analysis.world import arm, scene, session, visible
from analysis.world import build as world
from analysis.world.mix import FORMS, MIX, recipe, stage
from analysis.world.outside_more import MORE, RESERVED
from analysis.world.touch import World
from analysis.world.write import plain
from bayescal.dataset import read_dataset
from bayescal.estimate import estimate, settled
from bayescal.model import Scene, build

SEED = 101
OLD = {"effects": ["payload"], "noise_um": 9.73565034554, "lambda": 150.598473, "dataset": "c977cf2794a74d71"}
"""Session 5 of the first generator; see the test."""
KINDS = {"cube": {"plane", "sphere"}, "spheres": {"sphere"}, "tracker": {"instrument"}}
WORLDS = [("null", "cube"), ("single", "cube"), ("null", "spheres"), ("null", "tracker")]
TRUTH = ("truth", "effect", "lambda", "oracle", "outlier")


def number_of(kind: str, what: str) -> int:
    drawn = ((k, *recipe(SEED, k)) for k in range(10 * len(MIX)))
    return next(k for k, drawn_kind, makers in drawn
                if drawn_kind == kind and stage(SEED, k, VERSIONS[CONTACTS], makers) == what)  # fmt: skip


@pytest.fixture(scope="module", params=WORLDS)
def made(request, tmp_path_factory):
    """A world on disk: its folder, its number, its truth."""
    folder, number = tmp_path_factory.mktemp("world"), number_of(*request.param)
    texts, truth = world.build(SEED, number)
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder, number, plain(truth)


def test_it_is_a_dataset_whose_folder_does_not_tell(made):
    folder, _, truth = made
    dataset = read_dataset(folder)
    what = truth["session"]["stage"]
    stated = dataset.noise.point if what == "tracker" else dataset.noise.contact
    assert stated == pytest.approx(1e-6 * truth["stated_noise_um"], rel=1e-3)
    assert {t.kind for t in dataset.targets} == KINDS[what]
    assert set(dataset.measurements.role) == {"calibrate", "validate"}
    assert truth["robot"]["a"][2] != pytest.approx(0.3, abs=1e-6), "the arm is not as drawn"
    # its folder does not tell
    names = {"dataset.yaml", "robot.yaml", "measurements.csv", "baseline.txt"}
    assert {p.name for p in folder.iterdir()} == names
    text = "\n".join((folder / name).read_text() for name in names).lower()
    for word in (*TRUTH, *truth["effects"]):
        assert word not in text.replace("compliance", "") or word == "compliance"


@pytest.mark.parametrize("made", [WORLDS[1], WORLDS[3]], indirect=True)
def test_seed_and_number_are_all(made):
    """The same world again, whichever others are made before it."""
    folder, number, truth = made
    texts, again = world.build(SEED, number)
    for name, text in texts.items():
        assert (folder / name).read_text() == text
    assert again["noise_um"] == pytest.approx(truth["noise_um"])
    assert again["effects"] == truth["effects"]


@pytest.mark.parametrize("made", [w for w in WORLDS if w[0] == "null"], indirect=True)
def test_null_world_fits_to_the_noise(made):
    folder, _, truth = made
    dataset = read_dataset(folder)
    fitted = estimate(build(Scene(dataset), tuple(truth["baseline"])))
    fitted = estimate(build(settled(fitted), tuple(truth["baseline"])), start=fitted.z)
    kind, stated = ("point", dataset.noise.point) if truth["session"]["stage"] == "tracker" else (
        "contact", dataset.noise.contact
    )  # fmt: skip
    noise = 1e6 * stated * fitted.weights.scale[kind]
    count = sum(len(b.rows) for b in fitted.model.blocks)
    assert noise == pytest.approx(truth["noise_um"], rel=4 / np.sqrt(2 * count))
    assert np.array(list(truth["distance_rms_um"].values())).max() < 4 * truth["noise_um"]


def test_it_shares_nothing_with_the_model():
    """Its modules, imported afresh, bring none of the model's along."""
    modules = [f"analysis.world.{m.name}" for m in pkgutil.iter_modules(analysis.world.__path__)]
    assert all(importlib.import_module(name) for name in modules)
    program = (
        f"import importlib, sys; [importlib.import_module(n) for n in {modules}]; "
        "print(sorted(n for n in sys.modules if n.split('.')[0] in ('bayescal', 'factors')))"
    )
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert not set(eval(said)) - {"bayescal", "bayescal.errors", "analysis.world", *modules}


def test_a_seed_of_the_first_generator_keeps_its_meaning():
    """Noise, scene and effect of a session, unchanged by the second generator."""
    texts, truth = world.build(SEED, 5, generator=1)
    assert truth["effects"] == OLD["effects"]
    assert truth["noise_um"] == pytest.approx(OLD["noise_um"], rel=1e-9)
    assert truth["lambda"]["value"] == pytest.approx(OLD["lambda"], rel=1e-6)
    assert hashlib.sha256(texts["dataset.yaml"].encode()).hexdigest()[:16] == OLD["dataset"]


def test_reserved_causes_are_drawn_on_request_alone():
    free = {m for k in range(200) for m in recipe(SEED, k)[1]}
    asked = {m for k in range(200) for m in recipe(SEED, k, reserved=True)[1]}
    assert not free & set(RESERVED)
    assert set(MORE) <= free
    assert {*MORE, *RESERVED} <= asked


@pytest.fixture(scope="module")
def bench():
    """A true arm in a session with an added load, readings without noise, and what is missing there."""
    rng = np.random.default_rng(3)
    body, stage = arm.Arm(arm.draw(rng)), scene.draw(rng)
    plan = session.plan(rng, stage, {"payload": "half", "speeds": 2.5})
    made = World(body, stage, plan, body.shape.give)
    readings, _ = made.touch((), np.zeros(len(plan.time)), straight=True)
    return made, readings, made.gap(readings)


@pytest.mark.parametrize("maker", [*chain.from_iterable(FORMS.values()), *MORE, *RESERVED])
def test_a_form_moves_something_in_proportion_to_its_size(maker, bench):
    made, readings, still = bench
    act = maker(np.random.default_rng(1), made)
    assert json.dumps(plain(act.detail))
    one, less = (made.gap(readings, [(act, act.size * part)]) - still for part in (1.0, 0.5))
    assert np.all(np.isfinite(one))
    assert 1e-6 < np.std(one) < 1e-3
    if act.name != "carried-play":  # play grows with its clearance, but not in proportion
        assert np.std(less - one / 2) < 0.05 * np.std(one)
    assert maker in (*MORE, *RESERVED) or act.form != "first"


def test_a_mass_hung_elsewhere_is_a_mass_there(bench):
    """The first moment about the stated centre gives the torque of a mass at the other centre."""
    made, readings, _ = bench
    off, kilos = (0.03, -0.05, 0.08), 1.7
    coordinates = np.zeros((len(readings), arm.SIZE))
    coordinates[:, arm.JOINT] = readings @ arm.LINK_FROM_READING.T
    direct = made.arm.weigh(coordinates, kilos, off) - made.arm.weigh(coordinates)
    at_tool = made.arm.weigh(coordinates, kilos) - made.arm.weigh(coordinates)
    by_moment = at_tool + made._leaning(coordinates, np.tile(kilos * np.array(off), (len(readings), 1)))
    np.testing.assert_allclose(by_moment, direct, atol=1e-9)
    assert np.abs(direct - at_tool).max() > 0.5


def test_what_a_fit_on_spheres_absorbs_is_not_visible():
    """A shift of a free centre is absorbed; a certified distance that changes is not."""
    rng = np.random.default_rng(3)
    body, things = arm.Arm(arm.draw(rng)), scene.draw(rng)
    plan = session.plan(rng, things, {}, session.SPHERES)
    made = World(body, things, plan, body.shape.give)
    model = visible.fitted(made, made.touch((), np.zeros(len(plan.time)), straight=True)[0], True)
    alike = np.isin(plan.target, plan.calibrating[:3])[:, None] * model.normal
    assert np.linalg.norm(model.left(alike @ np.array([1e-4, 0.0, 0.0]), 8e-6)) < 0.05
    one = (plan.target == plan.calibrating[0])[:, None] * model.normal
    along = things.ball[plan.calibrating[0] - 4] - things.ball[plan.calibrating[1] - 4]
    assert np.linalg.norm(model.left(one @ along / np.linalg.norm(along) * 1e-4, 8e-6)) > 10


def test_a_cause_with_steep_steps_is_touched_too():
    """Its contacts need more than the usual number of iterations."""
    assert world.make(618033, 1, reserved=True).truth["solver_gap_m"] < 1e-8
