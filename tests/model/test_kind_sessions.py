"""Every kind and several at once: fit, validate and gap run on them and keep what they promise."""

from dataclasses import replace

import kind_sessions
import numpy as np
import pytest
from cases import refused
from kind_sessions import POINT, TURN, bar, cone, of_pieces, pin, sphere, tracker
from scipy.stats import chi2
from sessions import plain, with_columns

from bayescal.arm.transforms import rpy_of
from bayescal.assess.inputs import _certificates
from bayescal.calibration import fit
from bayescal.dataset import Certificate, read_dataset, write_dataset
from bayescal.dataset.contacts import measured_again
from bayescal.effects.geometry import LOOSE_ANGLE
from bayescal.estimate import calibrated, unexplained
from bayescal.estimate.bounds import with_latent_readings
from bayescal.estimate.unexplained import FaceCheck
from bayescal.gap.diagnose import diagnose
from bayescal.model.block import USUAL
from bayescal.model.scene import Scene
from bayescal.posterior import Density, gaussian
from bayescal.predict.crossvalidation import inside95
from bayescal.predict.validation import validate
from bayescal.reporting.gap.phrases import warnings
from factors.kind import rotation_vector

FULL = ("geometry", "compliance")
OFF = np.array([4e-3, -2e-3, 3e-3, 2e-3, -1e-3, 3e-3])
NORTH = tracker("tracker", [2.0, 0.3, 0.5], [5, -3, 170], OFF, count=90, held=24)
SOUTH = tracker("other", [-0.5, 1.8, 0.2], [0, 2, -60], -OFF, tools=(1, 2), count=60, held=16)
BALLS = (
    sphere("ball.A", [0.40, -0.15, 0.25], [1e-3, 0, -1e-3], count=24),
    sphere("ball.B", [0.50, 0.15, 0.20], [0, 1e-3, 2e-3], count=24),
)


def apart(a, b) -> Certificate:
    """The true distance between two centres, as a paper states it."""
    length = float(np.linalg.norm(a.true.centre - b.true.centre))
    return Certificate("distance", (a.target.name, b.target.name), length, 1e-6)


def whitened(session, found) -> dict[str, float]:
    """Errors of the arm's parameters and the tools' centres, in posterior standard deviations."""
    known = dict(session.arm.values)
    for name, (centre, _) in session.tools.items():
        known |= {f"{name} {axis}": centre[k] for k, axis in enumerate("xyz")}
    values, sd = found.model.physical(found.z), found.sd
    out = {}
    for k, p in enumerate(found.model.parameters):
        if p.name in known:
            out[p.name] = (values[k] - known[p.name]) / (sd[k] * p.sd)
    return out


def check_truth(session, found) -> None:
    """The truth lies where the posterior says, parameter by parameter and all together."""
    off = whitened(session, found)
    assert len(off) > 20
    assert max(map(abs, off.values())) < 4.5, off
    values = found.model.physical(found.z)[: len(found.model.parameters)]
    known = np.array([p.name in off for p in found.model.parameters])
    error = np.array([off[p.name] for p in found.model.parameters if p.name in off])
    index = np.flatnonzero(known)
    sd = found.sd[index]
    correlation = found.covariance[np.ix_(index, index)] / np.outer(sd, sd)
    assert len(values) >= len(error)
    assert chi2.sf(float(error @ np.linalg.solve(correlation, error)), len(error)) > 1e-4


def check_held_out(v, share=0.87) -> None:
    """Held-out rows of every kind lie in their predicted intervals as often as those say."""
    checks = [*v.planes, *v.points, *v.turns]
    assert checks
    for check in checks:
        assert inside95(check.residuals, check.predicted).mean() > share, check.target


@pytest.fixture(scope="module")
def posed(cube):
    """Full poses of two six-degree probes, beside points of a plain reflector."""
    probes = replace(NORTH, tools=(1, 2), poses=True)
    plain = tracker("plain", [1.0, -1.9, 0.4], [0, 0, 80], -OFF, tools=(3,), count=30)
    return of_pieces(cube(seed=6), (probes, plain), planes=False, seed=1)


@pytest.fixture(scope="module")
def fitted(posed):
    """The fit of points and orientations."""
    return calibrated(Scene(posed.dataset, oriented=True), FULL)


