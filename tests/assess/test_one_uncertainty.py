"""One measurand has one U: what a fit prints, stores, certifies and decides with is one number.

U is computed here again from the contributions of a budget, by Student's t of SciPy.
"""

import json
import re
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from markupsafe import escape
from rich.console import Console
from scipy.stats import t as student

from bayescal.assess.acceptance import FAIL, OPEN, PASS, conformance
from bayescal.assess.budget import budget, headline
from bayescal.assess.measurand import distance, volume
from bayescal.calibration import fit
from bayescal.reporting.fit.budget import in_words
from bayescal.reporting.fit.files import write_fit
from bayescal.reporting.fit.summary import fit_summary
from bayescal.reporting.shared.text import um2
from bayescal.simulation import Options, simulate

COVERAGE = 0.9545
FEW = Options(contacts=30, later=4, repeats=0, spheres=3, placements=2, seed=3)
"""Few contacts of an arm with compliance, fitted without it: few degrees of freedom, k differs from 2."""


@pytest.fixture(scope="module")
def fitted():
    return fit(simulate(FEW).dataset, ("geometry",), samples=0, seed=1, tolerance=1e-3)


@pytest.fixture(scope="module")
def run(fitted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("one") / "run"
    write_fit(fitted, folder, pictures=False)
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
        for share in (1e-6, 0.01, 0.1, 0.5):
            assert at(e + u * (1 + share)) == PASS
            assert at(e + u * (1 - share)) == OPEN
            if e > u * (1 + share):
                assert at(e - u * (1 + share)) == FAIL
                assert at(e - u * (1 - share)) == OPEN
            elif e < u:
                assert at(1e-3 * share * u) == OPEN
    assert max(apart) > 1.2  # k = 2 would be seen


def test_the_volume_is_decided_with_its_own_u(fitted):
    """Without certified distances, the decision changes at U of a distance of the volume."""
    v, space = replace(fitted.final.validation, distances=()), fitted.forecast.workspace
    u = budget(fitted.basis, volume(fitted.basis)).expanded
    assert space.expanded == pytest.approx(u)
    assert space.k > 2.5
    sound = replace(fitted.acceptance, checks=())

    def at(x):
        return conformance(x, fitted.forecast, v, sound, fitted.budgets).decision

    for share in (1e-6, 0.1, 0.5):
        assert at(u * (1 + share)) == PASS
        assert at(u * (1 - share)) == OPEN


def test_what_is_printed_stored_and_decided_with_is_one_number(fitted, run):
    record = json.loads((run / "fit.json").read_text())
    budgets = json.loads((run / "budget.json").read_text())
    page = (run / "report.html").read_text()
    shown = StringIO()
    Console(file=shown, width=200).print(fit_summary(fitted, verbose=True))
    text = shown.getvalue()

    lead = record["predicted_distance"]
    first = budget(fitted.basis, headline(fitted.basis))
    by_name = {b["measurand"]: b for b in budgets["budgets"]}
    assert len(by_name) == len(budgets["budgets"]) >= 5
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


def test_the_certificate_states_the_same_u(fitted):
    from bayescal.exporting.dcc import in_digits

    for pair, b in fitted.budgets.items():
        u, _ = expanded(fitted, pair)
        assert b.expanded == pytest.approx(u, rel=1e-5)
        assert in_digits(b.measurand.value, b.expanded)[1] == in_digits(b.measurand.value, u)[1]
        assert f"k = {b.k:.2f}" in in_words(b)


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
