"""Links between pages of the site and files of the repository.

Pages link to files as GitHub shows them (``../CONTRIBUTING.md``, ``docs/api.md``). On the site such a link
leads to the page of that file; a file without a page is named by its path.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(?<!!)\[([^\]\n]*)\]\(([^)\s]+)\)")
CODE = re.compile(r"(^```.*?^```$|`[^`\n]*`)", re.MULTILINE | re.DOTALL)

TOP = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
"""Files at the top of the repository, and their pages."""
SCRIPTS = {"analysis/notebooks": "notebooks", "analysis/examples": "examples"}
"""Folders of scripts that are shown with their output, and the folders of their pages."""


def page_of(path: str) -> str | None:
    """The page of a file or folder of the repository, or None if it has none."""
    folder, name = posixpath.split(path)
    if path in TOP:
        return TOP[path]
    if path in SCRIPTS:
        return f"{SCRIPTS[path]}/index.md"
    if folder in SCRIPTS and name.endswith(".py"):
        return f"{SCRIPTS[folder]}/{name.removesuffix('.py')}.md"
    return path.removeprefix("docs/") if path.startswith("docs/") else None


def source_of(page: str) -> str:
    """The file of the repository from which a page is read; generated pages count as files of `docs`."""
    top = {page: path for path, page in TOP.items() if path != "README.md"}
    folder, name = posixpath.split(page)
    script = next(
        (f"{path}/{name.removesuffix('.md')}.py" for path, to in SCRIPTS.items() if to == folder), ""
    )
    return top.get(page) or (script if script and (ROOT / script).exists() else f"docs/{page}")


def linked(markdown: str, page: str) -> tuple[str, list[str]]:
    """A page with links to other pages, and its links that lead nowhere.

    Links between files of `docs` stay as they are: MkDocs checks them, with their anchors.
    """
    source, broken = source_of(page), []

    def link(match: re.Match[str]) -> str:
        text, target = match[1], match[2]
        if re.match(r"[a-z]+:|#", target):
            return match[0]
        target, _, anchor = target.partition("#")
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        if source.startswith("docs/") and path.startswith("docs/"):
            return match[0]
        if not (ROOT / path).exists():
            broken.append(match[2])
        to = page_of(path)
        if to is None:
            return text if text.strip("`") == path else f"{text} (`{path}`)"
        relative = posixpath.relpath(to, posixpath.dirname(page) or ".")
        return f"[{text}]({relative}{'#' + anchor if anchor else ''})"

    parts = CODE.split(markdown)
    return "".join(p if k % 2 else LINK.sub(link, p) for k, p in enumerate(parts)), broken
