"""XML that comes from elsewhere: read from this disk alone, without entities."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from bayescal.errors import BayescalError
from bayescal.reading import decoded
from bayescal.robots.xacro_file import expanded

NETWORK = re.compile(r"\s*(?:(?!(?:package|model|file):)[a-z][a-z0-9+.-]*://|//|\\\\)", re.IGNORECASE)
"""What is fetched from another machine. Meshes may say ``package://``: they are never opened."""


def read_markup(path: Path, allow_xacro: bool = False) -> tuple[ElementTree.Element, bytes]:
    """Root element of an XML or xacro file (by its suffix), and the content that it stands for (to hash).

    A xacro file is executed (`xacro_file`), so only where `allow_xacro` says that the user agreed.

    Raises
    ------
    BayescalError
        If it is no XML, has a DOCTYPE (entities, other files), names a file on the network, or is a
        xacro file that may not or cannot be expanded.
    """
    is_xacro = path.suffix.lower() == ".xacro"
    content = expanded(path, allow_xacro) if is_xacro else decoded(path)[1]
    return parse_markup(content, path.name), content


def refuse_network(reference: str, where: str) -> None:
    """Refuse a reference to another machine."""
    if NETWORK.match(reference):
        raise BayescalError(
            f"`{reference}` is on the network", where, "copy the file beside the dataset, and name the copy"
        )


def parse_markup(content: bytes, name: str) -> ElementTree.Element:
    """The root element of safe XML; `name` is the file, for messages."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root: ElementTree.Element = fromstring(content, forbid_dtd=True)
    except DefusedXmlException:
        raise BayescalError("has a DOCTYPE or entities", name, "write the values out") from None
    except ParseError as error:
        where = f"{name}:{error.position[0]}"
        raise BayescalError(f"not XML: {error}", where, "check tags, quotes and namespaces") from None
    for element in root.iter():
        refuse_network(element.get("filename", ""), name)
    return root
