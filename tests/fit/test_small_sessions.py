"""Sessions with little in them: known targets, repeats without scatter, few contacts or none."""

import re
from dataclasses import replace

import numpy as np
import pytest

from bayescal import calibration
from bayescal.assess.identifiability import _words
from bayescal.calibration import fit
from bayescal.effects import Parameter
from bayescal.errors import BayescalError
from bayescal.estimate import check_enough
from bayescal.estimate.unexplained import repeat_scatter
from bayescal.gap.diagnose import diagnose
from bayescal.methods import compare
from bayescal.model.scene import Scene
from bayescal.statistics import spawned


def with_targets(session, **known):
    """The session with all planes known as well as stated."""
    change = [replace(t, **known) if t.kind == "plane" else t for t in session.targets]
    return replace(session, targets=tuple(change))


def first(session, count):
    """The session with only its first rows to calibrate."""
    m = session.measurements
    order = np.cumsum(m.role == "calibrate")
    role = np.where((m.role == "calibrate") & (order > count), "validate", m.role)
    return replace(session, measurements=replace(m, role=role))


@pytest.mark.parametrize("known", [{"u": 0.0, "u_angle": 0.0}, {"u": 0.0}])
def test_targets_may_be_known(cube, known):
    """`u_mm: 0` of the contract; with all planes known the nominal model has no unknown at all."""
    simulated = cube(seed=2, count=80)
    found = fit(with_targets(simulated.dataset, **known), ("geometry",), samples=0)
    assert np.all(np.isfinite(found.final.estimate.sd))
    nominal, last = (level.unexplained.fitted for level in (found.levels[0], found.levels[-1]))
    assert last < nominal


def test_repeats_that_read_identically_are_no_noise(cube):
    """An encoder coarser than the noise: the stated noise stands in its place."""
    session = cube(seed=2, count=120).dataset
    m = session.measurements
    readings, repeat = m.readings.copy(), np.full(len(m.ids), "", object)
    for target in range(4):
        rows = np.flatnonzero((m.role == "calibrate") & (m.target == target))[:4]
        readings[rows] = readings[rows[0]]
        repeat[rows] = f"r{target}"
    same = replace(session, measurements=replace(m, readings=readings, repeat=repeat.astype(str)))
    found = fit(same, ("geometry",), samples=0)
    scatter, dof = repeat_scatter(Scene(same), found.final.estimate)
    assert (scatter, dof > 5) == (None, True)
    assert found.final.unexplained.floor == pytest.approx(5e-6)


@pytest.mark.parametrize("count", [0, 1, 3, 8])
@pytest.mark.parametrize("command", [fit, diagnose, compare])
def test_too_few_rows_are_refused_in_one_line(cube, count, command):
    with pytest.raises(BayescalError, match="role calibrate") as caught:
        command(first(cube(seed=2, count=80).dataset, count), ("geometry",))
    assert caught.value.where == "measurements.csv"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("known", [None, {"u": 0.0, "u_angle": 0.0}])
def test_the_number_that_is_asked_for_is_enough(cube, known):
    """Loose targets take up rows to be located; known ones take none: one row a joint is left to be asked."""
    session = cube(seed=2, count=80).dataset
    session = session if known is None else with_targets(session, **known)
    with pytest.raises(BayescalError) as caught:
        check_enough(Scene(first(session, 4)))
    needed = int(re.search(r"measure (\d+) or more", caught.value.remedy)[1])
    unknowns = 0 if known else 12
    assert 6 <= needed <= 6 + unknowns
    check_enough(Scene(first(session, 6 + unknowns)))
    with pytest.raises(BayescalError):
        check_enough(Scene(first(session, 5)))


def test_streams_are_independent(cube, monkeypatch):
    """Draws of the posterior, the noise added to them and the forecast once shared one stream."""
    used = {}
    for name in ("gaussian", "validate", "forecast"):
        plain = getattr(calibration, name)

        def told(*given, plain=plain, name=name, **named):
            used[name] = next(v for v in reversed(given) if isinstance(v, int) and v != 2000)
            return plain(*given, **named)

        monkeypatch.setattr(calibration, name, told)
    fit(cube(seed=2, count=80).dataset, ("geometry",), samples=0, seed=3)
    assert len({3, *used.values()}) == 4
    draws = [np.random.default_rng(s).standard_normal(10_000) for s in spawned(3, 6)]
    assert np.abs(np.corrcoef(draws) - np.eye(6)).max() < 0.05
    assert spawned(3, 6) == spawned(3, 6) != spawned(4, 6)


def parameter(name, unit, sd):
    return Parameter(name, unit, (), sd)


D2, D3 = (parameter(name, "m", 1e-4) for name in ("d2", "d3"))
THETA4, A4 = parameter("theta4", "rad", 1e-3), parameter("a4", "m", 2e-4)


@pytest.mark.parametrize(
    ("parameters", "free", "size", "words"),
    [
        ((D2, D3), (1, -1), 0.0, "only the combination d2 + d3 is identifiable"),
        ((D2, D3), (1, 1), 0.0, "only the combination d2 - d3 is identifiable"),
        # equal loadings, but of unequal priors: no sum of the two is identifiable
        ((D2, replace(D3, sd=2e-4)), (1, -1), 0.0, "only the combination d2 + 0.5 d3 is identifiable"),
        ((THETA4, A4), (1, 1), 0.0, "only the combination a4 - 3.5 mm/deg theta4 is identifiable"),
        ((D2, D3), (1, -1), 0.7, "the combination d2 + d3 is identifiable, d2 and d3 singly weakly"),
        ((D2, D3), (1, 0), 0.0, "d2 is not identifiable"),
        ((D2, D3), (0, 1), 0.9, "d3 is weakly identifiable"),
        (
            (D2, D3, A4),
            (1, -1, 1),
            0.0,
            "a common change of d2 by +0.058 mm, d3 by -0.058 mm and a4 by +0.12 mm is not identifiable",
        ),
    ],
)
def test_a_weak_direction_in_its_units(parameters, free, size, words):
    v = np.array(free) / np.linalg.norm(free)
    assert _words(parameters, v, size, v[:, None]) == words
    if words.startswith("only"):  # the combination does not change along the free direction
        change = {p.name: x * p.sd for p, x in zip(parameters, v, strict=True)}
        if "theta4" not in change:
            factor = float(re.search(r"[+-] ([\d.]*)", words)[1] or 1) * (-1 if " - " in words else 1)
            assert change["d2"] + factor * change["d3"] == pytest.approx(0.0, abs=1e-12)


def test_two_weak_directions_through_one_parameter_promise_no_pair():
    """d2 - d3 and d3 - a4 both free: neither d2 + d3 nor d3 + a4 is identifiable, only their common sum."""
    v = np.array([1, -1, 0]) / np.sqrt(2)
    weak = np.linalg.qr(np.array([[1, -1, 0], [0, 1, -1]], float).T)[0]
    assert "common change of d2" in _words((D2, D3, A4), v, 0.0, weak)
