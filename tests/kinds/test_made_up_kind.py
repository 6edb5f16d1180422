"""A kind of target that this test makes up: one class and one declaration, and everything takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from kind_sessions import MIDDLE, Piece, of_pieces

from bayescal.calibration import fit
from bayescal.dataset import Target, read_dataset, write_dataset
from bayescal.dataset.target_kinds import KINDS, TargetKind, place_sd
from bayescal.errors import BayescalError
from bayescal.storage.files import Number, Vector
from factors.feature import Feature, slopes
from factors.kind import dot


@dataclass(frozen=True)
class Gauge:
    """A height gauge: the TCP stands at a height along a known direction."""

    direction: np.ndarray
    height: float
    sd: np.ndarray
    rows = 1
    parts = (("height", "m"),)

    def residual(self, x, p):
        return (dot(self.direction, p) - (self.height + x[..., :1]))[..., None, :]

    def linearise(self, x, p):
        r = self.residual(x, p)
        u = np.broadcast_to(self.direction[:, None], (*r.shape[:-1], 3, r.shape[-1]))
        return r, u, np.full((*r.shape, 1), -1.0)

    def describe(self, x):
        return {"direction": self.direction, "height": float(self.height + x[0])}

    def feature(self, x):
        by = slopes(x)
        by[..., 0, :] = self.direction
        turn = np.broadcast_to(self.direction, (*x.shape[:-1], 3))
        return Feature((self.height + x) * self.direction, by, turn, slopes(x))


GAUGE = TargetKind(
    "gauge",
    "a height along a known direction",
    {"direction": Vector, "height_mm": Number},
    lambda t, seen: Gauge(
        np.asarray(t.values["direction"], float), float(t.values["height"]), np.array([place_sd(t)])
    ),
    form="plane",
    place=lambda t: t.values["height"] * np.asarray(t.values["direction"]),
    direction="direction",
    certificates=("flat",),
)
UP = np.array([0.0, 0.0, 1.0])
OFF = 2e-3


@pytest.fixture
def declared(monkeypatch):
    monkeypatch.setitem(KINDS, GAUGE.name, GAUGE)


@pytest.fixture
def session(declared, cube):
    target = Target("gauge", "gauge", {"direction": UP, "height": 0.3}, 5e-3)
    true = Gauge(UP, 0.3 + OFF, np.ones(1))
    return of_pieces(cube(seed=3, count=80), [Piece(target, true, count=60, held=12, about=MIDDLE)], seed=1)


def test_it_is_written_read_fitted_and_validated(session, tmp_path):
    write_dataset(session.dataset, tmp_path / "s")
    text = (tmp_path / "s" / "dataset.yaml").read_text()
    assert "gauge: {kind: gauge, direction: [0, 0, 1], height_mm: 300, u_mm: 5}" in text
    dataset = read_dataset(tmp_path / "s")
    result = fit(dataset, ("geometry", "compliance"), samples=0)
    found = result.final.estimate
    block, own = found.model.block_of["gauge"], found.model.slices["gauge"]
    off = block.state(found.z[own])[0] - OFF
    assert abs(off) < 4.5 * found.sd[own][0] * block.sd[0]
    (check,) = (c for c in result.final.validation.planes if c.target == "gauge")
    assert check.residuals.size == 12
    assert np.sqrt(np.mean(check.residuals**2)) < 15e-6


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"height_mm: 300": "height: 300"}, "key `height` has no unit in its name; write `height_mm`"),
        ({"height_mm: 300, ": ""}, "missing `height_mm`"),
        ({"[0, 0, 1], height": "[0, 0, 2], height"}, "the direction of `gauge` has length 2, not 1"),
        ({"kind: gauge": "kind: gage"}, "unknown kind 'gage'"),
        ({"height_mm: 300": "height_mm: 900"}, "all contacts of `gauge` are nominally"),
    ],
)
def test_its_mistakes_are_told_like_those_of_any_kind(session, tmp_path, wrong, words):
    write_dataset(session.dataset, tmp_path / "s")
    file = tmp_path / "s" / "dataset.yaml"
    text = file.read_text()
    for old, new in wrong.items():
        assert old in text
        text = text.replace(old, new)
    file.write_text(text)
    with pytest.raises(BayescalError, match=words):
        read_dataset(tmp_path / "s")


def test_without_its_declaration_it_is_unknown(session, tmp_path, monkeypatch):
    write_dataset(session.dataset, tmp_path / "s")
    monkeypatch.delitem(KINDS, GAUGE.name)
    with pytest.raises(BayescalError, match=r"unknown kind 'gauge'.*'plane', 'sphere'"):
        read_dataset(tmp_path / "s")
