"""A URDF as a tree of joints and bodies, and which of its chains is the arm."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter
from typing import Any
from xml.etree import ElementTree

import numpy as np

from bayescal.arm.transforms import rigid, rpy_matrix
from bayescal.errors import BayescalError, listed
from bayescal.storage.reading import table_beside

TURNING = ("revolute", "continuous")
MOVING = (*TURNING, "prismatic")
KINDS = (*MOVING, "fixed", "floating", "planar")
"""Types of joints that a URDF may have."""
MOST = 4000
"""Links and joints of a URDF; a cell with several arms has some hundred."""
LARGEST, HEAVIEST = 1e4, 1e6
"""Numbers beyond which squares lose all digits: m and rad, kg; the limits of robot.yaml (`files.RANGES`)."""
UNLIMITED = 1e9
"""rad/s and N m: a largest velocity or torque in a URDF that limits nothing."""
FEWER = "give the URDF of the arm alone"
KEPT: dict[str, tuple[list[str], list[str]]] = table_beside(__file__, "urdf.toml")
"""Attributes and children of each tag that matter here; pictures, collisions and controllers do not."""


@dataclass(frozen=True)
class Joint:
    """A joint: its frame in the parent link's, its axis in its own, limits (rad, m) where it states any.

    `velocity`, rad/s or m/s, and `torque`, N m or N, are its largest ones; nan where it states none, 0 or no
    end. `mimic`: the joint that it follows, the multiple of its reading, and what is added to that.
    """

    name: str
    kind: str
    parent: str
    child: str
    place: np.ndarray  # (4, 4), m
    axis: np.ndarray  # (3,), a unit vector
    limits: tuple[float, float] | None
    mimic: tuple[str, float, float] | None
    velocity: float = np.nan
    torque: float = np.nan
    damping: float = np.nan  # N m s/rad
    friction: float = np.nan  # N m


@dataclass(frozen=True)
class Body:
    """Mass of a link, kg, its centre (3,), m, and its inertia about it (3, 3), kg m2, in the link's axes."""

    mass: float
    centre: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class Tree:
    """Links (`bodies`) by name, and the `joint` above each but the root."""

    name: str
    file: str
    root: str
    bodies: dict[str, Body]
    joints: dict[str, Joint]

    def seen_from(self, link: str) -> Tree:
        """The same joints and bodies as a tree whose root is another link.

        A joint between the two roots is passed from child to parent: in the child's frame about the reversed
        axis, so that its reading keeps its sense, and then back along its `place`.
        """
        joints = dict(self.joints)
        for joint in self.above(link):
            inner = f"{joint.name}\0"  # no name in a file has it
            del joints[joint.child]
            turned = replace(joint, parent=joint.child, child=inner, place=np.eye(4), axis=-joint.axis)
            back = (inner, "fixed", inner, joint.parent, np.linalg.inv(joint.place), joint.axis, None, None)
            joints |= {inner: turned, joint.parent: Joint(*back)}
        return replace(self, root=link, joints=joints)

    def above(self, link: str) -> list[Joint]:
        """Joints from the root down to a link."""
        out = []
        while link != self.root:
            out.append(self.joints[link])
            link = out[-1].parent
        return out[::-1]


def read_tree(root: ElementTree.Element, file: str) -> Tree:
    """Joints and bodies of a URDF's root element, checked to be one tree of finite numbers.

    Raises
    ------
    BayescalError
        With the file and the item, of the first thing wrong.
    """
    from urdf_parser_py.urdf import URDF
    from urdf_parser_py.xml_reflection.core import ParseError

    if root.tag != "robot":
        raise BayescalError(f"begins with <{root.tag}>, not with <robot>", file, "give a URDF")
    pruned = _pruned(root, file)
    if len(pruned) > MOST:
        raise BayescalError(f"has {len(pruned)} links and joints, at most {MOST} are read", file, FEWER)
    for element in pruned.findall("joint"):
        if element.get("type") not in KINDS:
            what = f"joint `{element.get('name')}` has the type `{element.get('type')}`"
            raise BayescalError(what, file, f"known: {', '.join(KINDS)}")
    text = ElementTree.tostring(pruned)
    try:
        parsed = URDF.from_xml_string(text)
    except (ParseError, ValueError, AssertionError, TypeError, AttributeError) as error:
        raise BayescalError(f"not a URDF: {error}", file, "check it with `check_urdf`") from None
    bodies = {link.name: _body(link, file) for link in parsed.links}
    joints = {joint.child: _joint(joint, file) for joint in parsed.joints}
    _check_names([link.name for link in parsed.links], "links", file)
    _check_names([joint.name for joint in parsed.joints], "joints", file)
    _check_names([joint.child for joint in parsed.joints], "joints above a link", file)
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in bodies:
                what = f"joint `{joint.name}` names a link `{link}` that is not there"
                raise BayescalError(what, file, "add it")
    roots = [link for link in bodies if link not in joints]
    if len(roots) != 1:
        what = f"links with no joint above: {listed(roots)}" if roots else "the joints form a ring"
        raise BayescalError(what, file, "a URDF is one tree from one root")
    try:
        TopologicalSorter({joint.child: [joint.parent] for joint in joints.values()}).prepare()
    except CycleError as error:
        what = f"the joints around `{min(error.args[1])}` form a ring"
        raise BayescalError(what, file, "a URDF is one tree") from None
    return Tree(parsed.name, file, roots[0], bodies, joints)


BETWEEN = ".."
"""Between the names of the links at which a chain begins and ends."""


