"""Errors of the stated masses of a loaded arm, as displacements of every compliant site.

Masses of links differ from the robot file by 5 %, their centres of mass a little; the load on the flange is
known to half a percent, its centre of mass to a few millimetres. The compliances absorb most of this: the
stated uncertainty of a fit contains what they are wrong by. The remainder looks like an error that depends on
joint angles, so a diagnosis includes it in every hypothesis, with these priors.
Assumed: masses of links may be in error by up to 15 %, but by a common factor, which the compliances absorb.
Wider priors hide true effects (backlash and harmonics of a wrist lost two thirds of their evidence at 15 %
and 0.5 mm).
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import frames, link_angles
from bayescal.arm.statics import centre_of_mass, hinges, placed
from bayescal.effects.deflection import deflections
from bayescal.effects.vocabulary import Circumstances, Parameter

MASS_SHARE = 0.05
"""Standard uncertainty of a link's mass, and of each coordinate of its centre, as a share (assumed)."""
LOAD_SHARE = 0.005
"""Standard uncertainty of the mass of the load on the flange, as a share (assumed: it was weighed)."""
CENTRE_OFF = 2e-4
"""Standard uncertainty of a link's centre of mass beside the share of its coordinate, m (assumed)."""
LOAD_OFF = 4e-3
"""Standard uncertainty of each coordinate of the load's centre of mass, m (tuned: a tool is weighed, but its
centre is computed; with 10 mm small payloads are no longer named)."""


def masses(c: Circumstances) -> list[Parameter]:
    """Relative errors of masses and shifts of centres of mass, of each link and of the load.

    One that loads nothing in these rows has no terms; without any that has, there are none.
    """
    robot, n = c.robot, c.robot.n
    if robot.masses is None or robot.centres_of_mass is None or c.moments is None:
        return []
    delta = None if c.stance is None else c.stance.delta
    pose = frames(c.chain, link_angles(robot, c.readings), delta)
    about = hinges(c.chain, pose, delta)
    out: list[Parameter] = []

    def add(
        name: str,
        share: float,
        body: int,
        mass: np.ndarray,
        at: np.ndarray,
        turn: np.ndarray,
        off: np.ndarray,
    ) -> None:
        """Add mass (N,) and centre of mass (N, 3) in F0 of a body of orientation (N, 3, 3); `off` (3,), m."""
        of_mass, *of_centre = about.by_mass(body, mass[:, None] * c.gravity, at, turn)
        out.append(Parameter(f"mass of {name}", "1", deflections(c, of_mass), share))
        for axis, loads, sd in zip("xyz", of_centre, off.tolist(), strict=True):
            out.append(Parameter(f"centre of {name} {axis}", "m", deflections(c, loads), sd))

    for i, (mass, centre) in enumerate(zip(robot.masses, robot.centres_of_mass, strict=True), start=1):
        at = placed(pose[:, i], centre_of_mass(robot, c.chain, i, c.stance))
        turn = (pose[:, i] if robot.convention == "mdh" else pose[:, i] @ c.chain.link[i])[:, :3, :3]
        off = CENTRE_OFF + MASS_SHARE * np.abs(centre)
        add(f"link {i}", MASS_SHARE, i, np.full(len(at), mass), at, turn, off)
    flange, off = pose[:, n + 1], np.full(3, LOAD_OFF)
    add("load", LOAD_SHARE, n, c.load_mass, placed(flange, c.load_centre), flange[:, :3, :3], off)
    return out if any(p.terms for p in out) else []
