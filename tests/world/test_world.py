"""Blind worlds: readable, reproducible, silent about what they hide, and honest where they hide nothing."""

import importlib
import pkgutil
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bayescal.world
from bayescal.dataset import read_dataset
from bayescal.estimate import estimate, settled
from bayescal.model import build
from bayescal.model.scene import Scene
from bayescal.world import build as world
from bayescal.world.mix import MIX, recipe
from bayescal.world.write import plain

SEED = 101
TRUTH = ("truth", "effect", "lambda", "oracle", "outlier")


def number_of(kind: str) -> int:
    return next(k for k in range(len(MIX)) if recipe(SEED, k)[0] == kind)


@pytest.fixture(scope="module", params=["null", "single"])
def made(request, tmp_path_factory):
    """A world on disk: its folder, its number, its truth."""
    folder, number = tmp_path_factory.mktemp("world"), number_of(request.param)
    texts, truth = world.build(SEED, number)
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder, number, plain(truth)


def test_it_is_a_dataset(made):
    folder, _, truth = made
    dataset = read_dataset(folder)
    assert dataset.noise.contact == pytest.approx(1e-6 * truth["stated_noise_um"], rel=1e-3)
    assert {t.kind for t in dataset.targets} == {"plane", "sphere"}
    assert set(dataset.measurements.role) == {"calibrate", "validate"}
    assert truth["robot"]["a"][2] != pytest.approx(0.3, abs=1e-6), "the arm is not as drawn"


def test_its_folder_does_not_tell(made):
    folder, _, truth = made
    names = {"dataset.yaml", "robot.yaml", "measurements.csv", "baseline.txt"}
    assert {p.name for p in folder.iterdir()} == names
    text = "\n".join((folder / name).read_text() for name in names).lower()
    for word in (*TRUTH, *truth["effects"]):
        assert word not in text.replace("compliance", "") or word == "compliance"


def test_seed_and_number_are_all(made):
    """The same world again, whichever others are made before it."""
    folder, number, truth = made
    texts, again = world.build(SEED, number)
    for name, text in texts.items():
        assert (folder / name).read_text() == text
    assert again["noise_um"] == pytest.approx(truth["noise_um"])
    assert again["effects"] == truth["effects"]


def test_null_world_fits_to_the_noise(made):
    folder, _, truth = made
    if truth["kind"] != "null":
        pytest.skip("something is hidden in it")
    dataset = read_dataset(folder)
    fitted = estimate(build(Scene(dataset), tuple(truth["baseline"])))
    fitted = estimate(build(settled(fitted), tuple(truth["baseline"])), start=fitted.z)
    noise = 1e6 * dataset.noise.contact * fitted.weights.scale["contact"]
    count = sum(len(b.rows) for b in fitted.model.blocks)
    assert noise == pytest.approx(truth["noise_um"], rel=4 / np.sqrt(2 * count))
    off = np.array(list(truth["distance_rms_um"].values()))
    assert off.max() < 4 * truth["noise_um"]


def test_worlds_differ():
    kinds = [recipe(SEED, k)[0] for k in range(2 * len(MIX))]
    assert sorted(kinds) == sorted(2 * MIX)
    named = [m for k in range(100) for m in recipe(SEED, k)[1] if recipe(SEED, k)[0] == "single"]
    assert len(set(named)) == 18, "every effect in its turn"
    assert recipe(SEED, 3) == recipe(SEED, 3)


def test_no_command_needs_pinocchio():
    program = "import sys; sys.modules['pinocchio'] = None; import bayescal.cli, bayescal.world, bayescal.gap"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_it_shares_nothing_with_the_model():
    """Its modules, imported afresh, bring none of the model's along."""
    modules = [f"bayescal.world.{m.name}" for m in pkgutil.iter_modules(bayescal.world.__path__)]
    assert all(importlib.import_module(name) for name in modules)
    program = (
        f"import importlib, sys; [importlib.import_module(n) for n in {modules}]; "
        "print(sorted(n for n in sys.modules if n.split('.')[0] in ('bayescal', 'factors')))"
    )
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    others = set(eval(said)) - {"bayescal", "bayescal.errors", "bayescal.world", *modules}
    assert not others
