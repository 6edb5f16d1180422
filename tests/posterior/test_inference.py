"""The ArviZ record: what is written is read by ArviZ, with its groups, units and labels, and is of use."""

import numpy as np
import pytest
from arviz_line import az

import bayescal.calibration as calibration
import bayescal.reporting.fit.posterior as fit_posterior
from bayescal.calibration import fit
from bayescal.model.options import FitOptions
from bayescal.posterior.inference import Record, arviz, inference_data, load, save
from bayescal.reporting.fit.posterior import fit_draws
from bayescal.simulation import Options, simulate


def test_record_comes_back(tmp_path):
    """The file, written without ArviZ, holds what ArviZ is given in memory."""
    rng = np.random.default_rng(0)
    groups = {
        "posterior": {
            "a2": ((), rng.normal(size=(4, 10))),
            "z": (("parameter",), rng.normal(size=(4, 10, 3))),
        },
        "observed_data": {
            "distance_mm": (("pair",), np.array([1.0, 2.0])),
            "target": (("pair",), np.array(["µ", "ball"])),
        },
    }
    coords = {"parameter": ["a2", "d4", "theta5"], "pair": ["x", "y"]}
    labels = {"joint": ("parameter", ["J2", "J4", ""])}
    record = Record(groups, coords, {"a2": "mm"}, {"seed": "1"}, labels)
    save(record, tmp_path / "p.nc")
    for back in (load(tmp_path / "p.nc"), inference_data(record)):
        posterior, observed = back["posterior"], back["observed_data"]
        np.testing.assert_array_equal(np.asarray(posterior["a2"]), groups["posterior"]["a2"][1])
        assert posterior["a2"].attrs["units"] == "mm"
        assert posterior["a2"].dims == ("chain", "draw")
        assert list(posterior["z"].coords["parameter"].values) == coords["parameter"]
        assert list(posterior["z"].coords["joint"].values) == labels["joint"][1]
        assert list(observed["distance_mm"].coords["pair"].values) == ["x", "y"]
        assert list(observed["target"].values) == ["µ", "ball"]
        assert back.attrs["seed"] == "1"


@pytest.fixture(scope="module")
def records(cube, tmp_path_factory):
    """Two models of one session, as ArviZ reads them from their files."""
    dataset, out = cube(seed=4, count=120).dataset, {}
    for model in (("geometry",), ("geometry", "compliance")):
        path = tmp_path_factory.mktemp("nc") / "posterior.nc"
        save(fit_draws(fit(dataset, model, FitOptions(robust=False), samples=200)), path)
        out[model[-1]] = load(path)
    return out


def test_models_are_compared(records):
    """Leaving each contact out in turn, stiffness predicts it far better."""
    loo = az.loo(records["compliance"])
    parameters = np.asarray(records["compliance"]["posterior"]["z"]).shape[-1]
    assert 0.5 * 20 < float(getattr(loo, "p_loo", getattr(loo, "p", None))) < parameters + 1
    table = az.compare(records)
    assert list(table.index) == ["compliance", "geometry"]


def test_log_likelihood_is_the_normals(records):
    """Of the noise that was drawn: its mean over the rows follows from the residuals' own."""
    data = records["compliance"]
    log_likelihood = np.asarray(data["log_likelihood"]["residual_um"])
    assert log_likelihood.shape[2] == 120
    sigma = 5.0 * np.asarray(data["posterior"]["noise_scale"])
    # a fit to n rows by p parameters leaves about n - p of its chi-squared, a draw about n
    expected = -0.5 * np.log(2 * np.pi) - np.log(sigma) - 0.5
    assert log_likelihood.mean() == pytest.approx(expected.mean(), abs=0.1)


def test_replicated_data_scatter_as_the_data(records):
    """Residuals at the estimate of data that the posterior draws anew: as large as the data's, or larger."""
    data = records["compliance"]
    observed = np.asarray(data["observed_data"]["residual_um"]).std()
    replicated = np.asarray(data["posterior_predictive"]["residual_um"]).std()
    assert observed < replicated < 1.5 * observed


def test_prior_is_as_wide_as_stated(records):
    data = records["compliance"]
    a2 = np.asarray(data["prior"]["a2"])
    assert a2.mean() == pytest.approx(300.0, abs=0.03)
    assert a2.std() == pytest.approx(0.3, rel=0.06)
    assert np.asarray(data["prior"]["noise_scale"]).mean() == pytest.approx(1.108, abs=0.04)


def test_a_picture_of_what_was_predicted(records):
    """Every observed variable has its predictions."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg", force=True)
    assert set(records["compliance"]["observed_data"].data_vars) <= set(
        records["compliance"]["posterior_predictive"].data_vars
    )
    if hasattr(az, "plot_ppc"):
        az.plot_ppc(records["compliance"], num_pp_samples=20)
    else:
        az.plot_ppc_dist(records["compliance"], num_samples=20, backend="matplotlib")
    matplotlib.pyplot.close("all")


def test_many_validation_rows_have_fewer_draws(monkeypatch):
    dataset = simulate(Options(contacts=80, later=16, repeats=5, placements=1, seed=1)).dataset
    assert calibration.predicted_draws(dataset) == calibration.VALIDATION_DRAWS
    rows = int(np.sum(dataset.measurements.role == "validate"))
    monkeypatch.setattr(calibration, "MOST_PREDICTED", 800 * rows)
    found = calibration.fit(dataset, ("geometry",), FitOptions(robust=False), samples=0)
    assert {len(p.predicted) for level in found.levels for p in level.validation.planes} == {800}
    record = fit_draws(found)
    shapes = {values.shape[:2] for _, values in record.arrays("posterior_predictive").values()}
    assert shapes == {(4, 200)}


def test_a_large_session_keeps_fewer_predictions(cube, monkeypatch, tmp_path):
    """All predictions have the same draws, however few of single rows are kept."""
    monkeypatch.setattr(fit_posterior, "MOST_OF_LARGE", 4 * 60 * 100)
    found = fit(cube(seed=4, count=100).dataset, ("geometry",), FitOptions(robust=False), samples=0)
    record = fit_draws(found)
    shapes = {values.shape[:2] for _, values in record.arrays("posterior_predictive").values()}
    assert shapes == {(4, 60)}
    save(record, tmp_path / "p.nc")
    assert np.asarray(load(tmp_path / "p.nc")["log_likelihood"]["residual_um"]).shape == (4, 60, 100)


def test_arviz_is_imported_while_another_process_writes_its_date(monkeypatch):
    answers = iter([FileNotFoundError("daily_warning.tmp"), az])

    def once_in_vain(name):
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr("bayescal.posterior.inference.import_module", once_in_vain)
    assert arviz() is az
