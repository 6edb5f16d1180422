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
from bayescal.effects import Circumstances, Parameter
from bayescal.effects.deflection import deflections
from bayescal.gap.settings import LINEAR


def masses(c: Circumstances) -> list[Parameter]:
    """Errors of masses and centres of mass, of each link and of the load, as deflections of all sites."""
    robot, n = c.robot, c.robot.n
    if robot.masses is None or robot.centres_of_mass is None or c.moments is None:
        return []
    pose = frames(c.chain, link_angles(robot, c.readings), c.delta)
    about = pose[:, : n + 1].copy()
    about[:, 0] = c.chain.base  # the base deflects about its undisplaced origin
    turned, origins = about[..., :3, :3], about[..., :3, 3]
    out: list[Parameter] = []

    def add(name: str, body: int, kilograms: np.ndarray, lever: np.ndarray) -> None:
        """Add a parameter: kilograms (N,) at levers (N, n + 1, 3), m, carried by the frames up to `body`."""
        moments = np.cross(lever, kilograms[:, None, None] * c.gravity)
        moments = (np.swapaxes(turned, -1, -2) @ moments[..., None])[..., 0]
        moments[:, body + 1 :] = 0.0
        if terms := deflections(c, moments):
            out.append(Parameter(name, "1", terms, 1.0))

    def add_body(name: str, body: int, place: np.ndarray, centre: np.ndarray, mass: np.ndarray) -> None:
        """Add mass and centre of mass (N, 3) of a body with the pose `place` (N, 4, 4)."""
        share = LINEAR.load_share if name == "load" else LINEAR.mass_share
        at = (place[:, :3, :3] @ centre[..., None])[..., 0] + place[:, :3, 3]
        add(f"mass of {name}", body, share * mass, at[:, None] - origins)
        for k, axis in enumerate("xyz"):
            of_link = LINEAR.centre_off + LINEAR.mass_share * np.abs(centre[:, k])
            off = LINEAR.load_off if name == "load" else of_link
            way = np.broadcast_to(place[:, None, :3, k], origins.shape)
            add(f"centre of {name} {axis}", body, off * mass, way)

    for i in range(1, n + 1):
        place = pose[:, i] if robot.convention == "mdh" else pose[:, i] @ c.chain.link[i]
        centre = np.broadcast_to(robot.centres_of_mass[i - 1], (len(place), 3))
        add_body(f"link {i}", i, place, centre, np.full(len(place), robot.masses[i - 1]))
    add_body("load", n, pose[:, n + 1], c.load_centre, c.load_mass)
    return out
