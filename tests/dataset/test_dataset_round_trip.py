"""What is written reads back; whole or not at all."""

import re
from dataclasses import fields, replace
from pathlib import Path

import foreign
import numpy as np
import pytest
from cases import refused
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sessions import with_columns
from tiny_dataset import SETTINGS, TABLE, write

from bayescal.dataset import Dataset, Record, Target, Tool, read_dataset, write_dataset
from bayescal.dataset.join import PAUSE, joined
from bayescal.dataset.types import ROLES, Certificate, Measurements, Noise, Points
from bayescal.dataset.write import followed, taken
from bayescal.model.scene import Scene
from bayescal.robots import load_robot

FOLDERS = sorted(
    p.parent
    for pattern in ("real/*/dataset.yaml", "worlds-dev*/*0/dataset.yaml")  # simulated ones differ little
    for p in foreign.DATA.glob(pattern)
) or [foreign.DATA]


KEPT = {"payload": 6e-7, "mass": 6e-7, "torque": 6e-7, "velocity": 1e-8, "time": 6e-5, "temperature": 6e-5}
"""What half a last decimal is, in SI, where it is not a nanometre or two nanoradians."""


def same(a: object, b: object, path: str = "") -> None:
    """Equal to what `write_dataset` promises to keep."""
    if hasattr(a, "__dataclass_fields__"):
        for f in fields(a):  # type: ignore[arg-type]
            if f.name not in ("folder", "sha256", "robot_reference", "line"):
                same(getattr(a, f.name), getattr(b, f.name), f"{path}.{f.name}")
    elif isinstance(a, tuple | list):
        assert len(a) == len(b), path  # type: ignore[arg-type]
        for i, (x, y) in enumerate(zip(a, b, strict=True)):  # type: ignore[call-overload]
            same(x, y, f"{path}[{i}]")
    elif isinstance(a, dict):
        assert a.keys() == b.keys(), path  # type: ignore[attr-defined]
        for key in a:
            same(a[key], b[key], f"{path}.{key}")  # type: ignore[index]
    elif isinstance(a, float) or (isinstance(a, np.ndarray) and a.dtype.kind == "f"):
        atol = KEPT.get(path.rpartition(".")[2], 1.1e-9)
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=atol, err_msg=path)
    else:
        np.testing.assert_array_equal(a, b, err_msg=path)


@foreign.needs()
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda p: p.name)
def test_shared_datasets_read_and_come_back(folder, tmp_path):
    data = read_dataset(folder)
    write_dataset(data, tmp_path / "out")
    same(data, read_dataset(tmp_path / "out"))


def test_tiny_comes_back_and_hashes_differ_with_content(tmp_path):
    data = read_dataset(write(tmp_path))
    assert data.record == Record(
        date="2026-03-04",
        operator="A. <b>Operator</b>",
        serials={"arm": "0123", "probe": "P: 7, [/]"},
        certificates=("DKD-K-1234", "77"),
        temperature=20.5,
    )
    write_dataset(data, tmp_path / "new" / "out")
    again = read_dataset(tmp_path / "new" / "out")
    same(data, again)
    assert again.robot_reference == "fanuc-lrmate200ic"
    assert {p.name for p in (tmp_path / "new" / "out").glob("[!.]*")} == {"dataset.yaml", "measurements.csv"}
    assert read_dataset(write(tmp_path)).sha256 == data.sha256
    assert read_dataset(write(tmp_path, SETTINGS.replace("tiny", "tiny2"))).sha256 != data.sha256
    assert read_dataset(write(tmp_path, table=TABLE.replace("21.5", "21.6"))).sha256 != data.sha256


def test_changed_builtin_is_written_beside(tmp_path):
    data = read_dataset(write(tmp_path))
    arm = replace(data.robot, a=data.robot.a + 1e-5)
    write_dataset(replace(data, robot=arm), tmp_path / "out")
    again = read_dataset(tmp_path / "out")
    assert again.robot_reference == "robot.yaml"
    np.testing.assert_allclose(again.robot.a, arm.a, atol=1e-15)