@pytest.fixture(scope="module")
def every(cube):
    """A target of every kind, with certificates across kinds."""
    pieces = (
        *BALLS,
        cone("cone", [0.42, 0.05, 0.20], [1e-3, 1e-3, 0], count=12),
        bar("bar", [0.45, 0.1, -0.05], [0, -1e-3, 1e-3], count=30),
        pin("pin", [0.5, -0.05, 0.25], [0.0, 0.0, 1.0], [1e-3, -1e-3, 0], count=24),
        replace(NORTH, count=44, held=12, poses=True),
    )
    pairs = (BALLS, (BALLS[0], pieces[2]), pieces[2:4], (BALLS[1], pieces[3]))
    papers = tuple(apart(*pair) for pair in pairs)
    return of_pieces(cube(seed=8, count=40), pieces, papers, seed=3)


def scales_are_right(found):
    return all(0.7 < s < 1.4 for g, s in found.weights.scale.items() if g != "orientation")


def test_several_instruments(cube):
    # three reflectors on one tracker, two of which another sees too
    several = of_pieces(cube(seed=5), (NORTH, SOUTH), planes=False)
    found = calibrated(Scene(several.dataset, oriented=True), FULL)
    check_truth(several, found)
    assert scales_are_right(found)


def test_fit_and_validate(every, monkeypatch):
    result = fit(every.dataset, FULL, samples=0)
    found = result.final.estimate
    check_truth(every, found)
    check_held_out(result.final.validation)
    assert scales_are_right(found)
    # the form of a face adds its own unknowns alone: the turn of a tool is there already
    monkeypatch.setattr(unexplained, "ROUNDS", 1)
    formed = unexplained.with_uneven_faces(found, [FaceCheck("cube.+y", 20e-6, 0.0, True)]).model
    assert any(p.effect == "plane-form" for p in formed.parameters)
    assert len(set(formed.names)) == len(formed.names)


def test_poses_are_fitted_and_validated(posed, fitted):
    check_truth(posed, fitted)
    draws = gaussian(fitted, 0, 500)
    check_held_out(validate(fitted, draws.flat, draws.kappa))
    assert scales_are_right(fitted)


def test_one_artefact_at_two_placements_has_one_error(cube):
    """Each placement had a certified length of its own: its uncertainty fell with their number."""
    places = [("1", np.array([0.42, -0.1, 0.25])), ("2", np.array([0.42, 0.06, 0.2]))]
    pieces = [
        sphere(f"{name}@{k}", at + np.array([0, y, 0]), np.full(3, 2e-4), count=16)
        for k, at in places
        for name, y in (("ball.A", 0.0), ("ball.B", 0.06))
    ]
    pairs = [(f"ball.A@{k}", f"ball.B@{k}") for k, _ in places]
    papers = tuple(Certificate("distance", pair, 0.06, 4e-5) for pair in pairs)
    told = of_pieces(cube(seed=3, count=40), pieces, papers, planes=False).dataset
    other = tuple(replace(c, distance=0.06 + k * 1e-6) for k, c in enumerate(papers))  # of two artefacts
    each = [" ".join(pair) for pair in pairs]
    turned = [Certificate("parallel", pair, 0.06, 4e-5, 1e-5) for pair in pairs]  # by directions in F0
    assert measured_again(turned, {name for pair in pairs for name in pair}) == [(0,), (1,)]
    for certificates, numbers, names in ((papers, [(0, 1)], ["ball.A ball.B"]), (other, [(0,), (1,)], each)):
        fitted = calibrated(Scene(replace(told, certificates=certificates)), (*FULL, "artefact"))
        assert [(c.numbers, c.rows) for c in fitted.model.constraints] == [(n, len(n)) for n in numbers]
        of_artefact = [n for n in fitted.model.names if n.startswith("artefact")]
        assert of_artefact == [f"artefact {name} distance" for name in names]
        inputs = [one.input.name for one in _certificates(fitted)]
        assert inputs == [f"certificate: distance {name.replace(' ', ' - ')}" for name in names]


