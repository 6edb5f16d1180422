"""Files of one session that are joined: by time, by id with several reflectors, conditions; and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_logs import said, table

from bayescal.dataset.consistency import nominal
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert

ARM = "fanuc-lrmate200ic"
USUAL = {"robot": ARM, "noise": "10 um"}
START = 1795305600.0
"""s since 1970, of 2026-11-22T00:00:00Z."""


@pytest.fixture(scope="module")
def tracked(tracker):
    return tracker(seed=3, count=40).dataset


def lines(path, header, rows, separator=","):
    path.write_text("\n".join(separator.join(map(str, row)) for row in [header, *rows]), encoding="utf-8")
    return path


def controller(data, path):
    """A log of a controller, every 2 s: time since 1970, joints that are at rest for 8 s of every 10 s."""
    q = np.degrees(data.measurements.readings)
    rows = []
    for k in range(5 * len(q)):
        at, part = divmod(k, 5)
        here, there = q[at], q[min(at + 1, len(q) - 1)]
        reading = here if part < 4 else (here + there) / 2
        rows.append([START + 2.0 * k, *map(repr, reading.tolist())])
    return lines(path, ["t", *(f"A{j}" for j in range(1, 7))], rows)


def points(data, path, which, shift=0.3):
    """What a tracker exports: names, coordinates and ISO time stamps, in the middle of each standstill."""
    rows = []
    for i in which:
        seconds = 10.0 * i + 4.0 + shift
        stamp = f"2026-11-22T{int(seconds // 3600):02d}:{int(seconds // 60) % 60:02d}:{seconds % 60:05.2f}Z"
        rows.append([f"P{i}", *map(repr, (1e3 * data.measurements.xyz[i]).tolist()), stamp])
    return lines(path, ["Name", "X", "Y", "Z", "Time"], rows)


BY_TIME = "j*=A* deg, time=t epoch_s"
STAMPED = "id=Name, x=X mm, y=Y mm, z=Z mm, time=Time iso"


def test_by_time(tracked, tmp_path):
    which = [i for i in range(40) if i not in (7, 20)]
    log = controller(tracked, tmp_path / "ctrl.csv")
    seen = points(tracked, tmp_path / "tracker.csv", which)
    got = convert(Request(log, BY_TIME, points=seen, points_map=STAMPED, pair="time:1 s", **USUAL))
    rows = got.dataset.measurements
    assert rows.ids == tuple(f"P{i}" for i in which)
    np.testing.assert_allclose(rows.readings, tracked.measurements.readings[which], atol=1e-9)
    np.testing.assert_allclose(rows.xyz, tracked.measurements.xyz[which], atol=1e-9)
    np.testing.assert_allclose(rows.time, 10.0 * np.array(which), atol=1e-6)
    assert any("differences of 0.3 s (median), 0.3 s (maximum)" in note for note in got.notes)
    assert any(note == "38 of 200 rows of ctrl.csv are used" for note in got.notes)


def test_a_tracker_whose_clock_is_wrong(tracked, tmp_path):
    """Stamps that fall into the motions: the note says how far the arm moved."""
    log = controller(tracked, tmp_path / "ctrl.csv")
    seen = points(tracked, tmp_path / "tracker.csv", range(39), shift=3.7)
    wide = convert(Request(log, BY_TIME, points=seen, points_map=STAMPED, pair="time:3 s", **USUAL))
    assert any("39 of 39 measurements: check the clocks" in note for note in wide.notes)


@pytest.mark.parametrize(
    ("pair", "map_", "words"),
    [
        (
            "time:0.1 s",
            STAMPED,
            "no rows of ctrl.csv and tracker.csv are within 0.1 s: the nearest differ by 0.3 s",
        ),
        ("time", STAMPED, "`time` is not known; must be row, id or time:0.5 s"),
        ("time:1 mm", STAMPED, "`mm` is a unit of length, not of time"),
        ("time:1 s", STAMPED.replace("Time iso", "Time dmy"), "is not a date and time .dmy."),
        ("time:1 s", "id=Name, x=X mm, y=Y mm, z=Z mm", "tracker.csv: no column holds `time`"),
        ("row", STAMPED, "200 rows in ctrl.csv, 40 in tracker.csv"),
        ("near", STAMPED, "`near` is not known"),
    ],
)
def test_refused_by_time(tracked, tmp_path, pair, map_, words):
    log = controller(tracked, tmp_path / "ctrl.csv")
    seen = points(tracked, tmp_path / "tracker.csv", range(40))
    with pytest.raises(BayescalError, match=words):
        convert(Request(log, BY_TIME, points=seen, points_map=map_, pair=pair, **USUAL))


def test_clocks_that_cannot_be_compared(tracked, tmp_path):
    log = controller(tracked, tmp_path / "ctrl.csv")
    seen = points(tracked, tmp_path / "tracker.csv", range(40))
    text = seen.read_text(encoding="utf-8").replace("Z\n", "\n").rstrip("Z")
    seen.write_text(text, encoding="utf-8")
    with pytest.raises(
        BayescalError, match=r"time since 1970 in ctrl.csv, local time in tracker.csv; pair by id"
    ):
        convert(Request(log, BY_TIME, points=seen, points_map=STAMPED, pair="time:1 s", **USUAL))


def test_two_measurements_of_one_row_are_refused(tracked, tmp_path):
    log = controller(tracked, tmp_path / "ctrl.csv")
    seen = points(tracked, tmp_path / "tracker.csv", [0, 1, 1, 2, 3, 4, 5, 6])
    with pytest.raises(BayescalError, match=r"^tracker.csv:3: two rows have the same nearest row of the log"):
        convert(Request(log, BY_TIME, points=seen, points_map=STAMPED, pair="time:1 s", **USUAL))


@pytest.fixture(scope="module")
def reflectors(tracked):
    """Points of two reflectors at every pose, by the nominal arm and an instrument at (2, 0, 0.5) m."""
    centres = {"a": np.array([0.06, 0, 0.12]), "b": np.array([-0.05, 0.02, 0.1])}
    seen = {
        name: nominal(
            replace(tracked, tools=(replace(tracked.tools[0], centre=c),)), tracked.measurements.readings
        )
        - [2.0, 0, 0.5]
        for name, c in centres.items()
    }
    return centres, seen


def both_are_found(got, centres, seen, count=80):
    rows = got.dataset.measurements
    names = np.array([t.name for t in got.dataset.tools])[rows.tool]
    for name, centre in centres.items():
        own = next(t for t in got.dataset.tools if t.name == name)
        np.testing.assert_allclose(own.centre, centre, atol=1e-6)
        which = [
            int(i.partition(".")[0][1:]) for i, tool in zip(rows.ids, names, strict=True) if tool == name
        ]
        np.testing.assert_allclose(rows.xyz[names == name], seen[name][which], atol=1e-9)
    assert len(rows.ids) == len(set(rows.ids)) == count
    assert len(set(rows.stop.tolist()) - {""}) == count // 2


def test_two_reflectors_in_one_row(tracked, tmp_path, reflectors):
    centres, seen = reflectors
    rows = [
        [
            f"p{i}",
            *map(repr, q),
            *map(repr, 1e3 * seen["a"][i]),
            *(["", "", ""] if i == 5 else map(repr, 1e3 * seen["b"][i])),
        ]
        for i, q in enumerate(np.degrees(tracked.measurements.readings).tolist())
    ]
    rows = [[str(cell).replace("np.float64(", "").rstrip(")") for cell in row] for row in rows]
    header = ["n", *(f"A{j}" for j in range(1, 7)), *(f"{k}{n}" for n in (1, 2) for k in "XYZ")]
    log = lines(tmp_path / "log.csv", header, rows)
    map_ = "id=n, j*=A* deg, " + ", ".join(
        f"{k.lower()}@{t}={k}{n} mm" for t, n in (("a", 1), ("b", 2)) for k in "XYZ"
    )
    got = convert(Request(log, map_, **USUAL))
    assert "1 points of 2 reflectors excluded: not measured" in got.notes
    rows = got.dataset.measurements
    assert rows.ids[:2] == ("p0.a", "p0.b")
    assert "p5.b" not in rows.ids
    for tool in got.dataset.tools:
        np.testing.assert_allclose(tool.centre, centres[tool.name], atol=1e-6)


@pytest.mark.parametrize("files", [1, 2])
def test_two_reflectors_by_id(tracked, tmp_path, reflectors, files):
    centres, seen = reflectors
    log = table(tracked, tmp_path / "log.csv")
    ids = tracked.measurements.ids
    rows = {
        name: [[name, ids[i], *(repr(float(v)) for v in 1e3 * seen[name][i])] for i in range(40)]
        for name in centres
    }
    written = [rows["a"] + rows["b"]] if files == 1 else list(rows.values())
    paths = [
        lines(tmp_path / f"t{k}.csv", ["refl", "pose", "X", "Y", "Z"], part) for k, part in enumerate(written)
    ]
    map_ = said("deg").replace("role=role, ", "")
    got = convert(
        Request(
            log,
            map_,
            points=paths,
            points_map="id=pose, tool=refl, x=X mm, y=Y mm, z=Z mm",
            pair="id",
            **USUAL,
        )
    )
    rows = got.dataset.measurements
    assert len(set(rows.ids)) == 80
    np.testing.assert_allclose(rows.readings[::2], tracked.measurements.readings, atol=1e-9)
    for tool in got.dataset.tools:
        np.testing.assert_allclose(tool.centre, centres[tool.name], atol=1e-6)
    assert len(set(rows.stop.tolist())) == 40
    if files == 2:
        with pytest.raises(
            BayescalError, match=r"several files hold points; map `tool` .a reflector. or `target`"
        ):
            convert(
                Request(
                    log, map_, points=paths, points_map="id=pose, x=X mm, y=Y mm, z=Z mm", pair="id", **USUAL
                )
            )
    else:
        with pytest.raises(BayescalError, match=r"^t0.csv:2: id `.*` is given twice"):
            convert(
                Request(
                    log, map_, points=paths, points_map="id=pose, x=X mm, y=Y mm, z=Z mm", pair="id", **USUAL
                )
            )


def test_temperatures_of_another_logger(tracked, tmp_path):
    """A slow log: each row takes the nearest temperature, which may repeat."""
    log = table(tracked, tmp_path / "log.csv", "deg", "mm", clock=30.0 * np.arange(40))
    air = lines(tmp_path / "air.csv", ["s", "T"], [[300 * k, 20 + k] for k in range(6)])
    map_ = said("deg", "mm").replace("role=role, ", "")
    got = convert(
        Request(log, map_, points=air, points_map="time=s s, temperature=T C", pair="time:200 s", **USUAL)
    )
    rows = got.dataset.measurements
    assert len(rows.ids) == 40
    np.testing.assert_allclose(
        rows.temperature, 20 + np.round(np.nextafter(30.0 * np.arange(40) / 300, 0)), atol=1e-9
    )


def test_as_many_maps_as_files(tracked, tmp_path):
    log = table(tracked, tmp_path / "log.csv")
    with pytest.raises(BayescalError, match="2 files of points, but 3 maps"):
        convert(Request(log, said("deg"), points=[log, log], points_map=["mm", "m", "mm"], **USUAL))


def test_rows_that_are_earlier_than_the_row_above(tracked, tmp_path):
    clock = 30.0 * np.arange(40)
    clock[10] = 5.0
    log = table(tracked, tmp_path / "log.csv", "deg", "mm", clock=clock)
    got = convert(Request(log, said("deg", "mm"), **USUAL))
    assert (
        "1 rows are earlier than the row above: the order of rows is taken as the order of time" in got.notes
    )
