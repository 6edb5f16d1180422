"""Row and size of an unmodelled sudden change, and size of a rocking of the base, with their uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from gap_problems import Bench
from scipy.stats import chi2

from bayescal.arm.motion import CONTACT, Term
from bayescal.effects import Parameter
from bayescal.effects.location import BASE, PROBE, TOOL, Driver, joint
from bayescal.effects.stand import base_terms, tilts
from bayescal.gap.linear.evidence import weigh_sets
from bayescal.gap.linear.state import fit_state
from bayescal.gap.outcome import where
from bayescal.gap.outcome.where import places, sizes
from bayescal.gap.search.beam import Search
from bayescal.gap.search.unknown import cell_fits, with_set

ROW = 101  # of the session, from 0: between two rows that the cells try


@pytest.fixture(scope="module")
def bench(cube):
    return Bench.of(cube(seed=7, count=160).dataset)


def measured(bench, site, driver, parameters, amplitudes, left_out=()):
    """What is told of a cell of a session with a made-up error, without the contacts of some rows."""
    columns = bench.slopes.columns(parameters)
    # the error is what the model has to be moved by: residuals have the opposite sign
    p = bench.made_up(4, -columns @ (amplitudes / np.array([q.sd for q in parameters])))
    state = fit_state(p, (), ())
    at = next(k for k, x in enumerate(bench.pool.cells) if (x.site, x.driver) == (site, driver))
    f = cell_fits(state, bench.pool)[at]
    wider = with_set(state, bench.pool, f.best, f.scale)
    kept = ~np.isin(p.rows[p.contact], left_out)
    wider = replace(wider, weight=np.append(wider.weight[: p.count] * kept, wider.weight[p.count :]))
    return sizes(state, wider, bench.pool, f, bench.circumstances)


def since(bench):
    return (np.arange(len(bench.circumstances.q)) >= ROW).astype(float)


def test_a_stylus_that_shifts_has_its_row_and_a_vector(bench):
    end = bench.circumstances.chain.n + 1
    truth = np.array([60e-6, -40e-6, 25e-6])
    moved = [Parameter("", "m", (Term(end, f"t{axis}", since(bench)),), 1e-5) for axis in "xyz"]
    event, shift = measured(bench, TOOL, Driver("event"), moved, truth)
    first, last = event.interval95
    assert first <= event.row <= last
    assert first <= ROW <= last
    assert last - first <= 6
    assert [(a.what, a.unit, a.site) for a in shift] == [(f"shift {axis}", "m", TOOL) for axis in "xyz"]
    chi = [(a.value - value) / a.u for a, value in zip(shift, truth, strict=True)]
    assert np.max(np.abs(chi)) < 3.5
    assert all(a.u < 6e-6 and a.significant for a in shift)


def test_a_small_change_has_an_interval_of_many_rows(bench):
    small = [Parameter("", "m", (Term(CONTACT, "normal", since(bench)),), 1e-5)]
    large, _ = measured(bench, PROBE, Driver("event"), small, np.array([40e-6]))
    event, (shift,) = measured(bench, PROBE, Driver("event"), small, np.array([4e-6]))
    assert np.ptp(event.interval95) > np.ptp(large.interval95)
    assert (shift.what, shift.unit) == ("shift", "m")
    assert abs(shift.value - 4e-6) < 3.5 * shift.u


def test_rows_that_a_contact_left_out_does_not_distinguish(bench, monkeypatch):
    """The first of them is told, whatever rounding adds to their evidence."""
    shifted = [Parameter("", "m", (Term(CONTACT, "normal", since(bench)),), 1e-5)]
    first = bench.circumstances.fitted[bench.circumstances.fitted >= ROW][0]
    arguments = bench, PROBE, Driver("event"), shifted, np.array([300e-6]), [first]
    event, _ = measured(*arguments)
    assert event.row == first
    monkeypatch.setattr(
        where, "weigh_sets", lambda *a: weigh_sets(*a) + 1e-9 * np.arange(len(a[1].sets))[:, None]
    )
    assert measured(*arguments)[0].row == first


def test_the_zero_of_a_joint_that_changes(bench):
    turned = [Parameter("", "rad", (Term(4, "rz", since(bench)),), 1e-4)]
    event, (turn,) = measured(bench, joint(4), Driver("event"), turned, np.array([3e-4]))
    assert np.ptp(event.interval95) <= 6
    assert (turn.what, turn.unit, turn.significant) == ("rotation", "rad", True)
    assert abs(turn.value - 3e-4) < 3.5 * turn.u


def test_a_rocking_base_has_a_half_angle_about_an_axis(bench):
    c = bench.circumstances
    by = tilts(c)[0]
    mine = by.moment[c.fitted]
    knee = 0.02 * np.quantile(np.abs(mine), 0.9)
    rock = np.tanh((by.moment - np.median(mine)) / knee)
    parameters = [Parameter("", "rad", base_terms(c, "r", by.axis, rock), 1e-4)]
    driver = Driver("base moment", form="sign")
    event, (angle,) = measured(bench, BASE, driver, parameters, np.array([4e-4]))
    assert event is None
    x, y, _ = by.axis
    azimuth = round(np.degrees(np.arctan2(y, x))) % 180
    assert angle.what == f"half-angle about the horizontal axis at {azimuth} deg from x"
    assert abs(angle.value - 4e-4) < 3.5 * angle.u
    assert angle.significant


def test_amplitudes_of_one_change_share_the_margin(bench):
    """A probability of 0.007 is below the stated 0.01 for one amplitude, not for each of three."""
    end = bench.circumstances.chain.n + 1
    moved = [Parameter("", "m", (Term(end, f"t{axis}", since(bench)),), 1e-5) for axis in "xyz"]
    known = []
    for z in np.linspace(0.0, 12e-6, 7):
        _, shift = measured(bench, TOOL, Driver("event"), moved, np.array([60e-6, -40e-6, z]))
        p = chi2.sf((shift[2].value / shift[2].u) ** 2, 1)
        assert shift[2].significant == (3 * p < 0.01)
        known.append(p)
    assert any(0.01 / 3 < p < 0.01 for p in known), known


def test_only_significant_locations_have_a_size(bench):
    end = bench.circumstances.chain.n + 1
    moved = [Parameter("", "m", (Term(end, "tx", since(bench)),), 1e-5)]
    p = bench.made_up(4, bench.slopes.columns(moved)[:, 0] * 6.0)
    chosen = Search(p, bench.known).hypothesis(())
    found = places(chosen, bench.pool, (), bench.circumstances, 1e-10, p.jacobian.shape[1])
    assert (found[0].site, found[0].driver) == (TOOL, Driver("event"))
    assert found[0].event is not None
    assert found[0].amplitudes
    assert all(not q.amplitudes for q in found if q.family_p_value > 0.01)
