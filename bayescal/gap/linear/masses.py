"""Errors of stated masses of a loaded arm, as columns that every hypothesis may use.

Masses of links differ from the robot file by 5 %, their centres of mass a little; the load on the flange is
known to half a percent, its centre of mass to a few millimetres. The compliances absorb most of this. The
remainder looks like an error that depends on joint angles, so a diagnosis includes it, with these priors.
Assumed: masses of links may be in error by up to 15 %, but by a common factor, which the compliances absorb.
Wider priors hide true effects (backlash and harmonics of a wrist lost two thirds of their evidence at 15 %
and 0.5 mm).
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import frames, link_angles
from bayescal.arm.statics import centre_of_mass, hinges, placed
from bayescal.effects import Circumstances, Parameter
from bayescal.effects.deflection import deflections
from bayescal.gap.settings import LINEAR


def masses(c: Circumstances) -> list[Parameter]:
    """Errors of masses and centres of mass, of each link and of the load, as deflections of all sites."""
    robot, n = c.robot, c.robot.n
    if robot.masses is None or robot.centres_of_mass is None or c.moments is None:
        return []
    delta = None if c.stance is None else c.stance.delta
    pose = frames(c.chain, link_angles(robot, c.readings), delta)
    about, carried = hinges(c.chain, pose, delta), np.arange(n + 1)[:, None]
    out: list[Parameter] = []

    def add(name: str, body: int, moment: np.ndarray, weight: np.ndarray) -> None:
        """Add a parameter: a moment about F0's origin, N m, and a weight, N, (N, 3), up to frame `body`."""
        loads = about.loads(*(np.where(carried <= body, x[:, None], 0.0) for x in (moment, weight)))
        if terms := deflections(c, loads):
            out.append(Parameter(name, "1", terms, 1.0))

    def add_body(
        name: str, body: int, mass: np.ndarray, at: np.ndarray, turn: np.ndarray, off: np.ndarray
    ) -> None:
        """Add mass (N,) and centre of mass (N, 3) in F0 of a body of orientation (N, 3, 3); `off` (3,), m."""
        share = LINEAR.load_share if name == "load" else LINEAR.mass_share
        weight = mass[:, None] * c.gravity
        add(f"mass of {name}", body, share * np.cross(at, weight), share * weight)
        for k, axis in enumerate("xyz"):
            add(f"centre of {name} {axis}", body, off[k] * np.cross(turn[:, :, k], weight), 0.0 * weight)

    for i, (mass, centre) in enumerate(zip(robot.masses, robot.centres_of_mass, strict=True), start=1):
        at = placed(pose[:, i], centre_of_mass(robot, c.chain, i, c.stance))
        turn = (pose[:, i] if robot.convention == "mdh" else pose[:, i] @ c.chain.link[i])[:, :3, :3]
        off = LINEAR.centre_off + LINEAR.mass_share * np.abs(centre)
        add_body(f"link {i}", i, np.full(len(at), mass), at, turn, off)
    flange, off = pose[:, n + 1], np.full(3, LINEAR.load_off)
    add_body("load", n, c.load_mass, placed(flange, c.load_centre), flange[:, :3, :3], off)
    return out
