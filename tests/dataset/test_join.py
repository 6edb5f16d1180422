"""Several sessions as one: what they share, what stays their own, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayescal.dataset import Certificate, Tool
from bayescal.dataset.join import joined
from bayescal.errors import BayescalError
from bayescal.model.scene import Scene


@pytest.fixture(scope="module")
def pair(cube):
    """Two sessions, told apart by names and hashes."""
    one, other = (cube(seed=seed, count=60).dataset for seed in (1, 2))
    return (
        replace(one, name="A", sha256="a", folder=Path("A")),
        replace(other, name="B", sha256="b", folder=Path("B")),
    )


def with_rows(dataset, **columns):
    return replace(dataset, measurements=replace(dataset.measurements, **columns))


def test_a_single_session_stays_as_it_is(pair):
    assert joined(pair[:1]) is pair[0]


def test_names_tell_the_session_and_rows_follow_each_other(pair):
    both = joined(pair)
    assert both.name == "A + B"
    assert [s.name for s in both.sessions] == ["A", "B"]
    assert [t.name for t in both.targets] == [f"{s.name}:{t.name}" for s in pair for t in s.targets]
    assert [t.session for t in both.targets] == ["A"] * 4 + ["B"] * 4
    ids = [f"{s.name}:{k}" for s in pair for k in s.measurements.ids]
    assert list(both.measurements.ids) == ids
    assert len(set(ids)) == len(ids)
    scene, at = Scene(both), 0
    for s in pair:
        rows = np.arange(at, at := at + len(s.measurements.ids))
        np.testing.assert_array_equal(scene.points[rows], Scene(s).points)
        names = [both.targets[k].name for k in both.measurements.target[rows]]
        assert names == [f"{s.name}:{s.targets[k].name}" for k in s.measurements.target]
    for c in both.certificates:
        assert len({name.partition(":")[0] for name in c.targets}) == 1


def test_repeats_and_stops_of_two_sessions_stay_apart(pair):
    labels = np.array(["r1", ""] * 30)
    both = joined([with_rows(s, repeat=labels, stop=labels) for s in pair]).measurements
    for column in (both.repeat, both.stop):
        assert list(np.unique(column)) == ["", "A:r1", "B:r1"]


def test_clocks_follow_each_other_and_keep_their_course(pair):
    a, b = (with_rows(s, time=np.linspace(5.0, end, 60)) for s, end in zip(pair, (900, 300), strict=True))
    time = joined((a, b)).measurements.time
    assert np.all(np.diff(time) > 0)
    np.testing.assert_allclose(np.diff(time[60:]), np.diff(b.measurements.time))
    stopped = joined((a, with_rows(b, time=None))).measurements.time
    assert np.ptp(stopped[60:]) == 0
    assert stopped[60] > stopped[59]


def test_a_column_that_one_session_lacks_holds_what_empty_cells_do(pair):
    a, b = pair
    bare = with_rows(b, velocity=None, payload=None, temperature=None, u=None)
    told = with_rows(a, u=np.full(60, 1e-6), velocity=np.ones((60, 6)), temperature=np.linspace(20, 22, 60))
    m = joined((told, bare)).measurements
    assert np.all(m.velocity[60:] == 0)
    assert np.all(m.payload[60:] == 0)
    assert np.isnan(m.u[60:]).all()
    np.testing.assert_allclose(m.temperature[60:], 21.0)
    np.testing.assert_array_equal(m.velocity[:60], told.measurements.velocity)


def test_an_artefacts_temperature_is_not_taken_for_the_arms(pair):
    a, b = (with_rows(s, temperature=np.linspace(20, 22, 60)) for s in pair)
    mixed = joined((replace(a, temperature_of="artefact"), replace(b, temperature_of="arm")))
    assert mixed.temperature_of == "arm"
    assert np.ptp(mixed.measurements.temperature[:60]) == 0
    both = joined([replace(s, temperature_of="artefact") for s in (a, b)])
    assert both.temperature_of == "artefact"


def test_tools_stated_alike_are_one_tool_unless_remounted(pair):
    a, b = pair
    assert [t.name for t in joined(pair).tools] == ["ball"]
    both = joined(pair, remounted=True)
    assert [t.name for t in both.tools] == ["A:ball", "B:ball"]
    assert list(both.measurements.tool) == [0] * 60 + [1] * 60
    longer = replace(b, tools=(replace(b.tools[0], centre=b.tools[0].centre + 1e-3),))
    assert [t.name for t in joined((a, longer)).tools] == ["A:ball", "B:ball"]
    probe = Tool("probe", np.zeros(3), 2e-3)
    more = with_rows(replace(b, tools=(probe, b.tools[0])), tool=np.ones(60, int))
    both = joined((a, more))
    assert [t.name for t in both.tools] == ["ball", "probe"]
    assert set(both.measurements.tool) == {0}


def test_each_session_keeps_the_noise_it_states(pair):
    a, b = pair
    rough = replace(b, noise=replace(b.noise, contact=3 * a.noise.contact))
    scene = Scene(joined((a, rough)))
    np.testing.assert_allclose(scene.sigma(np.arange(60)), a.noise.contact)
    np.testing.assert_allclose(scene.sigma(np.arange(60, 120)), 3 * a.noise.contact)
    assert [scene.group(k) for k in (0, 4)] == ["contact of A", "contact of B"]
    assert Scene(joined((a, rough), own_noise=False)).group(4) == "contact"


def test_one_paper_does_not_average_out_over_sessions(pair):
    a, b = pair
    held = Certificate("perpendicular", ("cube.+y", "cube.+z"), u_angle=2e-5)
    role = np.where(
        b.measurements.target == [t.name for t in b.targets].index("cube.+z"), "validate", "calibrate"
    )
    both = joined((a, with_rows(replace(b, certificates=(*b.certificates, held)), role=role)))
    u = {(c.kind, c.targets): (c.u_distance, c.u_angle) for c in both.certificates}
    paper = {(c.kind, c.targets): c for c in a.certificates}
    for (kind, names), (u_distance, u_angle) in u.items():
        if names[0] == "B:cube.+y" and names[1] == "B:cube.+z" and u_angle == held.u_angle:
            continue
        one = paper[kind, tuple(name.partition(":")[2] for name in names)]
        fitted_by_both = "cube.+z" not in one.targets
        wide = np.sqrt(2) if fitted_by_both else 1.0
        assert u_angle == pytest.approx(wide * one.u_angle)
        if one.u_distance is not None:
            assert u_distance == pytest.approx(wide * one.u_distance)


def test_names_that_clash_give_way_to_folders_and_numbers(pair):
    a, b = (replace(s, name="cube/1") for s in pair)
    assert [s.name for s in joined((a, b)).sessions] == ["A", "B"]
    b = replace(b, folder=a.folder)
    assert [s.name for s in joined((a, b)).sessions] == ["cube-1 1", "cube-1 2"]


def _longer(dataset):
    a = dataset.robot.a + np.eye(6)[2] * 1e-3
    return replace(dataset, robot=replace(dataset.robot, a=a))


REFUSED = {
    "another arm": (_longer, "not the robot of A: a of J3 0.301, not 0.3"),
    "another name": (
        lambda d: replace(d, robot=replace(d.robot, name="other")),
        "not the robot of A: name other, not fanuc",
    ),
    "no masses": (
        lambda d: replace(d, robot=replace(d.robot, masses=None)),
        "not the robot of A: masses given for one of them only",
    ),
    "fewer joints": (
        lambda d: replace(d, robot=replace(d.robot, a=d.robot.a[:5])),
        "not the robot of A: 5 rows of a, not 6",
    ),
    "hanging": (lambda d: replace(d, gravity=-d.gravity), "`gravity_mps2` is"),
    "commanded": (lambda d: replace(d, readings="command"), "`readings` is command, in A it is encoder"),
    "other encoders": (
        lambda d: replace(d, noise=replace(d.noise, joint=1e-4)),
        "`noise.joint_deg` is 0.0057",
    ),
    "given twice": (lambda d: replace(d, sha256="a"), "the same session as A"),
}


@pytest.mark.parametrize(("change", "what"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_no_session_of_the_same_arm_is_refused_in_one_line(pair, change, what):
    a, b = pair
    with pytest.raises(BayescalError) as error:
        joined((a, change(b)))
    assert str(error.value).startswith(f"B: {what}")
    assert "\n" not in str(error.value)
    assert error.value.remedy


def test_limits_and_rounding_make_no_other_arm(pair):
    a, b = pair
    robot = replace(b.robot, limits=2 * b.robot.limits, a=b.robot.a + 1e-10)
    joined((a, replace(b, robot=robot)))
