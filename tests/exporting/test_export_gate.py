"""What is not exported without --force, and why."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bayescal as bc
from bayescal.errors import BayescalError
from bayescal.estimate.bounds import UNCHANGED
from bayescal.exporting.export import FORMATS, export
from bayescal.fitted import gate
from bayescal.fitted.arm import of_estimate, of_fit
from bayescal.fitted.gate import Use


@pytest.fixture(scope="module")
def result():
    return bc.fit(bc.simulate(contacts=90, later=10, repeats=5, spheres=0, seed=1), samples=0)


def test_a_good_fit_passes(result):
    assert of_fit(result.data).use.against == ()
    assert bc.export(result, "urdf").record["notes"][-1].startswith("joint values of the file")


def test_a_sampler_that_did_not_converge(result):
    draws = replace(result.data.draws, converged=False, complaint="R-hat 1.2")
    bad = replace(result.data, draws=draws)
    with pytest.raises(BayescalError, match="not exported: the sampler did not converge"):
        export(of_fit(bad), "urdf")
    notes = export(of_fit(bad), "urdf", force=True).notes
    assert any(n.startswith("exported with --force: the sampler did not converge") for n in notes)


def negative(found, name, times):
    """An estimate with a parameter at some u below zero."""
    k = found.model.names.index(name)
    p = found.model.parameters[k]
    z = found.z.copy()
    z[k] = -(times * found.sd[k] * p.sd + p.centre) / p.sd
    return replace(found, z=z)


@pytest.fixture(scope="module")
def soft(result):
    """The arm of a fit with a compliance that is significantly negative."""
    found = negative(result.data.final.estimate, "compliance J3", 5.0)
    return replace(of_estimate(found, found.covariance), use=Use(gate.of_estimate(found, found.covariance)))


def test_a_negative_compliance(soft):
    words = (
        r"not exported: negative by more than \S+ u, which is not physical: compliance J3 -\S+ µrad/\(N m\)"
    )
    with pytest.raises(BayescalError, match=words):
        export(soft, "robot.yaml")
    out = export(soft, "robot.yaml", force=True)
    assert [m.parameters for m in out.missing] == [("compliance J3",)]
    assert "compliance J3" not in [i.parameter for i in out.written.items]


@pytest.mark.parametrize("to", [f for f in FORMATS if f != "ur-yaml"])
def test_every_format_can_be_forced(soft, to):
    """What a format cannot hold, as a spring that pushes, is left out and said."""
    with pytest.raises(BayescalError, match="not exported"):
        export(soft, to)
    out = export(soft, to, force=True)
    why = next((m.why for m in out.missing if m.parameters == ("compliance J3",)), "")
    assert ("no spring turns against its torque" in why) == (to in ("mjcf", "sdf", "robot.yaml", "dh-csv"))
    lost = {name for m in out.missing for name in m.parameters}
    assert "compliance J3" in lost or any(i.parameter == "compliance J3" for i in out.written.items)
    assert any("exported with --force: negative by more than " in note for note in out.notes)
    assert out.record("x")["use"]["allowed"] is False


def test_priors_that_decide(result):
    """The same fit with the covariance of the prior."""
    found = result.data.final.estimate
    assert gate.of_estimate(found, found.covariance) == ()
    prior = np.eye(found.model.size)
    (reason,) = gate.of_estimate(found, prior)
    assert reason.startswith("the fit is not identified: distances between TCP positions keep 100 %")
    bare = replace(found.model, constraints=())
    assert gate.of_estimate(replace(found, model=bare), prior)[0].startswith("no certified length was fitted")


def test_a_diagnosis_is_judged_by_its_stated_covariance(result):
    """As a fit is: not by the narrower one of the solver."""
    found = result.data.final.estimate
    verdict = SimpleNamespace(named=(), kind="null")
    gap = SimpleNamespace(arm=found, covariance=np.eye(found.model.size), verdict=verdict, rigid=UNCHANGED)
    assert len(gate.of_gap(gap).against) == 1
    gap.covariance = found.covariance
    assert gate.of_gap(gap) == gate.NOTHING


def test_names_without_gain():
    assert gate.not_gained([("backlash", 4.0), ("bending", -0.5), ("step@3", float("nan"))]) == (
        "bending does not make the validation data more probable (-0.5 nats)",
        "step@3 does not make the validation data more probable (+nan nats)",
    )


def test_an_effect_that_the_machine_does_not_have_is_refused(result, tmp_path):
    """Added by the user: fitted again, and its gain on the validation measurements is not positive."""
    with pytest.raises(BayescalError, match="hysteresis does not make the validation data more probable"):
        bc.export(result, "urdf", with_="hysteresis")
    without = bc.export(result, "urdf", without="compliance")
    assert without.record["model"] == ["geometry"]
    assert not without.data.missing
    with pytest.raises(BayescalError, match="the model has compliance already"):
        bc.export(result, "urdf", with_="compliance")
