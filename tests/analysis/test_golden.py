"""A recording leaves out what is not reproducible, and a comparison sees an altered digit."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from analysis.golden import (
    CASES,
    commands,
    compared,
    keep,
    normalised,
    page_text,
    picture_size,
    recorded,
    slug,
)

FILES = {
    "fit.json": json.dumps(
        {"software": {"numpy": "1.2.3"}, "rms_um": 5.128, "a": 1.23456789012, "path": "/w/fit"}
    ),
    "page.html": "<p>RMS <b>5.128</b></p><script>9</script><script type='application/json'>[5.128]</script>",
    "arm.urdf": '<origin xyz="0.128 0 1e-3"/>\n',
}
ARRAY = np.array([1.0, 5.128, np.nan])


def recording(folder: Path, changed: str = "", a: str = "", b: str = "", array: np.ndarray = ARRAY) -> Path:
    """A recording of the files, in one of which `a` is replaced by `b`."""
    folder.mkdir()
    for name, text in FILES.items():
        source = folder / name
        source.write_text(text.replace(a, b) if name == changed else text)
        keep(source, folder / "kept" / name, {Path("/w"): "WORK"})
    with h5py.File(folder / "posterior.nc", "w") as file:
        file["posterior/a1"] = array
    keep(folder / "posterior.nc", folder / "kept" / "posterior.nc", {})
    return folder / "kept"


@pytest.mark.parametrize(
    ("name", "a", "b"),
    [
        ("fit.json", "5.128", "5.129"),
        ("fit.json", "1.23456789012", "1.23456799012"),
        ("fit.json", "rms_um", "rms_mm"),
        ("page.html", "<b>5.128", "<b>5.129"),
        ("page.html", "[5.128", "[5.129"),
        ("arm.urdf", "0.128", "-0.128"),
        ("arm.urdf", "1e-3", "1e-4"),
        ("arm.urdf", "0.128", "0.1280"),
        ("arm.urdf", "\n", "\nmore\n"),
    ],
)
def test_an_altered_digit_is_seen(tmp_path, name, a, b):
    assert list(compared(recording(tmp_path / "a"), recording(tmp_path / "b", name, a, b))) == [name]


@pytest.mark.parametrize("array", [[1.0, 5.12801, np.nan], [1.0, 5.128, 0.0], [1.0, 5.128]])
def test_an_altered_array_is_seen(tmp_path, array):
    other = recording(tmp_path / "b", array=np.array(array))
    assert list(compared(recording(tmp_path / "a"), other)) == ["posterior.nc.npz"]


@pytest.mark.parametrize(
    ("name", "a", "b"),
    [
        ("fit.json", "1.2.3", "1.2.4"),
        ("fit.json", "1.23456789012", "1.23456789013"),
        ("page.html", ">9<", ">8<"),
    ],
)
def test_what_is_not_reproducible_is_left_out(tmp_path, name, a, b):
    assert not compared(recording(tmp_path / "a"), recording(tmp_path / "b", name, a, b))


def test_a_missing_file_is_seen(tmp_path):
    a, b = recording(tmp_path / "a"), recording(tmp_path / "b")
    (b / "arm.urdf").unlink()
    assert compared(a, b) == {"arm.urdf": ["only in A"]}


def test_paths_progress_and_versions_are_left_out():
    text = "estimate 25 %, 10 s\nwritten /w/run, bayescal 0.1.0, numpy 2.4.6; 3.1 mm\n25 % of it, 10 s\n"
    assert normalised(text, {Path("/w"): "WORK"}) == "written WORK/run, VERSIONS; 3.1 mm\n25 % of it, 10 s\n"


def test_a_style_is_no_text_of_a_page():
    assert page_text(b"<style>p {}</style><p>a  b</p>") == "a b"


def test_every_command_of_a_session_has_a_folder_of_its_own():
    assert len(CASES) == 12
    for name in CASES:
        assert len({slug(c) for c in commands(name)}) == len(commands(name))


CLI = """
import os, pathlib, sys
print("in", os.getcwd(), *sys.argv[1:])
if "a" in sys.argv:
    pathlib.Path("old").write_text("1")
else:
    pathlib.Path("old").unlink()
    pathlib.Path("new").write_text("2")
    sys.exit("refused")
"""


def test_a_recording_holds_what_each_command_did(tmp_path, monkeypatch):
    (tmp_path / "code" / "bayescal").mkdir(parents=True)
    (tmp_path / "code" / "bayescal" / "__init__.py").touch()
    (tmp_path / "code" / "bayescal" / "cli.py").write_text(CLI)
    monkeypatch.setitem(CASES, "made-up", {"commands": "\nfit a\ngap b --out 'c d'\n"})
    recorded("made-up", tmp_path / "out", tmp_path / "code", tmp_path)
    out = tmp_path / "out" / "made-up"
    found = {str(p.relative_to(out)): p.read_text() for p in out.rglob("*") if p.is_file()}
    assert found == {
        "fit_a/exit": "0\n",
        "fit_a/stdout": "in WORK fit a\n",
        "fit_a/stderr": "",
        "fit_a/removed": "",
        "fit_a/files/old": "1",
        "gap_b_--out_c_d/exit": "1\n",
        "gap_b_--out_c_d/stdout": "in WORK gap b --out c d\n",
        "gap_b_--out_c_d/stderr": "refused\n",
        "gap_b_--out_c_d/removed": "old\n",
        "gap_b_--out_c_d/files/new": "2",
    }


def test_a_picture_is_its_size(tmp_path):
    from matplotlib.figure import Figure

    Figure(figsize=(3, 2), dpi=100).savefig(tmp_path / "a.png")
    assert picture_size((tmp_path / "a.png").read_bytes()) == "300 x 200 pixels"