def test_certificates_between_kinds(cube, tmp_path):
    """A ball off a face and a seat off a pin, with no other paper, say how long the arm is, and truly."""
    base = cube(seed=9)
    seat = cone("cone", [0.42, 0.05, 0.30], [1e-3, 1e-3, 0], count=12)
    rod = pin("pin", [0.5, -0.05, 0.30], [0.0, 0.0, 1.0], [1e-3, -1e-3, 0], count=24)
    normal, offset = base.planes["cube.+y"]
    height = float(normal @ BALLS[0].true.centre - offset)
    reach = float(np.linalg.norm((seat.true.centre - rod.true.point)[:2]))
    papers = (
        Certificate("distance", ("ball.A", "cube.+y"), round(abs(height), 9), 1e-6),
        Certificate("distance", ("cone", "pin"), round(reach, 9), 1e-6),
    )
    session = of_pieces(base, (BALLS[0], seat, rod), papers, seed=4)
    told = replace(session.dataset, certificates=papers)
    write_dataset(told, tmp_path / "kinds")
    assert read_dataset(tmp_path / "kinds").certificates == papers
    found = calibrated(Scene(told), FULL)
    assert found.model.knows_length
    assert len(found.model.constraints) == 2
    check_truth(session, found)
    bare = calibrated(Scene(replace(told, certificates=())), FULL)
    for constraint in found.model.constraints:
        both = ((found.model, found.z), (bare.model, bare.z))
        states = ([m.block_of[n].state(z[m.slices[n]]) for n in constraint.targets] for m, z in both)
        left, free = (constraint.linearise(np.zeros(0), *own)[0] for own in states)
        assert abs(left[0]) < 3
        assert abs(free[0]) > 2 * abs(left[0])


def test_orientations_are_told_from_points(posed, fitted):
    """Their noise is a group of its own, found from an assumed one; they sharpen what points leave open."""
    with_turns, without = fitted, calibrated(Scene(posed.dataset), FULL)
    scale = with_turns.weights.scale
    assert scale["orientation"] * USUAL == pytest.approx(TURN, rel=0.12)
    assert without.weights.scale.keys() == {"point"}
    index = [k for k, p in enumerate(with_turns.model.parameters) if p.effect in FULL]
    known = dict(zip(without.model.names, without.sd, strict=True))
    ratio = np.array([with_turns.sd[k] / known[with_turns.model.names[k]] for k in index])
    assert ratio.max() < 1.05
    assert ratio.min() < 0.8


def test_how_a_probe_stands_is_found(posed, fitted):
    """Its orientation on the flange, three parameters a tool, lies where the posterior says."""
    scene, found, model = Scene(posed.dataset, oriented=True), fitted, fitted.model
    tools = {p.name.split()[0] for p in model.parameters if p.name.endswith((" rx", " ry", " rz"))}
    assert tools == {"north", "east"}
    values, sd = model.physical(found.z), found.sd
    for name in tools:
        tools = [t.name for t in scene.dataset.tools]
        row = scene.dataset.measurements.tool.tolist().index(tools.index(name))
        at = [model.names.index(f"{name} {axis}") for axis in ("rx", "ry", "rz")]
        true = rotation_vector(scene.tool_frames[row].T @ posed.tools[name][1])
        spread = sd[at] * LOOSE_ANGLE
        assert np.all(np.abs(values[at] - true) < 4.5 * spread), (values[at], true)
        assert spread.max() < 3e-3


def test_a_stated_orientation(posed):
    """A tool that says how it stands is believed as far as its u_rad, and noise as stated."""
    tools = tuple(
        replace(t, rpy=None if t.name == "ball" else rpy_of(posed.tools[t.name][1]), u_angle=1e-3)
        for t in posed.dataset.tools
    )
    dataset = replace(posed.dataset, tools=tools, noise=replace(posed.dataset.noise, orientation=TURN))
    found = calibrated(Scene(dataset, oriented=True), FULL)
    check_truth(posed, found)
    assert found.weights.scale["orientation"] == pytest.approx(1.0, abs=0.12)
    assert {p.sd for p in found.model.parameters if p.name.endswith((" rx", " ry", " rz"))} == {1e-3}


