"""The walk of CONTRIBUTING for an export format: one file and one entry, and the command takes it."""

import json

import pytest
from cases import file_text
from export_arms import fake, session_of

from bayescal.errors import BayescalError
from bayescal.exporting import FORMATS
from bayescal.exporting.export import export


@pytest.fixture
def entry(tmp_path, monkeypatch):
    """The file in a temporary folder, and its entry."""
    (tmp_path / "made_up_format.py").write_text(file_text("walks/made_up_format.txt"))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(FORMATS, "made-up", "made_up_format:MADE_UP")


def test_the_help_lists_every_format(command):
    """First: a process makes the help once, with the formats of that time."""
    _, text, _ = command("export", "--help")
    words = "".join(text.replace("│", " ").split())  # lines end at hyphens of names
    assert f"Format:{','.join(FORMATS)},dcc." in words


def test_a_file_and_an_entry_are_a_format(entry, tmp_path):
    arm = fake(session_of(), ("geometry", "compliance"))
    path, sidecar = export(arm, "made-up", force=True, name="cell").save(tmp_path / "arm.txt")
    assert path.read_text().splitlines() == [f"J{k} cell" for k in range(1, 7)]
    record = json.loads(sidecar.read_text())
    assert record["format"] == "made-up"
    assert {item["element"] for item in record["written"]} == {f"line {k}" for k in range(2, 7)}
    (missing,) = record["not_expressed"]  # follows from what the format holds
    assert missing["effect"] == "compliance"
    assert "holds constants only" in missing["why"]
    assert missing["max_um"] > missing["rms_um"] > 0
    assert "a note of the made-up format" in record["notes"]


def test_the_command_takes_it(entry, tmp_path, monkeypatch, output_of):
    arm = fake(session_of(), ("geometry",))
    monkeypatch.setattr("bayescal.public.arms.arm_of", lambda *_: arm)
    output_of("export", "run", "--to", "made-up", "--force", "--out", tmp_path / "arm.txt")
    assert (tmp_path / "arm.txt").is_file()


def test_without_its_entry_there_is_no_such_format():
    with pytest.raises(BayescalError, match="there is no format `made-up`"):
        export(fake(session_of(), ("geometry",)), "made-up", force=True)
