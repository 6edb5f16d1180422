"""Sections as a page: one file, everything in it, a policy that permits nothing from outside.

Plotly for pages: its source, compressed, and the hash that a content security policy permits.

Only the JavaScript file of the package is read: `plotly.graph_objects` is slow to import and not needed.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from bayescal import __version__
from bayescal.reporting.page.section import Section

STILL = "Figures that move with the pointer need plotly: pip install 'bayescal[interactive]'."
"""The last line of a page that has still figures alone."""


@lru_cache(maxsize=1)
def plotly() -> tuple[str, str] | None:
    """Source of plotly.js as base64 of gzip, and its CSP hash ``'sha256-...'``; None without plotly.

    The page inflates it (DecompressionStream) and runs it as an inline script with this hash: the policy
    permits no other code.
    """
    try:
        source = files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    except ModuleNotFoundError:
        return None
    packed = gzip.compress(source, compresslevel=4, mtime=0)  # 9: a twentieth less, twice the time
    return base64.b64encode(packed).decode("ascii"), csp_hash(source)


def csp_hash(source: bytes) -> str:
    """Hash of an inline script, as a content security policy states it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(source).digest()).decode('ascii')}'"


GENERATOR = '<meta name="generator" content="bayescal">'
"""In the head of every page: a file with it may be replaced."""
TEMPLATES = Path(__file__).parent / "templates"


def environment() -> Environment:
    """The templates of pages; values are escaped."""
    made = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["coded"] = coded
    return made


def coded(text: Any) -> Markup:
    """A text, escaped, with what is between backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def script_json(value: Any) -> Markup:
    """JSON for the inside of a script element: no text in it can end the element."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))  # ASCII: U+2028 is escaped too
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)


def asset(name: str) -> str:
    """The text of a file beside the templates."""
    return (TEMPLATES / name).read_text(encoding="utf-8")


def page(
    title: str,
    subtitle: str,
    sections: Sequence[Section | None],
    foot: Sequence[str] = (f"bayescal {__version__}",),
    data: Mapping[str, Any] | None = None,
    headers: Sequence[tuple[str, Mapping[str, str]]] = (),
) -> str:
    """A page as text.

    Parameters
    ----------
    title, subtitle : str
    sections : sequence of Section
        In the order of the page, without those that are None; the first one is seen first.
    foot : sequence of str
        Lines at the end; default: the version.
    data : mapping, optional
        What interactive figures draw, as JSON; without it, or without plotly, the page has no scripts.
    headers : sequence of (str, mapping), optional
        What a filed report states below its title: a heading or "", names and values.
    """
    templates = environment()
    packed, allowed, script = "", "'none'", ""
    library = None if data is None else plotly()
    if library is None:
        data, foot = None, foot if data is None else (*foot, STILL)
    else:
        packed, permitted = library
        script = asset("page.js")
        allowed = f"{permitted} {csp_hash(script.encode())}"
    shown = [section for section in sections if section is not None]
    bodies = [(s, Markup(templates.get_template(s.template).render(s.context))) for s in shown]
    return templates.get_template("base.html.j2").render(
        generator=Markup(GENERATOR),
        title=title,
        subtitle=subtitle,
        headers=headers,
        bodies=bodies,
        foot=foot,
        style=Markup(asset("page.css")),
        policy=f"default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {allowed}; "
        "base-uri 'none'; form-action 'none'",
        data=None if data is None else script_json(data),
        script=Markup(script),
        packed=packed,
    )
