"""A user's MJCF file, with included files in place and as MuJoCo compiles it, and the arm in it.

The arm is its joints from its base to the tip, and the elements of their bodies.
"""

import copy
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import Robot
from bayescal.arm.transforms import rigid
from bayescal.errors import BayescalError, listed, refused_as
from bayescal.exporting.same_arm import FileArm, Match, match
from bayescal.exporting.written import mujoco
from bayescal.exporting.xml_text import XmlText
from bayescal.robots.urdf import LARGEST, refuse_network
from bayescal.storage.reading import decoded


@dataclass(frozen=True)
class FoundArm:
    """The joints of an arm and the bodies that they move, as elements and as compiled.

    `file` is the arm at zero: frames with their origins on the axes of the joints; `where` is its match.
    `anchors` (n, 3) are these origins in the frames of the bodies, `references` (n,) the joints' values as
    the file is written, rad. `steps` (n, 4, 4) stand in the file between the body of the joint before and the
    frame in which each body is written; `written` (n, 4, 4) are these poses. `parents` are those of all
    elements.
    """

    file: FileArm
    where: Match
    bodies: tuple[ET.Element, ...]
    joints: tuple[ET.Element, ...]
    ids: tuple[int, ...]  # of the bodies
    anchors: np.ndarray
    references: np.ndarray
    steps: np.ndarray
    written: np.ndarray
    parents: Mapping[ET.Element, ET.Element]


def find_arm(root: ET.Element, spec: Any, model: Any, robot: Robot, tip: str, where: str) -> FoundArm:
    """Find the arm of a robot in a file: the chain of so many hinges that is this arm.

    Joints before it carry its base, joints behind it belong to its tool.

    Parameters
    ----------
    root : ET.Element
    spec, model : MjSpec, MjModel
        Of the same file.
    robot : Robot
    tip : str
        Name of its last body, or of one that this carries; "" to look for it.
    where : str
        Name of the file.

    Raises
    ------
    BayescalError
        If there is no such chain, or there are several, or it is made of parts that cannot be patched.
    """
    end = _named(model, tip, where) if tip else -1
    matches: dict[tuple[int, ...], tuple[FileArm, Match]] = {}
    reasons = []
    for chain in _chains(model, robot.n, end):
        file = _file_arm(model, chain)
        try:
            matches[chain] = file, match(robot, file, where)
        except BayescalError as error:
            reasons.append(error)
    remedy = f"name the last body of the arm, as in --into {where}#wrist_3_link"
    if len(matches) > 1:
        ends = listed([model.body(chain[-1]).name for chain in matches])
        raise BayescalError(f"has several arms {robot.name}; they end at {ends}", where, remedy)
    if not matches:
        raise reasons[0] if reasons else _no_chain(model, robot, end, where, remedy)
    ids, (file, where_matched) = next(iter(matches.items()))
    elements = _elements(root, model, ids, where)
    joints = [next((e for e in body if e.tag == "joint"), None) for body in elements]
    addresses = [int(model.body_jntadr[b]) for b in ids]
    written = np.array([_written(spec, model.body(b).name) for b in ids])
    compiled = np.array([_pose(model.body_pos[b], model.body_quat[b]) for b in ids])
    framed = compiled @ np.linalg.inv(written)  # poses of elements <frame> around the bodies
    return FoundArm(
        file,
        where_matched,
        elements,
        tuple(_joint(e, model.body(b).name, where) for e, b in zip(joints, ids, strict=True)),
        ids,
        model.jnt_pos[addresses].copy(),
        model.qpos0[model.jnt_qposadr[addresses]].copy(),
        file.fixed @ framed,
        written,
        {child: e for e in root.iter() for child in e},
    )


def _chains(model: Any, n: int, tip: int) -> Iterator[tuple[int, ...]]:
    """Bodies of n hinges in series: all that end before a tip, or, without one, all of the file."""
    for end in [tip] if tip >= 0 else range(model.nbody):
        chain = [b for b in above(model, end) if model.body_jntnum[b]]
        if tip < 0 and (not chain or chain[-1] != end):
            continue
        for first in range(len(chain) - n, -1, -1) if tip >= 0 else [len(chain) - n]:
            bodies = tuple(chain[max(first, 0) : first + n])
            if len(bodies) == n and all(_hinge(model, b) for b in bodies):
                yield bodies


def _hinge(model: Any, body: int) -> bool:
    kind = model.jnt_type[model.body_jntadr[body]]
    return bool(model.body_jntnum[body] == 1 and kind == mujoco().mjtJoint.mjJNT_HINGE)


def _no_chain(model: Any, robot: Robot, tip: int, where: str, remedy: str) -> BayescalError:
    """Why there is no chain of hinges."""
    if tip < 0:
        return BayescalError(f"the file has no chain of {robot.n} joints", where, remedy)
    chain = [b for b in above(model, tip) if model.body_jntnum[b]]
    for b in chain[::-1]:
        if not _hinge(model, b):
            has = "several joints" if model.body_jntnum[b] > 1 else "a joint that is no hinge"
            return BayescalError(f"body {model.body(b).name} has {has}", where, remedy)
    what = f"{len(chain)} joints turn before the tip, the arm {robot.name} has {robot.n}"
    return BayescalError(what, where, remedy)


