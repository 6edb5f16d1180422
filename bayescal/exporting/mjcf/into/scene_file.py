"""A user's MJCF file: its text and its elements, with included files in place, and as MuJoCo compiles it."""

from __future__ import annotations

import copy
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from bayescal.errors import BayescalError
from bayescal.exporting.engine import mujoco
from bayescal.exporting.xml_text import XmlText
from bayescal.reading import decoded
from bayescal.robots.markup import LARGEST, refuse_network

ROOTS = ("mujoco", "mujocoinclude")
SKELETON = ("compiler", "option", "size", "default", "asset", "worldbody", "extension")
"""Sections that place and weigh bodies; the others may refer to parts that are not there."""
FOLDERS = {
    "mesh": "meshdir",
    "hfield": "meshdir",
    "skin": "meshdir",
    "flexcomp": "meshdir",
    "texture": "texturedir",
}
"""Attribute of the compiler with the folder of the files of each element."""
MOST = 100
"""Included files."""


@dataclass(frozen=True)
class SceneFile:
    """A file with its text, in which `included` files stand in place of their elements."""

    path: Path
    xml: XmlText
    included: tuple[str, ...] = ()

    @property
    def root(self) -> ET.Element:
        """The root element, which may be changed."""
        return self.xml.root


def read_scene(path: Path) -> SceneFile:
    """Read a file, and those that it includes.

    Raises
    ------
    BayescalError
        If it is no MJCF, has a DOCTYPE, or includes a file that cannot be read.
    """
    text = decoded(path, LARGEST)[0]
    seen: list[Path] = []
    xml = XmlText(_with_included(text, path, path.parent, seen), path.name)
    if xml.root.tag != "mujoco":
        raise BayescalError(f"the root element is {xml.root.tag}, not mujoco", path.name, "give an MJCF file")
    if xml.root.find("worldbody") is None:
        raise BayescalError("has no <worldbody>", path.name, "give the file of the arm, not of its assets")
    scene = SceneFile(path, xml, tuple(p.name for p in seen))
    if seen:
        _check_same(path, compiled(xml.text, path.parent, path.name))
    return scene


def _with_included(text: str, path: Path, main: Path, seen: list[Path]) -> str:
    """A text with the content of included files in place of their elements, as MuJoCo reads them."""
    own = XmlText(text, path.name)
    by = {}
    for e in own.root.iter("include"):
        file = e.get("file", "")
        refuse_network(file, path.name)
        # relative to the main file, else to the file that includes it
        here = next((f / file for f in (main, path.parent) if (f / file).is_file()), None)
        absolute, again = not file or Path(file).is_absolute(), here in seen or len(seen) >= MOST
        if here is None or absolute or again:
            why = (
                "no relative path"
                if absolute
                else "it is included twice"
                if again
                else "there is no such file"
            )
            remedy = "give a relative path, and include each file once"
            raise BayescalError(f"<include file='{file}'>: {why}", path.name, remedy)
        seen.append(here)
        inner = XmlText(_with_included(decoded(here, LARGEST)[0], here, main, seen), here.name)
        if inner.root.tag not in ROOTS:
            what = f"the root element is {inner.root.tag}, not {' or '.join(ROOTS)}"
            raise BayescalError(what, here.name, "include MJCF files only")
        by[e] = inner.inside.strip()
    return own.spliced(by)


def _check_same(path: Path, model: Any) -> None:
    """Refuse a text with included parts that MuJoCo reads otherwise than the files."""
    mj = mujoco()
    try:
        whole = mj.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise _refused(error, path.name) from None
    sizes = ("nq", "nv", "nu", "nbody", "ngeom", "nmesh", "nsite", "neq", "ntendon", "nkey")
    same = all(getattr(whole, s) == getattr(model, s) for s in sizes) and whole.names == model.names
    if not (same and (whole.body_pos == model.body_pos).all() and (whole.body_mass == model.body_mass).all()):
        what = "its included files cannot be written into it without a change"
        raise BayescalError(what, path.name, "write them into the file yourself")


def spec_of(text: str, folder: Path, where: str) -> Any:
    """The MjSpec of a text whose files are relative to a folder.

    Raises
    ------
    BayescalError
        If MuJoCo is not installed, or refuses the text.
    """
    try:
        spec = mujoco().MjSpec.from_string(text)
    except ValueError as error:
        raise _refused(error, where) from None
    spec.modelfiledir = str(folder.resolve())
    return spec


def compiled(text: str, folder: Path, where: str) -> Any:
    """The model of a text; arguments and errors as of `spec_of`."""
    return model_of(spec_of(text, folder, where), where)


def model_of(spec: Any, where: str) -> Any:
    """The model of an MjSpec; errors as of `spec_of`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of MuJoCo, on details of the user's file
            return spec.compile()
    except ValueError as error:
        raise _refused(error, where) from None


def _refused(error: ValueError, where: str) -> BayescalError:
    told = " ".join(str(error).split())
    return BayescalError(f"MuJoCo refuses the file: {told}", where, "correct it, with its meshes")


def skeleton(root: ET.Element) -> str:
    """The text of the bodies alone."""
    out = ET.Element(root.tag, root.attrib)
    out.extend([copy.deepcopy(e) for e in root if e.tag in SKELETON])
    return ET.tostring(out, encoding="unicode")


def moved(text: str, before: Path, after: Path) -> str:
    """A text whose files are found from another folder: their folders in `compiler` are rewritten."""
    xml = XmlText(text, "scene")
    root, back = xml.root, Path(os.path.relpath(before.resolve(), after.resolve())).as_posix()
    if back == ".":
        return text
    for e in root.iter("model"):
        if e.get("file"):
            e.set("file", _from(back, e.get("file", "")))
    files = (e for e in root.iter() if e.tag in FOLDERS and any(key.startswith("file") for key in e.attrib))
    needed = {FOLDERS[e.tag] for e in files}
    compilers = root.findall("compiler")
    for c in compilers:
        for name in ("assetdir", "meshdir", "texturedir"):
            if name in c.attrib:
                c.set(name, _from(back, c.get(name, "")))
    stated = {name for c in compilers for name in c.attrib}
    missing = set() if "assetdir" in stated else needed - stated
    if missing:
        own = compilers[0] if compilers else ET.Element("compiler")
        if not compilers:
            root.insert(0, own)
        own.attrib.update(dict.fromkeys(sorted(missing), back))
    return xml.text


def _from(back: str, path: str) -> str:
    """A path, as it is found from elsewhere."""
    return path if Path(path).is_absolute() else Path(os.path.normpath(Path(back) / path)).as_posix()