def test_one_wrong_orientation_is_an_outlier(posed):
    """A row turned the wrong way leaves the fit, and moves nothing."""
    rows = posed.dataset.measurements
    first = int(np.flatnonzero(~np.isnan(rows.rpy[:, 0]) & (rows.role == "calibrate"))[0])
    turned = rows.rpy.copy()
    turned[first, 2] += 0.05
    found = calibrated(Scene(with_columns(posed.dataset, rpy=turned), oriented=True), FULL)
    assert list(found.rejected) == [first]
    check_truth(posed, found)


def test_latent_readings_and_draws_of_poses(posed):
    """A pose has one error of its readings, whatever is read of it; draws spread as the linear covariance."""
    dataset = replace(posed.dataset, noise=replace(posed.dataset.noise, joint=5e-6))
    found = calibrated(Scene(dataset, oriented=True), FULL)
    latent = with_latent_readings(found)
    assert np.max(np.abs(latent.z - found.z) / found.sd) < 0.2
    np.testing.assert_allclose(latent.sd, found.sd, rtol=0.03)
    np.testing.assert_allclose(gaussian(found, 0, 4000).flat.std(axis=0), found.sd, rtol=0.1)
    density = Density(found)
    contacts, rest = density.misfit(found.z[None])
    assert contacts[0] @ density.kappa**-2.0 == pytest.approx(np.sum(found.linear.residual**2), rel=1e-9)
    assert rest[0] == pytest.approx(found.z @ found.z)


def test_gap_takes_every_kind(every):
    """No false name on an arm that errs by nothing but geometry and compliance."""
    found = diagnose(plain(every.dataset))
    assert found.verdict.kind == "null", found.verdict
    assert found.magnitude.validation_rms < 25e-6
    assert any("orientation" in warning for warning in warnings(found))


def test_what_only_turns_the_tool_is_named_by_orientations(cube, monkeypatch):
    """An eccentric joint 6 moves reflectors near its axis by far less than their noise."""
    near = {"north": [0.0, 0.0, 0.10], "east": [0.0, 0.0, 0.12], "south": [0.0, 0.0, 0.08]}
    monkeypatch.setattr(kind_sessions, "REFLECTORS", near)
    pieces = (replace(NORTH, tools=(1, 2), poses=True, count=40, held=10),)
    dataset = of_pieces(cube(seed=5), pieces, planes=False).dataset
    m = dataset.measurements
    readings = m.readings.copy()
    readings[:, 5] -= 1e-3 * np.sin(readings[:, 5] + 0.7)
    found = diagnose(with_columns(plain(dataset), readings=readings))
    assert found.verdict.kind == "named"
    assert [(n.effect, n.site) for n in found.verdict.named] == [("eccentricity", "joint 6")]
    # what is told in metres is of the points, and these hardly tell
    assert max(p.rms for p in found.where) < 5e-6
    assert found.magnitude.validation_rms < 2 * POINT
    assert all(t.rms < 2 * POINT for margin in found.margins.values() for t in margin)
    assert {len(r) for r in found.residuals} == {3 * int(np.sum(m.role == "calibrate"))}


def test_poses_come_back_from_disk(posed, tmp_path):
    """What a row reads of an orientation is what it was written as."""
    write_dataset(posed.dataset, tmp_path / "poses")
    again = read_dataset(tmp_path / "poses")
    np.testing.assert_allclose(again.measurements.rpy, posed.dataset.measurements.rpy, atol=2e-9)


@pytest.mark.parametrize("factor", [np.pi / 180, 180 / np.pi])
def test_orientations_in_radians_are_refused(posed, tmp_path, factor):
    """Turns from row to row are as large as the arm's, whatever the frames."""
    wrong = with_columns(posed.dataset, rpy=posed.dataset.measurements.rpy * factor)
    write_dataset(wrong, tmp_path / "poses")
    refused("orientation", lambda: read_dataset(tmp_path / "poses"))


def test_tools_whose_orientation_matters_are_those_whose_orientation_is_read(posed):
    m, fitted = posed.dataset.measurements, Scene(posed.dataset).rows("calibrate")
    read = {int(m.tool[k]) for k in fitted if np.isfinite(m.rpy[k]).all()}
    assert {1, 2} == read < set(m.tool[fitted].tolist())
    assert set(Scene(posed.dataset, oriented=True).circumstances().turned_tools) == read
    assert not Scene(posed.dataset).circumstances().turned_tools  # orientations are told from points
