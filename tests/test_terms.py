"""Texts use the terms of the field: a table of words and phrases that no text of the program may contain."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from cases import ROOT, cases

TERMS = cases("terms")
"""What must not be written, as a regular expression of whole words, and what to write instead."""
PATTERN = re.compile(r"(?<![\w@./-])(?:" + "|".join(TERMS) + r")(?![\w/(]|\.\w|-\w)", re.IGNORECASE)

FOLDERS = ("analysis", "bayescal", "factors", "docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md")
NOT_YET: tuple[str, ...] = ()
"""Files and folders not covered yet; empty when all are."""


EXACT = cases("terms_of_the_contract")
"""String literals that are keys or units of the contract, and why."""


@cache
def parts(path: Path) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """Of a module, with their line numbers: literals; variables, parameters, fields, and its functions."""
    literals, bound, methods = list[tuple[int, str]](), list[tuple[int, str]](), set[ast.stmt]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            literals.append((node.lineno, node.value))
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            bound.append((node.lineno, node.id))
        elif isinstance(node, ast.arg):
            bound.append((node.lineno, node.arg))
        elif isinstance(node, ast.ClassDef):
            methods.update(node.body)
        elif isinstance(node, ast.FunctionDef) and node not in methods:
            bound.append((node.lineno, node.name))
    return literals, bound


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Line number and text of everything a user or reader sees: Markdown, docstrings, comments, literals."""
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        inside = False
        for k, line in enumerate(source.splitlines(), start=1):
            inside ^= line.lstrip().startswith("```")
            if not inside:
                yield k, re.sub(r"`[^`]*`|^\w+ = ", "", line)  # without the keys of TOML
        return
    for first, literal in parts(path)[0]:
        if literal not in EXACT:
            for k, line in enumerate(literal.splitlines(), start=first):
                yield k, re.sub(r"`[^`]*`", "", line)
    for k, line in enumerate(source.splitlines(), start=1):
        if found := re.search(r"(?:^|\s)# (.*)", line):
            yield k, re.sub(r"`[^`]*`", "", found.group(1))


def files() -> list[Path]:
    """Every file that must use the terms."""
    out: list[Path] = []
    for name in FOLDERS:
        at = ROOT / name
        found = [at] if at.is_file() else [p for p in at.rglob("*") if p.suffix in (".py", ".md", ".toml")]
        out += [p for p in found if not str(p.relative_to(ROOT)).startswith(NOT_YET or ("\0",))]
    return sorted(out)


def test_terms():
    found = [
        f"{path.relative_to(ROOT)}:{k}: '{m.group(0)}' in: {text.strip()}"
        for path in files()
        for k, text in texts(path)
        for m in PATTERN.finditer(text)
    ]
    assert not found, "\n".join(found)


VAGUE = {"own", "found", "at", "known", "rest", "left", "told"}
"""Names that say nothing of a value; a method is read with its object: `arm.at(...)`."""
ALLOWED = {
    ("bayescal/reporting/page/svg.py", "left"),  # a side
    ("bayescal/public/changes.py", "at"),  # the option `--at`
    ("bayescal/cli/evaluation.py", "at"),
}


SOURCES = [p for name in ("bayescal", "factors") for p in sorted((ROOT / name).rglob("*.py"))]
LONGEST = 400
"""Lines of a module."""


def test_no_module_is_too_long():
    sizes = {str(p): p.read_text(encoding="utf-8").count("\n") for p in SOURCES}
    assert {name: size for name, size in sizes.items() if size > LONGEST} == {}


def test_names_of_values_say_what_they_hold():
    vague = [
        f"{file}:{k}: {name}"
        for p in SOURCES
        for file in [p.relative_to(ROOT).as_posix()]
        for k, name in parts(p)[1]
        if name in VAGUE and (file, name) not in ALLOWED
    ]
    assert not vague, "\n".join(vague)
