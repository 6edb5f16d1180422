"""A made-up kind that has a centre: its declaration alone says that its distances are validated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from kind_sessions import Piece, of_pieces

from bayescal.dataset import Certificate, Target
from bayescal.dataset.target_kinds import KINDS, TargetKind, place_sd
from bayescal.effects import parameters_of
from bayescal.estimate import estimate
from bayescal.gap.design.blind_spots import located
from bayescal.model import ARM, Model, build
from bayescal.model.scene import Scene
from bayescal.posterior import gaussian
from bayescal.predict import validate
from factors.feature import Feature, point

EFFECTS = ("geometry", "compliance")


@dataclass(frozen=True)
class Nest:
    """A nest that holds the ball; unlike the built-in kinds it has no attribute `centre`."""

    at: np.ndarray
    sd: np.ndarray
    rows = 3
    parts = (("x", "m"), ("y", "m"), ("z", "m"))

    def residual(self, x, p):
        return p - (self.at + x)[..., None]

    def linearise(self, x, p):
        r = self.residual(x, p)
        u = np.broadcast_to(np.eye(3)[:, :, None], (*r.shape[:-1], 3, r.shape[-1]))
        dx = np.broadcast_to(-np.eye(3)[:, None, :], (*r.shape, 3))
        return r, u, dx

    def describe(self, x):
        return {"centre": self.at + x}

    def feature(self, x) -> Feature:
        return point(self.at, x)


NEST = TargetKind(
    "nest",
    "a nest that holds the ball",
    {"centre_mm": list},
    lambda t, seen: Nest(np.asarray(t.values["centre"], float), np.full(3, place_sd(t))),
    form="point",
    place=lambda t: np.asarray(t.values["centre"], float),
    centred=True,
    found=True,
)
NESTS = {"nest.A": [0.45, -0.2, 0.2], "nest.B": [0.35, 0.2, 0.25]}
OFF = np.array([1e-3, -5e-4, 8e-4])


@pytest.fixture(scope="module")
def session(cube):
    pieces = [
        Piece(Target(name, "nest", {"centre": np.array(at)}), Nest(np.array(at) + k * OFF, np.ones(3)),
              count=14, held=14, about=np.array(at), spread=0.0)
        for k, (name, at) in enumerate(NESTS.items())
    ]  # fmt: skip
    a, b = (p.true.at for p in pieces)
    certificate = Certificate("distance", tuple(NESTS), float(np.linalg.norm(a - b)), 1e-6)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(KINDS, "nest", NEST)
        return of_pieces(cube(seed=3, count=80), pieces, (certificate,), seed=1).dataset


@pytest.fixture
def fitted(session, monkeypatch):
    monkeypatch.setitem(KINDS, "nest", NEST)
    return estimate(build(Scene(session), EFFECTS))


def test_its_distance_is_validated_and_its_rows_are_not(fitted):
    draws = gaussian(fitted, 0, 500)
    found = validate(fitted, draws.flat, draws.kappa, excess=5e-6)
    (distance,) = found.distances
    assert distance.between == tuple(NESTS)
    assert abs(distance.error) < 4 * distance.predicted.std()
    assert not found.points
    assert not found.diameters


def test_it_is_located_where_it_is(fitted):
    model = fitted.model
    scene = model.scene
    parameters = parameters_of(EFFECTS, scene.circumstances(scene.rows("calibrate")))
    wide = Model(scene, EFFECTS, parameters, (), ())
    values = model.deviations(fitted.z[model.slices[ARM]])
    index = {t.name: k for k, t in enumerate(scene.dataset.targets)}
    block, z = located(fitted, wide, index["nest.B"], values)
    np.testing.assert_allclose(block.state(z), OFF, atol=2e-4)
    assert located(fitted, wide, 0, values) is None


def test_without_the_declaration_its_rows_are_validated(session, monkeypatch):
    monkeypatch.setitem(KINDS, "nest", replace(NEST, centred=False, found=False))
    fitted = estimate(build(Scene(session), EFFECTS))
    draws = gaussian(fitted, 0, 100)
    found = validate(fitted, draws.flat, draws.kappa)
    assert not found.distances
    assert {p.target for p in found.points} == set(NESTS)
