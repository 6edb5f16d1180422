"""Where the tool is: one uncertainty for positions, compensated targets and budgets, checked by draws."""

from dataclasses import replace

import numpy as np
import pytest

import bayescal as bc
from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.compensating.position import Frame, expanded, positions
from bayescal.compensating.solve import compensated
from bayescal.errors import BayescalError
from bayescal.fitted.arm import of_fit
from bayescal.fitted.gate import Use
from bayescal.model import ARM
from bayescal.programs.targets import Target
from bayescal.programs.tools import tool_of
from bayescal.public.positions import Positioned

DRAWS = 6000


@pytest.fixture(scope="module")
def fitted(tracker):
    """Without the compliances that the arm has: what is not modelled is most of the uncertainty."""
    return bc.fit(tracker(seed=3, count=80).dataset, "geometry", samples=0)


@pytest.fixture(scope="module")
def arm(fitted):
    return of_fit(fitted.data)


@pytest.fixture(scope="module")
def readings(arm):
    return arm.dataset.measurements.readings[[3, 17, 40, 66]]


def test_the_session_has_a_discrepancy(arm, readings):
    """Else the tests below would check parameters alone; the cross terms with these are seen."""
    assert arm.beyond.variances
    poses = arm.at(readings)
    alone = np.trace(poses.by_parameters @ arm.covariance @ np.swapaxes(poses.by_parameters, 1, 2), 0, 1, 2)
    with_all = np.trace(poses.covariance, 0, 1, 2)
    assert np.max(np.abs(np.log(alone / with_all))) > 0.2


@pytest.mark.parametrize("frame", ["base", "tracker"])
def test_covariance_by_draws_of_all_unknowns(fitted, arm, readings, frame):
    """Draws of arm, target and functions together, through the kinematics: no slope, no elimination."""
    stated = fitted.data.stated
    wide, rng = stated.wide.model, np.random.default_rng(0)
    plain = stated.plain
    z = plain.z + rng.standard_normal((DRAWS, len(plain.z))) @ np.linalg.cholesky(plain.covariance).T
    drawn = stated.draws(z, rng)
    rows = [arm.dataset.measurements.readings.tolist().index(q.tolist()) for q in readings]
    points = wide.motion(np.array(rows)).points(wide.deviations(drawn[:, wide.slices[ARM]]))
    points = np.moveaxis(points, -1, 1) + arm.beyond.excess * rng.standard_normal((DRAWS, len(rows), 3))
    if frame == "tracker":
        block = wide.block_of["tracker"]
        at = np.array(
            [block.kind.describe(block.state(own))["frame"] for own in drawn[:, wide.slices["tracker"]]]
        )
        points = np.einsum("sji,scj->sci", at[:, :3, :3], points - at[:, None, :3, 3])
    expected = np.array([np.cov(points[:, k].T) for k in range(len(rows))])
    found = positions(arm, readings, frame=frame)
    size = np.trace(expected, 0, 1, 2)
    np.testing.assert_allclose(found.uncertain.u, np.sqrt(size), rtol=0.05)
    assert np.abs(found.uncertain.covariance - expected).max(axis=(1, 2)) == pytest.approx(
        0, abs=0.07 * size.max()
    )
    away = np.linalg.norm(points - points.mean(axis=0), axis=2)
    within = np.mean(away <= found.uncertain.expanded, axis=0)
    assert np.all(within > 0.945)  # more where the variances have few degrees of freedom


def test_one_uncertainty_for_budgets_positions_and_compensations(fitted, arm, readings, tmp_path):
    fitted.save(tmp_path / "run", pictures=False)
    live, loaded = fitted.position(readings), bc.load(tmp_path / "run").position(readings)
    np.testing.assert_allclose(loaded.poses, live.poses, atol=1e-9)
    np.testing.assert_allclose(loaded.covariance, live.covariance, rtol=1e-6, atol=1e-16)
    for k, q in enumerate(readings):
        budget = bc.budget(fitted, point=np.degrees(q))
        # nearly: a budget does not limit the parameters to their priors
        assert 1e3 * live.u[k] == pytest.approx(budget.u, rel=0.01)
        assert 1e3 * live.U[k] == pytest.approx(budget.U, rel=0.03)
    done = compensated(arm, [Target("", readings=q) for q in readings])
    there = positions(arm, np.array([own.readings for own in done]))
    np.testing.assert_allclose([own.u for own in done], there.uncertain.u, rtol=1e-9)
    np.testing.assert_allclose([own.expanded for own in done], there.uncertain.expanded, rtol=1e-9)
    assert [own.inside for own in done] == there.inside.tolist()


def test_a_length_that_errors_do_not_exceed():
    """Of isotropic, flat and single errors, and with a variance that was estimated from few values."""
    rng = np.random.default_rng(1)
    for sides in ([1, 1, 1], [3, 1, 0.1], [1, 0, 0]):
        covariance = np.diag(np.square(np.array(sides, float)))[None]
        away = np.linalg.norm(rng.standard_normal((200_000, 3)) * sides, axis=1)
        assert np.mean(away <= expanded(covariance, np.array([1e6]))[0]) == pytest.approx(0.9545, abs=4e-3)
        scale = np.sqrt(rng.chisquare(6, 200_000) / 6)
        few = expanded(covariance, np.array([6.0]))[0]
        assert np.mean(away <= few * scale) == pytest.approx(0.9545, abs=4e-3)


