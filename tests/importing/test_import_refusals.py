"""Maps, units and files that say too little or what cannot be: one line with the remedy."""

import numpy as np
import pytest

from bayescal.errors import BayescalError
from bayescal.importing import Request, convert
from bayescal.importing.columns import columns_of
from bayescal.importing.log import read_log
from bayescal.importing.mapping import read_map
from bayescal.importing.units import UNITS, quantity, unit_of

ARM = "fanuc-lrmate200ic"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("j1=A1 mm", "`mm` is a unit of length, not of angle; give one of deg, rad, mrad"),
        ("x=X furlong", "unknown unit `furlong`; give one of mm, m, cm, um, in"),
        ("j7=A7 deg", "`j7`, but the robot has 6 joints"),
        ("j1=A deg, j1=B deg", "`j1` is given twice"),
        ("xx=X mm", "unknown quantity `xx`"),
        ("j1", "'j1' is not an entry of a map"),
        ("x=Actual position", "unknown unit `position`; .*spaces is enclosed in braces: {Actual position}"),
    ],
)
def test_maps(text, words):
    with pytest.raises(BayescalError, match=words):
        read_map(text, 6)


def test_a_map_with_everything():
    got = read_map("j*=Joint * deg, j2_velocity=v2 deg/s, j1_torque=#9 Nm, id=Point, target='cube.+x'", 2)
    assert (got["j2"].name, got["j2"].unit) == ("Joint 2", UNITS["deg"])
    assert got["j2_velocity"].unit is UNITS["degps"]
    assert got["j1_torque"].name == "#9"
    assert (got["target"].name, got["target"].constant) == ("cube.+x", True)
    assert not got["id"].constant


@pytest.mark.parametrize(
    ("name", "dimension", "value", "si"),
    [
        ("in", "length", 2, 0.0508),
        ("µm", "length", 3, 3e-6),
        ("°", "angle", 180, np.pi),
        ("deg/s", "rate", 90, np.pi / 2),
        ("F", "temperature", 212, 100),
        ("K", "temperature", 293.15, 20),
        ("min", "time", 2, 120),
        ("g", "mass", 250, 0.25),
    ],
)
def test_units(name, dimension, value, si):
    unit = unit_of(name, dimension, "")
    assert unit.scale * value + unit.offset == pytest.approx(si, abs=1e-12)


def test_quantities():
    assert quantity("0, 0.07, 31 mm", "length", 3, "") == pytest.approx((0, 7e-5, 0.031))
    for text in ("1 2 mm", "1 2 3", "1 2 x mm", "1 2 3 deg"):
        with pytest.raises(BayescalError):
            quantity(text, "length", 3, "--tcp")


@pytest.mark.parametrize(
    ("text", "map_", "words"),
    [
        ("a;b\n1;2\n3\n", "x=a mm", r"log.csv:3: 1 cells, the header has 2"),
        (
            "alpha,b\n1,2\n",
            "x=Alpha mm",
            r"log.csv: `x`: no column `Alpha`; is it `alpha`",
        ),
        ("a,b\n1,two\n", "x=b mm", r"log.csv:2: `x` is not a number: 'two'"),
        ("a;b\n1;1.000,5\n", "x=b mm", r"`x` is not a number: '1.000,5'"),
        ("a,b\n", "x=a mm", "no rows below the header"),
        ("1,2\n", "x=#3 mm", "log.csv: `x`: there is no column 3, the file has 2 columns"),
        ("// nothing\n", "x=#3 mm", "no rows"),
        ("a,b\n1,2\n", "j1=a", r"--map: column `a` of `j1` has no unit; write `j1=a deg`, or one of deg"),
        ("a,b\n1,2\n", "temperature=b", "`temperature` has no unit; write `temperature=b C`"),
    ],
)
def test_logs(tmp_path, text, map_, words):
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    with pytest.raises(BayescalError, match=words):
        columns_of(read_log(tmp_path / "log.csv"), read_map(map_, 6))


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"robot": ""}, "--robot: the robot is not stated"),
        (
            {"map": ""},
            "log.csv: the contents and units of the columns are not stated.* A1, A2, .*, Y, Z",
        ),
        ({"format": "xlsx"}, "--format: `xlsx` is not known; must be csv or robodk"),
        ({"noise": ""}, "--noise: the uncertainty of the instrument is not stated"),
        ({"noise": "0.03"}, "--noise: '0.03' is not 1 number and a unit of length"),
        ({"map": "j*=A* deg"}, "no points, and no template"),
        ({"map": "j*=A* deg, x=X mm"}, "`y` is not mapped, `x` is"),
        ({"map": "j1=A1 deg, x=X mm, y=Y mm, z=Z mm"}, "`j2` is not mapped, `j1` is"),
        ({}, "2 points of `tracker` do not determine its position; give at least 6"),
    ],
)
def test_requests(tmp_path, said, words):
    log = tmp_path / "log.csv"
    log.write_text("A1,A2,A3,A4,A5,A6,X,Y,Z\n" + "1,2,3,4,5,6,7,8,9\n" * 2, encoding="utf-8")
    usual = {"map": "j*=A* deg, x=X mm, y=Y mm, z=Z mm", "robot": ARM, "noise": "10 um"}
    with pytest.raises(BayescalError, match=words):
        convert(Request(log, **{**usual, **said}))


@pytest.mark.parametrize(
    ("row", "columns"),
    [("1.5 2 3", "345"), ("P1, 1.5, 2, 3", "P1"), ("A::B 7 1.5 2 3", None), ("P1 1.5 2 3 0.1", None)],
)
def test_which_columns_are_points(tmp_path, row, columns):
    """Where names and numbers cannot be told apart, it is asked for."""
    from bayescal.importing.ask import points_map

    (tmp_path / "p.txt").write_text(f"{row}\n{row}\n", encoding="utf-8")
    log = read_log(tmp_path / "p.txt")
    if columns is None:
        with pytest.raises(BayescalError, match="it is not clear which of the 5 columns are x, y, z"):
            points_map(log, "mm")
        return
    got = columns_of(log, points_map(log, "mm"))
    np.testing.assert_allclose([got.numbers[k][1] for k in "xyz"], [1.5e-3, 2e-3, 3e-3])
