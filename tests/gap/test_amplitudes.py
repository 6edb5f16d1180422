"""Amplitudes of named effects: their values and uncertainties against sampling, and which are told."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_problems import BASELINE, unsolved

from bayescal.effects.location import joint
from bayescal.effects.sizes import length, magnitude, phase, propagated
from bayescal.gap.outcome.notes import amplitudes
from bayescal.gap.result import Named
from bayescal.reporting.gap.causes import lines, told
from bayescal.reporting.gap.phrases import named


@pytest.mark.parametrize(("of", "count"), [(magnitude, 1), (length, 2), (length, 3), (phase, 2)])
def test_uncertainties_are_those_of_samples(of, count):
    rng = np.random.default_rng(count)
    x, root = rng.standard_normal(count), 0.01 * rng.standard_normal((count, count))
    value, u = propagated(of, x, root @ root.T)
    drawn = np.array([of(x + root @ z)[0] for z in rng.standard_normal((4000, count))])
    assert np.mean(drawn) == pytest.approx(value, abs=0.1 * u + 1e-4)
    assert np.std(drawn) == pytest.approx(u, rel=0.06)


def test_a_wave_is_its_amplitude_and_phase():
    t = np.linspace(0, 6, 50)
    a, b = -0.3, 0.4
    np.testing.assert_allclose(
        a * np.sin(t) + b * np.cos(t), length(np.array([a, b]))[0] * np.sin(t + phase(np.array([a, b]))[0])
    )


EFFECTS = ("eccentricity at joint 2", "backlash", "step@40")


@pytest.fixture(scope="module")
def found(cube):
    """Amplitudes of a model whose parameters are set, with independent u of 0.05 prior sds."""
    fitted = unsolved(cube(seed=1).dataset, (*BASELINE, *EFFECTS), off=0.0)
    names = fitted.model.names
    z = np.zeros(len(names))
    z[names.index("eccentricity J2 sin")], z[names.index("eccentricity J2 cos")] = 3.0, -4.0
    z[names.index("backlash J3")] = -2.0
    z[names.index("step x")], z[names.index("step z")] = 6.0, 8.0
    fitted = replace(fitted, z=z, covariance=0.05**2 * np.eye(len(z)))
    each = [Named(model.partition(" ")[0].partition("@")[0], model, (), "", 1.0, 0.0) for model in EFFECTS]
    gap = SimpleNamespace(amplitudes=amplitudes(fitted, fitted.covariance, each))
    return gap, each


def test_values_of_parameters_that_are_set(found):
    gap, _ = found
    own = {(a.effect, str(a.site), a.unit): a for a in gap.amplitudes}
    wave = own["eccentricity", "joint 2", "rad"]
    assert (wave.value, wave.u) == pytest.approx((5e-4, 5e-6))
    assert wave.phase == pytest.approx((np.arctan2(-4.0, 3.0), 0.01))
    lag = own["backlash", "joint 3", "rad"]
    assert (lag.value, lag.u, lag.significant) == (pytest.approx(1.6e-4), pytest.approx(4e-6), True)
    shift = own["step", "base", "m"]
    assert (shift.value, shift.u, shift.significant) == (pytest.approx(5e-4), pytest.approx(2.5e-6), True)
    assert not own["step", "base", "rad"].significant
    assert sum(a.effect == "backlash" for a in gap.amplitudes) == 6


def test_only_what_is_significant_is_told(found):
    gap, each = found
    assert lines(gap) == [
        "eccentricity of J2: amplitude 0.02865(29) deg, phase -53.13(57) deg",
        "backlash of J3: half-width 0.00917(23) deg",
        "step of the base: shift 500.0(2.5) µm",
    ]
    assert named(each[1], gap).startswith("joint 3 has lost motion on reversal (backlash,")


def test_every_joint_only_where_all_are_significant(found):
    gap, each = found

    def said(*joints):
        own = [replace(a, significant=a.site in map(joint, joints)) for a in gap.amplitudes]
        return named(each[1], SimpleNamespace(amplitudes=own))

    assert said(2, 3, 5).startswith(
        "backlash in joints 2, 3 and 5 (each has lost motion on reversal; probability"
    )
    assert said(1, 2, 3, 4, 5, 6).startswith("every joint has lost motion")
    assert said().startswith("at least one joint has lost motion")
    none = SimpleNamespace(amplitudes=[replace(a, significant=False) for a in gap.amplitudes], where=())
    assert [str(a.site) for a in told(none, "backlash")] == ["joint 3"]
    assert lines(none)[1].endswith("deg, not significant alone")
    places = [
        SimpleNamespace(site=a.site, driver=a.driver, explained_by=name, rms=rms)
        for a, name, rms in zip(
            [a for a in none.amplitudes if a.effect == "backlash"],
            ["backlash", "backlash", "backlash", "eccentricity", "", ""],
            [1.0, 3.0, 2.0, 9.0, 9.0, 9.0],
            strict=True,
        )
    ]
    none.where = places
    assert [str(a.site) for a in told(none, "backlash")] == ["joint 2"]  # the largest location of the effect
