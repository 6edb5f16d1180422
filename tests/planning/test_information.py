"""Information of candidate contacts against fits of the chosen rows alone, and matrices with known values."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_pools import MODEL, every, linear, mixed, pool, pool_of

from bayescal.dataset import Noise
from bayescal.dataset.append import taken
from bayescal.errors import BayescalError
from bayescal.estimate import linearise, unit_weights
from bayescal.model import ARM, Scene, build
from bayescal.model.block import parts_of
from bayescal.planning.exchange import arm_information, criteria, observability, observability_of
from bayescal.planning.pool import check_count, inverse, linearised


def only(dataset, rows):
    """The session with some of its rows."""
    return replace(dataset, measurements=taken(dataset.measurements, rows))


def equal(a, b) -> bool:
    """Whether two information matrices are equal except for rounding."""
    return bool(np.max(np.abs(a - b)) < 1e-9 * np.max(np.abs(b)))


def test_parts_that_the_model_lacks_are_no_unknowns():
    found = linearised(pool(), MODEL, without=parts_of(["geometry at joint 4"], MODEL))
    lost = {p.name for p in linear().model.parameters} - {p.name for p in found.model.parameters}
    assert "theta4" in lost
    assert found.jacobian.shape[1] == linear().jacobian.shape[1] - len(lost)


@pytest.mark.parametrize("of", [lambda: pool(), mixed])
def test_covariance_is_that_of_a_model_of_the_chosen_rows(of):
    p = of()
    found = linearised(p, MODEL)
    chosen = np.sort(np.random.default_rng(0).permutation(found.count)[:150])
    model = build(Scene(only(p.session, p.candidates[chosen])), MODEL)
    nominal = np.zeros(model.size)  # where `linearised` is: compliances deflect the mean of the prior
    nominal[model.slices[ARM]] = -model.shift / model.sd
    j = linearise(model, nominal, unit_weights(model, nominal)).jacobian
    own = np.linalg.inv(np.eye(model.size) + j.T @ j)
    size = len(model.parameters)
    # a plane tilts about the middle of its own contacts: its loose prior is another one
    assert np.allclose(
        np.sqrt(np.diag(found.covariance(chosen))[:size]), np.sqrt(np.diag(own)[:size]), rtol=3e-3
    )


def test_blocks_have_as_many_residuals_as_the_kind():
    found = linearised(mixed(), MODEL)
    m = mixed().session.measurements
    tracked = np.isfinite(m.xyz[mixed().candidates, 0])
    assert found.blocks.shape[1] == 3
    assert np.array_equal(np.bincount(found.contact), np.where(tracked, 3, 1))
    assert np.all(found.blocks[~tracked, 1:] == 0)
    rows = found.jacobian[np.isin(found.contact, [5, 9, 11])]
    assert equal(found.selected([5, 9, 11]), rows.T @ rows)


def test_rows_measured_already_count():
    p = pool()
    first, rest = np.arange(100), np.arange(100, 600)
    continued = linearised(pool_of(p.session, measured=100), MODEL)
    assert continued.count == 500
    assert continued.residuals == 100
    assert equal(continued.information([]), linear().information(first))
    assert equal(continued.information(every(continued)), linear().information(np.append(first, rest)))


def test_order_and_noise():
    p, found = pool(), linear()
    order = np.random.default_rng(1).permutation(len(p.session.measurements.role))
    shuffled = pool_of(only(p.session, order))
    where = np.argsort(order)[p.candidates]  # rows of the shuffled session
    chosen = np.arange(0, 600, 5)
    same = np.searchsorted(shuffled.candidates, where[chosen])
    again = linearised(shuffled, MODEL)
    assert equal(again.information(same), found.information(chosen))
    noisy = replace(p.session, noise=Noise(contact=2 * p.session.noise.contact))
    assert equal(4 * linearised(pool_of(noisy), MODEL).selected(chosen), found.selected(chosen))


def test_joint_noise_lowers_the_information():
    d = pool().session
    shaky = linearised(pool_of(replace(d, noise=replace(d.noise, joint=1e-4))), MODEL)
    ratio = np.linalg.norm(shaky.jacobian, axis=1) / np.linalg.norm(linear().jacobian, axis=1)
    assert np.all(ratio < 0.5)
    assert np.ptp(ratio) > 0.01


def test_refusals_of_a_pool():
    d = pool().session
    for silent in (None, 0.0):
        with pytest.raises(BayescalError, match="noise of cube"):
            linearised(pool_of(replace(d, noise=Noise(contact=silent))), MODEL)
    with pytest.raises(BayescalError, match="no candidate"):
        linearised(pool_of(d, measured=len(d.measurements.role)), MODEL)


def test_counts_that_are_refused_or_warned_of():
    found = linear()
    size = found.model.size
    with pytest.raises(BayescalError, match=rf"{size} contacts are not more than the {size} unknowns"):
        check_count(found, size)
    assert f"{size + 40} or more" in check_count(found, size + 39)
    assert check_count(found, size + 40) == ""
    with pytest.raises(BayescalError, match="601 contacts of 600 candidates"):
        check_count(found, 601)
    continued = linearised(pool_of(pool().session, measured=100), MODEL)
    assert check_count(continued, 1) == ""


def test_observability_of_known_singular_values():
    rng = np.random.default_rng(0)
    u, v = (np.linalg.qr(rng.standard_normal(shape))[0] for shape in ((50, 3), (3, 3)))
    j = u @ np.diag([8.0, 2.0, 1.0]) @ v
    found = observability(j.T @ j, 50)
    expected = {
        "O1": 16 ** (1 / 3) / 50**0.5,
        "O2": 1 / 8,
        "O3": 1.0,
        "O4": 1 / 8,
        "O5": 1 / (1 / 8 + 1 / 2 + 1),
    }
    assert found == pytest.approx(expected)
    assert criteria(j.T @ j).d == pytest.approx(2 * np.log(16))
    assert criteria(j.T @ j).a == pytest.approx((1 / 64 + 1 / 4 + 1) / 3)
    assert criteria(j.T @ j).e == pytest.approx(1.0)


def test_criteria_improve_with_contacts_and_leave_out_what_no_contact_determines():
    found = linear()
    few, many = np.arange(80), np.arange(400)
    a, b = (criteria(arm_information(found, chosen)) for chosen in (few, many))
    assert b.d > a.d
    assert b.a < a.a
    assert b.e < a.e < 0.5
    values = np.linalg.eigvalsh(inverse(inverse(found.information(many))[:27, :27]))
    assert values[0] < 1.1
    assert len(arm_information(found, many)) == 26
    assert set(observability_of(found, many)) == {"O1", "O2", "O3", "O4", "O5"}
    assert observability_of(found, many)["O3"] > observability_of(found, few)["O3"]
