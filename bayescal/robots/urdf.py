"""A URDF chain as modified DH rows, exactly.

With all joints at zero, F0 is what stands before the first joint, Fi between joints i and i + 1, Fn from the
last joint to the tip, each a constant transform. A joint turns about a unit vector, of which R is a rotation
that takes z there, by R Rz(q) R'; a prismatic one slides along it, by R Tz(q) R'. So the chain is

    F0 R1 Rz(q1) R1' F1 R2 Rz(q2) ... Rz(qn) Rn' Fn  =  K0 Rz(q1) K1 Rz(q2) ... Rz(qn) Kn,

with Ki = Ri' Fi R(i+1) constant. Any rigid transform is Rz(t) Tz(u) [Rx(alpha) Tx(a) Ry(beta)] Rz(t')
Tz(u') (`arm.transforms.split`). The bracket of Ki is row i + 1; t and u add to the offset and d of joint i,
t' and u' to those of joint i + 1, with whose turn and slide they commute. K0 is the base. Of Kn the slide
along the last axis is its d, and what is left is the flange. Where K0 or Kn is no more than a turn and a
slide, base or flange is the identity. Signs stay those of the URDF: a row's z is the joint's axis.

A point c of the URDF's link i, the child of joint i, is at (Rz(t) Tz(u))^-1 Ri' c of the row's link frame.
Masses of all that hangs on a link by fixed joints, or by joints beside the chain (at zero), are its own.

The stages of a telescopic column are prismatic joints of which all but one follow it (``mimic``: a multiple
of its reading, plus an offset). They slide along one direction, with constant transforms between them: so
they are one joint, which slides by the sum of the multiples per reading. Masses of inner stages count to the
outer link.

A chain may begin at another link than the root, such as the flange of a first arm, which then is F0: the tree
is seen from there (`Tree.seen_from`), and the last link on the way to the root is the ground.

XML that comes from elsewhere: read from this disk alone, without entities.
"""

import re
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from bayescal.arm.chain import Ground, Robot
from bayescal.arm.transforms import rigid, rotation, split
from bayescal.errors import BayescalError
from bayescal.robots.tree import MOVING, TURNING, Joint, Tree, chain_in, read_tree

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


EXACT = 1e-13
"""m and rad: what is taken for rounding where a base or flange is looked at."""

REACH = (0.02, 50.0)
"""m: a chain whose lengths add up to less or more was not written in metres."""

WIDEST = 30.0
"""rad: no joint moves that far; limits beyond were written in degrees."""


