"""The tutorial's commands, word for word and in order, and what the page says of their results."""

import contextlib
import io
import json
import re
import shlex
import sys
from pathlib import Path

import pytest
from cases import ROOT

FENCE = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMANDS = [
    line
    for block in FENCE.findall((ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8"))
    for line in block.replace("\\\n", " ").splitlines()
    if line
]


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What each command prints, by its name; all run in one folder, by the console script's function."""
    from bayescal.cli import main

    out: dict[str, str] = {"folder": str(tmp_path_factory.mktemp("tutorial"))}
    arguments = sys.argv
    with contextlib.chdir(out["folder"]):
        for command in COMMANDS:
            program, *words = shlex.split(command)
            assert program == "bayescal"
            sys.argv = [program, *words]
            text, code = io.StringIO(), 0
            with contextlib.redirect_stdout(text):
                try:
                    main()
                except SystemExit as end:
                    code = end.code
            assert not code, f"{command}: {text.getvalue()}"
            out[words[0]] = text.getvalue()
    sys.argv = arguments
    return out


def test_the_path_of_a_newcomer_is_complete():
    names = [shlex.split(command)[1] for command in COMMANDS]
    assert list(dict.fromkeys(names)) == ["init", "simulate", "check", "fit", "gap", "report"]


def test_what_the_page_says_of_the_results(said):
    folder = Path(said["folder"])
    assert "!FILL_IN" in (folder / "cell" / "dataset.yaml").read_text(encoding="utf-8")
    assert "run bayescal gap" in said["fit"]
    assert "small residuals do not prove this calibration" in " ".join(said["fit"].split())
    gap = json.loads((folder / "runs" / "practice-gap" / "gap.json").read_text(encoding="utf-8"))
    assert gap["effects"] == ["backlash"]
    assert {a["effect"] for a in gap["amplitudes"]} == {"backlash"}
    for page in ("practice-fit.html", "practice-gap.html"):
        assert (folder / page).stat().st_size > 10_000


def test_a_setup_is_refused_until_it_is_filled_in(said):
    import bayescal as bc

    with pytest.raises(bc.BayescalError, match="FILL_IN"):
        bc.fit(Path(said["folder"]) / "cell", samples=0)
