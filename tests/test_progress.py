"""The progress of a command where no terminal shows a bar: lines on the error stream."""

import re
import time
from types import SimpleNamespace

import pytest

from bayescal.cli import progress as module
from bayescal.cli.progress import progress


@pytest.fixture
def written(capsys):
    """A function that returns the error stream's text as soon as a pattern is found in it."""
    parts = []

    def until(pattern: str = "") -> str:
        for _ in range(12_000):
            parts.append(capsys.readouterr().err)
            if re.search(pattern, "".join(parts)):
                return "".join(parts)
            time.sleep(0.01)
        return pytest.fail(f"never written: {pattern}")

    return until


def test_lines_state_stage_share_and_time_also_while_nothing_is_reported(monkeypatch, written):
    monkeypatch.setattr(module, "EVERY", 0.02)
    with progress("worlds") as notify:
        written(r"(worlds 0 %, \d+ s\n){2}")
        notify("sample", 0.256)
        written(r"sample 26 %, \d+ s\n")
        notify.say("a note")
    lines = written().splitlines()
    kinds = [line if line == "a note" else re.fullmatch(r"(\w+ \d+ %), \d+ s", line)[1] for line in lines]
    assert list(dict.fromkeys(kinds)) == ["worlds 0 %", "sample 26 %", "a note"]
    assert kinds[-1] == "a note"


def test_a_short_command_writes_none(capsys):
    with progress() as notify:
        notify("estimate", 0.5)
    assert capsys.readouterr() == ("", "")


def test_a_long_command_writes_few(monkeypatch, capsys):
    """An hour in simulated time."""
    now = 0.0

    def wait(seconds: float) -> bool:
        nonlocal now
        now += seconds
        return now > 3600.0

    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    module._Lines("sample", begin=0.0, ended=SimpleNamespace(wait=wait)).watch()
    out, err = capsys.readouterr()
    assert not out
    seconds = [int(re.fullmatch(r"sample 0 %, (\d+) s", line)[1]) for line in err.splitlines()]
    assert seconds[:10] == list(range(5, 55, 5))
    assert 3200 < seconds[-1] <= 3600
    assert 40 < len(seconds) < 60
