"""The kills of `analysis.kills` in small, and what its judgement sees."""

import json
import sys
from collections import Counter
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from analysis.kills import COMMANDS, SIDECAR, contents, kills, state
from bayescal.folders import whole


def test_killed_commands_leave_nothing_or_a_complete_result(tmp_path):
    found = sum(kills(["init"], 4, 1, tmp_path).values(), Counter())
    assert found["runs"] == 4
    assert not found["DAMAGED"]
    assert found["killed"]


def written(folder, text):
    with whole(folder / "fit", "fit.json") as stage:
        (stage / "fit.json").write_text(text)


def test_what_is_incomplete_is_seen(tmp_path):
    fit, out = COMMANDS["fit"], tmp_path / "fit"
    assert state(fit, tmp_path, {}) == "nothing"
    written(tmp_path, "first")
    before = contents(out)
    assert state(fit, tmp_path, before) == "earlier"
    written(tmp_path, "second")
    assert state(fit, tmp_path, before) == "new"
    (out / "fit.json").write_text("sec")
    assert state(fit, tmp_path, before) == "DAMAGED"
    (out / "fit.json").unlink()
    assert state(fit, tmp_path, before) == "DAMAGED"


@pytest.mark.parametrize(("sha256", "found"), [("", "DAMAGED"), (None, "new")])
def test_a_file_and_its_sidecar_are_of_one_export(tmp_path, sha256, found):
    out = tmp_path / "arm.urdf"
    out.write_text("<robot/>")
    record = {"sha256": contents(out)["arm.urdf"] if sha256 is None else sha256}
    out.with_name(out.name + SIDECAR).write_text(json.dumps(record))
    assert state(COMMANDS["export"], tmp_path, {}) == found
