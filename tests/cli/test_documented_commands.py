"""Commands in README, CONTRIBUTING, docs and `--help`: they parse, and make targets and modules exist."""

import ast
import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer
from cases import ROOT, refused
from click.testing import CliRunner

from bayescal.cli import app
from bayescal.posterior.sample import sample

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
LINE = re.compile(r"^(?: {4})?(?:\$ )?(bayescal [a-z].*)$", re.MULTILINE)
INLINE = re.compile(r"`(bayescal [^`]+)`")
MAKE = re.compile(r"(?:^ {4}|`)make ([a-z-]+)", re.MULTILINE)
MODULE = re.compile(r"python -m ((?:bayescal|analysis)[\w.]*)")


def parsed(command: str, partly: bool = False) -> None:
    """Parse a command as the console script would; optional parts may stand in brackets.

    `partly`: what a command requires may be missing, as in a sentence that only names it.
    """
    words = shlex.split(re.sub(r"[\[\]]", "", command), comments=True)[1:]
    found = commands()["bayescal"]
    context = found.make_context("bayescal", words, resilient_parsing=partly)
    while hasattr(found, "resolve_command"):
        rest = [*context._protected_args, *context.args]
        if not rest and partly:
            return
        name, found, rest = found.resolve_command(context, rest)
        context = found.make_context(name, rest, parent=context, resilient_parsing=partly)


def occurrences(pattern: re.Pattern[str]) -> list:
    """What a pattern finds on all pages, once each, with the first page that has it."""
    found: dict[str, str] = {}
    for page in PAGES:
        for text in pattern.findall(page.read_text(encoding="utf-8").replace("\\\n", " ")):
            found.setdefault(text, page.name)
    return [pytest.param(text, id=f"{page}: {text[:60]}") for text, page in found.items()]


@pytest.mark.parametrize("command", occurrences(LINE))
def test_every_command_of_a_code_block_parses(command):
    parsed(command)


@cache
def commands(group=None, name: str = "bayescal") -> dict:
    """Every command and group of the command line by its words, and what parses it; made once."""
    group = group or typer.main.get_command(app)
    out = {name: group}
    for word, found in getattr(group, "commands", {}).items():
        out |= commands(found, f"{name} {word}")
    return out


@pytest.mark.parametrize("name", commands())
def test_help_ends_with_two_examples_that_parse(name):
    examples = LINE.findall(commands()[name].epilog)
    assert len(examples) == 2
    words = [*name.split()[1:], "--help"]
    shown = CliRunner().invoke(commands()["bayescal"], words, terminal_width=150).output
    assert [line.strip() for line in shown.strip().splitlines()[-2:]] == examples
    for example in examples:
        assert f"{example} ".startswith(f"{name} ")
        parsed(example)


@pytest.mark.parametrize("command", occurrences(INLINE))
def test_every_command_in_a_sentence_has_its_options(command):
    parsed(command, partly=True)


@pytest.mark.parametrize("command", [
    "bayescal fit cell --sample 0",
    "bayescal fitt cell",
    "bayescal check one two",
    "bayescal fit",
    "bayescal fit cell --samples some",
])  # fmt: skip
def test_a_command_that_does_not_parse_is_seen(command):
    with pytest.raises(Exception, match=r"(?i)no such|unexpected|missing|valid integer"):
        parsed(command)


def targets() -> dict[str, str]:
    """Recipes of the Makefile by target."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    return dict(re.findall(r"^([a-z-]+):(?!=)[^\n]*\n((?:\t.*\n)*)", text, re.MULTILINE))


@pytest.mark.parametrize("target", occurrences(MAKE))
def test_every_make_target_exists(target):
    assert target in targets()


def test_the_two_commands_of_the_readme_do_what_it_says():
    """`make fit` is the command that README states; `make test` runs the suite, and the gate runs it."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    stated = re.search(r"^ {4}make fit +#.*: (bayescal .*)$", readme, re.MULTILINE)[1]
    recipe = targets()["fit"].strip()
    assert recipe.startswith(f"$(BIN)/{stated} ")
    parsed(recipe.removeprefix("$(BIN)/").replace("$(OUT)", "runs"))
    assert re.search(r"^ {4}make test ", readme, re.MULTILINE)
    assert targets()["test"].strip().startswith("$(BIN)/python -m pytest ")
    assert "make test" in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("module", occurrences(MODULE))
