"""A user's MJCF file: its text as a tree with comments, and as MuJoCo compiles it."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from bayescal.errors import BayescalError
from bayescal.exporting.engine import mujoco
from bayescal.exporting.tag import around
from bayescal.reading import decoded
from bayescal.robots.markup import LARGEST, parse_markup

REFUSED = {
    "include": "its parts are in another file",
    "attach": "it takes parts of another file",
    "replicate": "its bodies are copies of one element",
}
"""Elements with which a file cannot be patched, and why."""
FOLDERS = ("meshdir", "texturedir", "assetdir")


@dataclass(frozen=True)
class SceneFile:
    """A file as a tree; `before` and `behind` are its text outside the root element."""

    path: Path
    root: ET.Element
    before: str
    behind: str

    @property
    def text(self) -> str:
        """The text of the file."""
        return self.before + ET.tostring(self.root, encoding="unicode") + self.behind


def read_scene(path: Path) -> SceneFile:
    """Read a file.

    Raises
    ------
    BayescalError
        If it is no MJCF, has a DOCTYPE, or is made of parts that cannot be patched.
    """
    text = decoded(path, LARGEST)[0]
    root = parse_markup(text, path.name, comments=True)
    if root.tag != "mujoco":
        raise BayescalError(f"the root element is {root.tag}, not mujoco", path.name, "give an MJCF file")
    for tag, why in REFUSED.items():
        if root.find(f".//{tag}") is not None:
            remedy = "compile it to one file: python -m mujoco.mjcf, or MjSpec.to_xml()"
            raise BayescalError(f"has an element <{tag}>: {why}", path.name, remedy)
    if root.find("worldbody") is None:
        raise BayescalError("has no <worldbody>", path.name, "give the file of the arm, not of its assets")
    return SceneFile(path, root, *around(text))


def compiled(root: ET.Element, folder: Path, where: str) -> Any:
    """The model of a file in a folder.

    Raises
    ------
    BayescalError
        If MuJoCo is not installed, or refuses the file.
    """
    mj, own = mujoco(), copy.deepcopy(root)
    compiler = own.find("compiler")
    if compiler is None:
        compiler = ET.SubElement(own, "compiler")
    for name in FOLDERS:
        if name in compiler.attrib:
            compiler.set(name, str((folder / compiler.get(name, "")).resolve()))
    if not any(name in compiler.attrib for name in FOLDERS):
        compiler.set("assetdir", str(folder.resolve()))
    try:
        return mj.MjModel.from_xml_string(ET.tostring(own, encoding="unicode"))
    except ValueError as error:
        raise BayescalError(
            f"MuJoCo refuses the file: {error}", where, "correct it, with its meshes"
        ) from None
