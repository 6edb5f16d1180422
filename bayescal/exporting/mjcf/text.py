"""Elements and numbers of an MJCF file."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.exporting.digits import number, numbers

DEFAULT = "bayescal"
"""Class of all added elements."""


def place(pose: np.ndarray) -> dict[str, str]:
    """Attributes `pos` and `quat` of a pose (4, 4)."""
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return {"pos": numbers(pose[:3, 3]), "quat": numbers((w, x, y, z))}


def add(parent: ET.Element, tag: str, **attributes: str | float | Iterable[float]) -> ET.Element:
    """Append an element; numbers are written with all their digits."""
    return ET.SubElement(parent, tag, {k: _text(v) for k, v in attributes.items()})


def _text(value: str | float | Iterable[float]) -> str:
    if isinstance(value, str):
        return value
    return number(value) if isinstance(value, float | int) else numbers(value)


def document(root: ET.Element) -> str:
    """The text of a file."""
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
