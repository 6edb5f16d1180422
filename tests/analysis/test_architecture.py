"""The rooms of the code as docs/architecture.md shows them, and no import around a circle."""

import re
from collections import Counter
from graphlib import CycleError, TopologicalSorter

import grimp
import pytest
from cases import ROOT

from analysis import architecture

SOURCE = '''"""A docstring
of two lines."""

# a comment
VALUE = """a text
is code"""


def f():
    """Docstring."""
    return (1,
            2)  # two lines
'''


def test_lines_with_code_are_counted():
    assert architecture.code_lines(SOURCE) == 5


@pytest.mark.parametrize(
    ("module", "room"),
    [
        ("bayescal.arm.chain", "arm"),
        ("bayescal.errors", "errors"),
        ("factors.contacts", "factors"),
        ("bayescal", "bayescal"),
    ],
)
def test_the_room_of_a_module(module, room):
    assert architecture.room_of(module) == room


def test_imports_that_follow_from_others_are_not_drawn():
    pairs = Counter({("a", "b"): 1, ("b", "c"): 1, ("a", "c"): 5})
    assert architecture.reduced(pairs) == {("a", "b"), ("b", "c")}
    assert architecture.circles(pairs + Counter({("c", "b"): 1})) == [("b", "c")]


def test_the_page_shows_the_rooms_and_imports_of_the_code(monkeypatch):
    monkeypatch.setattr(architecture, "code_lines", len)  # counted above, in seconds for all files
    pairs, rooms = architecture.arrows(), architecture.sizes()
    assert not architecture.circles(pairs)
    drawn = {
        tuple(pair.split()) for pair in re.findall(r'class="(\w+ \w+)"', architecture.PICTURE.read_text())
    }
    assert drawn == architecture.reduced(pairs), "python -m analysis.architecture --write"
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"\*\*(\w+)\*\*", page))
    assert named == rooms.keys() - {"bayescal"}


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph("bayescal", "factors", exclude_type_checking_imports=True, cache_dir=None)


def circle(imports: dict[str, set[str]]) -> list[str]:
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_files_import_each_other(graph):
    imports = {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}
    assert not circle(imports)
    assert circle(imports | {"bayescal.errors": {"bayescal.cli"}})


def test_every_folder_has_several_importers(graph):
    """A folder that one file alone imports belongs to that file; nothing imports the commands."""
    folders = {m.rpartition(".")[0] for m in graph.modules} - {"", "bayescal", "factors", "bayescal.cli"}
    for folder in folders:
        inside = {m for m in graph.modules if m == folder or m.startswith(f"{folder}.")}
        importers = {m for each in inside for m in graph.find_modules_that_directly_import(each)} - inside
        assert len(importers) > 1, folder
