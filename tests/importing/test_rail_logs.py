"""Logs of an arm on a rail: positions in any unit of length, and units that are not of a length."""

import numpy as np
import pytest
from rails import folder_of
from typer.testing import CliRunner

from analysis.world import rail
from bayescal.cli import app
from bayescal.dataset import read_dataset

JOINTS = ", ".join(f"j{k}=A{k - 1} deg" for k in range(2, 8))
MAP = f"id=P, j1=Rail, {JOINTS}, x=X mm, y=Y mm, z=Z mm"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A session, and a log of it with the position in metres."""
    folder = folder_of(rail.make(3, 40), tmp_path_factory.mktemp("log"))
    _, *rows = (folder / "measurements.csv").read_text().splitlines()
    lines = ["P,Rail [m],A1,A2,A3,A4,A5,A6,X,Y,Z"]
    for row in rows:
        name, _, _, position, *others = row.split(",")
        lines.append(",".join([name, repr(float(position) / 1e3), *others]))
    (folder / "log.csv").write_text("\n".join([*lines, ""]))
    return folder


def imported(folder, out, map_):
    arguments = ["import", folder / "log.csv", "--template", folder, "--map", map_, "--out", out]
    return CliRunner().invoke(app, list(map(str, arguments)), env={"COLUMNS": "200"})


def test_a_position_in_metres(folder, tmp_path):
    found = imported(folder, tmp_path / "out", MAP)
    assert found.exit_code == 0, found.output
    assert "j1 = Rail m" in found.output
    readings = read_dataset(tmp_path / "out").measurements.readings
    np.testing.assert_allclose(readings, read_dataset(folder).measurements.readings, atol=1e-9)


@pytest.mark.parametrize(("old", "new", "words"), [
    ("j1=Rail", "j1=Rail deg", "`deg` is a unit of angle, not of length"),
    ("j2=A1 deg", "j2=A1 mm", "`mm` is a unit of length, not of angle"),
    ("j1=Rail", "j1_deg=Rail", "not of length"),
])  # fmt: skip
def test_units_of_another_kind(folder, tmp_path, old, new, words):
    found = imported(folder, tmp_path / "out", MAP.replace(old, new))
    assert found.exit_code == 1
    assert words in str(found.exception) + found.output
    assert not (tmp_path / "out").exists()


def test_formats_of_controllers_are_refused(folder, tmp_path):
    given = ["--template", folder, "--format", "robodk", "--out", tmp_path / "out"]
    found = CliRunner().invoke(app, list(map(str, ["import", folder / "log.csv", *given])))
    assert "RAIL is prismatic: logs of robodk" in str(found.exception) + found.output
