"""The progress of a command where no terminal shows a bar: lines on the error stream."""

import re
import time

from bayescal.cli import progress as module
from bayescal.cli.progress import progress


def test_lines_state_stage_share_and_time_also_while_nothing_is_reported(monkeypatch, capsys):
    monkeypatch.setattr(module, "EVERY", 0.05)
    with progress("worlds") as notify:
        time.sleep(0.12)
        notify("sample", 0.256)
        time.sleep(0.12)
        notify.say("a note")
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert not out
    assert all(re.fullmatch(r"(worlds 0|sample 26) %, 0 s|a note", line) for line in lines)
    assert set(lines) == {"worlds 0 %, 0 s", "sample 26 %, 0 s", "a note"}


def test_a_short_command_writes_none_and_a_long_one_few(monkeypatch, capsys):
    with progress() as notify:
        notify("estimate", 0.5)
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(module, "EVERY", 0.01)
    monkeypatch.setattr(module, "GROWTH", 1.0)  # each line doubles the time
    with progress():
        time.sleep(0.4)
    assert 3 <= len(capsys.readouterr().err.splitlines()) <= 7
