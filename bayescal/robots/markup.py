"""XML that comes from elsewhere: read from this disk alone, without entities."""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

from bayescal.errors import BayescalError

NETWORK = re.compile(r"\s*(?:(?!(?:package|model|file):)[a-z][a-z0-9+.-]*://|//|\\\\)", re.IGNORECASE)
"""What is fetched from another machine. Meshes may say ``package://``: they are never opened."""

DEEPEST, MOST = 200, 50_000
"""Levels and elements of an XML file; a scene of ten arms has some thousand elements."""
LARGEST = 2**26
"""Bytes of an XML file, without the meshes."""


def refuse_network(reference: str, where: str) -> None:
    """Refuse a reference to another machine."""
    if NETWORK.match(reference):
        remedy = "copy the file beside the dataset, and name the copy"
        raise BayescalError(f"`{reference}` is on the network", where, remedy)


def parse_markup(content: str | bytes, name: str) -> ElementTree.Element:
    """The root element of safe XML of bounded size; `name` is the file, for messages.

    Raises
    ------
    BayescalError
        If it is no XML, has a DOCTYPE, names a file on the network, or has too many elements or levels.
    """
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import DefusedXMLParser

    parser = DefusedXMLParser(target=_Bounded(name), forbid_dtd=True)
    try:
        parser.feed(content)
        root: ElementTree.Element = parser.close()
    except DefusedXmlException:
        raise BayescalError("has a DOCTYPE or entities", name, "write the values out") from None
    except ElementTree.ParseError as error:
        where = f"{name}:{error.position[0]}"
        raise BayescalError(f"not XML: {error}", where, "check tags, quotes and namespaces") from None
    except (ValueError, LookupError) as error:  # of the encoding that its first line states
        raise BayescalError(f"not XML: {error}", f"{name}:1", "save the file as UTF-8") from None
    for element in root.iter():
        refuse_network(element.get("filename", ""), name)
    return root


class _Bounded(ElementTree.TreeBuilder):
    """Builds a tree, and refuses one that functions which descend into it could not end."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name, self._depth, self._count = name, 0, 0

    def start(self, tag: str, attrs: Any, /) -> ElementTree.Element:
        self._depth += 1
        self._count += 1
        if self._depth > DEEPEST or self._count > MOST:
            what = f"{DEEPEST} levels" if self._depth > DEEPEST else f"{MOST} elements"
            raise BayescalError(f"more than {what}", self._name, "check its tags")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)
