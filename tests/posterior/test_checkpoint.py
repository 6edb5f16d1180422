"""An interrupted sampling continues with the draws of an uninterrupted one, or starts afresh and says so."""

import os
import re
from dataclasses import fields, replace

import numpy as np
import pytest

from bayescal.estimate import estimate
from bayescal.model import Scene, build, with_parameters
from bayescal.posterior import checkpoint as module
from bayescal.posterior import sample as sampling
from bayescal.posterior.checkpoint import Checkpoint
from bayescal.posterior.density import Density
from bayescal.posterior.linearised import CHAINS, Linearised
from bayescal.posterior.sample import sample
from bayescal.storage import locks, stopping
from bayescal.storage.locks import first_line

OPTIONS = {"effective": 60, "seed": 3, "max_steps": 8}


@pytest.fixture(scope="module")
def fitted(tracker):
    """Of few parameters: the size of an ensemble, and so its cost, grows with their square."""
    scene = Scene(tracker(seed=5, count=12).dataset)
    return estimate(with_parameters(scene, ("joint",), build(scene, ("joint",)).parameters[:4]))


@pytest.fixture(scope="module", autouse=True)
def short():
    """A sampling of few steps: after each of them the whole file is written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampling, "BURN", 5)
        patch.setattr(sampling, "TAUS", 5)
        yield


@pytest.fixture(scope="module")
def plain(fitted, short):
    return sample(fitted, **OPTIONS)


class Stop(BaseException):
    """A signal."""


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A checkpoint that is written at once, and what it says."""
    monkeypatch.setattr(module, "EVERY", -1.0)
    monkeypatch.setattr(module, "SHARE", float("inf"))
    monkeypatch.setattr(locks.os, "fsync", lambda handle: None)
    said = []
    return Checkpoint(tmp_path / "kept", said.append), said


def stop(*_):
    """What a kill does, as far as a test can."""
    raise Stop


def interrupted(monkeypatch, fitted, kept, calls, **options):
    """Sample until the density was computed `calls` times; the number of points."""
    left, count, own = calls, 0, Density.__call__

    def counted(self, x):
        nonlocal left, count
        left -= 1
        if left < 0:
            raise Stop
        count += len(x)
        return own(self, x)

    with monkeypatch.context() as patch:
        patch.setattr(Density, "__call__", counted)
        with pytest.raises(Stop):
            sample(fitted, **(OPTIONS | options), checkpoint=kept)
    return count


def proposed(monkeypatch, fitted, kept):
    """How many points a run draws from the linearised posterior, and how often it tests for convergence."""
    counts, draw, test = [0, 0], Linearised.draw, sampling.convergence

    def counted_draw(self, count, *rest, **options):
        counts[0] += count
        return draw(self, count, *rest, **options)

    def counted_test(chains):
        counts[1] += 1
        return test(chains)

    with monkeypatch.context() as patch:
        patch.setattr(Linearised, "draw", counted_draw)
        patch.setattr(sampling, "convergence", counted_test)
        sample(fitted, **OPTIONS, checkpoint=kept)
    return counts


def computed(monkeypatch, fitted, kept, every=600.0, **options):
    """Draws, and how many points the density was computed at; they are written after `every`, s."""
    count, own = 0, Density.__call__

    def counted(self, x):
        nonlocal count
        count += len(x)
        return own(self, x)

    with monkeypatch.context() as patch:
        patch.setattr(Density, "__call__", counted)
        patch.setattr(module, "EVERY", every)
        return sample(fitted, **(OPTIONS | options), checkpoint=kept), count


