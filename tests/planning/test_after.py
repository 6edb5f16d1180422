"""What a diagnosis leaves open: from its hypotheses to gap.json, and back to the pairs of a plan."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from gap_pools import MODEL, nominal, pool

from bayescal.errors import BayescalError
from bayescal.gap.design.advise import undecided
from bayescal.gap.linear.problem import problem
from bayescal.gap.result import Pair, Suspect
from bayescal.gap.search.beam import Member, Search
from bayescal.gap.search.candidates import candidates
from bayescal.planning.contrasts import contrasts
from bayescal.planning.plan import continuation, continued
from bayescal.planning.projection import Projection
from bayescal.reporting.gap.contacts import undecided_records

RECORD = {
    "schema": "bayescal-gap/1",
    "dataset": {"sha256": "a"},
    "baseline": list(MODEL),
    "without": [],
    "named": [],
    "probability": {"null": 0.5, "backlash": 0.2},
    "undecided": [],
}


def examined(*sets: tuple[tuple[str, str], ...], unclaimed: tuple[str, ...] = (), probability: float = 0.3):
    """An examined baseline with hypotheses of effects at sites, the most probable first."""
    fitted = nominal()
    scene = fitted.model.scene
    known = candidates(scene.circumstances(scene.rows("calibrate")), MODEL)
    search = Search(problem(fitted, known.pool), known)
    search.problem.residual[:] = np.random.default_rng(0).normal(size=len(search.problem.residual))

    def member(effect: str, site: str) -> Member:
        return Member(next(v for v in known.variants[effect] if v.site == site), 1.0, 0.0)

    found = [search.hypothesis([member(*one) for one in own]) for own in sets]
    weighed = [SimpleNamespace(hypothesis=h, cell=None, probability=probability) for h in found]
    decision = SimpleNamespace(
        weighed=weighed, hypothesis=found[0], unclaimed=frozenset(unclaimed), withheld=frozenset()
    )
    return SimpleNamespace(decision=decision, candidates=known)


def test_two_explanations_are_a_pair_with_their_fitted_parameters() -> None:
    hardening, hysteresis, lobing = ("hardening", "joint 2"), ("hysteresis", "joint 2"), ("lobing", "")
    e = examined((lobing, hardening), (lobing, hysteresis))
    (pair,) = undecided(e)
    (own,), (other,), (common,) = pair.a, pair.b, pair.common
    assert own.model.startswith("hardening")
    assert "at joint 2" in own.model
    assert other.selection.effect == "hysteresis"
    assert common.selection.effect == "lobing"
    state = e.decision.weighed[0].hypothesis.state
    fitted = dict(zip((e.candidates.pool[k].name for k in state.columns), state.amplitudes, strict=True))
    sd = {e.candidates.pool[k].name: e.candidates.pool[k].sd for k in state.columns}
    assert own.values == pytest.approx({"hardening J2": fitted["hardening J2"] * sd["hardening J2"]})
    assert set(common.values) == {name for name in fitted if name.startswith("lobing")}


def test_improbable_alternatives_are_no_pairs_and_unconfirmed_names_are() -> None:
    sets = (("backlash", "joint 3"),), (("latency", ""),)
    assert undecided(examined(*sets, probability=0.01)) == ()
    (pair,) = undecided(examined(*sets, unclaimed=("backlash",), probability=0.01))
    assert pair.a[0].selection.effect == "backlash"
    assert pair.b == pair.common == ()


def test_pairs_survive_gap_json_and_become_contrasts() -> None:
    e = examined((("hardening", "joint 2"),), (("hysteresis", "joint 2"),))
    pairs = undecided(e)
    text = json.dumps(RECORD | {"undecided": undecided_records(SimpleNamespace(undecided=pairs))})
    read = continued(json.loads(text), "gap.json")
    assert read.effects == MODEL
    for old, new in zip(pairs, read.pairs, strict=True):
        for a, b in zip((*old.a, *old.b), (*new.a, *new.b), strict=True):
            assert a.model == b.model
            assert b.values == pytest.approx(a.values)
    c = contrasts(pool(), nominal(), read.pairs)
    strength = c.strengths(Projection(c.columns, np.arange(150)))
    assert np.all(strength > 0)


def test_effects_are_separated_beside_compliance_that_a_diagnosis_added() -> None:
    entry = {"a": [{"model": "lobing", "values": []}], "b": [], "common": []}
    record = RECORD | {"baseline": ["geometry"], "named": [{"effect": "compliance"}], "undecided": [entry]}
    read = continued(record, "gap.json")
    assert read.effects == ("geometry", "compliance")
    assert read.pairs == (Pair((Suspect("lobing"),)),)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("no json", "invalid JSON"),
        ('{"schema": "bayescal-fit/1"}', "the schema is bayescal-fit/1"),
        (json.dumps(RECORD | {"dataset": {"sha256": "other"}}), "no diagnosis of the present files"),
        (json.dumps(RECORD | {"dataset": "a"}), "no diagnosis of the present files"),
        (json.dumps({k: v for k, v in RECORD.items() if k != "undecided"}), "it lacks 'undecided'"),
        (json.dumps(RECORD | {"probability": {"backlash": "high"}}), "incomplete: could not convert"),
        (json.dumps(RECORD | {"probability": 0.5}), "incomplete"),
    ],
)
def test_other_files_are_refused(tmp_path, text: str, match: str) -> None:
    (tmp_path / "gap.json").write_text(text)
    with pytest.raises(BayescalError, match=match):
        continuation(SimpleNamespace(name="session", sha256="a"), tmp_path)
    with pytest.raises(BayescalError, match="no such file"):
        continuation(SimpleNamespace(name="session", sha256="a"), tmp_path / "absent.json")
