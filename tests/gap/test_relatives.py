"""Relatives of a name, signs of physical parameters, and cells of effects that the vocabulary lacks."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_problems import bench_of
from scipy.integrate import quad
from scipy.stats import norm

from bayescal.effects import EFFECTS
from bayescal.effects.location import BASE, TOOL, Driver, joint
from bayescal.gap.concluded import _most
from bayescal.gap.linear.state import fit_state
from bayescal.gap.search.beam import Member, Search
from bayescal.gap.search.cells import cells
from bayescal.gap.search.makers import arguments
from bayescal.gap.search.unknown import _weights, relatives
from bayescal.gap.settings import RELATIVES
from bayescal.statistics import rms

LOADED = Driver("torque", 2)


@pytest.fixture(scope="module")
def bench(cube):
    return bench_of(cube, 7, 180)


def with_backlash(bench, by, seed, strength=400.0):
    """Noise and lost motion of joint 3, times a function (N,) of the rows; and what names it."""
    forms, p = bench.known.variants["backlash"], bench.problem
    variant = next(v for v in forms if v.setting is None and v.sites == (joint(3),))
    contribution = np.zeros(len(p.residual))
    contribution[: p.count] = p.pool[: p.count, variant.columns].sum(axis=1) * by[p.rows[p.contact]]
    contribution *= np.sqrt(strength / (contribution @ contribution))
    search = Search(bench.made_up(seed, contribution), bench.known)
    return search, search.hypothesis([Member(variant, 1.0, 0.0)]), search.hypothesis(())


def relatives_of(bench, named, null, without=None):
    """Relatives of the names of a hypothesis, over the evidence without it."""
    given = arguments(bench.circumstances)
    return list(relatives(named, named.members, null.log_evidence, given, lambda m: without or null))


def relative(bench, by, seed, strength=400.0):
    """The relative of that name."""
    _, named, null = with_backlash(bench, by, seed, strength)
    (found,) = relatives_of(bench, named, null)
    return found


def test_an_error_that_a_name_only_resembles_has_a_relative(bench):
    """Lost motion in proportion to a load: the load is found, with nats that no true name leaves."""
    torque = bench.circumstances.torques[:, LOADED.joint - 1]
    found = [relative(bench, np.abs(torque - np.median(torque)), seed) for seed in range(3)]
    assert min(r.gain for r in found) > 10.0
    assert {r.driver.joint for r in found} == {LOADED.joint}
    plain = [relative(bench, np.ones(len(torque)), seed).gain for seed in range(8)]
    assert max(plain) < 2.0
    # the verdict on a relative is not the name
    search, _, _ = with_backlash(bench, np.abs(torque - np.median(torque)), 1)
    decision, _ = bench.decided(search.problem)
    assert decision.kind in ("class", "unknown", "named+unexplained")
    assert "backlash" not in [m.effect for m in decision.members] or decision.kind != "named"
    assert decision.probability["unknown"] > 0.5


def test_a_name_that_explains_little_has_no_relatives(bench):
    _, named, null = with_backlash(bench, np.ones(len(bench.circumstances.q)), 0)
    least = replace(null, log_evidence=named.log_evidence - RELATIVES.least)
    assert relatives_of(bench, named, null, least)
    less = replace(least, log_evidence=least.log_evidence + 1e-6)
    assert not relatives_of(bench, named, null, less)


def test_a_name_is_as_sure_as_the_data_exclude_that_another_quantity_drives_it(bench):
    """Lost motion in proportion to a load, and one that is not: either is excluded if the other is true."""
    c = bench.circumstances
    load = np.abs(c.torques[:, 1]) / rms(c.torques[c.fitted, 1])
    loaded, excluded = (relative(bench, by, 0, strength=90.0) for by in (load, np.ones(len(load))))
    assert loaded.driver.joint == LOADED.joint
    assert loaded.gain > 0.0 > np.log(0.2) > excluded.gain


def test_an_error_of_a_certificate_has_no_relatives(bench):
    """It moves no contact, so that nothing can modulate it."""
    variant = bench.known.variants["artefact"][0]
    search = Search(bench.made_up(0), bench.known)
    named = search.hypothesis([Member(variant, 1.0, 0.0)])
    low = replace(search.hypothesis(()), log_evidence=named.log_evidence - 50.0)
    assert not relatives_of(bench, named, low)


@pytest.mark.parametrize("value", [-3.0, -0.5, 0.0, 2.0])
def test_the_evidence_of_a_positive_parameter_is_that_of_half_a_prior(bench, value):
    """By the integral over positive values of likelihood times twice the prior."""
    search = Search(bench.made_up(0), bench.known)
    positive = next(k for k, p in enumerate(bench.known.pool) if p.positive)
    state = fit_state(search.problem, [positive], [1.0], robust=False)
    sd = 0.4
    covariance = state.covariance.copy()
    covariance[-1, -1] = sd**2
    state = replace(state, step=np.append(state.step[:-1], value * sd), covariance=covariance)
    share, _ = quad(lambda x: norm.pdf(x, value * sd, sd), 0.0, 10.0, epsabs=1e-12)
    assert search.signs(state) == pytest.approx(np.log(2.0 * share), abs=1e-6)
    other = next(k for k, p in enumerate(bench.known.pool) if not p.positive)
    assert search.signs(replace(state, columns=np.array([other]))) == 0.0


@pytest.mark.parametrize(
    ("effect", "place"), [("backlash", (joint(2), Driver("direction", 2))), ("step", (BASE, Driver("event")))]
)
def test_a_cell_of_an_effect_is_a_rival_where_the_vocabulary_lacks_the_effect(
    bench, monkeypatch, effect, place
):
    def known():
        return next(x.of_known_effect for x in cells(bench.circumstances) if (x.site, x.driver) == place)

    assert known()
    monkeypatch.delitem(EFFECTS._effects, effect)
    assert not known()


def test_a_tool_has_cells_by_the_direction_of_gravity(bench):
    """In its own frame, which turns with the arm; sets that flip, and sets along one axis."""
    cell = bench.pool.cells[bench.number(TOOL, Driver("gravity direction"))]
    linear, *flips = cell.sets[:4]
    size = np.sqrt(sum(np.asarray(q.terms[0].driver) ** 2 for q in linear[::3]))
    assert np.allclose(size, 1.0)
    for flip, q in zip(flips, linear[::3], strict=True):
        assert np.array_equal(np.sign(flip[0].terms[0].driver), np.sign(q.terms[0].driver))
    x, y, z = (np.asarray(q.terms[0].driver) for q in linear[::3])
    for own, axis in zip(cell.sets[4:], ("tx", "ty", "tz"), strict=True):
        assert {t.axis for q in own for t in q.terms} == {axis}
        functions = np.column_stack([np.ones(len(x)), *(q.terms[0].driver for q in own)])
        for wanted in (x * y, x * x, y * z, z * z):
            assert np.allclose(functions @ np.linalg.lstsq(functions, wanted, rcond=None)[0], wanted)


@pytest.mark.parametrize(
    ("kind", "explained", "shares", "refuted"),
    [
        ("named", 0.6, (1.0, 1.0), 1.0),
        ("named+unexplained", 0.6, (0.6, 0.85), 0.5),
        ("named+unexplained", 0.95, (0.85, 0.85), 0.5),
        ("unknown", 0.0, (0.0, 0.85), 0.5),
    ],
)
def test_beside_an_unmodelled_effect_a_name_has_no_more_than_the_share_that_it_explains(
    kind, explained, shares, refuted
):
    """Only names of the leading explanation: another one, or compliance named before, keeps its own.

    Where the validation data refuse all names together, none is likely.
    """
    best = SimpleNamespace(names=("backlash",))
    d = SimpleNamespace(
        weighed=(best,), explained=explained, withheld=frozenset(), replaced={"step"}, unclaimed=set()
    )
    assert (_most("backlash", kind, d), _most("compliance", kind, d)) == shares
    assert _most("unknown", kind, d) == 1.0
    assert _most("step", kind, d) == 0.85  # the evidence is that of a form which validation data refuse
    d.unclaimed.add("backlash")
    assert _most("backlash", kind, d) == refuted


def test_quantities_of_the_joints_of_a_name_have_half_of_the_prior():
    """However many there are of them and of others; all alike where one sort is missing."""
    member = SimpleNamespace(variant=SimpleNamespace(places=((SimpleNamespace(number=3), None),)))
    of = [SimpleNamespace(driver=Driver("angle", j)) for j in (3, 1, 2, 4)]
    prior = np.exp(_weights(member, of))
    assert prior == pytest.approx([1 / 2, 1 / 6, 1 / 6, 1 / 6])
    assert np.exp(_weights(member, of[1:])) == pytest.approx(1 / 3)