def chain_in(tree: Tree, asked: str) -> tuple[Tree, str]:
    """A tree whose root is where the chain begins, and the link at its end.

    `asked` is the link that carries the tool (`tip_of`), with ``first..`` before it where the chain begins at
    another link than the root, as it does where that carries what is measured.
    """
    first, between, tip = asked.partition(BETWEEN)
    if not between:
        return tree, tip_of(tree, asked)
    if not first or not tip or tip_of(tree, first) == tip_of(tree, tip):
        remedy = f"write `{tree.file}#FIRST{BETWEEN}TIP` with two of its links"
        raise BayescalError(f"`{asked}` does not name two links", tree.file, remedy)
    return tree.seen_from(first), tip


def tip_of(tree: Tree, asked: str) -> str:
    """The link that carries the tool: as asked for, or at the end of the longest chain.

    Longest is the chain with most joints that move, then with most links.

    Raises
    ------
    BayescalError
        If there is no such link, or chains of one length end at several.
    """
    tips = sorted(set(tree.bodies) - {joint.parent for joint in tree.joints.values()})
    if asked:
        if asked not in tree.bodies:
            raise BayescalError(f"no link is called `{asked}`", tree.file, f"chains end at: {listed(tips)}")
        return asked
    chains = {tip: tree.above(tip) for tip in tips}
    length = {tip: (sum(j.kind != "fixed" for j in chain), len(chain)) for tip, chain in chains.items()}
    best = [tip for tip in tips if length[tip] == max(length.values())]
    if len(best) > 1:
        shared = [j.child for j in chains[best[0]] if all(j in chains[tip] for tip in best[1:])]
        remedy = f"name the link that carries the tool, as in {tree.file}#{[best[0], *shared][-1]}"
        raise BayescalError(f"several chains are the longest; they end at {listed(best)}", tree.file, remedy)
    return best[0]


def _pruned(element: ElementTree.Element, file: str) -> ElementTree.Element:
    """What matters of an element and all below; refuses what a link or joint states twice."""
    attributes, children = KEPT[element.tag]
    out = ElementTree.Element(element.tag, {k: v for k, v in element.attrib.items() if k in attributes})
    out.extend([_pruned(child, file) for child in element if child.tag in children])
    for child in out if element.tag != "robot" else ():
        if len(out.findall(child.tag)) > 1:
            what = f"{element.tag} {element.get('name', '')} has several <{child.tag}>"
            raise BayescalError(what, file, "keep one")
    return out


def _numbers(values: Any, what: str, file: str, largest: float = LARGEST) -> np.ndarray:
    out = np.array(values, float)
    if not np.all(np.isfinite(out)):
        raise BayescalError(f"{what} is not finite", file, "write plain numbers")
    if np.any(np.abs(out) > largest):
        what = f"{what} has the number {np.max(np.abs(out)):g}"
        raise BayescalError(what, file, f"no arm has more than {largest:g}; correct it")
    return out


def _frame(origin: Any, what: str, file: str) -> np.ndarray:
    if origin is None:
        return np.eye(4)
    xyz, rpy = (_numbers(v, f"the origin of `{what}`", file) for v in (origin.xyz, origin.rpy))
    return rigid(rpy_matrix(rpy), xyz)


def _body(link: Any, file: str) -> Body:
    if link.inertial is None:
        return Body(0.0, np.zeros(3), np.zeros((3, 3)))
    mass = float(_numbers(link.inertial.mass, f"the mass of `{link.name}`", file, HEAVIEST))
    if mass < 0.0:
        raise BayescalError(f"the mass of `{link.name}` is {mass:g} kg", file, "must be at least 0")
    frame, inertia = _frame(link.inertial.origin, link.name, file), np.zeros((3, 3))
    if link.inertial.inertia is not None:
        what = f"the inertia of `{link.name}`"
        inertia = _numbers(link.inertial.inertia.to_matrix(), what, file, HEAVIEST)
    return Body(mass, frame[:3, 3], frame[:3, :3] @ inertia @ frame[:3, :3].T)


def _joint(joint: Any, file: str) -> Joint:
    # exporters write 0 0 0 for a joint that has no axis
    moves = joint.type != "fixed"
    axis = _numbers((joint.axis if moves else None) or (1.0, 0.0, 0.0), f"the axis of `{joint.name}`", file)
    size = float(np.linalg.norm(axis))
    if size == 0.0:
        raise BayescalError(f"the axis of `{joint.name}` is zero", file, "write its direction")
    limits, most = None, (0.0, 0.0)
    if joint.limit is not None:
        most = (float(joint.limit.velocity), float(joint.limit.effort))
        limits = (float(joint.limit.lower), float(joint.limit.upper))
        _numbers(limits, f"a limit of `{joint.name}`", file)
    place = _frame(joint.origin, joint.name, file)
    velocity, torque = (x if 0.0 < x < UNLIMITED else np.nan for x in most)
    names = (joint.name, joint.type, joint.parent, joint.child)
    loss = [np.nan, np.nan]
    if joint.dynamics is not None:
        stated = [joint.dynamics.damping or 0.0, joint.dynamics.friction or 0.0]
        loss = _numbers(stated, f"the dynamics of `{joint.name}`", file, HEAVIEST).tolist()
    mimic = None
    if joint.mimic is not None:
        ratio = 1.0 if joint.mimic.multiplier is None else joint.mimic.multiplier
        follows = [ratio, joint.mimic.offset or 0.0]
        multiple, offset = _numbers(follows, f"what `{joint.name}` follows", file).tolist()
        mimic = (str(joint.mimic.joint), multiple, offset)
    return Joint(*names, place, axis / size, limits, mimic, velocity, torque, *loss)


def _check_names(names: list[str], what: str, file: str) -> None:
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise BayescalError(f"several {what} are called `{twice[0]}`", file, "rename or remove one")
