"""Logs in whatever units come back as the session that they were made from, or are refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from made_up_logs import robodk, said, spatial_analyzer, table
from typer.testing import CliRunner

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.cli import app
from bayescal.dataset import Tool, read_dataset, write_dataset
from bayescal.dataset.consistency import nominal
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert, write

ARM = "fanuc-lrmate200ic"
NOISE = "10 um"


@pytest.fixture(scope="module")
def tracked(tracker):
    """Forty points of a reflector at (60, 0, 120) mm, roughly, on an arm with errors."""
    return tracker(seed=3, count=40)


def brought(tmp_path, force=False, **request):
    draft = convert(Request(**{"robot": ARM, "noise": NOISE, **request}))
    write(draft, tmp_path / "out", force)
    return read_dataset(tmp_path / "out", judge=not force)


def same_rows(a, b):
    assert a.ids == b.ids
    np.testing.assert_array_equal(a.role, b.role)
    for name in ("readings", "xyz", "time"):
        if getattr(b, name) is not None:
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=3e-9)


@pytest.mark.parametrize(
    ("angle", "length", "separator", "mark"),
    [("deg", "mm", ",", "."), ("rad", "m", ";", ","), ("mrad", "in", "\t", "."), ("rad", "um", "\t", ",")],
)
def test_any_unit_comes_back(tracked, tmp_path, angle, length, separator, mark):
    data = tracked.dataset
    log = table(data, tmp_path / "log.csv", angle, length, separator, mark)
    got = brought(tmp_path, log=log, map=said(angle, length))
    same_rows(got.measurements, data.measurements)
    assert got.noise.point == pytest.approx(1e-5)


def test_instrument_and_reflector_are_found(tracked, tmp_path):
    """To what an arm that is a millimetre or two wrong lets them be."""
    data = tracked.dataset
    map_ = said("deg", "mm")
    got = brought(tmp_path, log=table(data, tmp_path / "log.csv", "deg", "mm"), map=map_)
    np.testing.assert_allclose(got.tools[0].centre, data.tools[0].centre, atol=6e-3)
    place = got.targets[0].values
    frame = rigid(rpy_matrix(place["rpy"]), place["xyz"])
    reads = np.c_[data.measurements.xyz, np.ones(40)]
    assert np.abs(reads @ (frame - tracked.frame).T).max() < 6e-3


def test_two_stations_and_two_reflectors(tracked, tmp_path):
    """Half of the rows from elsewhere, a third with another reflector, which is told."""
    data = tracked.dataset
    m, where = data.measurements, np.arange(40) % 2
    tool = (np.arange(40) % 3 == 0).astype(int)
    second = Tool("b", np.array([-0.05, 0.02, 0.1]))
    turn = rpy_matrix(np.array([0.3, -0.2, 2.0]))
    moved = replace(
        data, tools=(replace(data.tools[0], name="a"), second), measurements=replace(m, tool=tool)
    )
    at_home = nominal(moved, m.readings)
    xyz = (at_home - [1.0, 2, 3]) @ turn
    xyz[where == 1] = (at_home[where == 1] + [0.5, 0, 1]) @ turn.T
    lines = ["id,tool,at," + ",".join(f"q{j}" for j in range(1, 7)) + ",x,y,z"]
    for i in range(40):
        cells = [
            f"p{i}",
            "ab"[tool[i]],
            f"s{where[i]}",
            *np.degrees(m.readings[i]).tolist(),
            *xyz[i].tolist(),
        ]
        lines.append(",".join(map(str, cells)))
    (tmp_path / "log.csv").write_text("\n".join(lines), encoding="utf-8")
    map_ = "id=id, tool=tool, target=at, j*=q* deg, x=x m, y=y m, z=z m"
    got = brought(tmp_path, log=tmp_path / "log.csv", map=map_)
    found = {t.name: t.centre for t in got.tools}
    np.testing.assert_allclose([found["a"], found["b"]], [data.tools[0].centre, second.centre], atol=1e-6)
    place = {t.name: t.values["xyz"] for t in got.targets}
    np.testing.assert_allclose(place["s0"], [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(place["s1"], [-0.5, 0, -1], atol=1e-6)


def test_a_wild_row_does_not_carry_the_frame_away(tracked, tmp_path):
    data = tracked.dataset
    xyz = data.measurements.xyz.copy()
    xyz[7] += [0.4, -0.3, 0.2]
    wild = replace(data, measurements=replace(data.measurements, xyz=xyz))
    map_ = said("deg", "mm")
    with pytest.raises(BayescalError, match=r"^log.csv:9: impossible reading"):
        brought(tmp_path, log=table(wild, tmp_path / "log.csv", "deg", "mm"), map=map_)
    assert not (tmp_path / "out").exists()


WRONG = [
    ("rad", "deg", "mm", "mm", "`j1` to `j6` cannot be in deg: the numbers are 57 times too small; in rad"),
    ("deg", "rad", "mm", "mm", "`j1` to `j6` cannot be in rad: the numbers are 57 times too large; in deg"),
    ("deg", "mrad", "mm", "mm", "`j1` to `j6` cannot be in mrad: .* in deg"),
    ("deg", "deg", "m", "mm", "`x` to `z` cannot be in mm: the numbers are 1000 times too small; in m"),
    ("deg", "deg", "mm", "m", "`x` to `z` cannot be in m: the numbers are 1000 times too large; in mm"),
    ("deg", "deg", "in", "mm", "`x` to `z` cannot be in mm: the numbers are 25 times too small; in in"),
]


@pytest.mark.parametrize("tool", ["", "60 0 120 mm"])
@pytest.mark.parametrize(("angle", "claimed", "length", "told", "words"), WRONG)
def test_a_wrong_unit_is_caught(tracked, tmp_path, angle, claimed, length, told, words, tool):
    log = table(tracked.dataset, tmp_path / "log.csv", angle, length)
    map_ = said(claimed, told)
    with pytest.raises(
        BayescalError, match=words + r" they agree with the nominal arm within [\d.]+ mm.*--force"
    ):
        brought(tmp_path, log=log, map=map_, tool=tool)
    assert not (tmp_path / "out").exists()
    got = brought(tmp_path, force=True, log=log, map=map_, tool=tool)
    assert len(got.measurements.ids) == 40


def test_one_joint_in_another_unit_is_caught(tracked, tmp_path):
    log = table(tracked.dataset, tmp_path / "log.csv", "deg", "mm")
    map_ = "id=Point, x=X mm, y=Y mm, z=Z mm" + "".join(f", j{j}=A{j} deg" for j in range(1, 7))
    with pytest.raises(BayescalError, match=r"^log.csv: `j4` cannot be in mrad"):
        brought(tmp_path, log=log, map=map_.replace("A4 deg", "A4 mrad"))


def test_contacts_with_a_template(cube, tmp_path):
    data = cube(seed=2, count=60).dataset
    write_dataset(data, tmp_path / "template")
    log = table(data, tmp_path / "log.csv", "rad")
    usual = {"log": log, "template": tmp_path / "template", "robot": "", "noise": ""}
    got = brought(tmp_path, map=said("rad") + ", target=face", **usual)
    same_rows(got.measurements, data.measurements)
    np.testing.assert_array_equal(got.measurements.target, data.measurements.target)
    assert got.certificates == data.certificates
    with pytest.raises(BayescalError, match="cannot be in deg: the numbers are 57 times too small"):
        convert_and_write(tmp_path / "other", map=said("deg") + ", target=face", **usual)
    with pytest.raises(BayescalError, match=r"the target of the rows is not stated.*cube.-x"):
        convert(Request(map=said("rad"), **usual))


def convert_and_write(folder, **request):
    write(convert(Request(**request)), folder)


def test_points_of_a_tracker_paired_by_id(tracked, tmp_path):
    data = tracked.dataset
    order = np.random.default_rng(0).permutation(40)[:37]
    points = spatial_analyzer(data, tmp_path / "sa.txt", order, "m")
    log = table(data, tmp_path / "log.csv")
    usual = {"log": log, "map": said("deg"), "points": points, "robot": ARM, "noise": NOISE}
    draft = convert(Request(points_map="m", pair="id", **usual))
    assert draft.notes[0] == "excluded: 3 rows of log.csv without a partner"
    kept = np.sort(order)
    np.testing.assert_allclose(draft.dataset.measurements.xyz, data.measurements.xyz[kept], atol=1e-7)
    np.testing.assert_allclose(
        draft.dataset.measurements.readings, data.measurements.readings[kept], atol=1e-9
    )
    with pytest.raises(BayescalError, match=r"40 rows in log.csv, 37 in sa.txt; .*pair them by id"):
        convert(Request(points_map="m", **usual))


def test_points_in_another_order_are_no_unit(tracked, tmp_path):
    """Paired by row although they were shuffled: refused, and no unit is blamed."""
    points = spatial_analyzer(tracked.dataset, tmp_path / "sa.txt", np.roll(np.arange(40), 5))
    log = table(tracked.dataset, tmp_path / "log.csv")
    draft = convert(Request(log, said("deg"), robot=ARM, noise=NOISE, points=points, points_map="mm"))
    assert draft.wrong == ""
    with pytest.raises(BayescalError, match="disagree with the arm"):
        write(draft, tmp_path / "out")


@pytest.mark.parametrize("pose", [False, True])
def test_robodk(tracked, tmp_path, pose):
    data = tracked.dataset
    m = data.measurements
    at = np.array([[0.06, 0, 0.12], [-0.05, 0.02, 0.1]])
    both = replace(
        data,
        tools=(replace(data.tools[0], centre=at[0]), Tool("b", at[1])),
        measurements=replace(m, tool=np.arange(40) % 2, readings=np.repeat(m.readings[:20], 2, axis=0)),
    )
    both = replace(
        both,
        measurements=replace(both.measurements, xyz=nominal(both, both.measurements.readings) - [2.0, 1, 0]),
    )
    log = robodk(both, tmp_path / "dk.csv", at[both.measurements.tool], pose, lost=(3, 8))
    draft = convert(Request(log, format="robodk", robot=ARM, noise=NOISE))
    got = draft.dataset
    assert draft.notes[0] == "2 rows of dk.csv excluded: not measured (0, 0, 0)"
    assert [t.name for t in got.tools] == ["tcp1", "tcp2"]
    np.testing.assert_allclose([t.centre for t in got.tools], at, atol=1e-9)
    np.testing.assert_allclose(got.targets[0].values["xyz"], [2, 1, 0], atol=1e-6)
    stops = got.measurements.stop.tolist()
    assert stops[0] == stops[1] != ""
    assert stops[2] == ""  # its neighbour was lost
    assert draft.line.tolist()[:4] == [1, 2, 3, 5]
    write(draft, tmp_path / "out")
    with pytest.raises(BayescalError, match="columns do not match a RoboDK table of 6 joints"):
        convert(Request(table(data, tmp_path / "log.csv"), format="robodk", robot=ARM, noise=NOISE))


def test_on_the_command_line(tracked, tmp_path):
    import bayescal.cli.import_  # noqa: F401  (registers itself)

    log = table(tracked.dataset, tmp_path / "log.csv", "deg", "mm")
    map_ = tmp_path / "map.yaml"
    map_.write_text(
        "j*: A* deg\nid: Point\nx: X mm\ny: Y mm\nz: Z mm\ntarget: \"'leica'\"\n", encoding="utf-8"
    )
    words = ["import", str(log), "--map", str(map_), "--robot", ARM, "--noise", NOISE, "--out"]
    done = CliRunner().invoke(app, [*words, str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert re.search(r"instrument `leica` located at .*\n.*median", done.output)
    again = CliRunner().invoke(app, [*words, str(tmp_path / "out")])
    assert isinstance(again.exception, BayescalError)
    assert "not empty" in again.exception.what
    assert read_dataset(tmp_path / "out").targets[0].name == "leica"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.csv", "map.yaml", "out"]
