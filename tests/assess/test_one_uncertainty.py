"""One measurand has one U: what a fit prints, stores, certifies and decides with is one number.

U is computed here again from the contributions of a budget, by Student's t of SciPy.
"""

import json
import re
import tracemalloc
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from markupsafe import escape
from rich.console import Console
from scipy.stats import f as f_distribution
from scipy.stats import ncf
from scipy.stats import t as student
from sessions import with_columns

from bayescal.assess.acceptance import Check
from bayescal.assess.budget import budget, headline
from bayescal.assess.conformance import FAIL, OPEN, PASS, _differs, conformance, iso9283
from bayescal.assess.findings import reliability
from bayescal.assess.identifiability import directions
from bayescal.assess.inputs import UNEXPLAINED, Basis
from bayescal.assess.measurand import certified_distances, distance, distances, volume
from bayescal.calibration import fit
from bayescal.estimate import calibrated
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.outliers import POWER, detectable, rejected
from bayescal.model import ARM, FitOptions, Scene
from bayescal.predict.errors import centre_distances, lengths, slopes
from bayescal.predict.forecast import workspace
from bayescal.public.budgets import _as_written
from bayescal.reporting.fit.record import fit_record, write_fit
from bayescal.reporting.fit.summary import fit_summary
from bayescal.reporting.text import um2
from bayescal.simulation import Options, simulate

COVERAGE = 0.9545
FEW = Options(contacts=30, later=4, repeats=0, spheres=3, placements=2, seed=3)
"""Few contacts of an arm with compliance, fitted without it: few degrees of freedom, k differs from 2."""


@pytest.fixture(scope="module")
def fitted():
    return fit(simulate(FEW).dataset, ("geometry",), FitOptions(seed=1, tolerance=1e-3), samples=0)


