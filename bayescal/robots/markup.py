"""XML that comes from elsewhere: read from this disk alone, without entities, xacro expanded."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.dom import minidom
from xml.etree import ElementTree

from bayescal.errors import BayescalError
from bayescal.files import decoded

NETWORK = re.compile(r"\s*(?:(?!(?:package|model|file):)[a-z][a-z0-9+.-]*://|//|\\\\)", re.IGNORECASE)
"""What is fetched from another machine. Meshes may say ``package://``: they are never opened."""


def read_markup(path: Path) -> tuple[ElementTree.Element, bytes]:
    """Root element of an XML or xacro file (by its suffix), and the content that it stands for (to hash).

    Raises
    ------
    BayescalError
        If it is no XML, has a DOCTYPE (entities, other files), names a file on the network, or, xacro, cannot
        be expanded from files beside it.
    """
    content = _expanded(path) if path.suffix.lower() == ".xacro" else decoded(path)[1]
    return _checked(content, path.name), content


def refuse_network(reference: str, where: str) -> None:
    """Refuse a reference to another machine."""
    if NETWORK.match(reference):
        raise BayescalError(
            f"`{reference}` is on the network", where, "copy the file beside the dataset, and name the copy"
        )


def _checked(content: bytes, name: str) -> ElementTree.Element:
    """The root of safe XML."""
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


def _expanded(path: Path) -> bytes:
    """What a xacro file expands to, with the arguments' defaults."""
    import xacro

    with _reading_safely(xacro):
        try:
            return bytes(xacro.process_file(str(path), verbosity=0).toxml(encoding="utf-8"))
        except BayescalError:
            raise
        except Exception as error:  # a xacro file is a program: it fails in any way it likes
            told = " ".join(str(error).split()) or type(error).__name__
            remedy = (
                "include files by their path from this one and give arguments a default; or expand it where "
                f"ROS is installed: `xacro {path.name} > {path.stem}.urdf`"
            )
            raise BayescalError(f"xacro cannot expand it: {told}", path.name, remedy) from None


def _refuse_inner_names(root: ElementTree.Element, name: str) -> None:
    """Refuse expressions that reach for Python's own names: xacro evaluates what it is given."""
    for element in root.iter():
        for text in (*element.attrib.values(), element.text or "", element.tail or ""):
            if "$" in text and "__" in text:
                raise BayescalError("an expression holds `__`", name, "write the value out")


@contextmanager
def _reading_safely(xacro: Any) -> Iterator[None]:
    """Every file that xacro opens, the first and those that it includes, passes our check."""
    plain: Callable[..., Any] = xacro.parse

    def parse(inp: Any, filename: str) -> minidom.Document:
        refuse_network(filename, "")
        path = Path(filename)
        content = decoded(path)[1]
        _refuse_inner_names(_checked(content, path.name), path.name)
        return minidom.parseString(content)

    xacro.parse = parse
    try:
        yield
    finally:
        xacro.parse = plain