def test_every_module_that_is_run_exists(module):
    assert find_spec(module) or find_spec(f"{module}.__main__")


def test_every_heading_of_a_release_is_there_once():
    """Bullets that merges leave below the heading of others are found by their second heading."""
    for release in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1:]:
        headings = re.findall(r"^### .*$", release, re.MULTILINE)
        assert len(headings) == len(set(headings))
        assert not re.search(r"^- .*(?:\n  .*)*\n\n(?=- )", release, re.MULTILINE), "a gap between bullets"


# --- `bayescal --help` answers at once: the libraries that compute are loaded by the commands that use them.

HEAVY = ("numpy", "scipy", "gtsam", "matplotlib", "numba", "rich", "yaml", "emcee", "arviz", "xarray", "h5py")
PROGRAM = """
import contextlib, io, sys
from bayescal.cli import main
said = io.StringIO()
for words in {requests}:
    sys.argv = ["bayescal", *words, "--help"]
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        main()
print((said.getvalue().count("Usage: "), sorted(sys.modules)))
"""


def loaded(*requests: tuple[str, ...]) -> set[str]:
    """The modules that are loaded once the help of each of `requests` has been printed by one process."""
    program = PROGRAM.format(requests=requests)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    printed, modules = ast.literal_eval(done.stdout)
    assert printed == len(requests), done.stdout
    return set(modules)


def test_help_loads_no_library_that_computes():
    # pydantic too: bayescal declares its files with it, and loading it takes a tenth of a second
    assert loaded(()).isdisjoint({*HEAVY, "pydantic", "bayescal.dataset", "bayescal.robots"})


def test_help_of_every_command_loads_no_library_that_computes():
    # here typer may load pydantic for itself, to convert arguments
    names = [words for name in commands() if len(words := tuple(name.split()[1:])) == 1]
    assert {("fit",), ("schema",), ("robots",)} < {*names}
    assert loaded(*names).isdisjoint({*HEAVY, "bayescal.dataset", "bayescal.robots"})


def test_every_module_with_a_command_is_listed():
    from bayescal.cli import entry

    modules = Path(entry.__file__).parent.glob("*.py")
    with_app = {f"bayescal.cli.{p.stem}" for p in modules if "\n@command(" in p.read_text("utf-8")}
    assert with_app == with_app & loaded(()) != set()


@pytest.mark.parametrize("library", ["numpy", "pydantic"])
def test_a_library_loaded_too_early_would_be_seen(library, tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text(f"import {library}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    assert library in loaded(())


# --- The tutorial's commands, word for word and in order, and what the page says of their results.

FENCE = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
LINES = "".join(FENCE.findall(TUTORIAL)).replace("\\\n", " ").splitlines()
TUTORIAL_COMMANDS = list(filter(None, LINES))


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What each command prints, by its name; all run in one folder, by the console script's function."""
    from bayescal.cli import main

    out: dict[str, str] = {"folder": str(tmp_path_factory.mktemp("tutorial"))}
    arguments = sys.argv

    def quick(found, count, *more, **own):
        return sample(found, 100, *more, **own)

    with contextlib.chdir(out["folder"]), pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.posterior.sample.sample", quick)
        for command in TUTORIAL_COMMANDS:
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
    names = [shlex.split(command)[1] for command in TUTORIAL_COMMANDS]
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

    refused("FILL_IN", lambda: bc.fit(Path(said["folder"]) / "cell", samples=0))