@pytest.fixture(scope="module")
def run(fitted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("one") / "run"
    write_fit(fitted, folder, fit_record(fitted), pictures=False)
    return folder


def expanded(fitted, pair):
    """U of the error of a distance, m: contributions, Welch and Satterthwaite, Student's t."""
    parts = budget(fitted.basis, distance(fitted.basis, pair)).components
    u2 = sum(c.contribution**2 for c in parts)
    same = {}
    for c in parts:
        key = (c.input.scale or c.input.name, c.input.dof)
        same[key] = same.get(key, 0.0) + c.contribution**2
    dof = u2**2 / sum(v**2 / of for (_, of), v in same.items())
    return float(student.ppf(0.5 + COVERAGE / 2, dof) * np.sqrt(u2)), dof


def test_decisions_change_at_the_error_plus_and_minus_u_and_nowhere_else(fitted):
    v = fitted.final.validation
    assert len(v.distances) >= 5
    apart = []
    for k, d in enumerate(v.distances):
        u, dof = expanded(fitted, d.between)
        apart.append(student.ppf(0.5 + COVERAGE / 2, dof) / 2.0)

        def at(x, k=k):
            return conformance(x, fitted.forecast, v, fitted.acceptance, fitted.budgets).distances[k].decision

        e = abs(d.error)
        for share in (1e-6, 0.1):
            assert at(e + u * (1 + share)) == PASS
            assert at(e + u * (1 - share)) == OPEN
            if e > u * (1 + share):
                assert at(e - u * (1 + share)) == FAIL
                assert at(e - u * (1 - share)) == OPEN
            elif e < u:
                assert at(1e-3 * share * u) == OPEN
    assert max(apart) > 1.2  # k = 2 would be seen


def test_the_volume_has_its_own_u_and_without_a_certified_distance_nothing_conforms(fitted):
    v, space = replace(fitted.final.validation, distances=()), fitted.forecast.workspace
    u = budget(fitted.basis, volume(fitted.basis)).expanded
    assert space.expanded == pytest.approx(u)
    assert space.k > 2.5
    sound = replace(fitted.acceptance, checks=(), doubts=())

    def at(x, tests=sound, validation=v):
        return conformance(x, fitted.forecast, validation, tests, fitted.budgets)

    for share in (1e-6, 0.1, 0.5):
        assert "no certified distance was measured" in at(u * (1 + share)).why
        assert "is larger than the tolerance" in at(u * (1 - share)).why
        assert {at(u * (1 + sign * share)).decision for sign in (-1, 1)} == {OPEN}
    measured = fitted.final.validation
    wide = 10.0 * max(u, *(abs(d.error) for d in measured.distances))
    assert at(wide, validation=measured).decision == PASS
    doubted = replace(sound, doubts=(Check("doubt", 2.0, 1.0, 1e-9, 1e-3, ""),))
    assert at(wide, doubted, measured).decision == OPEN


def test_an_error_of_each_point_is_in_a_distance_twice(fitted):
    """In the variance of a budget, as in the draws of a forecast (tests/predict)."""
    excess = 80e-6
    plain, wide = (budget(b, volume(b)) for b in (replace(fitted.basis, excess=e) for e in (0.0, excess)))
    np.testing.assert_allclose(wide.u**2 - plain.u**2, 2.0 * excess**2, rtol=1e-6)


def test_a_run_folder_states_the_unexplained_error_of_its_fit(fitted, run):
    """Read back with its degrees of freedom, in metres; the fit states it as a finding."""
    assert fitted.basis.excess > 0.0
    assert "unexplained" in {f.code for f in fitted.findings}
    again = _as_written(replace(fitted.basis, excess=0.0, excess_dof=1.0), run)
    assert again.excess == pytest.approx(fitted.basis.excess)
    assert again.excess_dof == pytest.approx(fitted.basis.excess_dof)


def test_what_is_printed_stored_and_decided_with_is_one_number(fitted, run):
    record = json.loads((run / "fit.json").read_text())
    budgets = json.loads((run / "budget.json").read_text())
    page = (run / "report.html").read_text()
    shown = StringIO()
    Console(file=shown, width=200).print(fit_summary(fitted, fit_record(fitted), verbose=True))
    text = shown.getvalue()

    lead = record["predicted_distance"]
    first = budget(fitted.basis, headline(fitted.basis))
    by_name = {b["measurand"]: b for b in budgets["budgets"]}
    assert len(by_name) == len(budgets["budgets"]) >= 5
    for b in by_name.values():  # independent components: shares of the variance, which is their sum
        shares = np.array([[c["share"], (c["contribution"] / b["u"]) ** 2] for c in b["components"]])
        assert shares[:, 0] == pytest.approx(shares[:, 1])
        assert np.sum(shares[:, 0]) == pytest.approx(1.0)
    assert lead["expanded_U_um"] == pytest.approx(budgets["U_um"]) == pytest.approx(1e6 * first.expanded)
    for told in lead["all"]:
        (of,) = [b for n, b in by_name.items() if f"({told['count']} distances)" in n]
        assert told["expanded_U_um"] == pytest.approx(of["U_um"])
        assert told["k"] == pytest.approx(of["k"])
        assert told["coverage"] == of["coverage"] == COVERAGE
        assert told["predicted_rms_um"] == pytest.approx(of["u_um"])
        assert told["expanded_U_um"] == pytest.approx(told["k"] * told["predicted_rms_um"])
        words = f"U = {um2(1e-6 * told['expanded_U_um'])} µm"
        assert f"{words}, k = {told['k']:.2f}" in text
        assert words in page or um2(1e-6 * told["expanded_U_um"]) in page
        assert of["text"] == f"{words}, k = {told['k']:.2f}"
    assert f"U = {um2(1e-6 * lead['expanded_U_um'])} µm (k = {lead['k']:.2f})" in page

    decided = record["acceptance"]
    assert decided["volume"]["U_um"] == pytest.approx(lead["all"][-1]["expanded_U_um"])
    assert decided["k"] == pytest.approx(lead["all"][-1]["k"])
    assert decided["coverage"] == COVERAGE
    assert len(decided["distances"]) == len(record["validation"]["distances"]) >= 5
    for own, checked in zip(decided["distances"], record["validation"]["distances"], strict=True):
        u, _ = expanded(fitted, tuple(own["between"]))
        assert own["U_um"] == pytest.approx(1e6 * u, rel=1e-5)
        assert own["U_um"] == pytest.approx(own["k"] * checked["predicted_sd_um"])
    for b in budgets["budgets"]:
        pair = next((d for d in decided["distances"] if " - ".join(d["between"]) in b["measurand"]), None)
        if pair is not None:
            assert b["U_um"] == pytest.approx(pair["U_um"])
            assert b["k"] == pytest.approx(pair["k"])


def test_a_parameter_is_as_identifiable_as_its_stated_u_says(fitted, run):
    """The fit has discrepancy: u is larger than that of the rows alone, as is what remains of the prior."""
    record = json.loads((run / "fit.json").read_text(encoding="utf-8"))
    names = [p.name for p in fitted.stated.plain.model.parameters]
    share = dict(zip(names, np.diag(fitted.stated.limited), strict=False))
    plain = np.diag(fitted.stated.plain.covariance)
    found = record["identifiability"]
    for name, left in share.items():
        word = "determined" if left <= 0.1 else "prior_only" if left > 0.9 else "partly"
        assert name in found[word], (name, left)
    assert {n for n, left in zip(share, plain, strict=False) if left <= 0.1} > set(found["determined"])


def test_u_covers_what_it_states(fitted):
    """Of any one of the distances of the volume: errors drawn by their own scatter and a common variance."""
    b = budget(fitted.basis, volume(fitted.basis))
    rng = np.random.default_rng(5)
    scale = np.sqrt(b.dof / rng.chisquare(b.dof, 4000))[:, None] if np.isfinite(b.dof) else 1.0
    drawn = scale * b.spread * rng.standard_normal((4000, len(b.spread)))
    assert np.mean(np.abs(drawn) <= b.expanded) == pytest.approx(COVERAGE, abs=0.004)


def test_a_page_lists_a_finding_once_and_does_not_contradict_its_u(fitted, run):
    text = re.sub(r"<[^>]+>", " ", (run / "report.html").read_text().partition("<nav")[0])
    failed = fitted.acceptance.failed
    assert failed
    told = {c.test for c in failed}
    others = [f.text for f in fitted.findings if f.code not in told]
    assert others
    for words in [*(c.words for c in failed), *others]:
        assert text.count(str(escape(words)).replace("`", "")) == 1, words
    assert "too small" not in text


# --- Gross errors that a fit does not detect: the bound by simulation, its consequence by fits.

FULL = ("geometry", "compliance")


def test_the_noncentrality_of_a_known_noise_is_that_of_baarda():
    """4.13 for a probability of 0.001 of a false rejection and 0.8 of a detection."""
    assert np.sqrt(detectable(1, 1e7, 10)) == pytest.approx(4.13, abs=0.005)


@pytest.mark.parametrize(("rows", "count"), [(1, 3), (3, 2), (3, 15)])
def test_the_noncentrality_is_by_the_noise_of_the_other_measurements(rows, count):
    """By the F distribution of SciPy; the stated noise counts as eight degrees of freedom."""
    rest = rows * count - rows + 8
    limit = f_distribution.isf(0.01 / count, rows, rest)
    found = detectable(rows, float(rows * count), count)
    assert ncf.sf(limit, rows, rest, found) == pytest.approx(POWER, abs=1e-4)


@pytest.mark.parametrize(("rows", "count"), [(1, 30), (3, 15)])
def test_the_rule_for_outliers_detects_such_an_error_with_the_stated_probability(rows, count):
    """Normal residuals that a fit has left alone, and one error of the noncentrality."""
    rng, dof, trials = np.random.default_rng(0), float(rows * count), 4000
    residuals = rng.standard_normal((trials, count, rows))
    residuals[:, 0, 0] += np.sqrt(detectable(rows, dof, count))
    found = 0
    for own in residuals:
        chi2 = np.sum(own**2, axis=1)
        scale = np.sqrt(np.sum(chi2) / dof)
        found += rejected(chi2, rows, scale, dof, True, 8.0)[0]
    assert found / trials == pytest.approx(POWER, abs=0.04)


def test_no_error_of_a_point_in_any_direction_does_more(tracker):
    """Errors of the stated noncentrality in many directions, through the linear fit itself."""
    # a fit to points of an instrument, with its reliability
    found = calibrated(Scene(tracker(seed=2, count=30).dataset), FULL)
    points = found, reliability(found)
    found, own = points
    block = found.model.blocks[0]
    space = workspace(found)
    by = slopes(found.model, space.motion, space.values, space.pairs)
    jacobian = found.linear.jacobian[found.linear.of_block[block.name]].reshape(3, len(block.rows), -1)
    size = detectable(3, found.dof[block.group], len(block.rows))
    rng, sigma = np.random.default_rng(0), 1.0 / found.weights.whitening(block).reshape(3, -1)
    directions = rng.standard_normal((20_000, 3))
    for c in (0, 7, 29):
        j = jacobian[:, c]
        kept = np.einsum("ei,ij,ej->e", directions, np.eye(3) - j @ found.covariance @ j.T, directions)
        errors = directions * np.sqrt(size / kept)[:, None]
        moved = (errors @ j @ found.covariance)[:, found.model.slices[ARM]] @ by.T
        shifts = np.sqrt(np.mean(moved**2, axis=1))
        most = int(np.argmax(shifts))
        assert shifts[most] == pytest.approx(own.shift[c], rel=1e-3)
        assert shifts[most] <= own.shift[c] * (1 + 1e-9)
        assert np.linalg.norm(errors[most] * sigma[:, c]) == pytest.approx(own.error[c], rel=0.02)


def with_error(found, row, error):
    """The session of a fit with a residual of one row off by an error, m: its readings moved."""
    model = found.model
    block = next(b for b in model.blocks if row in b.rows)
    state = found.z[model.slices[block.target]]
    by = block.by_readings(found.arm, state, model.scene.dataset.robot.link_from_reading)
    slope = by[np.flatnonzero(block.rows == row)[0]]
    session = model.scene.dataset
    readings = session.measurements.readings.copy()
    readings[row] += error * slope / (slope @ slope)
    return with_columns(session, readings=readings)


def test_an_error_below_the_bound_stays_in_the_fit_and_moves_distances_as_stated(cube):
    """Of the contact with the largest effect: half the bound is kept, twice the bound is rejected."""
    found = calibrated(Scene(cube(seed=6, count=60).dataset), FULL)
    own, space = reliability(found), workspace(found)
    k = int(np.argmax(own.shift))

    def distances(other):
        return lengths(space.motion.points(other.arm), space.pairs)

    again = calibrated(Scene(with_error(found, own.rows[k], 0.5 * own.error[k])), FULL)
    assert not np.isin(own.rows[k], again.rejected)
    moved = np.sqrt(np.mean((distances(again) - distances(found)) ** 2))
    assert moved == pytest.approx(0.5 * own.shift[k], rel=0.1)
    again = calibrated(Scene(with_error(found, own.rows[k], 2.0 * own.error[k])), FULL)
    assert np.isin(own.rows[k], again.rejected)


def test_a_rejected_row_is_not_judged(cube):
    found = calibrated(Scene(cube(seed=3, count=120, outliers=4).dataset), FULL)
    assert len(found.rejected)
    assert not np.isin(found.rejected, reliability(found).rows).any()


@pytest.mark.parametrize(("count", "told"), [(30, True), (120, False)])
def test_few_contacts_have_the_finding_many_have_not(cube, count, told):
    found = fit(cube(seed=6, count=count).dataset, FULL, samples=0)
    words = [f.text for f in found.findings if f.code == "gross_error_unseen"]
    assert bool(words) == told
    if told:
        assert f"in one of {count} measurements" in words[0]
        assert f"U = {float(f'{1e6 * found.forecast.workspace.expanded:.2g}'):.9g} µm" in words[0]


# --- Figures of ISO 9283 against their formulas, on readings made for it.


@pytest.fixture(scope="module")
def cycled(tracker):
    """60 readings to fit, then 5 poses that an instrument reads four times each."""
    dataset = tracker(1, 80).dataset
    m = dataset.measurements
    readings, xyz = m.readings.copy(), m.xyz.copy()
    role, first = np.where(np.arange(80) < 60, "calibrate", "validate"), 60 + 4 * ((np.arange(80) - 60) // 4)
    first[:60] = np.arange(60)
    rng = np.random.default_rng(3)
    readings, xyz = readings[first], xyz[first] + 2e-5 * rng.standard_normal(xyz.shape)
    return with_columns(dataset, readings=readings, xyz=xyz, role=role)


def test_poses_by_hand(cycled):
    found = calibrated(Scene(cycled, oriented=True), ("geometry", "compliance"), FitOptions(robust=False))
    basis = Basis(stated(found))
    (row,) = basis.prepared.rows
    error = row.in_rows.T.reshape(5, 4, 3)
    middle = error.mean(axis=1)
    apart = np.linalg.norm(error - middle[:, None], axis=2)
    rp = apart.mean(axis=1) + 3.0 * apart.std(axis=1, ddof=1)
    figures = {f.symbol: f for f in iso9283(basis).figures}
    assert figures["AP"].count == figures["RP"].count == 5
    assert figures["AP"].mean == pytest.approx(np.mean(np.linalg.norm(middle, axis=1)))
    assert figures["AP"].maximum == pytest.approx(np.max(np.linalg.norm(middle, axis=1)))
    assert figures["RP"].mean == pytest.approx(rp.mean())
    assert figures["RP"].maximum == pytest.approx(rp.max())
    # four readings of one coordinate, and the location of the instrument by sixty
    alone = row.noise.mean() / 2.0
    assert alone < figures["AP"].u_max < 1.5 * alone
    assert alone / np.sqrt(5) < figures["AP"].u < alone
    assert any("5 poses with 4 cycles each" in text for text in iso9283(basis).differs)


def test_the_load_of_a_test_is_that_of_its_own_poses(cycled):
    """Those that were fitted carried 2 kg, those that are judged at most 0.5 kg."""
    payload = np.where(cycled.measurements.role == "calibrate", 2.0, 0.0)
    payload[-1] = 0.5
    scene = Scene(with_columns(cycled, payload=payload))
    basis = SimpleNamespace(stated=SimpleNamespace(wide=SimpleNamespace(model=SimpleNamespace(scene=scene))))
    assert any("up to 0.5 kg additional payload" in text for text in _differs(basis, []))


def spread_of(basis, kind_rows, draws=4000, small=1e-4):
    """Standard deviations of the mean and of the largest error of the poses, over noise of all residuals.

    The noise of each residual, and that of the targets at a known arm, by many small draws.
    """
    rng, plain, wide = np.random.default_rng(5), basis.stated.plain, basis.stated.wide.model
    m, every = wide.scene.dataset.measurements, []
    for r in (r for r in basis.prepared.rows if r.block.kind.rows == kind_rows):
        off = small * r.noise * rng.standard_normal((draws, len(r.noise)))
        if r.target is None:
            j = plain.linear.jacobian[:, plain.model.slices[r.block.target]]
            covariance = np.linalg.inv(j.T @ j + np.eye(j.shape[1]))
            moved = rng.multivariate_normal(np.zeros(len(covariance)), covariance, draws, method="cholesky")
            off += small * moved @ r.by_z[:, wide.slices[r.block.target]].T
        else:
            by = r.by_target @ r.target.scatter
            off += small * rng.standard_normal((draws, by.shape[1])) @ by.T
        error = (r.residual + off).reshape(draws, kind_rows, -1)
        _, pose = np.unique(m.readings[r.block.rows], axis=0, return_inverse=True)
        every.append(np.stack([error[:, :, pose == k].mean(axis=2) for k in range(pose.max() + 1)], axis=1))
    size = np.linalg.norm(np.concatenate(every, axis=1), axis=2)  # (S, poses)
    largest = size[:, np.argmax(size.mean(axis=0))]
    return np.std(size.mean(axis=1)) / small, np.std(largest) / small


def test_u_of_mean_and_maximum_by_draws(cycled, simulated_fit, monkeypatch):
    """Of points, of contacts and of distances: each reading has its noise, and a target its location."""
    points = Basis(stated(calibrated(Scene(cycled, oriented=True), FULL, FitOptions(robust=False))))
    for basis, rows, symbol in ((points, 3, "AP"), (simulated_fit.basis, 1, "AP n")):
        (figure,) = (f for f in iso9283(basis).figures if f.symbol == symbol)
        assert (figure.u, figure.u_max) == pytest.approx(spread_of(basis, rows), rel=0.05)
    basis, rng = simulated_fit.basis, np.random.default_rng(2)
    m = distances(basis, certified_distances(basis), "")
    # some longer and some shorter, with errors in common as of a ball that ends two of them
    shared = (m.errors[0][0], 1e-6 * rng.standard_normal((len(m.values), 2)))
    values = tuple(abs(v) * (-1) ** k for k, v in enumerate(m.values))
    m = replace(m, values=values, errors=(*m.errors, shared))
    monkeypatch.setattr("bayescal.assess.conformance.distances", lambda *given: m)
    (figure,) = (f for f in iso9283(basis).figures if f.symbol == "AD")
    own = [by for source, by in m.errors if source.group != UNEXPLAINED]
    off = sum(1e-4 * rng.standard_normal((4000, by.shape[1])) @ by.T for by in own)
    error = np.abs(np.array(m.values) + off)
    assert figure.u == pytest.approx(1e4 * np.std(error.mean(axis=1)), rel=0.05)
    assert figure.u_max == pytest.approx(1e4 * np.std(error[:, np.argmax(error.mean(axis=0))]), rel=0.05)


@pytest.fixture(scope="module")
def simulated_fit():
    session = simulate(Options(contacts=90, later=6, repeats=4, spheres=3, placements=1, seed=7)).dataset
    return fit(session, ("geometry", "compliance"), samples=0)


@pytest.mark.parametrize("name", ["simulated_fit", "fitted"])  # one placement of three balls, and two
def test_distances_that_share_a_centre(name, request):
    """A ball moves a distance whose second end it is, and one whose first, in opposite senses."""
    scene = Scene(request.getfixturevalue(name).dataset, oriented=True)
    basis = Basis(stated(calibrated(scene, ("geometry", "compliance"))))
    wide = basis.stated.wide.model
    d = centre_distances(wide.scene, basis.prepared.located, np.zeros((len(wide.parameters),) * 2))
    m = distances(basis, certified_distances(basis), "")
    own = sum(by @ by.T for source, by in m.errors if source.group != UNEXPLAINED)
    expected = sum(by @ by.T for by in (d.by_noise, d.by_parameters, d.by_certificates))
    np.testing.assert_allclose(own, expected, rtol=1e-6, atol=1e-6 * np.max(expected))


def test_contacts_and_distances(simulated_fit):
    found = simulated_fit
    figures = {f.symbol: f for f in iso9283(found.basis).figures}
    error = [abs(d.error) for d in found.final.validation.distances]
    assert figures["AD"].mean == pytest.approx(np.mean(error))
    assert figures["AD"].maximum == pytest.approx(np.max(error))
    assert figures["AD"].count == 3
    largest = found.final.validation.distances[int(np.argmax(error))]
    # without the arm's parameters it is less than the prediction with them, and at least the certificate
    assert largest.u_certified < figures["AD"].u_max < np.std(largest.predicted)
    assert "AP" not in figures
    assert figures["AP n"].maximum <= max(np.abs(p.residuals).max() for p in found.final.validation.planes)
    assert figures["AP n"].words == "pose accuracy, component along the normal of the surface"
    assert any("normal" in text for text in iso9283(found.basis).differs)


def test_nothing_without_validation_rows(cycled):
    alone = with_columns(cycled, role=np.full(80, "calibrate"))
    found = calibrated(Scene(alone, oriented=True), ("geometry",), FitOptions(robust=False))
    assert iso9283(Basis(stated(found))) == iso9283(Basis(stated(found))).__class__((), ())


# --- Principal directions of the fitted data, as of their scatter matrix, in memory linear in the rows.


def model_of(normals: np.ndarray) -> SimpleNamespace:
    """A stand-in for a model whose rows look along given directions (N, 3)."""
    block = SimpleNamespace(target="face", rows=np.arange(len(normals)))

    def looks(target, rows):
        return normals.T[None][:, :, rows]

    scene = SimpleNamespace(index={"face": 0}, in_images=np.zeros(len(normals), bool), looks=looks)
    return SimpleNamespace(states=(block,), scene=scene)


@pytest.mark.parametrize("count", [1, 2, 3, 40])
def test_axes_of_the_scatter_matrix(count):
    normals = np.random.default_rng(count).normal(size=(count, 3)) * [3.0, 1.0, 0.2]
    found = directions(model_of(normals))
    values = np.linalg.eigvalsh(normals.T @ normals)[::-1]
    np.testing.assert_allclose(found.share, np.sqrt(np.maximum(values / values[0], 0.0)), atol=1e-7)
    np.testing.assert_allclose(found.axes @ found.axes.T, np.eye(3), atol=1e-12)
    along = np.linalg.norm(normals @ found.axes.T, axis=0)
    np.testing.assert_allclose(along, found.share * along[0], atol=1e-7 * along[0])


def test_memory_is_linear_in_the_rows():
    normals = np.random.default_rng(0).normal(size=(3000, 3))
    tracemalloc.start()
    directions(model_of(normals))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * normals.nbytes  # a square matrix of the rows would be 1000 times that
