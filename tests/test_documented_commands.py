"""Commands in README, CONTRIBUTING, docs and `--help`: they parse, and make targets and modules exist."""

import re
import shlex
from importlib.util import find_spec

import pytest
import typer
from cases import ROOT
from typer.testing import CliRunner

from bayescal.cli import app

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
    found = typer.main.get_command(app)
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


def commands(group=None, name: str = "bayescal") -> dict:
    """Every command and group of the command line by its words, and what parses it."""
    group = group or typer.main.get_command(app)
    out = {name: group}
    for word, found in getattr(group, "commands", {}).items():
        out |= commands(found, f"{name} {word}")
    return out


@pytest.mark.parametrize("name", commands())
def test_help_ends_with_two_examples_that_parse(name):
    examples = LINE.findall(commands()[name].epilog)
    assert len(examples) == 2
    shown = CliRunner().invoke(app, [*name.split()[1:], "--help"], terminal_width=150).output
    assert [line.strip() for line in shown.strip().splitlines()[-2:]] == examples
    for example in examples:
        assert f"{example} ".startswith(f"{name} ")
        parsed(example)


@pytest.mark.parametrize("command", occurrences(INLINE))
def test_every_command_in_a_sentence_has_its_options(command):
    parsed(command, partly=True)


@pytest.mark.parametrize(
    "command",
    [
        "bayescal fit cell --sample 0",
        "bayescal fitt cell",
        "bayescal check one two",
        "bayescal fit",
        "bayescal fit cell --samples some",
    ],
)
def test_a_command_that_does_not_parse_is_seen(command):
    with pytest.raises(Exception, match=r"(?i)no such|unexpected|missing|valid integer"):
        parsed(command)


def targets() -> dict[str, str]:
    """Recipes of the Makefile by target."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    return dict(re.findall(r"^([a-z-]+):[^=\n]*\n((?:\t.*\n)*)", text, re.MULTILINE))


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
