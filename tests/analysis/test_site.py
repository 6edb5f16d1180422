"""Sources of the documentation site, without building it: navigation, links, anchors, pages of effects."""

import posixpath
import re

import pytest
import yaml
from cases import ROOT

from analysis.site import effects, scripts, signatures
from analysis.site.links import CODE, LINK, TOP, linked, page_of, source_of
from analysis.site.pages import entries, expanded
from bayescal.effects import EFFECTS

REFERENCE = ("reference/commands.md", "reference/python.md")
OWN = {p.relative_to(ROOT / "docs").as_posix(): p for p in (ROOT / "docs").rglob("*.md")}
INCLUDED = {page: ROOT / path for path, page in TOP.items() if path != "README.md"}
GENERATED = {*REFERENCE, *scripts.paths(), "effects/index.md", *(f"effects/{name}.md" for name in EFFECTS)}
PAGES = {*OWN, *INCLUDED, *GENERATED}


def navigation() -> list[str]:
    """Paths of the navigation in order, with patterns expanded."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    return entries(expanded(yaml.safe_load(text)["nav"], PAGES))


def test_every_page_is_in_the_navigation_once():
    shown = navigation()
    assert sorted(shown) == sorted(set(shown))
    assert set(shown) == PAGES


def test_the_site_opens_and_searches_from_the_disk():
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert settings["use_directory_urls"] is False
    assert [name for name in settings["plugins"] if isinstance(name, str)] == ["search", "offline"]
    added = settings["extra"]["polyfills"]
    # with this name the plugin `offline` does not add one that is loaded from a network
    assert [name for name in added if "iframe-worker" in name and (ROOT / "docs" / name).is_file()] == added
    assert "http" not in (ROOT / "docs" / added[0]).read_text(encoding="utf-8")


def slug(heading: str) -> str:
    """The anchor of a heading."""
    plain = re.sub(r"[`*]", "", heading)
    plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", plain)
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", plain).strip().lower())


def anchors(text: str) -> set[str]:
    return {slug(h) for h in re.findall(r"^#+ (.+)$", text, re.MULTILINE)}


@pytest.mark.parametrize("page", sorted({**OWN, **INCLUDED}), ids=str)
def test_links_lead_to_pages_and_headings(page):
    text, broken = linked({**OWN, **INCLUDED}[page].read_text(encoding="utf-8"), page)
    assert not broken
    for _, target in LINK.findall(CODE.sub("", text)):
        if re.match(r"[a-z]+:", target):
            continue
        to, _, anchor = target.partition("#")
        at = posixpath.normpath(posixpath.join(posixpath.dirname(page), to)) if to else page
        if not at.endswith(".md"):
            assert (ROOT / "docs" / at).exists(), target
            continue
        assert at in PAGES, target
        if anchor and at not in GENERATED:
            assert anchor in anchors({**OWN, **INCLUDED}[at].read_text(encoding="utf-8")), target


def test_readme_links_to_files_that_exist():
    for _, target in LINK.findall(CODE.sub("", (ROOT / "README.md").read_text(encoding="utf-8"))):
        assert re.match(r"[a-z]+:|#", target) or (ROOT / target.partition("#")[0]).exists(), target


def test_a_link_to_nowhere_is_reported():
    assert linked("see [x](../nowhere.py)", "gap.md") == ("see x (`nowhere.py`)", ["../nowhere.py"])
    assert linked("[c](../CONTRIBUTING.md#an-effect)", "gap.md")[0] == "[c](contributing.md#an-effect)"
    assert linked("[d](docs/gap.md)", "contributing.md")[0] == "[d](gap.md)"
    assert linked("`[x](../nowhere.py)`", "gap.md") == ("`[x](../nowhere.py)`", [])
    assert page_of("analysis/notebooks/first_fit.py") == "notebooks/first_fit.md"
    assert source_of("contributing.md") == "CONTRIBUTING.md"
    assert source_of("notebooks/first_fit.md") == "analysis/notebooks/first_fit.py"
    assert linked("[s](../../docs/study.md#x)", "notebooks/first_fit.md") == ("[s](../study.md#x)", [])
    assert source_of("notebooks/index.md") == "docs/notebooks/index.md"


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_states_formula_prior_and_remedy(name):
    text = effects.body(EFFECTS[name])
    assert "```math" in text, "add a line 'Formula: $`...`$.' to its docstring"
    assert re.search(r"[Pp]rior", text)
    assert EFFECTS[name].remedy


def test_a_constant_error_has_no_curve():
    """Its axis showed the numbers of the rows."""
    assert not signatures.signature("ball-radius").varies
    assert signatures.signature("backlash").varies


def test_formulas_are_read():
    why = "not in the extra `test`: latex2mathml"
    convert = pytest.importorskip("latex2mathml.converter", reason=why).convert
    for name in EFFECTS:
        formula = re.search(r"```math\n(.*?)\n```", effects.body(EFFECTS[name]), re.DOTALL)[1]
        assert convert(formula).startswith("<math")
        assert "\\" not in re.sub(r"<[^>]*>", "", convert(formula)), "a command that is not known"


def test_addedhave_a_title_and_an_end():
    for folder in scripts.SCRIPTS:
        for path in scripts.scripts(folder):
            assert scripts.title(path)
            assert "plt.show()" in path.read_text(encoding="utf-8"), path
