"""A made-up kind that has a centre, and certified coordinates, in a fit and in a validation."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pytest
from kind_sessions import Piece, cone, of_pieces
from sessions import circumstances

from bayescal.arm.transforms import rpy_matrix
from bayescal.assess.inputs import CERTIFICATE, propagated
from bayescal.calibration import fit
from bayescal.dataset import Certificate, Points, Target
from bayescal.dataset.join import joined
from bayescal.dataset.session import distances_of
from bayescal.dataset.target_kinds import KINDS, TargetKind, place_sd
from bayescal.effects import parameters_of
from bayescal.estimate import calibrated, estimate
from bayescal.estimate.discrepancy import stated
from bayescal.gap.advise import located
from bayescal.model import ARM, Model, Scene, build
from bayescal.posterior import gaussian
from bayescal.predict.validation import validate
from factors.kind import Feature

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
        return r, u, np.broadcast_to(-np.eye(3)[:, None, :], (*r.shape, 3))

    def describe(self, x):
        return {"centre": self.at + x}

    def feature(self, x) -> Feature:
        return Feature(self.at + x, np.broadcast_to(np.eye(3), (*x.shape, 3)))


NEST = TargetKind(
    "nest",
    "a nest that holds the ball",
    {"centre_mm": list},
    lambda t, seen: Nest(np.asarray(t.values["centre"], float), np.full(3, place_sd(t))),
    form="point",
    place=lambda t: np.asarray(t.values["centre"], float),
    centred=True,
    located=True,
)
NESTS = {"nest.A": [0.45, -0.2, 0.2], "nest.B": [0.35, 0.2, 0.25]}
MADE_UP_CENTRE_OFF = np.array([1e-3, -5e-4, 8e-4])


@pytest.fixture(scope="module")
def centre_session(cube):
    pieces = [
        Piece(Target(name, "nest", {"centre": np.array(at)}),
              Nest(np.array(at) + k * MADE_UP_CENTRE_OFF, np.ones(3)),
              count=14, held=14, about=np.array(at), spread=0.0)
        for k, (name, at) in enumerate(NESTS.items())
    ]  # fmt: skip
    a, b = (p.true.at for p in pieces)
    certificate = Certificate("distance", tuple(NESTS), float(np.linalg.norm(a - b)), 1e-6)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(KINDS, "nest", NEST)
        return of_pieces(cube(seed=3, count=80), pieces, (certificate,), seed=1).dataset


@pytest.fixture
def fitted(centre_session, monkeypatch):
    monkeypatch.setitem(KINDS, "nest", NEST)
    return estimate(build(Scene(centre_session), EFFECTS))


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
    wide = Model(scene, EFFECTS, parameters_of(EFFECTS, circumstances(scene)), (), ())
    values = model.deviations(fitted.z[model.slices[ARM]])
    index = {t.name: k for k, t in enumerate(scene.dataset.targets)}
    block, z = located(fitted, wide, index["nest.B"], values)
    np.testing.assert_allclose(block.state(z), MADE_UP_CENTRE_OFF, atol=2e-4)
    assert located(fitted, wide, 0, values) is None


def test_without_the_declaration_its_rows_are_validated(centre_session, monkeypatch):
    monkeypatch.setitem(KINDS, "nest", replace(NEST, centred=False, located=False))
    fitted = estimate(build(Scene(centre_session), EFFECTS))
    draws = gaussian(fitted, 0, 100)
    found = validate(fitted, draws.flat, draws.kappa)
    assert not found.distances
    assert {p.target for p in found.points} == set(NESTS)


# --- Certified coordinates in a fit and in a validation.

PLATE = np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0], [0.0, 0.12, 0.0], [0.15, 0.12, 0.0], [0.07, 0.06, 0.0]])
U = 1e-6


def artefact(names, placements, of=None, u=U) -> Certificate:
    of = tuple(range(len(names))) if of is None else of
    spread = tuple(map(tuple, (u**2 * np.eye(PLATE.size)).tolist()))
    points = Points("plate", tuple("abcde"), tuple(map(tuple, PLATE.tolist())), spread, of, placements)
    return Certificate("points", names, points=points)


@pytest.fixture(scope="module")
def artefact_session(cube):
    """Seats of a plate at two placements, the second validated."""
    rng, pieces = np.random.default_rng(2), []
    true = PLATE + U * rng.normal(size=PLATE.shape)
    for place, (middle, rpy, held) in enumerate(
        (([0.38, -0.1, 0.25], [0.1, 0.2, 0.3], 0), ([0.42, 0.0, 0.35], [-0.3, 0.5, 1.0], 12))
    ):
        for k, centre in enumerate(true @ rpy_matrix(np.array(rpy)).T + middle):
            nominal = centre + np.array([1e-3, -2e-3, 1e-3])
            pieces.append(cone(f"{'abcde'[k]}@{place}", nominal, centre - nominal, count=12, held=held))
    found = of_pieces(cube(seed=9), pieces, planes=False, seed=4)
    whole = artefact(tuple(p.target.name for p in pieces), ("0",) * 5 + ("1",) * 5, (*range(5), *range(5)))
    found.dataset = replace(found.dataset, certificates=(whole, *distances_of(whole)))
    return found


def test_fit_and_validation(artefact_session):
    result = fit(artefact_session.dataset, EFFECTS, samples=0)
    found = result.stated.plain
    (constraint,) = found.model.constraints
    assert constraint.rows == 3 * 5 - 6  # of the fitted placement alone
    assert constraint.targets == tuple(f"{k}@0" for k in "abcde")
    assert found.model.knows_length
    off = []
    values = found.model.physical(found.z)
    for k, p in enumerate(found.model.parameters):
        if p.name in artefact_session.arm.values:
            off.append((values[k] - artefact_session.arm.values[p.name]) / (found.sd[k] * p.sd))
    assert len(off) > 15
    assert np.max(np.abs(off)) < 4.5
    checks = result.levels[-1].validation.distances
    assert len(checks) == 10
    error, drawn = np.array([c.error for c in checks]), np.stack([c.predicted for c in checks])
    assert np.all(np.abs(error - drawn.mean(axis=1)) < 4 * drawn.std(axis=1))


def test_two_points_are_a_distance(artefact_session):
    """The same estimate and covariance as with a certified distance of the same uncertainty."""
    pair = ("a@0", "d@0")
    length = float(np.linalg.norm(PLATE[3]))
    single = Certificate("distance", pair, distance=length, u_distance=np.sqrt(2) * U)
    papers = (artefact(pair, ("0", "0"), (0, 3)), single)
    sessions = (replace(artefact_session.dataset, certificates=(c,)) for c in papers)
    one, other = (calibrated(Scene(session), ("geometry",)) for session in sessions)
    np.testing.assert_allclose(one.z, other.z, atol=2e-4)
    np.testing.assert_allclose(one.sd, other.sd, rtol=2e-4)


def test_derived_distances_are_not_counted_twice(artefact_session):
    dataset = artefact_session.dataset
    both = (dataset.certificates, [c for c in dataset.certificates if not c.derived])
    one, other = (build(Scene(replace(dataset, certificates=tuple(c))), EFFECTS) for c in both)
    assert len(one.constraints) == len(other.constraints) == 1


def test_the_budget_contains_it_without_a_remainder(artefact_session):
    found = stated(calibrated(Scene(artefact_session.dataset), EFFECTS))
    parts = propagated(found)
    certificates = [p.input.name for p in parts if p.input.group == CERTIFICATE]
    assert certificates == ["certificate: coordinates of plate"]
    total = sum(p.by @ p.by.T for p in parts)
    np.testing.assert_allclose(total, found.wide.covariance, atol=1e-6 * np.abs(found.wide.covariance).max())


def test_an_error_of_a_coordinate_is_estimated(artefact_session):
    """The effect `artefact` has a parameter for each certified coordinate; a wrong one is found."""
    (whole, *_) = artefact_session.dataset.certificates
    moved = [list(p) for p in PLATE.tolist()]
    moved[1][1] += 60e-6
    coordinates = tuple(map(tuple, moved))
    spread = tuple(map(tuple, (400e-12 * np.eye(15)).tolist()))
    wrong = replace(whole, points=replace(whole.points, coordinates=coordinates, covariance=spread))
    session = replace(artefact_session.dataset, certificates=(wrong,))
    found = calibrated(Scene(session), (*EFFECTS, "artefact"))
    names = [p.name for p in found.model.parameters]
    values = found.model.physical(found.z)
    coordinates = [f"{p} {a}" for p in "abcde" for a in "xyz"]
    of = {name: values[names.index(f"artefact {name}")] for name in coordinates}
    corrected = np.array([[of[f"{p} {a}"] for a in "xyz"] for p in "abcde"]) + np.array(moved)
    for i, j in combinations(range(5), 2):
        length = np.linalg.norm(corrected[i] - corrected[j])
        assert length == pytest.approx(np.linalg.norm(PLATE[i] - PLATE[j]), abs=25e-6)


def test_joined_sessions_share_its_error(artefact_session):
    one = replace(artefact_session.dataset, name="A", sha256="a")
    rows = replace(one.measurements, readings=one.measurements.readings + 0.0)
    both = joined((one, replace(one, name="B", sha256="b", measurements=rows)))
    wide = [np.array(c.points.covariance)[0, 0] for c in both.certificates if c.points is not None]
    np.testing.assert_allclose(wide, [2 * U**2] * 2, rtol=1e-6)
    assert [c.targets[0] for c in both.certificates if c.points is not None] == ["A:a@0", "B:a@0"]
