"""A recording leaves out what is not reproducible, and a comparison sees an altered digit."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from cases import cases

from analysis.golden import compared, keep, normalised

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


@pytest.mark.parametrize(("name", "a", "b"), cases("golden_changes"))
def test_an_altered_digit_is_seen(tmp_path, name, a, b):
    assert list(compared(recording(tmp_path / "a"), recording(tmp_path / "b", name, a, b))) == [name]


@pytest.mark.parametrize("array", [[1.0, 5.12801, np.nan], [1.0, 5.128, 0.0], [1.0, 5.128]])
def test_an_altered_array_is_seen(tmp_path, array):
    other = recording(tmp_path / "b", array=np.array(array))
    assert list(compared(recording(tmp_path / "a"), other)) == ["posterior.nc.npz"]


@pytest.mark.parametrize(("name", "a", "b"), [
    ("fit.json", "1.2.3", "1.2.4"),
    ("fit.json", "1.23456789012", "1.23456789013"),
    ("page.html", ">9<", ">8<"),
])  # fmt: skip
def test_what_is_not_reproducible_is_left_out(tmp_path, name, a, b):
    assert not compared(recording(tmp_path / "a"), recording(tmp_path / "b", name, a, b))


def test_a_missing_file_is_seen(tmp_path):
    a, b = recording(tmp_path / "a"), recording(tmp_path / "b")
    (b / "arm.urdf").unlink()
    assert compared(a, b) == {"arm.urdf": ["only in A"]}


def test_a_crash_is_seen_though_both_have_it(tmp_path):
    for text, number in (("bayescal: no such file\n", 0), ("Traceback (most recent call last):\n", 1)):
        a, b = tmp_path / f"a{number}", tmp_path / f"b{number}"
        for folder in (a, b):
            folder.mkdir()
            (folder / "stderr").write_text(text)
        assert len(compared(a, b)) == number


def test_paths_progress_and_versions_are_left_out():
    text = "estimate 25 %, 10 s\nwritten /w/run, bayescal 0.1.0, numpy 2.4.6; 3.1 mm\n25 % of it, 10 s\n"
    assert normalised(text, {Path("/w"): "WORK"}) == "written WORK/run, VERSIONS; 3.1 mm\n25 % of it, 10 s\n"