def robot_from_urdf(content: bytes, file: str, tip: str = "") -> Robot:
    """Read the arm of a URDF, in modified DH.

    Parameters
    ----------
    content : bytes
        The text of the URDF.
    file : str
        Its name, for messages.
    tip : str
        The link that tools are given in; the end of the longest chain where left out. F0 is the root link, or
        the first of ``first..tip``: of two arms, that which carries what is measured.

    Raises
    ------
    BayescalError
        For what is not a URDF of this disk, a chain with joints that float or follow others (but stages of a
        column), several longest chains, no limits, or lengths and angles that cannot be m and rad.
    """
    stood = read_tree(parse_markup(content, file), file)
    tree, tip = chain_in(stood, tip)
    tree, stages = _joined(tree, tree.above(tip))
    chain = tree.above(tip)
    for joint in chain:
        if joint.mimic or joint.kind not in (*MOVING, "fixed"):
            what = f"joint `{joint.name}` {'follows another joint' if joint.mimic else f'is {joint.kind}'}"
            remedy = "only joints that turn or slide are known: choose a tip before it, as in"
            raise BayescalError(what, file, f"{remedy} `robot: {file}#{joint.parent}`")
    moving = [joint for joint in chain if joint.kind in MOVING]
    if not moving:
        what = f"no joint moves between `{tree.root}` and `{tip}`"
        raise BayescalError(what, tree.file, "choose another tip")
    n = len(moving)
    prismatic = np.array([joint.kind not in TURNING for joint in moving])
    endless = np.array([joint.kind == "continuous" for joint in moving])
    ratio = np.array([stages.get(joint.name, 1.0) for joint in moving])
    limits = np.array([_limits(joint, tree.file) for joint in moving])
    between = _between(chain)
    alpha, a, beta, offset, d = np.zeros((5, n))
    behind = np.tile(np.eye(4), (n, 1, 1))  # from a joint's turn to its row's link frame
    for k in range(1, n):
        (alpha[k], a[k], beta[k]), (turn, slide), (next_turn, next_slide) = split(between[k])
        behind[k - 1] = _screw(turn, slide)
        offset[k - 1 : k + 1] += turn, next_turn
        d[k - 1 : k + 1] += slide, next_slide
    base, turn, slide = _end(between[0])
    offset[0], d[0] = offset[0] + turn, d[0] + slide
    flange, turn, slide = _end(between[n])
    if not np.array_equal(flange, np.eye(4)):  # the slide along the last axis is still a length of the arm's
        slide = float(between[n][2, 3])
        flange = _screw(0.0, -slide) @ between[n]
    offset[n - 1], d[n - 1] = offset[n - 1] + turn, d[n - 1] + slide
    behind[n - 1] = _screw(turn, slide)
    reach = np.abs(np.concatenate([a, d])).sum() + np.ptp(limits[prismatic], axis=1).sum()
    if not REACH[0] <= reach <= REACH[1]:
        raise BayescalError(f"the arm's lengths add up to {reach:g} m", file, "a URDF is in metres")
    masses, centres, inertias, held = _lumped(tree, moving, behind)
    ground = None
    up = {joint.name for joint in tree.above(stood.root)}
    if passed := sum(joint.name in up for joint in moving):
        ground = Ground(passed, _in_row(tree, moving, behind, stood.root)[1], *held)
        masses[passed - 1], inertias[passed - 1] = 0.0, 0.0  # of the link that stands still
    return Robot(
        name=tree.name,
        convention="mdh",
        joint_names=tuple(joint.name for joint in moving),
        alpha=alpha,
        a=a,
        d=d,
        offset=np.arctan2(np.sin(offset), np.cos(offset)),
        beta=beta,
        limits=np.abs(ratio)[:, None] * limits,
        link_from_reading=np.diag(ratio),
        prismatic=prismatic if prismatic.any() else None,
        endless=endless if endless.any() else None,
        base=base,
        masses=masses if np.any(masses) else None,
        centres_of_mass=centres if np.any(masses) else None,
        flange=flange,
        ground=ground,
        velocities=_most([joint.velocity for joint in moving]),
        torques=_most([joint.torque for joint in moving]),
        inertias=inertias if np.any(inertias) else None,
        coulomb=_most([joint.friction if joint.kind in TURNING else np.nan for joint in moving]),
        viscous=_most([joint.damping if joint.kind in TURNING else np.nan for joint in moving]),
    )


def _joined(tree: Tree, chain: list[Joint]) -> tuple[Tree, dict[str, float]]:
    """A tree whose stages that follow another one are fixed, and how far those, by name, slide for all.

    A joint that follows in any other way is left as it is.
    """
    index = {joint.name: k for k, joint in enumerate(chain)}
    joints, ratio = dict(tree.joints), dict[str, float]()
    for k, joint in enumerate(chain):
        if joint.mimic is None or joint.mimic[0] not in index:
            continue
        leader = chain[index[joint.mimic[0]]]
        low, high = sorted((k, index[leader.name]))
        between = chain[low + 1 : high]
        group = all(j.kind == "fixed" or (j.mimic and j.mimic[0] == leader.name) for j in between)
        turn = np.eye(3)
        for step in chain[low + 1 : high + 1]:
            turn = turn @ step.place[:3, :3]
        along = float(chain[low].axis @ turn @ chain[high].axis)
        if group and leader.kind == joint.kind == "prismatic" and 1.0 - abs(along) < EXACT:
            _, multiple, offset = joint.mimic
            ratio[leader.name] = ratio.get(leader.name, 1.0) + multiple * np.sign(along)
            place = joint.place @ rigid(None, offset * joint.axis)
            joints[joint.child] = replace(joint, kind="fixed", place=place, mimic=None)
    return replace(tree, joints=joints), ratio


