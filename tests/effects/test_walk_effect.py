"""An effect is one definition and one entry: a made-up one is added, and no other file names an effect."""

import ast
from pathlib import Path

import pytest
from cases import cases, file_text
from sessions import plain

import bayescal as bc
from bayescal.effects import ALWAYS, EFFECTS, MODELS, location

ROOT = Path(__file__).parents[2]
ENTRY = "[bayescal.effects]\ncable-drag = cable_drag:CABLE_DRAG\n"


def test_a_made_up_effect_is_one_file_and_one_entry(tmp_path, monkeypatch):
    """Simulated, fitted, and named by a diagnosis without it, with nothing else changed."""
    (tmp_path / "cable_drag.py").write_text(file_text("walks/cable_drag.txt"))
    made_up = tmp_path / "cable_drag-1.0.dist-info"
    made_up.mkdir()
    (made_up / "METADATA").write_text("Metadata-Version: 2.1\nName: cable-drag\nVersion: 1.0\n")
    (made_up / "entry_points.txt").write_text(ENTRY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(EFFECTS, "_effects", dict(EFFECTS._effects))
    monkeypatch.setattr(EFFECTS, "_complete", False)  # as at the start of a program
    few = {"contacts": 100, "later": 20, "repeats": 4, "spheres": 1, "placements": 1, "seed": 3}
    session = plain(bc.simulate(effects="geometry, compliance, cable-drag", **few).dataset)
    row = bc.fit(session, "geometry, compliance, cable-drag", samples=0).parameters.loc["cable-drag"]
    assert (row.effect, row.u < 0.3 * row.prior_sd) == ("cable-drag", True)
    gap = bc.diagnose(session, "geometry, compliance")
    assert (gap.verdict, gap.data.verdict.credible_set90) == ("named", ("cable-drag",))
    assert "is pulled by a cable" in str(gap)


WORDS = {"joint", "tool", "payload", "step", "artefact", "coupling"}
"""Names of effects that are also words of other things: keys, columns and kinds of sites."""
ALLOWED = cases("words_of_effects")
"""Modules that name an effect because of its physics, and why."""


def own_words(path: Path) -> set[str]:
    """Effects that a module names: in a text that is no docstring, or by an import of the effect."""
    constants = {name.replace("-", "_").upper() for name in (*MODELS, *ALWAYS)}
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in docstrings and isinstance(node.value, str):
            found |= {node.value} & (set(MODELS) - WORDS)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayescal.effects."):
            names = set() if node.module == location.__name__ else {alias.name for alias in node.names}
            found |= names & constants
    return found


def test_no_other_module_names_an_effect():
    naming = {}
    for path in sorted((ROOT / "bayescal").rglob("*.py")):
        name = path.relative_to(ROOT / "bayescal").as_posix()
        if not name.startswith("effects/") and (found := own_words(path)):
            naming[name] = found
    assert not {name: found for name, found in naming.items() if not any(map(name.startswith, ALLOWED))}
    assert not [allowed for allowed in ALLOWED if not any(name.startswith(allowed) for name in naming)]


@pytest.mark.parametrize(("text", "words"), [
    ("NAMES = ('backlash', 'x')", {"backlash"}),
    ("from bayescal.effects.readings import GEAR_MESH", {"GEAR_MESH"}),
    ("'''backlash'''\nfrom bayescal.effects.common import sides\nX = 'step'", set()),
])  # fmt: skip
def test_a_module_that_names_an_effect_is_seen(text, words, tmp_path):
    (tmp_path / "module.py").write_text(text)
    assert own_words(tmp_path / "module.py") == words