def same(a, b) -> bool:
    """Whether draws are equal bit by bit, with all that is stated of them."""
    pairs = ((getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return all(np.array_equal(x, y) if isinstance(x, np.ndarray) else x == y for x, y in pairs)


def test_interrupted_again_and_again_the_draws_are_the_same(monkeypatch, capfd, fitted, plain, kept):
    checkpoint, said = kept
    for calls in (1, 7, 20, 30):  # before the first step, in the burn-in and after it
        interrupted(monkeypatch, fitted, checkpoint, calls)
    assert capfd.readouterr() == ("", ""), "emcee prints no traceback"
    with monkeypatch.context() as patch:  # killed in a write
        patch.setattr(locks.Path, "replace", stop)
        interrupted(monkeypatch, fitted, checkpoint, 10)
    draws, count = computed(monkeypatch, fitted, checkpoint, every=-1.0)
    assert same(draws, plain)
    _, every = computed(monkeypatch, fitted, None)
    assert count < 0.8 * every
    assert len(said) == 4
    assert all(text.startswith("sampling continues after ") for text in said)
    again, few = computed(monkeypatch, fitted, checkpoint)  # killed before its results were written
    assert same(again, plain)
    starts = CHAINS * plain.walkers
    assert few == starts
    assert proposed(monkeypatch, fitted, checkpoint) == [starts, 0]


def test_what_is_left_is_computed_and_no_more(monkeypatch, fitted, plain, kept):
    checkpoint, _ = kept
    _, every = computed(monkeypatch, fitted, None)
    begun = interrupted(monkeypatch, fitted, checkpoint, 60)
    _, count = computed(monkeypatch, fitted, checkpoint)
    # the starts, and what was computed of the interrupted step, are computed again
    assert 0 <= begun + count - every - CHAINS * plain.walkers < plain.walkers


def test_a_stop_after_the_sampling_says_that_the_draws_are_kept(monkeypatch, fitted, kept):
    monkeypatch.setattr(stopping, "_kept", [lambda: "nothing was written"])
    sample(fitted, effective=1, max_steps=1)
    assert stopping.Stopped(2).kept == "nothing was written"
    draws = sample(fitted, effective=1, max_steps=1, checkpoint=kept[0])
    count = CHAINS * (sampling.BURN + draws.steps) * draws.walkers
    assert stopping.Stopped(2).kept == f"{count:,} draws are kept; the same command continues"


def test_progress_grows_by_steps_and_is_complete_only_at_the_end(cube, monkeypatch):
    """Of ensembles that do not drift after the burn-in; up to the first test, which may ask for more."""
    monkeypatch.setattr(sampling, "BURN", 15)
    monkeypatch.setattr(sampling, "TAUS", 10)
    fitted, shares = estimate(build(Scene(cube(seed=5, count=40).dataset), ("geometry",))), []
    draws = sample(fitted, **(OPTIONS | {"max_steps": 20}), progress=shares.append)
    assert len(shares) == CHAINS * (sampling.BURN + draws.steps) + 1
    assert np.all(np.diff(shares[: CHAINS * (sampling.BURN + sampling.TAUS)]) >= 0)
    assert max(shares[:-1]) <= sampling.NEARLY
    assert shares[-1] == 1.0
    expected = sampling.BURN / (sampling.BURN + sampling.TAUS)
    assert shares[CHAINS * sampling.BURN - 1] == pytest.approx(expected, abs=0.02)


OTHERS = {
    "seed": lambda fitted: (fitted, {"seed": 4}),
    "draws": lambda fitted: (fitted, {"effective": 90}),
    "start": lambda fitted: (replace(fitted, z=fitted.z + 1e-12), {}),
}


@pytest.mark.parametrize("what", OTHERS)
def test_other_inputs_start_afresh_and_say_so(monkeypatch, fitted, kept, what):
    checkpoint, said = kept
    interrupted(monkeypatch, fitted, checkpoint, 25)
    other, options = OTHERS[what](fitted)
    draws, count = computed(monkeypatch, other, checkpoint, **options)
    assert len(said) == 1
    assert said[0].endswith("is of other inputs or another version: it starts afresh")
    expected, every = computed(monkeypatch, other, None, **options)
    assert same(draws, expected)
    assert count == every


def test_another_density_at_the_same_points_is_seen(monkeypatch, fitted, kept):
    checkpoint, said = kept
    interrupted(monkeypatch, fitted, checkpoint, 25)
    own = Density.__call__
    monkeypatch.setattr(Density, "__call__", lambda self, x: own(self, x) * (1 + 1e-15))
    draws = sample(fitted, **OPTIONS, checkpoint=checkpoint)
    assert said[0].endswith("it starts afresh")
    assert same(draws, sample(fitted, **OPTIONS))


def test_a_damaged_file_is_not_used(monkeypatch, fitted, plain, kept):
    checkpoint, said = kept
    interrupted(monkeypatch, fitted, checkpoint, 25)
    content = bytearray(checkpoint.path.read_bytes())
    content[int(0.9 * len(content))] ^= 1
    checkpoint.path.write_bytes(content)
    draws, _ = computed(monkeypatch, fitted, checkpoint)
    assert same(draws, plain)
    assert len(said) == 1
    assert said[0].endswith("it starts afresh")


FOREIGN = {
    "file of the user": lambda path: path.write_text("my notes"),
    "data of the user": lambda path: path.write_bytes(b'{"schema": "notes/1"}\n' + bytes(100)),
    "brackets": lambda path: path.write_text("[" * 5000),
    "link to a file": lambda path: path.symlink_to(path.with_name("notes.txt")),
    "link to a checkpoint": lambda path: path.symlink_to(path.with_name("other")),
    "link to nothing": lambda path: path.symlink_to(path.with_name("nothing")),
    "pipe": lambda path: os.mkfifo(path),
    "folder": lambda path: path.mkdir(),
}


@pytest.mark.parametrize("what", FOREIGN)
def test_what_is_not_a_checkpoint_is_never_written_or_removed(fitted, kept, what):
    checkpoint, said = kept
    folder = checkpoint.path.parent
    (folder / "notes.txt").write_text("my notes")
    (folder / "other").write_bytes(first_line(module.SCHEMA) + bytes(10))
    FOREIGN[what](checkpoint.path)

    def there():
        return {p.name: (p.lstat()[:7], p.read_bytes() if p.is_file() else b"") for p in folder.iterdir()}

    before = there()
    sample(fitted, effective=1, max_steps=1, checkpoint=checkpoint)
    assert len(said) == 1
    assert re.fullmatch("no checkpoint is kept: (kept is not a file of bayescal|Is a directory)", said[0])
    checkpoint.remove()
    assert there() == before


def test_an_empty_file_and_one_of_an_earlier_schema_are_ours(fitted, kept):
    checkpoint, said = kept
    for content in (b"", first_line("bayescal-checkpoint/1") + bytes(30)):
        checkpoint.path.write_bytes(content)
        sample(fitted, effective=1, max_steps=1, checkpoint=checkpoint)
        assert checkpoint.path.read_bytes().startswith(b'{"bayescal": ')
        checkpoint.remove()
        assert not checkpoint.path.exists()
    words = "the checkpoint of an interrupted run is of other inputs or another version: it starts afresh"
    assert said == [words]


def test_a_short_run_writes_none_and_without_space_it_goes_on(monkeypatch, fitted, plain, tmp_path):
    path = tmp_path / "kept"
    monkeypatch.setattr(module, "EVERY", 600.0)  # short for a busy machine too
    assert same(sample(fitted, **OPTIONS, checkpoint=Checkpoint(path)), plain)
    assert not path.exists()
    monkeypatch.setattr(module, "EVERY", -1.0)
    said = []
    draws = sample(fitted, **OPTIONS, checkpoint=Checkpoint(tmp_path / "missing" / "kept", said.append))
    assert same(draws, plain)
    assert said == ["no checkpoint is kept: No such file or directory"]