def _most(values: list[float]) -> np.ndarray | None:
    """Largest speeds or torques of joints, (n,); None where no joint states any."""
    return None if np.all(np.isnan(values)) else np.array(values)


def _between(chain: list[Joint]) -> list[np.ndarray]:
    """K0 to Kn: constant transforms between the turns of a chain's joints."""
    out = [np.eye(4)]
    for joint in chain:
        out[-1] = out[-1] @ joint.place
        if joint.kind in MOVING:
            onto = rigid(_onto(joint.axis))
            out[-1] = out[-1] @ onto
            out.append(onto.T)
    return out


def _onto(axis: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) that takes z to a unit vector; opposite to z, half a turn about x."""
    if axis[2] < 0.0:  # turn half over first: near -z the smallest turn is ill determined
        return _onto(-axis) @ np.diag([1.0, -1.0, -1.0])
    return smallest_turn(np.array([0.0, 0.0, 1.0]), axis)


def smallest_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) that takes a unit vector to another, nearby one."""
    cross = np.cross(a, b)
    skew = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + float(a @ b))


def _screw(turn: float, slide: float) -> np.ndarray:
    return rigid(rotation(2, turn), np.array([0.0, 0.0, slide]))


def _end(m: np.ndarray) -> tuple[np.ndarray, float, float]:
    """A transform at a chain's end as a frame and a turn and slide: all in these two where that is all."""
    turn, slide = float(np.arctan2(m[1, 0], m[0, 0])), float(m[2, 3])
    if np.abs(m - _screw(turn, slide)).max() < EXACT:
        return np.eye(4), turn, slide
    return m, 0.0, 0.0


def _in_row(tree: Tree, moving: list[Joint], behind: np.ndarray, link: str) -> tuple[int, np.ndarray]:
    """Number of the row, from 1, that moves a link, and the link's pose (4, 4) in its frame; 0 and in F0."""
    number = {joint.name: i for i, joint in enumerate(moving)}
    row, pose = 0, np.eye(4)
    for joint in tree.above(link):
        pose = pose @ joint.place
        if joint.name in number:
            row = number[joint.name] + 1
            pose = np.linalg.inv(behind[row - 1]) @ rigid(_onto(joint.axis).T)
    return row, pose


def _lumped(
    tree: Tree, moving: list[Joint], behind: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, np.ndarray]]:
    """Masses (n,), kg, their centres (n, 3), m, and inertias (n, 3, 3), in the rows' link frames.

    The last are mass and centre (3,), in F0, of what no joint moves: it stands, or moves with F0.
    """
    n = len(moving) + 1
    masses, moments, inertias = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    for link, body in tree.bodies.items():
        i, pose = _in_row(tree, moving, behind, link)
        centre = pose[:3, :3] @ body.centre + pose[:3, 3]
        masses[i] += body.mass
        moments[i] += body.mass * centre
        inertias[i] += pose[:3, :3] @ body.inertia @ pose[:3, :3].T + body.mass * _about(centre)
    centres = np.divide(moments, masses[:, None], out=np.zeros_like(moments), where=masses[:, None] > 0.0)
    inertias -= masses[:, None, None] * np.array([_about(centre) for centre in centres])
    return masses[1:], centres[1:], inertias[1:], (float(masses[0]), centres[0])


def _about(centre: np.ndarray) -> np.ndarray:
    """Inertia (3, 3) of a unit mass at a point about the origin."""
    return centre @ centre * np.eye(3) - np.outer(centre, centre)


def _limits(joint: Joint, file: str) -> tuple[float, float]:
    if joint.kind == "continuous":
        return -2.0 * np.pi, 2.0 * np.pi
    if joint.limits is None or not joint.limits[0] < joint.limits[1]:
        what = f"joint `{joint.name}` has no limits in order"
        raise BayescalError(what, file, "state lower and upper, rad or m")
    widest, unit = (WIDEST, "rad") if joint.kind in TURNING else (REACH[1], "m")
    if max(map(abs, joint.limits)) > widest:
        raise BayescalError(f"the limits of joint `{joint.name}` are too wide", file, f"write them in {unit}")
    return joint.limits