def _file_arm(model: Any, ids: tuple[int, ...]) -> FileArm:
    """Joints of bodies, at zero; other joints of the file are where it has them."""
    mj = mujoco()
    data = mj.MjData(model)
    addresses = [int(model.body_jntadr[b]) for b in ids]
    data.qpos[model.jnt_qposadr[addresses]] = 0.0
    mj.mj_kinematics(model, data)
    pose = np.array([rigid(data.xmat[b].reshape(3, 3), data.xpos[b]) for b in range(model.nbody)])
    frames = np.array([pose[b] @ rigid(None, model.jnt_pos[j]) for b, j in zip(ids, addresses, strict=True)])
    pairs = zip((0, *ids[:-1]), ids, strict=True)
    steps = [np.linalg.inv(pose[before]) @ pose[int(model.body_parentid[b])] for before, b in pairs]
    names = tuple(model.joint(j).name for j in addresses)
    none = np.zeros(len(names), bool)
    return FileArm(names, frames, model.jnt_axis[addresses].copy(), np.array(steps), np.eye(4), none)


def above(model: Any, body: int) -> list[int]:
    """Bodies from the world to a body."""
    out = [body]
    while body:
        body = int(model.body_parentid[body])
        out.insert(0, body)
    return out


def _named(model: Any, tip: str, where: str) -> int:
    try:
        return int(model.body(tip).id)
    except KeyError:
        what = f"there is no body `{tip}`"
        raise BayescalError(what, where, "name the last body of the arm") from None


def _elements(root: ET.Element, model: Any, ids: tuple[int, ...], where: str) -> tuple[ET.Element, ...]:
    """Elements of bodies, which must be written in the file itself."""
    named = {e.get("name"): e for e in root.iter("body") if e.get("name")}
    for b in ids:
        if not model.body(b).name:
            raise BayescalError("a body of the arm has no name", where, "name the bodies of the arm")
        if model.body(b).name not in named:
            what = f"body {model.body(b).name} of the arm is made by <attach> or <replicate>"
            raise BayescalError(what, where, "write the bodies of the arm into the file: MjSpec.to_xml()")
    return tuple(named[model.body(b).name] for b in ids)


def _joint(element: ET.Element | None, body: str, where: str) -> ET.Element:
    if element is None or not element.get("name"):
        has = "is in a <frame>" if element is None else "has no name"
        raise BayescalError(f"the joint of body {body} {has}", where, "write it in the body, with a name")
    return element


def _written(spec: Any, name: str) -> np.ndarray:
    """Pose (4, 4) of a body as its element states it."""
    body = spec.body(name)
    quat = np.array(body.quat)
    if body.alt.type != mujoco().mjtOrientation.mjORIENTATION_QUAT:
        c = spec.compiler
        quat = np.array(spec.resolve_orientation(c.degree, c.eulerseq, body.alt))
    return _pose(np.array(body.pos), quat)


def _pose(pos: np.ndarray, quat: np.ndarray) -> np.ndarray:
    return rigid(Rotation.from_quat(quat, scalar_first=True).as_matrix(), pos)


ROOTS = ("mujoco", "mujocoinclude")
SKELETON = ("compiler", "option", "size", "default", "asset", "worldbody", "extension")
"""Sections that place and weigh bodies; the others may refer to parts that are not there."""
FOLDERS = dict.fromkeys(("mesh", "hfield", "skin", "flexcomp"), "meshdir") | {"texture": "texturedir"}
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
    xml = XmlText(text, path.name)
    by = {}
    for e in xml.root.iter("include"):
        file = e.get("file", "")
        refuse_network(file, path.name)
        # relative to the main file, else to the file that includes it
        here = next((f / file for f in (main, path.parent) if (f / file).is_file()), None)
        absolute, again = not file or Path(file).is_absolute(), here in seen or len(seen) >= MOST
        if here is None or absolute or again:
            missing = "it is included twice" if again else "there is no such file"
            what = f"<include file='{file}'>: {'no relative path' if absolute else missing}"
            raise BayescalError(what, path.name, "give a relative path, and include each file once")
        seen.append(here)
        inner = XmlText(_with_included(decoded(here, LARGEST)[0], here, main, seen), here.name)
        if inner.root.tag not in ROOTS:
            what = f"the root element is {inner.root.tag}, not {' or '.join(ROOTS)}"
            raise BayescalError(what, here.name, "include MJCF files only")
        by[e] = inner.inside.strip()
    return xml.spliced(by)


def _check_same(path: Path, model: Any) -> None:
    """Refuse a text with included parts that MuJoCo reads otherwise than the files."""
    mj = mujoco()
    with _refused(path.name):
        whole = mj.MjModel.from_xml_path(str(path))
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
    with _refused(where):
        spec = mujoco().MjSpec.from_string(text)
    spec.modelfiledir = str(folder.resolve())
    return spec


def compiled(text: str, folder: Path, where: str) -> Any:
    """The model of a text; arguments and errors as of `spec_of`."""
    return model_of(spec_of(text, folder, where), where)


def model_of(spec: Any, where: str) -> Any:
    """The model of an MjSpec; errors as of `spec_of`."""
    with _refused(where), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of MuJoCo, on details of the user's file
        return spec.compile()


def _refused(where: str) -> AbstractContextManager[None]:
    return refused_as("MuJoCo refuses the file", where, "correct it, with its meshes", ValueError)


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
        compiler = compilers[0] if compilers else ET.Element("compiler")
        if not compilers:
            root.insert(0, compiler)
        compiler.attrib.update(dict.fromkeys(sorted(missing), back))
    return xml.text


def _from(back: str, path: str) -> str:
    """A path, as it is found from elsewhere."""
    return path if Path(path).is_absolute() else Path(os.path.normpath(Path(back) / path)).as_posix()
