"""Widths of text in mm, and text wrapped to a width: what keeps labels inside a figure."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from bayescal.reporting.figures.palette import SIZE

MM_PER_PT = 25.4 / 72.0
LEADING = 1.25
"""Distance of two lines over the size of the text."""

HINTED = 1.03
"""Width of drawn text, whose letters begin at pixels, over that of its outlines, at most."""
ASCENT = 0.95
"""From the top of a line to its baseline, over the size of the text."""


@lru_cache(maxsize=4096)
def width(text: str, size: float = SIZE, bold: bool = False) -> float:
    """The width of a line of text, mm; `size` in pt."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=size, weight="bold" if bold else "normal")
    points = float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])
    return HINTED * points * MM_PER_PT


def line(size: float = SIZE) -> float:
    """The height of a line of text, mm."""
    return LEADING * size * MM_PER_PT


def baseline(k: int, size: float = SIZE) -> float:
    """From the top of a block of lines to the baseline of line k (from 0), mm."""
    return ASCENT * size * MM_PER_PT + k * line(size)


def wrapped(text: str, room: float, size: float = SIZE, bold: bool = False) -> list[str]:
    """Lines of a text that are at most `room` mm wide; a word that is wider is divided."""
    out: list[str] = []
    for paragraph in text.split("\n"):
        out += _filled(_pieces(paragraph.split(), room, size, bold), room, size, bold) or [""]
    return out


def _pieces(words: Iterable[str], room: float, size: float, bold: bool) -> list[str]:
    """Words, those that are too wide in parts."""
    out = []
    for word in words:
        while len(word) > 1 and width(word, size, bold) > room:
            fits = next((n for n in range(len(word) - 1, 1, -1) if width(word[:n], size, bold) <= room), 1)
            out.append(word[:fits])
            word = word[fits:]
        out.append(word)
    return out


def _filled(words: list[str], room: float, size: float, bold: bool) -> list[str]:
    lines: list[str] = []
    for word in words:
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and width(longer, size, bold) <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines
