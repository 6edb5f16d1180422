"""The study in small: true arms are found as surely as is said, and a false certainty would be seen."""

import json

import numpy as np
import pytest

from analysis.study import figures, page, pictures, run, session
from bayescal.simulation import Options

SEEDS = range(20, 24)


@pytest.fixture(scope="module")
def records() -> list[session.Record]:
    """Four sessions of 150 contacts."""
    small = {"contacts": 150, "later": 40, "repeats": 5, "placements": 2}
    return [session.run(Options(seed=seed, **small)) for seed in SEEDS]


@pytest.fixture(scope="module")
def found(records):
    return figures.of(records)


def sure_of_itself(records: list[session.Record], factor: float) -> list[session.Record]:
    """The same sessions, had the fit stated standard deviations of `factor` times what it did."""
    from scipy.stats import norm

    def narrowed(places):
        # a predictive distribution that is as good as normal, narrowed about its middle
        return norm.cdf(norm.ppf(np.clip(places, 1e-6, 1 - 1e-6)) / factor).tolist()

    out = []
    for r in records:
        wrong = {key: narrowed(r[key]) for key in figures.COVERED.values()}
        z = {key: (np.array(r[key]) / factor).tolist() for key in ("z", "independent_z")}
        out.append(r | wrong | z)
    return out


def within_bands(found) -> bool:
    """The bands of this test: 4 sessions of 26 parameters and 6 distances."""
    z, held = found["z_scores"], {name: c["inside"] for name, c in found["coverage"].items()}
    return (
        abs(z["mean"]) < 0.25
        and 0.8 < z["sd"] < 1.2
        and z["independent"]["ks_p_value"] > 1e-3
        and held["sphere distances"] > 0.85
        and all(value > 0.88 for name, value in held.items() if name != "sphere distances")
    )


def test_the_truth_is_found(records, found):
    assert within_bands(found), found["z_scores"] | found["coverage"]
    assert found["z_scores"]["independent"]["sd"] == pytest.approx(1.0, abs=4 / np.sqrt(2 * 26 * len(SEEDS)))
    assert all(r["least_compliance_urad_per_nm"] > 0 for r in records)
    scales = [r["noise_scale"] for r in records]
    assert np.mean(scales) == pytest.approx(1.0, abs=4 * 0.07 / np.sqrt(len(SEEDS)))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_false_certainty_is_seen(records, factor):
    """Standard deviations of half or twice what they should be fall out of the bands."""
    wrong = figures.of(sure_of_itself(records, factor))
    assert not within_bands(wrong)
    assert not 0.8 < wrong["z_scores"]["sd"] < 1.2
    if factor < 1:
        assert min(c["inside"] for c in wrong["coverage"].values()) < 0.85
        assert wrong["z_scores"]["independent"]["ks_p_value"] < 1e-3


def test_every_quantity_is_identified(found):
    """Compliance and geometry are identifiable together; of d2 and d3 only the sum."""
    told = found["identified"]
    assert {f"compliance J{j}" for j in range(2, 7)} < set(told)
    assert "d2 + d3" in told
    assert "d2" not in told
    assert len(told) == 26
    assert min(told.values()) > 0.9


def test_compliance_reduces_the_error(found):
    median = {level: s["median"] for level, s in found["maximum_distance_mm"].items()}
    assert median["geometry + compliance"] < 0.2 * median["geometry"] < 0.2 * median["nominal"]
    assert found["maximum_distance_mm"]["geometry + compliance"]["most"] < 0.05


def test_quantities_sum_what_goes_together():
    told = session.Quantities.of(("a1", "d2", "a2", "d3"))
    assert told.names == ("a1", "d2 + d3", "a2")
    np.testing.assert_array_equal(told.matrix @ [1.0, 2.0, 3.0, 4.0], [1.0, 6.0, 3.0])


def test_emcee_agrees(records):
    task = Options(seed=SEEDS[0], contacts=100, later=10, repeats=0, placements=1, sphere_contacts=8)
    said = session.run(task, with_emcee=True)["emcee"]
    assert said["converged"]
    assert said["largest_shift_over_sd"] < 0.1
    assert 0.9 < said["sd_ratio"][0] < said["sd_ratio"][1] < 1.1


def test_bands():
    """A coverage band knows that the trials of a session hang together."""
    rng = np.random.default_rng(1)
    alone = rng.uniform(size=(200, 10))
    together = np.repeat(rng.uniform(size=(200, 1)), 10, axis=1)
    width = {}
    for name, places in (("alone", alone), ("together", together)):
        c = figures.coverage(places.tolist(), 0.5)
        assert c["band95"][0] < 0.5 < c["band95"][1]
        width[name] = np.ptp(c["band95"])
        assert np.ptp(c["binomial95_if_independent"]) == pytest.approx(4 * 0.5 / np.sqrt(2000), rel=0.1)
    assert width["together"] == pytest.approx(np.sqrt(10) * width["alone"], rel=0.25)


def test_pictures_and_page(records, found, tmp_path, renewed):
    (tmp_path / "sessions.json").write_text(json.dumps([*records, {"seed": 1, "refused": "out of reach"}]))
    text = renewed(page, lambda path: run.main(["--again", "--out", str(tmp_path), "--page", str(path)]))
    assert "out of reach" not in text
    assert "[1]" in text
    assert json.loads((tmp_path / "study.json").read_text())["z_scores"] == found["z_scores"]
    for name in pictures.NAMES:
        assert (tmp_path / "pictures" / name).stat().st_size > 20_000


def test_tasks_differ():
    first, second = run.tasks(5, 1, 2), run.tasks(5, 2, 0)
    seeds = [options.seed for options, _ in (*first, *second)]
    assert len(set(seeds)) == 10
    assert [with_emcee for _, with_emcee in first] == [True, True, False, False, False]


def test_a_session_that_cannot_be_is_said_to_be_refused():
    record = session.run(Options(seed=3, contacts=16, repeats=0, later=0, spheres=8, sphere_contacts=4))
    assert record["seed"] == 3
    assert "sphere" in record["refused"]
