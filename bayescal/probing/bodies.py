"""Capsules of an arm and its tool, from the lengths of the kinematic table.

The body of a link follows the table: from the origin of its frame along the common normal to the next joint
axis, and along that axis to the next origin. A link with both lengths is therefore an L of two capsules. The
part along the next axis houses that joint, and has the radius of the next link. If the two joint axes are
parallel, the table does not say where between them the link lies: the upper arm of a UR5 stands 0.14 m beside
its common normal. The centre of mass, if it is stated, says it (UR5, UR10, PUMA 560: within 25 mm of the
joint offsets that their descriptions give).

Assumed: the radius decreases linearly along the arm from `BASE` to `WRIST`, as fractions of the length of the
arm from axis 2 to the flange. Published capsules, as the same fractions, of upper arm, forearm and wrist:
Motoman GP50 0.09, 0.06, 0.07 and LR Mate 200iD 0.17, 0.11 (robotproperty.m of planners by Liu and others,
github.com/intelligent-control-lab: cylinders about the whole casting); Panda 0.07, 0.07, 0.06 (spheres of its
collision models); UR5e 0.06, 0.05, 0.04 and UR10e 0.05, 0.04, 0.03 (MuJoCo Menagerie). The assumption is near
the first, wide for collaborative arms and narrow for the shoulder of small industrial ones. `radius_mm` of a
link in robot.yaml replaces it.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from bayescal.arm.chain import Chain, Robot, chain_of
from bayescal.arm.shapes import Capsule
from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset.types import Tool

BASE, WRIST = 0.10, 0.055
"""Radius of the links at axis 2 and at the flange, of the length of the arm between them."""

MERGED = 0.25
"""Corners of a link nearer to each other than this fraction of its radius are a single corner."""

STYLUS = 0.05
"""m, assumed: length of a stylus (M2 to M4 styli are 10 to 100 mm long); at most half of the tool."""

PROBE = 0.02
"""m: radius of the body of a tool, from the flange to its stylus. Touch probes for robots have a diameter of
25 to 40 mm, the adapter of a tool about that of a small flange (ISO 9409-1-31.5: 40 mm)."""

PASSING = PROBE + 0.01
"""m: from a flange that is turned by a right angle to the forearm, whose last axes meet: a tool passes it."""

SHAFT = 0.7
"""Radius of a stylus shaft, of that of its ball (ruby styli: 1.5 to 2.5 mm for a ball of 3 mm)."""

TIP = 4.0
"""Length of the last part of a stylus, in radii of its ball: the part that may touch the target. A target out
of place by 1 mm, or a deflected arm, then is no collision."""

PARALLEL = 1e-6  # rad, between joint axes
ALONG = 0.95
"""Cosine: a part of a link along the next joint axis, of which merged corners may turn it a little."""


def arm_capsules(
    robot: Robot, tool: Tool, stand: float = 0.0, held: Sequence[Capsule] = ()
) -> tuple[Capsule, ...]:
    """Capsules of an arm with its tool, from base to ball.

    Parameters
    ----------
    robot : Robot
    tool : Tool
    stand : float
        Height of the column below the first frame, m, along its z axis: for an F0 that is not at the foot. A
        carriage has none.
    held : sequence of Capsule
        What the tool holds beside itself, in its frame.

    Returns
    -------
    tuple of Capsule
        Several for a link with several lengths, none for a link without.
    """
    chain = chain_of(robot)
    radii, lengths = link_radii(robot), _lengths(chain)
    out = []
    if stand > 0 and not robot.slides[0]:
        foot = np.array([0.0, 0.0, -stand])
        out.append(Capsule(0, foot, np.zeros(3), float(radii[0]), "base"))
    for link in range(robot.n + 1):
        name = "base" if link == 0 else f"link {link}"
        for a, b in pairwise(_corners(robot, chain, link, MERGED * radii[link])):
            along = abs((b - a) @ chain.link[link, :3, 2]) > ALONG * np.linalg.norm(b - a)
            last = link < robot.n and np.allclose(b, _step(chain, link))
            number = link + (along and last)
            radius = float(radii[number])
            stated = robot.radii is not None and np.isfinite(robot.radii[max(number - 1, 0)])
            in_wrist = last and link + 1 < robot.n and lengths[link + 1] < MERGED * radius
            if in_wrist and not stated:
                over = np.sqrt(max((radius + PASSING) ** 2 - lengths[link + 1 :].sum() ** 2, 0.0))
                b = b - min(over / np.linalg.norm(b - a), 1.0) * (b - a)
            out.append(Capsule(link, a, b, radius, name))
    turn = np.eye(3) if tool.rpy is None else rpy_matrix(tool.rpy)
    for body in held:
        a, b = (turn @ end + tool.centre for end in (body.a, body.b))
        out.append(Capsule(robot.n + 1, a, b, body.radius, f"{body.name} on the flange"))
    return (*out, *_tool(robot.n + 1, tool))


def link_radii(robot: Robot) -> np.ndarray:
    """Radii (n + 1,), m, of the base and the links: as the robot file states, otherwise assumed."""
    lengths = _lengths(chain_of(robot))
    first = min(2, robot.n)  # links before axis 2 carry the arm and are not part of its length
    arm = float(lengths[first:].sum() or lengths.sum())
    to_flange = lengths[::-1].cumsum()[::-1] - 0.5 * lengths
    if robot.ground is not None:  # a flange at each end
        to_flange, arm = np.minimum(to_flange, lengths.cumsum() - 0.5 * lengths), 0.5 * arm
    out = arm * (WRIST + (BASE - WRIST) * np.minimum(to_flange / max(arm, 1e-9), 1.0))
    if robot.radii is not None:
        stated = np.concatenate([robot.radii[:1], robot.radii])
        out = np.where(np.isnan(stated), out, stated)
    return out


def _lengths(chain: Chain) -> np.ndarray:
    """Length of the base and of each link, (n + 1,), m."""
    return np.linalg.norm([_step(chain, link) for link in range(chain.n + 1)], axis=1)


def _step(chain: Chain, link: int) -> np.ndarray:
    """Origin of the next frame (3,), m, in frame `link`; of the flange behind the last."""
    along = chain.d[link] if link < chain.n else 0.0
    return chain.link[link, :3, 3] + chain.link[link, :3, 2] * along


def _corners(robot: Robot, chain: Chain, link: int, near: float) -> list[np.ndarray]:
    """Corners of a link in its own frame, from its origin to the next; nearer than `near`, m, are merged."""
    end = _step(chain, link)
    corners = [np.zeros(3), end]
    if link < chain.n:
        z = chain.link[link, :3, 2]
        beside = np.array([0.0, 0.0, _beside(robot, chain, link)])
        corners = [np.zeros(3), beside, chain.link[link, :3, 3] + beside, end]
        if np.hypot(z[0], z[1]) > PARALLEL:
            corners[1:3] = [chain.link[link, :3, 3]]
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.linalg.norm(corner - kept[-1]) > near:
            kept.append(corner)
    if len(kept) > 1 and np.linalg.norm(end - kept[-1]) <= near:
        kept[-1] = end
    return kept


def _beside(robot: Robot, chain: Chain, link: int) -> float:
    """How far along its joint axis the body of a link is, m, by its centre of mass; 0 if none is stated."""
    if link == 0 or robot.centres_of_mass is None:
        return 0.0
    centre = robot.centres_of_mass[link - 1]
    if robot.convention == "dh":  # its link frame stands behind the whole row
        centre = chain.link[link, :3, :3] @ centre + chain.link[link, :3, 3]
    return float(centre[2])


def _tool(flange: int, tool: Tool) -> tuple[Capsule, ...]:
    """Body, stylus, its last part and the ball of a tool; a tool without a ball is all body."""
    length = float(np.linalg.norm(tool.centre))
    if length == 0.0:
        return ()
    out = tool.centre / length
    name = f"tool {tool.name}"
    if tool.ball_radius is None:
        radius = min(PROBE, 0.5 * length)
        return (Capsule(flange, np.zeros(3), (length - radius) * out, radius, name),)
    ball = tool.ball_radius
    stylus = min(STYLUS, 0.5 * length)
    tip = min(TIP * ball, 0.5 * stylus)
    radius = min(PROBE, 0.5 * (length - stylus))
    shaft = SHAFT * ball
    root, neck = (length - stylus) * out, (length - tip) * out
    return (
        Capsule(flange, np.zeros(3), root - radius * out, radius, name),
        Capsule(flange, root - radius * out, neck, shaft, f"stylus of {name}"),
        Capsule(flange, neck, tool.centre, shaft, f"stylus of {name}", probe=True),
        Capsule(flange, tool.centre, tool.centre, ball, f"ball of {name}", probe=True),
    )
