"""Measured orientations in the conventions of makers, written down apart from the code under test."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import read_dataset
from bayescal.errors import BayescalError
from bayescal.importing import Request, convert, write
from bayescal.importing.orientations import flanges

ARM = "fanuc-lrmate200ic"


@pytest.fixture(scope="module")
def posed(tracker):
    """Points with errors of the arm; orientations of a nominal arm, whose tool is turned on its flange."""
    session = tracker(seed=3, count=40)
    data = session.dataset
    tool = rpy_matrix(np.array([0.2, -0.4, 1.0]))
    flange = flanges(data.robot, data.measurements.readings)[:, :3, :3]
    return data, session.frame[:3, :3].T @ flange @ tool


def rx(a):
    c, s = np.cos(a), np.sin(a)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def ry(a):
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rz(a):
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


MADE = {
    "wpr deg": lambda w, p, r: rz(r) @ ry(p) @ rx(w),
    "rpy deg": lambda w, p, r: rz(r) @ ry(p) @ rx(w),
    "abc deg": lambda a, b, c: rz(a) @ ry(b) @ rx(c),
    "zyx rad": lambda a, b, c: rz(a) @ ry(b) @ rx(c),
    "xyz deg": lambda a, b, c: rx(a) @ ry(b) @ rz(c),
    "oat deg": lambda o, a, t: rz(o) @ ry(a) @ rz(t),
}
"""Rotations of three angles."""


@pytest.mark.parametrize("words", MADE)
def test_angles(words):
    from bayescal.importing.rotations import matrices

    angles = np.random.default_rng(1).uniform(-1.5, 1.5, (5, 3))
    made = [MADE[words](*row) for row in angles]
    np.testing.assert_allclose(matrices(angles, words.split()[0]), made, atol=1e-12)


def written(data, turns, path, words):
    """A log with ids, joints, points, and orientations in columns o1, o2, ..."""
    rotation = Rotation.from_matrix(turns)
    kind = words.split()[0]
    numbers = {
        "wxyz": lambda: rotation.as_quat()[:, [3, 0, 1, 2]],
        "xyzw": lambda: -rotation.as_quat(),
        "rotvec": lambda: rotation.as_rotvec(),
        "matrix": lambda: turns.reshape(-1, 9),
        "matrix-columns": lambda: turns.transpose(0, 2, 1).reshape(-1, 9),
        "abc": lambda: np.degrees(rotation.as_euler("ZYX")),
        "wpr": lambda: np.degrees(rotation.as_euler("xyz")),
        "xyz": lambda: np.degrees(rotation.as_euler("XYZ")),
        "oat": lambda: np.degrees(rotation.as_euler("ZYZ")),
    }[kind]()
    m = data.measurements
    rows = np.column_stack([np.degrees(m.readings), 1e3 * m.xyz, numbers])
    width = numbers.shape[1]
    header = ["n", *(f"A{j}" for j in range(1, 7)), "X", "Y", "Z", *(f"o{k + 1}" for k in range(width))]
    lines = [",".join(header)] + [
        ",".join([i, *map(repr, row)]) for i, row in zip(m.ids, rows.tolist(), strict=True)
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return f"id=n, j*=A* deg, x=X mm, y=Y mm, z=Z mm, rotation={' '.join(header[10:])} {words}"


@pytest.mark.parametrize(
    "words",
    ["wxyz", "xyzw", "rotvec rad", "matrix", "matrix-columns", "abc deg", "wpr deg", "xyz deg", "oat deg"],
)
def test_comes_back(posed, tmp_path, words):
    data, turns = posed
    map_ = written(data, turns, tmp_path / "log.csv", words)
    got = convert(Request(tmp_path / "log.csv", map_, robot=ARM, noise="10 um, 0.01 deg"))
    np.testing.assert_allclose(rpy_matrix(got.dataset.measurements.rpy), turns, atol=1e-9)
    assert got.dataset.noise.orientation == pytest.approx(np.radians(0.01))
    assert got.wrong == ""
    assert any("of the nominal arm" in note and "orientations are read as" in note for note in got.notes)
    write(got, tmp_path / "out")
    again = read_dataset(tmp_path / "out").measurements
    np.testing.assert_allclose(rpy_matrix(again.rpy), turns, atol=1e-8)


@pytest.mark.parametrize(
    ("made", "stated"),
    [
        ("wxyz", "xyzw"),
        ("abc deg", "wpr deg"),
        ("matrix", "matrix-columns"),
        ("rotvec rad", "abc rad"),
        ("xyz deg", "abc deg"),
    ],
)
def test_another_convention_is_refused_and_the_right_one_named(posed, tmp_path, made, stated):
    data, turns = posed
    map_ = written(data, turns, tmp_path / "log.csv", made).replace(made, stated)
    draft = convert(Request(tmp_path / "log.csv", map_, robot=ARM, noise="10 um"))
    kind = made.split()[0]
    with pytest.raises(
        BayescalError, match=f"orientations as .* differ from the nominal arm by .* as {kind} by"
    ):
        write(draft, tmp_path / "out")
    write(draft, tmp_path / "out", force=True)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("rotation=o1 o2 o3 o4", "the convention of the orientation is not stated; write .*wxyz"),
        ("rotation=o1 o2 o3 abc", "the orientation has no unit; write `rotation=o1 o2 o3 abc deg`"),
        ("rotation=o1 o2 o3 o4 wxyz deg", "wxyz has no unit; remove `deg`"),
        ("rotation=o1 o2 o3 wxyz", "wxyz needs 4 columns, 3 are given"),
        ("rotation=A1 A2 A3 A4 wxyz", r"log.csv:2: \(.*\) is not a unit quaternion"),
        ("rotation=#2..#10 matrix", r"is not a rotation matrix; check the columns"),
        ("rotation=o1 o2 o3 o4 wxyz, rx=o1 deg, ry=o2 deg, rz=o3 deg", "`rotation` and `rx` are both mapped"),
        ("rx=o1 deg, ry=o2 deg", "`rz` is not mapped, `rx` is"),
    ],
)
def test_refused(posed, tmp_path, words, said):
    data, turns = posed
    map_ = written(data, turns, tmp_path / "log.csv", "wxyz").partition(", rotation")[0]
    with pytest.raises(BayescalError, match=said):
        convert(Request(tmp_path / "log.csv", f"{map_}, {words}", robot=ARM, noise="10 um"))


def test_the_frame_of_a_tool(posed, tmp_path):
    data, turns = posed
    map_ = written(data, turns, tmp_path / "log.csv", "wxyz")
    usual = {"robot": ARM, "noise": "10 um"}
    tool = "60 0 120 mm; 0.2 -0.4 1 wpr rad"
    got = convert(Request(tmp_path / "log.csv", map_, tool=tool, **usual))
    np.testing.assert_allclose(got.dataset.tools[0].rpy, [0.2, -0.4, 1.0], atol=1e-12)
    write(got, tmp_path / "out")
    np.testing.assert_allclose(read_dataset(tmp_path / "out").tools[0].rpy, [0.2, -0.4, 1.0], atol=1e-8)
    other = convert(Request(tmp_path / "log.csv", map_, tool=tool.replace("0.2", "1.2"), **usual))
    assert "orientations as wxyz differ from the nominal arm by 57 deg" in other.wrong
    for tool, words in (
        ("0 0 31 mm; 0 0 90 wpr", "'0 0 90 wpr' is not an orientation; write"),
        ("0 0 31 mm; 2 0 0 0 wxyz", "'2 0 0 0 wxyz' is not a unit quaternion"),
        ("0 0 31 mm; 0 0 x abc deg", "has a word that is not a number"),
    ):
        with pytest.raises(BayescalError, match=words):
            convert(Request(tmp_path / "log.csv", map_, tool=tool, **usual))