def test_another_tool_is_carried_by_the_flange(arm, readings):
    """The offset of the probe has taken up zero and length of the last joint: a tool has them in its u."""
    tcp = np.array([0.03, -0.02, 0.15, 0.2, -0.1, 0.4])
    found = positions(arm, readings, tcp=tcp)
    flange = arm.at(readings).flange
    np.testing.assert_allclose(found.poses, flange @ rigid(rpy_matrix(tcp[3:]), tcp[:3]), atol=1e-12)
    axis, arms = flange[:, :3, 2], flange[:, :3, :3] @ tcp[:3]
    way = np.cross(axis, arms)
    # by the tolerances of d6, 0.3 mm, and of theta6, 2 mrad
    expected = 3e-4**2 * axis[:, :, None] * axis[:, None] + 2e-3**2 * way[:, :, None] * way[:, None]
    working = tool_of(arm, None, tcp)
    poses = working.arm.at(readings, tool="tcp")
    np.testing.assert_allclose(working.covariance(poses), expected, rtol=1e-3, atol=1e-12)
    more = found.uncertain.covariance - poses.covariance
    np.testing.assert_allclose(more, working.covariance(poses), atol=1e-15)
    own = arm.dataset.tools[0]
    for tool, message in (
        ({"tool": own.name, "tcp": tcp}, "--tcp: a tool and its pose are given"),
        ({"tcp": tcp[:5]}, "--tcp: is not six numbers"),
        ({"tool": "pen"}, "--tool: there is no tool `pen`; tools: ball"),
    ):
        with pytest.raises(BayescalError, match=message):
            positions(arm, readings, **tool)


def test_a_tool_of_the_dataset_that_no_row_uses(arm, readings):
    gun = replace(arm.dataset.tools[0], name="gun", centre=np.array([0, 0, 0.2]), u=1e-4)
    dataset = replace(arm.dataset, tools=(*arm.dataset.tools, gun))
    scene = replace(arm.model.scene, dataset=dataset)
    both = replace(arm, model=replace(arm.model, scene=scene))
    found = positions(both, readings, tool="gun")
    same = positions(arm, readings, tcp=np.array([0, 0, 0.2, 0, 0, 0]))
    np.testing.assert_allclose(found.poses[:, :3, 3], same.poses[:, :3, 3], atol=1e-12)
    extra = found.uncertain.covariance - same.uncertain.covariance
    np.testing.assert_allclose(extra, np.broadcast_to(1e-8 * np.eye(3), extra.shape), atol=1e-12)
    assert found.inside.tolist() == positions(arm, readings).inside.tolist()
    with pytest.raises(BayescalError, match="--tool: the session has several tools"):
        positions(both, readings)


def test_the_covariance_is_along_the_axes_of_the_frame(arm, readings, monkeypatch):
    turn = rpy_matrix(np.array([0.4, -0.9, 1.3]))
    plain = positions(arm, readings)
    stand = Frame(np.eye(4), rigid(turn))
    monkeypatch.setattr("bayescal.compensating.position.frame_of", lambda *_: stand)
    found = positions(arm, readings)
    np.testing.assert_allclose(found.poses[:, :3, 3], plain.poses[:, :3, 3] @ turn, atol=1e-12)
    expected = turn.T @ plain.uncertain.covariance @ turn
    np.testing.assert_allclose(found.uncertain.covariance, expected, rtol=1e-6, atol=1e-16)


def test_direction_of_motion_and_load(fitted, arm, readings):
    """Every argument arrives: as in `FittedArm.at`."""
    heavy = fitted.position(readings, payload_kg=2.0)
    np.testing.assert_allclose(heavy.points, arm.at(readings, payload_kg=2.0).points, atol=1e-12)
    turned = fitted.position(readings, frame="tracker")
    here = fitted.position(readings)
    np.testing.assert_allclose(
        np.trace(turned.covariance, 0, 1, 2) < np.trace(here.covariance, 0, 1, 2) * 1.5, True
    )
    table = here.table
    np.testing.assert_allclose(table[["x_mm", "y_mm", "z_mm"]].to_numpy(), 1e3 * here.points)
    np.testing.assert_allclose(table["u_mm"], 1e3 * here.u)
    np.testing.assert_allclose(rpy_matrix(np.radians(table[["rx_deg", "ry_deg", "rz_deg"]].to_numpy())),
                               here.poses[:, :3, :3], atol=1e-12)  # fmt: skip
    for wrong in (readings[:, :5], np.full(6, np.nan)):
        with pytest.raises(BayescalError, match="readings: readings of shape"):
            fitted.position(wrong)
    with pytest.raises(BayescalError, match="another shape than the readings"):
        fitted.position(readings, payload_kg=[1.0, 2.0])


def test_an_arm_that_must_not_be_used(arm, readings):
    class Result(Positioned):
        _arm = replace(arm, use=Use(("it rests on its priors",), ("verdict: not validated",)))

    with pytest.raises(BayescalError, match="not used: it rests on its priors"):
        Result().position(readings)
    text = str(Result().position(readings, force=True)).splitlines()
    assert text[:2] == ["warning: not to be used: it rests on its priors", "warning: verdict: not validated"]
