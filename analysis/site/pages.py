"""The pages of the site that are generated, by their paths, and the order of all pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fnmatch import fnmatch
from typing import Any

from analysis.site import api, commands, effects, frames, scripts
from analysis.site.links import ROOT, TOP


def texts() -> dict[str, str]:
    """Markdown of the generated pages, by path."""
    out = {
        page: (ROOT / path).read_text(encoding="utf-8") for path, page in TOP.items() if path != "README.md"
    }
    out |= {"reference/commands.md": commands.page(), "reference/python.md": api.page()}
    return out | effects.texts() | scripts.texts()


def pictures() -> dict[str, bytes]:
    """Generated pictures, by path."""
    return {"pictures/frames.png": frames.picture()} | effects.pictures() | scripts.pictures()


def entries(nav: Any) -> list[str]:
    """Paths and patterns of a navigation, in order."""
    if isinstance(nav, str):
        return [nav]
    return [path for item in (nav.values() if isinstance(nav, Mapping) else nav) for path in entries(item)]


def expanded(nav: Any, paths: Iterable[str]) -> Any:
    """A navigation with every pattern replaced by the paths that match it and that it does not name."""
    named = set(entries(nav))
    free = sorted(set(paths) - named)

    def walk(item: Any) -> Any:
        if isinstance(item, Mapping):
            return {title: walk(below) for title, below in item.items()}
        if not isinstance(item, list):
            return item
        out: list[Any] = []
        for one in item:
            out += (
                [p for p in free if fnmatch(p, one)] if isinstance(one, str) and "*" in one else [walk(one)]
            )
        return out

    return walk(nav)
