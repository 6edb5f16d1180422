"""Errors of stated masses of a loaded arm, as columns that every hypothesis may use.

Masses of links differ from the robot file by 5 %, their centres of mass a little; the load on the flange is
known to half a percent. The compliances absorb most of this. The remainder looks like an error that depends
on joint angles, so a diagnosis includes it, with these priors. Assumed: masses of links may be in error by
up to 15 %, but by a common factor, which the compliances absorb. Wider priors hide true effects (backlash
and harmonics of a wrist lost two thirds of their evidence at 15 % and 0.5 mm).
"""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import frames
from bayescal.arm.motion import Term
from bayescal.effects import Circumstances, Parameter
from bayescal.effects.compliance import expected
from bayescal.effects.joints import carries
from bayescal.gap.settings import LINEAR


def masses(c: Circumstances, delta: np.ndarray | None = None) -> list[Parameter]:
    """Errors of masses and centres of mass as rotations of the loaded joints: of each link and of the load.

    Parameters
    ----------
    c : Circumstances
    delta : np.ndarray, shape (N, n + 2, 6), optional
        Displacements of the frames from nominal.
    """
    robot, n = c.robot, c.robot.n
    if robot.masses is None or robot.centres_of_mass is None or c.moments is None:
        return []
    compliance = expected(robot) if c.compliance is None else c.compliance
    pose = frames(c.chain, c.q, delta)
    axes, origins = pose[:, 1 : n + 1, :3, 2], pose[:, 1 : n + 1, :3, 3]
    turn = np.cross(c.gravity, axes)  # (N, n, 3): a kilogram at x loads an axis with turn . (x - origin)
    out: list[Parameter] = []

    def add(name: str, body: int, kilograms: np.ndarray, lever: np.ndarray) -> None:
        """Add a parameter: kilograms (N,) at levers (N, n, 3), m, carried by the joints up to `body`."""
        torque = np.sum(turn * lever, axis=2) * kilograms[:, None]
        terms = tuple(
            Term(j, "rz", compliance[j - 1] * torque[:, j - 1])
            for j in range(1, body + 1)
            if compliance[j - 1] > 0 and carries(torque[:, j - 1])
        )
        if terms:
            out.append(Parameter(name, "1", terms, 1.0))

    def add_body(name: str, body: int, place: np.ndarray, centre: np.ndarray, mass: np.ndarray) -> None:
        """Add mass and centre of mass (N, 3) of a body with the pose `place` (N, 4, 4)."""
        share = LINEAR.load_share if name == "load" else LINEAR.mass_share
        at = (place[:, :3, :3] @ centre[..., None])[..., 0] + place[:, :3, 3]
        add(f"mass of {name}", body, share * mass, at[:, None] - origins)
        for k, axis in enumerate("xyz"):
            off = LINEAR.centre_off + (0.0 if name == "load" else LINEAR.mass_share) * np.abs(centre[:, k])
            way = np.broadcast_to(place[:, None, :3, k], origins.shape)
            add(f"centre of {name} {axis}", body, off * mass, way)

    for i in range(1, n + 1):
        place = pose[:, i] if robot.convention == "mdh" else pose[:, i] @ c.chain.link[i]
        centre = np.broadcast_to(robot.centres_of_mass[i - 1], (len(place), 3))
        add_body(f"link {i}", i, place, centre, np.full(len(place), robot.masses[i - 1]))
    add_body("load", n, pose[:, n + 1], c.load_centre, c.load_mass)
    return out
