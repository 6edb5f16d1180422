"""Formulas in Markdown as MathML, written when the site is built: no script, no font, no network.

The notation is that of GitHub: a fence ```` ```math ```` for a formula of its own, and ``$`...`$`` in a line.
"""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element

from latex2mathml.converter import convert
from markdown import Extension, Markdown
from markdown.inlinepatterns import InlineProcessor
from markdown.preprocessors import Preprocessor

FENCE = re.compile(r"^```math\n(.*?)\n```$", re.MULTILINE | re.DOTALL)
INLINE = r"\$`([^`]+)`\$"


class _Fences(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        def block(match: re.Match[str]) -> str:
            formula = convert(match[1], display="block")
            return self.md.htmlStash.store(f'<div class="formula" tabindex="0">{formula}</div>')

        return FENCE.sub(block, "\n".join(lines)).split("\n")


class _Inline(InlineProcessor):
    def handleMatch(self, m: re.Match[str], data: str) -> tuple[Element | str, int, int]:
        return self.md.htmlStash.store(convert(m[1])), m.start(0), m.end(0)


class Mathematics(Extension):
    """Formulas as MathML."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Register both notations, before code is read."""
        md.preprocessors.register(_Fences(md), "formulas", 28)
        md.inlinePatterns.register(_Inline(INLINE, md), "formula", 200)
