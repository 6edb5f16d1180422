"""What a diagnosis says of simulated sessions of a camera, of a simulator that shares no code."""

from pathlib import Path

import numpy as np
import pytest
from sessions import with_columns, with_rows

pytest.importorskip("pinocchio")

from analysis.world.camera import build
from bayescal.dataset import read_dataset
from bayescal.gap.diagnose import diagnose, explain
from bayescal.model.scene import Scene
from bayescal.reporting.gap.phrases import headline


def made(folder: Path, number: int, side: str, detectability: float, every: int = 5):
    """A session of 20 images of which one corner in `every` is read, and its ground truth."""
    texts, truth = build(20261, number, side, every * detectability, 20)
    for name, text in texts.items():
        (folder / name).write_text(text)
    session = read_dataset(folder)
    return with_rows(session, np.flatnonzero(session.measurements.pixel[:, 2] % every == 0)), truth


def verdict_on(session):
    return explain(Scene(session, oriented=True), ("geometry", "compliance")).verdict


@pytest.mark.parametrize(("number", "side"), [(4, "camera"), (10, "clock")])
def test_the_side_is_named(number, side, tmp_path):
    session, truth = made(tmp_path, number, side, 300.0)
    assert [n.effect for n in verdict_on(session).named] == truth["effects"]


def test_a_slip_is_before_an_image_and_not_within(tmp_path):
    """As the row of the effect that a fit takes is: a headline must not state another."""
    session, truth = made(tmp_path, 40, "mount", 400.0, every=4)
    (named,) = verdict_on(session).named
    (event,) = named.events
    stop = session.measurements.stop
    assert stop[event.row] != stop[event.row - 1]
    assert named.model.split()[0] == f"step@{event.row + 1}"
    assert abs(int(stop[event.row][1:]) - truth["detail"]["image"]) <= 2


def test_nothing_is_named_where_nothing_is_hidden(tmp_path):
    session, _ = made(tmp_path, 2, "null", 0.0)
    verdict = verdict_on(session)
    assert verdict.kind == "null"
    assert verdict.probability["null"] > 0.5
    # shifts of the images that each has anew are no effect, and are told
    image = np.unique(session.measurements.stop, return_inverse=True)[1]
    pixel = session.measurements.pixel.copy()
    pixel[:, :2] += np.random.default_rng(1).normal(0.0, 0.5, (image.max() + 1, 2))[image]
    found = diagnose(with_columns(session, pixel=pixel))
    assert found.verdict.kind == "null"
    assert found.scatter.beyond
    (_, said, *_) = headline(found)
    assert found.scatter.words in said
    assert "the model explains these data" not in headline(found)[0]
