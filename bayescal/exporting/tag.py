"""Attributes of a tag of XML text, changed in place."""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.sax.saxutils import quoteattr


def with_attributes(tag: str, attributes: Mapping[str, str]) -> str:
    """A start tag (or an empty element) with other values of some attributes; missing ones are added last."""
    for key, value in attributes.items():
        pattern = rf"""(\s{re.escape(key)}\s*=\s*)("[^"]*"|'[^']*')"""
        found = re.search(pattern, tag)
        if found:
            new = tag[: found.start(2)] + quoteattr(value) + tag[found.end() :]
        else:
            end = re.search(r"\s*/?>$", tag)
            assert end, "a tag ends with >"
            new = f"{tag[: end.start()]} {key}={quoteattr(value)}{tag[end.start() :]}"
        tag = new
    return tag
