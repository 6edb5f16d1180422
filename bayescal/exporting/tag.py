"""XML text changed in place: attributes of a tag, origins of the joints of a URDF."""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.parsers import expat
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


def with_origins(text: str, origins: Mapping[str, Mapping[str, str]]) -> str:
    """The text of a URDF with other attributes of the origins of some joints; all else stays, to the byte."""
    data = text.encode("utf-8")
    spots: dict[str, tuple[int, bool]] = {}  # position of the tag to change, and whether it is an origin
    stack: list[tuple[str, str]] = []
    parser = expat.ParserCreate("utf-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        inside = stack[-1] if stack else ("", "")
        if tag == "joint" and len(stack) == 1 and attributes.get("name") in origins:
            spots[attributes["name"]] = (parser.CurrentByteIndex, False)
        if tag == "origin" and len(stack) == 2 and inside[0] == "joint" and inside[1] in origins:
            spots[inside[1]] = (parser.CurrentByteIndex, True)
        stack.append((tag, attributes.get("name", "")))

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: stack.pop()
    parser.Parse(data, True)
    for name, (at, is_origin) in sorted(spots.items(), key=lambda spot: -spot[1][0]):
        end = tag_end(data, at)
        if is_origin:
            new = with_attributes(data[at:end].decode(), origins[name]).encode()
        else:
            attributes = " ".join(f"{key}={quoteattr(value)}" for key, value in origins[name].items())
            new = data[at:end] + f"<origin {attributes}/>".encode()
        data = data[:at] + new + data[end:]
    return data.decode("utf-8")


def around(text: str) -> tuple[str, str]:
    """The text before and behind the root element of an XML text."""
    data, parser = text.encode("utf-8"), expat.ParserCreate("utf-8")
    starts: list[int] = []
    ends: list[int] = []
    parser.StartElementHandler = lambda tag, attributes: starts.append(parser.CurrentByteIndex)
    parser.EndElementHandler = lambda tag: ends.append(parser.CurrentByteIndex)
    parser.Parse(data, True)
    return data[: starts[0]].decode(), data[tag_end(data, ends[-1]) :].decode()


def tag_end(data: bytes, at: int) -> int:
    """Position behind a tag that starts at `at`; a > in a quoted value does not end it."""
    quote = 0
    for k in range(at, len(data)):
        byte = data[k]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in b"\"'":
            quote = byte
        elif byte == ord(">"):
            return k + 1
    raise AssertionError("a parsed tag ends")
