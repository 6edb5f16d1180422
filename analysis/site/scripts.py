"""Notebooks and examples as pages: scripts that are run when the site is built, with their output."""

from __future__ import annotations

import ast
import contextlib
import hashlib
import io
import os
import pickle
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import jupytext
import matplotlib

from analysis.site.links import ROOT, SCRIPTS

KEPT = ROOT / ".cache" / "site"
"""Outputs of earlier builds."""
SETTINGS = {"BAYESCAL_NOTEBOOK_CANDIDATES": "1000", "BAYESCAL_NOTEBOOK_SAMPLES": "2000"}
"""Settings of notebooks for the site, which is built in minutes."""


@dataclass
class Page:
    """A page in work: its Markdown, and its pictures by file name."""

    stem: str
    parts: list[str] = field(default_factory=list)
    pictures: dict[str, bytes] = field(default_factory=dict)

    @property
    def markdown(self) -> str:
        """The whole page."""
        return "\n\n".join(self.parts) + "\n"


def scripts(folder: str) -> list[Path]:
    """Scripts of a folder of the repository, in the order of their pages."""
    return sorted(path for path in (ROOT / folder).glob("*.py") if not path.stem.startswith("_"))


def paths() -> Iterator[str]:
    """Paths of all pages of scripts."""
    for folder, to in SCRIPTS.items():
        yield f"{to}/index.md"
        yield from (f"{to}/{path.stem}.md" for path in scripts(folder))


def title(path: Path) -> str:
    """The title of a script: its first heading."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(line.removeprefix("# # ") for line in lines if line.startswith("# # "))


def fenced(text: str, kind: str) -> str:
    """A block of code or output."""
    return f"```{kind}\n{text.rstrip()}\n```"


@cache
def sources() -> bytes:
    """A digest of the program, its data and `SETTINGS`: outputs are kept while it is the same."""
    digest = hashlib.sha256(repr(sorted(SETTINGS.items())).encode())
    for folder in ("bayescal", "factors", "data"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.read_bytes())
    return digest.digest()


@cache
def run(path: Path) -> Page:
    """The page of a script: run, or as an earlier build left it if nothing has changed since."""
    name = hashlib.sha256(sources() + path.read_bytes()).hexdigest()[:32]
    kept = KEPT / f"{path.stem}-{name}.pickle"
    if kept.exists():
        return pickle.loads(kept.read_bytes())
    os.environ.update(SETTINGS)
    page = executed(path)
    KEPT.mkdir(parents=True, exist_ok=True)
    for old in KEPT.glob(f"{path.stem}-{'?' * 32}.pickle"):
        old.unlink()
    kept.write_bytes(pickle.dumps(page))
    return page


def executed(path: Path) -> Page:
    """Run a script cell by cell, in its folder, as a notebook does."""
    page, space = Page(path.stem), {"__name__": "__main__"}
    notebook = jupytext.read(path, fmt="py:percent")
    matplotlib.use("Agg")
    with contextlib.chdir(path.parent):
        for cell in notebook.cells:
            if cell.cell_type == "markdown":
                page.parts.append(cell.source)
                continue
            page.parts.append(fenced(cell.source, "python"))
            if not _cell(page, cell.source, space):
                break
    return page


def _cell(page: Page, source: str, space: dict[str, Any]) -> bool:
    """Run a cell and add its output; return False where the script ends early."""
    from matplotlib import pyplot as plt

    tree, last = ast.parse(source), None
    if tree.body and isinstance(tree.body[-1], ast.Expr):
        last = ast.Expression(tree.body.pop().value)  # type: ignore[attr-defined]
    said, value, going = io.StringIO(), None, True
    with contextlib.redirect_stdout(said):
        try:
            exec(compile(tree, page.stem, "exec"), space)
            value = eval(compile(last, page.stem, "eval"), space) if last else None
        except SystemExit as end:
            print(end)
            going = False
    if text := said.getvalue():
        page.parts.append(f'<div class="output" markdown="1">\n\n{fenced(text, "text")}\n\n</div>')
    if value is not None and (html := getattr(value, "_repr_html_", None)):
        page.parts.append(f'<div class="output">{html()}</div>')
    for number in plt.get_fignums():
        name = f"{page.stem}-{len(page.pictures) + 1}.png"
        picture = io.BytesIO()
        plt.figure(number).savefig(picture, format="png", dpi=100)
        page.pictures[name] = picture.getvalue()
        page.parts.append(f"![Figure {len(page.pictures)} of {page.stem}]({name})")
    plt.close("all")
    return going


def _folder_of(page: str) -> tuple[str, str]:
    folder, _, name = page.partition("/")
    return next(source for source, to in SCRIPTS.items() if to == folder), name


def texts() -> dict[str, str]:
    """Pages of all scripts, by path."""
    out = {}
    for page in paths():
        folder, name = _folder_of(page)
        out[page] = (
            index(folder) if name == "index.md" else _shown(ROOT / folder / name.replace(".md", ".py"))
        )
    return out


def _shown(path: Path) -> str:
    return f"{run(path).markdown}\n---\n\nThis page is the output of `{path.relative_to(ROOT)}`.\n"


def pictures() -> dict[str, bytes]:
    """Pictures of all scripts, by path."""
    return {
        f"{to}/{name}": picture
        for folder, to in SCRIPTS.items()
        for path in scripts(folder)
        for name, picture in run(path).pictures.items()
    }


INDEX = {
    "analysis/notebooks": "# Notebooks\n\nComplete analyses, with their output. Open a script in Jupyter "
    "with jupytext (`pip install .[notebook]`), or run it with Python.",
    "analysis/examples": "# Examples\n\nShort scripts; each runs in a few seconds.",
}


def index(folder: str) -> str:
    """A gallery of the scripts of a folder: title and first figure."""
    cards = []
    for path in scripts(folder):
        first = next(iter(run(path).pictures), None)
        picture = f'<img src="{first}" alt="">' if first else ""
        cards.append(f'<a href="{path.stem}.html">{picture}<br>{title(path)}</a>')
    return f'{INDEX[folder]}\n\n<div class="gallery">\n' + "\n".join(cards) + "\n</div>\n"
