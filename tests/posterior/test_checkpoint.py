"""An interrupted sampling continues with the draws of an uninterrupted one, or starts afresh and says so."""

from dataclasses import fields, replace

import numpy as np
import pytest

from bayescal.estimate import estimate
from bayescal.model import build
from bayescal.model.scene import Scene
from bayescal.posterior import checkpoint as module
from bayescal.posterior.checkpoint import Checkpoint
from bayescal.posterior.density import Density
from bayescal.posterior.sample import sample

OPTIONS = {"effective": 60, "seed": 3, "max_steps": 20}


@pytest.fixture(scope="module")
def fitted(cube):
    return estimate(build(Scene(cube(seed=5, count=40).dataset), ("geometry",)))


@pytest.fixture(scope="module")
def plain(fitted):
    return sample(fitted, **OPTIONS)


class Stop(BaseException):
    """A signal."""


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A checkpoint that is written at once, and what it says."""
    monkeypatch.setattr(module, "EVERY", -1.0)
    said = []
    return Checkpoint(tmp_path / "kept", said.append), said


def interrupted(monkeypatch, fitted, kept, calls, **options):
    """Sample until the density was computed `calls` times."""
    left, own = calls, Density.__call__

    def counted(self, x):
        nonlocal left
        left -= 1
        if left < 0:
            raise Stop
        return own(self, x)

    with monkeypatch.context() as patch:
        patch.setattr(Density, "__call__", counted)
        with pytest.raises(Stop):
            sample(fitted, **(OPTIONS | options), checkpoint=kept)


def computed(monkeypatch, fitted, kept, **options):
    """Draws, and how many points the density was computed at."""
    count, own = 0, Density.__call__

    def counted(self, x):
        nonlocal count
        count += len(x)
        return own(self, x)

    with monkeypatch.context() as patch:
        patch.setattr(Density, "__call__", counted)
        return sample(fitted, **(OPTIONS | options), checkpoint=kept), count


def same(a, b) -> bool:
    """Whether draws are equal bit by bit, with all that is stated of them."""
    pairs = ((getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return all(np.array_equal(x, y) if isinstance(x, np.ndarray) else x == y for x, y in pairs)


def test_interrupted_again_and_again_the_draws_are_the_same(monkeypatch, capfd, fitted, plain, kept):
    checkpoint, said = kept
    for calls in (1, 7, 40, 100):  # in the burn-in and after it
        interrupted(monkeypatch, fitted, checkpoint, calls)
    assert capfd.readouterr() == ("", ""), "emcee prints no traceback"
    content = checkpoint.path.read_bytes()
    checkpoint.path.write_bytes(content[:-3])  # as if killed in a write
    interrupted(monkeypatch, fitted, checkpoint, 10)
    draws, count = computed(monkeypatch, fitted, checkpoint)
    assert same(draws, plain)
    _, every = computed(monkeypatch, fitted, None)
    assert count < 0.8 * every
    assert len(said) == 5
    assert all(text.startswith("sampling continues after ") for text in said)
    again, few = computed(monkeypatch, fitted, checkpoint)  # killed before its results were written
    assert same(again, plain)
    assert few < 0.05 * every


OTHERS = {
    "seed": lambda fitted: (fitted, {"seed": 4}),
    "draws": lambda fitted: (fitted, {"effective": 90}),
    "start": lambda fitted: (replace(fitted, z=fitted.z + 1e-12), {}),
}


@pytest.mark.parametrize("what", OTHERS)
def test_other_inputs_start_afresh_and_say_so(monkeypatch, fitted, kept, what):
    checkpoint, said = kept
    interrupted(monkeypatch, fitted, checkpoint, 60)
    other, options = OTHERS[what](fitted)
    draws, count = computed(monkeypatch, other, checkpoint, **options)
    assert len(said) == 1
    assert said[0].endswith("is of other inputs or another version: it starts afresh")
    expected, every = computed(monkeypatch, other, None, **options)
    assert same(draws, expected)
    assert count == every


def test_another_density_at_the_same_points_is_seen(monkeypatch, fitted, kept):
    checkpoint, said = kept
    interrupted(monkeypatch, fitted, checkpoint, 60)
    own = Density.__call__
    monkeypatch.setattr(Density, "__call__", lambda self, x: own(self, x) * (1 + 1e-15))
    draws = sample(fitted, **OPTIONS, checkpoint=checkpoint)
    assert said[0].endswith("it starts afresh")
    assert same(draws, sample(fitted, **OPTIONS))


@pytest.mark.parametrize("place", [0.5, 0.9])
def test_a_damaged_file_is_used_up_to_the_damage(monkeypatch, fitted, plain, kept, place):
    checkpoint, _ = kept
    interrupted(monkeypatch, fitted, checkpoint, 60)
    content = bytearray(checkpoint.path.read_bytes())
    content[int(place * len(content))] ^= 1
    checkpoint.path.write_bytes(content)
    draws, _ = computed(monkeypatch, fitted, checkpoint)
    assert same(draws, plain)


def test_a_short_run_writes_none_and_without_space_it_goes_on(monkeypatch, fitted, plain, tmp_path):
    path = tmp_path / "kept"
    assert same(sample(fitted, **OPTIONS, checkpoint=Checkpoint(path)), plain)
    assert not path.exists()
    monkeypatch.setattr(module, "EVERY", -1.0)
    said = []
    draws = sample(fitted, **OPTIONS, checkpoint=Checkpoint(tmp_path / "missing" / "kept", said.append))
    assert same(draws, plain)
    assert said == ["no checkpoint is kept: No such file or directory"]
