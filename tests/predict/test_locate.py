"""Targets found from their own rows, draw by draw: where they are, and how sure that is."""

import numpy as np
import pytest

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.predict.locate import robust_rows, search
from factors.fixed_point import FixedPoint
from factors.instrument import Instrument
from factors.sphere import Sphere

CENTRE, DIAMETER, RADIUS = np.array([0.4, -0.1, 0.2]), 50.8e-3, 3e-3


def contacts(rng, count, noise, diameter=DIAMETER):
    """Ball centres (3, count) on the upper half of a sphere that is off its nominal place."""
    true = CENTRE + np.array([1e-3, -2e-3, 0.5e-3])
    u = rng.standard_normal((3, count))
    u[2] = np.abs(u[2])
    u /= np.linalg.norm(u, axis=0)
    return true, true[:, None] + u * (diameter / 2 + RADIUS + noise * rng.standard_normal(count))


def test_sphere_is_found_with_the_spread_that_it_has():
    rng = np.random.default_rng(0)
    kind = Sphere(CENTRE, DIAMETER, np.full(12, RADIUS), np.array([0.05, 0.05, 0.05, 1e-3]))
    sigma, errors, spreads = 5e-6, [], []
    for _ in range(60):
        true, p = contacts(rng, 12, sigma)
        at = search(kind, p[None], np.full((1, 12), 1 / sigma))
        noise = sigma * rng.standard_normal((400, 1, 12))
        drawn = search(kind, np.broadcast_to(p, (400, 3, 12)), np.full((1, 12), 1 / sigma), noise=noise)
        errors.append(at.x[0, :3] - (true - CENTRE))
        spreads.append(drawn.x[:, :3].std(axis=0))
    z = np.array(errors) / np.array(spreads)
    assert np.std(z) == pytest.approx(1.0, abs=0.15)


def test_certified_diameter_sharpens_the_centre():
    rng = np.random.default_rng(1)
    _, p = contacts(rng, 12, 5e-6)
    noise = 5e-6 * rng.standard_normal((500, 1, 12))
    spread = {}
    for u in (1e-3, 1e-6):
        kind = Sphere(CENTRE, DIAMETER, np.full(12, RADIUS), np.array([0.05, 0.05, 0.05, u]))
        drawn = search(kind, np.broadcast_to(p, (500, 3, 12)), np.full((1, 12), 2e5), noise=noise)
        spread[u] = drawn.x[:, 2].std()
    assert spread[1e-6] < 0.7 * spread[1e-3]


def test_instrument_and_reflector_are_found_together():
    rng = np.random.default_rng(2)
    nominal = rigid(rpy_matrix(np.array([0.1, -0.2, 1.0])), np.array([2.0, 0.5, 0.3]))
    true = rigid(rpy_matrix(np.array([0.103, -0.201, 1.002])), np.array([2.004, 0.499, 0.302]))
    count, shift = 20, np.array([1e-3, -2e-3, 0.5e-3])
    turns = rpy_matrix(rng.uniform(-1, 1, (count, 3)))
    flange = np.array([0.4, 0, 0.3]) + rng.uniform(-0.2, 0.2, (count, 3))
    nominal_tool = np.array([0.0, 0.0, 0.1])
    p = (flange + turns @ nominal_tool).T
    actual = flange + turns @ (nominal_tool + shift)
    xyz = (actual - true[:3, 3]) @ true[:3, :3]
    kind = Instrument(nominal, np.array([0.4, 0, 0.3]), xyz, np.array([0.2] * 3 + [0.05] * 3))
    slopes = np.moveaxis(turns, 0, -1).swapaxes(0, 1)[None]  # (1, tool axis, xyz, C)
    found = search(kind, p[None], np.full((3, count), 1e5), tool_slopes=slopes, tool_sd=5e-3)
    np.testing.assert_allclose(found.tool[0], shift, atol=2e-8)
    np.testing.assert_allclose(kind.describe(found.x[0])["frame"], true, atol=2e-7)


def test_a_slipped_contact_does_not_help_to_find():
    rng = np.random.default_rng(3)
    kind = Sphere(CENTRE, DIAMETER, np.full(12, RADIUS), np.array([0.05, 0.05, 0.05, 1e-3]))
    _, p = contacts(rng, 12, 5e-6)
    clean = robust_rows(kind, p, np.full((1, 12), 5e-6))
    p[:, 4] += 0.4e-3 * (p[:, 4] - CENTRE) / np.linalg.norm(p[:, 4] - CENTRE)
    kept = robust_rows(kind, p, np.full((1, 12), 5e-6))
    assert clean.sum() >= 11
    assert kept[4] == 0.0
    assert kept.sum() >= 10


def test_known_target_stays_where_it_is():
    kind = FixedPoint(CENTRE, np.zeros(3))
    found = search(kind, np.ones((2, 3, 5)), np.ones((3, 5)))
    assert np.all(found.x == 0.0)