def test_whole_or_not_at_all(tmp_path):
    data = read_dataset(write(tmp_path))
    refused("not empty", lambda: write_dataset(data, tmp_path))
    broken = replace(data, targets=(replace(data.targets[0], values={}), *data.targets[1:]))
    with pytest.raises(KeyError):
        write_dataset(broken, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    write_dataset(data, tmp_path / "out")
    assert not [p for p in tmp_path.glob("[!.]*") if p.name.endswith(".part")]


LETTERS = st.characters(exclude_categories=["Cs", "Cc", "Cf", "Zl", "Zp"])
NAMES = st.text(LETTERS, min_size=1, max_size=12).filter(lambda s: s == s.strip())


@st.composite
def datasets(draw) -> Dataset:
    """The tiny dataset's fixed point and instrument, under any names and with any optional column."""
    count, n = 3, 6
    floats = st.floats(-1, 1, allow_subnormal=False)
    column = st.lists(floats, min_size=count, max_size=count).map(np.array)
    block = st.lists(st.lists(floats, min_size=n, max_size=n), min_size=count, max_size=count).map(np.array)
    names = draw(st.lists(NAMES, min_size=3, max_size=3, unique=True))
    words = st.lists(NAMES | st.just(""), min_size=count, max_size=count).map(np.array)
    uncertain = st.none() | st.just(0.0) | st.floats(1e-8, 0.1)
    rows = Measurements(
        ids=tuple(draw(st.lists(NAMES, min_size=count, max_size=count, unique=True))),
        role=np.array(draw(st.lists(st.sampled_from(ROLES), min_size=3, max_size=3))),
        target=np.zeros(count, int),
        tool=np.array([0, 1, 0]),
        readings=np.deg2rad(draw(block)) + 0.1,
        line=np.arange(2, 2 + count),
        velocity=draw(st.none() | block),
        torque=draw(st.none() | block),
        stop=draw(st.none() | words),
        repeat=draw(st.none() | words),
        time=draw(st.none() | column),
        temperature=draw(st.none() | column),
        payload=draw(st.none() | column.map(np.abs)),
        u=draw(st.none() | column.map(lambda v: np.where(v > 0, v + 1e-6, np.nan))),
    )
    centre = np.array([0.675, 0.0, 0.3])
    u = draw(uncertain)
    return Dataset(
        name=draw(NAMES),
        folder=Path(),
        robot=load_robot("fanuc-lrmate200ic")[0],
        robot_reference="fanuc-lrmate200ic",
        readings="command",
        gravity=np.array([0.1, 0.0, -9.8]),
        tools=(
            Tool(names[0], np.array([0.06, 0.0, 0.12]), u=u, u_angle=u, rpy=np.array([0.1, -3.0, 1e-7])),
            Tool(names[1], np.array([0.06, 0.0, 0.12]), mass=0.1, ball_radius=0.003),
        ),
        noise=Noise(1e-5, draw(st.none() | st.just(2e-6)), 1e-5, draw(st.none() | st.just(3e-4))),
        targets=(
            Target(names[0], "fixed-point", {"centre": centre}, u_angle=u),
            Target(names[1], "distance", {"centre": centre - [0, 0, 0.3], "length": np.nan}),
            Target(names[2], "plane", {"normal": np.array([0.6, 0.0, 0.8]), "offset": 0.1}),
        ),
        certificates=(
            Certificate("distance", (names[0], names[1]), distance=0.3, u_distance=1e-6),
            Certificate("flat", (names[2],), u_form=2.5e-6),
        ),
        measurements=rows,
        temperature_of=draw(st.sampled_from((None, "arm", "air", "artefact"))),
        source=draw(st.none() | NAMES),
        record=Record(
            date=draw(st.just("") | st.dates().map(str)),
            operator=draw(st.just("") | NAMES),
            serials=draw(st.dictionaries(st.sampled_from(("arm", "probe", "artefact", "instrument")), NAMES)),
            certificates=tuple(draw(st.lists(NAMES, max_size=2))),
            temperature=draw(st.none() | st.floats(-40, 60).map(lambda t: round(t, 3))),
        ),
    )


@given(data=datasets())
@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
def test_any_dataset_comes_back(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("any") / "out"
    write_dataset(data, folder)
    same(data, read_dataset(folder))


# --- Several sessions as one: what they share, what stays their own, and what is refused.


@pytest.fixture(scope="module")
def pair(cube):
    """Two sessions, told apart by names and hashes."""
    each = zip((cube(seed=seed, count=60).dataset for seed in (1, 2)), "AB", strict=True)
    return tuple(replace(s, name=name, sha256=name.lower(), folder=Path(name)) for s, name in each)


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
    both = joined([with_columns(s, repeat=labels, stop=labels) for s in pair]).measurements
    for column in (both.repeat, both.stop):
        assert list(np.unique(column)) == ["", "A:r1", "B:r1"]


def test_clocks_follow_each_other_and_keep_their_course(pair):
    a, b = (with_columns(s, time=np.linspace(5.0, end, 60)) for s, end in zip(pair, (900, 300), strict=True))
    time = joined((a, b, replace(b, name="C", sha256="c", folder=Path("C")))).measurements.time
    assert np.all(np.diff(time) > 0)
    for later in (time[60:120], time[120:]):
        np.testing.assert_allclose(np.diff(later), np.diff(b.measurements.time))
    stopped = joined((a, with_columns(b, time=None))).measurements.time
    assert np.ptp(stopped[60:]) == 0
    assert stopped[60] > stopped[59]


def test_a_column_that_one_session_lacks_holds_what_empty_cells_do(pair):
    a, b = pair
    bare = with_columns(b, velocity=None, payload=None, temperature=None, u=None)
    columns = {"u": np.full(60, 1e-6), "velocity": np.ones((60, 6)), "temperature": np.linspace(20, 22, 60)}
    told = with_columns(a, **columns)
    m = joined((told, bare)).measurements
    assert np.all(m.velocity[60:] == 0)
    assert np.all(m.payload[60:] == 0)
    assert np.isnan(m.u[60:]).all()
    np.testing.assert_allclose(m.temperature[60:], 21.0)
    np.testing.assert_array_equal(m.velocity[:60], told.measurements.velocity)


def test_an_artefacts_temperature_is_not_taken_for_the_arms(pair):
    a, b = (with_columns(s, temperature=np.linspace(20, 22, 60)) for s in pair)
    mixed = joined((replace(a, temperature_of="artefact"), replace(b, temperature_of="arm")))
    assert mixed.temperature_of == "arm"
    assert np.ptp(mixed.measurements.temperature[:60]) == 0
    assert joined([replace(s, temperature_of="artefact") for s in (a, b)]).temperature_of == "artefact"


def test_tools_stated_alike_are_one_tool_unless_remounted(pair):
    a, b = pair
    assert [t.name for t in joined(pair).tools] == ["ball"]
    both = joined(pair, remounted=True)
    assert [t.name for t in both.tools] == ["A:ball", "B:ball"]
    assert list(both.measurements.tool) == [0] * 60 + [1] * 60
    longer = replace(b, tools=(replace(b.tools[0], centre=b.tools[0].centre + 1e-3),))
    assert [t.name for t in joined((a, longer)).tools] == ["A:ball", "B:ball"]
    probe = Tool("probe", np.zeros(3), 2e-3)
    both = joined((a, with_columns(replace(b, tools=(probe, b.tools[0])), tool=np.ones(60, int))))
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
    top = b.measurements.target == [t.name for t in b.targets].index("cube.+z")
    role = np.where(top, "validate", "calibrate")
    both = joined((a, with_columns(replace(b, certificates=(*b.certificates, held)), role=role)))
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


def test_coordinates_of_an_artefact_have_the_information_of_one_paper(pair):
    """However many sessions use them."""
    root = np.random.default_rng(0).standard_normal((6, 6))
    covariance = 1e-12 * (root @ root.T + np.eye(6))
    at = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    paper = Points("plate", ("a", "b"), at, tuple(map(tuple, covariance)), (0, 1), ("", ""))
    names = tuple(t.name for t in pair[0].targets[:2])
    each = [replace(s, certificates=(Certificate("points", names, points=paper),)) for s in pair]
    for sessions in (each, [*each, replace(each[0], name="C", sha256="c", folder=Path("C"))]):
        found = [np.array(c.points.covariance) for c in joined(sessions).certificates]
        assert len(found) == len(sessions)
        np.testing.assert_allclose(sum(map(np.linalg.inv, found)), np.linalg.inv(covariance), rtol=1e-6)


def test_names_that_clash_give_way_to_folders_and_numbers(pair):
    a, b = (replace(s, name="cube/1") for s in pair)
    assert [s.name for s in joined((a, b)).sessions] == ["A", "B"]
    b = replace(b, folder=a.folder)
    assert [s.name for s in joined((a, b)).sessions] == ["cube-1 1", "cube-1 2"]


OTHER = "not the robot of A: "


def _of(dataset, **changes):
    return replace(dataset, robot=replace(dataset.robot, **changes))


REFUSED = {
    "another arm": (lambda d: _of(d, a=d.robot.a + np.eye(6)[2] * 1e-3), f"{OTHER}a of J3 0.301, not 0.3"),
    "another name": (lambda d: _of(d, name="other"), f"{OTHER}name other, not fanuc"),
    "no masses": (lambda d: _of(d, masses=None), f"{OTHER}masses given for one of them only"),
    "fewer joints": (lambda d: _of(d, a=d.robot.a[:5]), f"{OTHER}5 rows of a, not 6"),
    "hanging": (lambda d: replace(d, gravity=-d.gravity), "`gravity_mps2` is"),
    "commanded": (lambda d: replace(d, readings="command"), "`readings` is command, in A it is encoder"),
    "other encoders": (lambda d: replace(d, noise=Noise(joint=1e-4)), "`noise.joint_deg` is 0.0057"),
    "given twice": (lambda d: replace(d, sha256="a"), "the same session as A"),
}


@pytest.mark.parametrize(("change", "what"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_no_session_of_the_same_arm_is_refused_in_one_line(pair, change, what):
    a, b = pair
    assert refused(f"^B: {re.escape(what)}", lambda: joined((a, change(b)))).remedy


def test_limits_and_rounding_make_no_other_arm(pair):
    a, b = pair
    joined((a, replace(b, robot=replace(b.robot, limits=2 * b.robot.limits, a=b.robot.a + 1e-10))))


# --- Rows that were measured later follow those of a session: times continue, labels stay apart.


@pytest.fixture(scope="module")
def halves(cube):
    m = cube(seed=1).dataset.measurements
    m = replace(m, repeat=np.where(np.arange(len(m.ids)) % 30 == 0, "r1", ""))
    return taken(m, np.arange(60)), taken(m, np.arange(60, 120))


def test_columns_of_both_are_continued(halves):
    first, second = halves
    rows, lost = followed(first, second)
    assert lost == ()
    assert rows.ids == (*first.ids, *second.ids)
    np.testing.assert_array_equal(rows.readings, np.concatenate([first.readings, second.readings]))
    np.testing.assert_array_equal(rows.time, np.concatenate([first.time, second.time]))
    assert set(rows.repeat[:60].tolist()) == {"", "r1"}
    assert set(rows.repeat[60:].tolist()) == {"", "r1.later"}
    # a clock that begins again, wherever, continues
    since = second.time - second.time[0]
    for begin in (0.0, 7.0, -3.0):
        rows, _ = followed(first, replace(second, time=begin + since))
        np.testing.assert_allclose(rows.time[60:], first.time[-1] + PAUSE + since)


def test_empty_cells_stand_for_nothing_and_other_columns_are_left_out(halves):
    first, second = halves
    later = replace(second, time=None, torque=None, velocity=None)
    rows, lost = followed(replace(first, payload=None, u=None), later)
    assert lost == ("torque", "time")
    assert rows.time is None
    np.testing.assert_array_equal(rows.payload, [*np.zeros(60), *second.payload])
    np.testing.assert_array_equal(rows.velocity[60:], 0.0)
    assert rows.u is None
