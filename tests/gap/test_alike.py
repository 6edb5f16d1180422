"""A location is stated with every other site at which an error would look the same, and with no further."""

import numpy as np
import pytest
from gap_problems import bench_of

from bayescal.effects.location import BASE, TOOL, Driver, joint
from bayescal.gap.linear.state import fit_state
from bayescal.gap.outcome.where import Contribution, beside, neighbours
from bayescal.gap.search.beam import Member, Search
from bayescal.gap.search.makers import along, at_joint
from bayescal.gap.search.unknown import with_columns


@pytest.fixture(scope="module")
def bench(cube):
    return bench_of(cube, 3, 240)


@pytest.fixture(scope="module")
def errors(bench):
    """Errors of joints and shifts of the tool that begin in the middle of the session, by site."""
    c = bench.circumstances
    since = (np.arange(len(c.q)) >= c.fitted[len(c.fitted) // 2]).astype(float)
    turns = {joint(j): at_joint(c, j, [since]) for j in range(1, c.robot.n + 1)}
    return turns | {TOOL: [along(c.robot.n + 1, axis, since) for axis in ("tx", "ty", "tz")]}


def alike(bench, site, driver, parameters, amplitude):
    """Neighbours of an error of lambda 300 in data that have it."""
    columns = bench.slopes.columns(parameters)
    motion = bench.visible((columns @ amplitude)[:, None], 300.0, 0)
    amplitude = np.linalg.lstsq(columns, motion, rcond=None)[0]
    without = fit_state(bench.made_up(1, motion), (), (), robust=False)
    with_it = with_columns(without, columns, 100.0)
    of = Contribution(site, driver, parameters, columns, amplitude, 0.0)
    return neighbours(of, without, with_it, bench.circumstances, bench.slopes)


def test_the_zero_of_the_last_joint_is_a_shift_of_the_only_tool(bench, errors):
    """Exactly, in one direction; a shift of the tool in another is of no joint."""
    turned, shifted = (bench.slopes.columns(errors[site]) for site in (joint(6), TOOL))
    by = np.linalg.lstsq(shifted, turned, rcond=None)[0][:, 0]
    np.testing.assert_allclose(shifted @ by, turned[:, 0], atol=1e-9 * np.max(np.abs(turned)))
    event, across = Driver("event"), np.cross(by, [0.0, 0.0, 1.0])
    assert alike(bench, joint(6), event, errors[joint(6)], np.ones(1)) == (TOOL,)
    assert alike(bench, TOOL, event, errors[TOOL], by) == (joint(6),)
    assert alike(bench, TOOL, event, errors[TOOL], across) == ()


@pytest.mark.parametrize(
    ("number", "driver", "sites"),
    [(1, "event", (BASE,)), (1, "torque", ()), (2, "event", ()), (4, "event", ()), (5, "torque", ()),
     (6, "torque", (TOOL,)), (6, "direction", (TOOL,)), (6, "angle", ())],
)  # fmt: skip
def test_a_site_is_alike_by_what_may_move_it_and_where_it_leaves_nothing(
    bench, errors, number, driver, sites
):
    site = joint(number)
    assert alike(bench, site, Driver(driver, number), errors[site], np.ones(1)) == sites


def test_what_is_alike_is_stated_of_every_effect_and_is_none_of_a_certificate(bench):
    search = Search(bench.made_up(0), bench.known)
    sites = {}
    for *_, variant in bench.known.variants.values():
        member = Member(variant, 1.0, 0.0)
        named = search.hypothesis([member])
        sites[variant.effect] = beside(member, named, bench.known.pool, bench.circumstances, bench.slopes)
    assert any(sites.values())
    assert not sites["artefact"]
