"""Figures as files: PNG and SVG with the same bytes for the same record."""

from __future__ import annotations

from io import BytesIO, StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from bayescal.reporting.figures.figures import FILES, content, has, posterior_content
from bayescal.reporting.figures.palette import DPI, drawing
from bayescal.reporting.figures.posterior import Draws
from bayescal.reporting.figures.sheet import sheet
from bayescal.storage.reading import Json

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FAST = {"compress_level": 3}
"""Compression of PNG: half the time of the default, for a tenth more bytes."""


def png(figure: Figure) -> bytes:
    """A figure as PNG, without a date."""
    out = BytesIO()
    with drawing():
        figure.savefig(out, format="png", dpi=DPI, metadata={"Software": None}, pil_kwargs=FAST)
    return out.getvalue()


def svg(figure: Figure) -> str:
    """A figure as SVG: text as paths (each glyph once), no date, the same identifiers each time.

    Without the XML declaration, to be put into a page.
    """
    out = StringIO()
    with drawing():
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    return text[text.index("<svg") :]


def figures_of(record: Json, draws: Draws | None = None) -> dict[str, bytes]:
    """File names of the figures of a fit or a diagnosis, and their content as PNG.

    With the draws of its parameters, by name, the posterior of a fit too.
    """
    drawable = {
        file: content(name, record) for file, name in FILES[record["schema"]].items() if has(name, record)
    }
    if draws:
        drawable["fit-posterior.png"] = posterior_content(record, draws)
    with drawing():
        return {file: png(sheet(title, rows)) for file, (title, rows) in drawable.items()}


def write(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or, by the ending of the path, SVG."""
    if path.suffix == ".svg":
        path.write_text(svg(figure), encoding="utf-8")
    else:
        path.write_bytes(png(figure))
