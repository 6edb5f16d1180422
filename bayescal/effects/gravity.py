"""Gravity on an arm: deflections by added loads, and errors of the stated masses.

A site that the model contains deflects by its fitted (or true) compliance: joints, bearings, links and the
base. A joint of unknown compliance has the value of the robot file, or a typical one; any other site whose
compliance is unknown is rigid. Measured torques contain the torque of every mass: then only links and base
deflect by an added one.

Masses of links differ from the robot file by 5 %, their centres of mass a little; the load on the flange is
known to half a percent, its centre of mass to a few millimetres. The compliances absorb most of this: the
stated uncertainty of a fit contains what they are wrong by. The remainder looks like an error that depends on
joint angles, so a diagnosis includes it in every hypothesis, with these priors.
Assumed: masses of links may be in error by up to 15 %, but by a common factor, which the compliances absorb.
Wider priors hide true effects (backlash and harmonics of a wrist lost two thirds of their evidence at 15 %
and 0.5 mm).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayescal.arm.chain import frames, link_angles
from bayescal.arm.motion import Term
from bayescal.arm.statics import Loads, centre_of_mass, gravity_in_f0, hinges, placed
from bayescal.effects.axis_bending import AXIS_BENDING
from bayescal.effects.base_compliance import BASE_COMPLIANCE
from bayescal.effects.bending import BENDING
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.vocabulary import Circumstances, Parameter

COMPLIANT = (COMPLIANCE, BENDING, BASE_COMPLIANCE, AXIS_BENDING)
"""Effects whose parameters are compliances: displacement = value x gravity moment."""


def compliances(parameters: Sequence[Parameter], deviations: np.ndarray) -> Mapping[str, float]:
    """Values (SI) of all compliances among P parameters, by name, at deviations (P,) from nominal."""
    names = {effect.name for effect in COMPLIANT}
    out: dict[str, float] = {}
    for p, value in zip(parameters, deviations.tolist(), strict=True):
        if p.effect not in names:
            continue
        out |= {member.name: member.nominal + value * member.centre for member in p.stands_for} or {
            p.name: p.nominal + value
        }
    return out


def deflections(c: Circumstances, loads: Loads) -> tuple[Term, ...]:
    """Displacements of all compliant sites by added gravity moments."""
    added, out = replace(c, loads=loads), []
    for effect in COMPLIANT:
        if effect is COMPLIANCE and c.measured_torques is not None:
            continue
        if effect is not COMPLIANCE and not any(f"{effect.name} " in name for name in c.compliances):
            continue
        makers = (effect.parameters, *(form.parameters for form in effect.forms))
        for p in {p.name: p for make in makers for p in make(added)}.values():
            value = c.compliances.get(p.name, p.centre if effect is COMPLIANCE else 0.0)
            if value:
                out += [replace(term, driver=value * np.asarray(term.driver)) for term in p.terms]
    return tuple(out)


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
    gravity = gravity_in_f0(c.chain, pose, c.gravity, c.stance)
    out: list[Parameter] = []

    def add(name: str, share: float, of_body: list[Loads], off: np.ndarray) -> None:
        """Add the mass and the centre of mass of a body, by the loads of `by_mass`; `off` (3,), m."""
        of_mass, *of_centre = of_body
        out.append(Parameter(f"mass of {name}", "1", deflections(c, of_mass), share))
        for axis, loads, sd in zip("xyz", of_centre, off.tolist(), strict=True):
            out.append(Parameter(f"centre of {name} {axis}", "m", deflections(c, loads), sd))

    for i, (mass, centre) in enumerate(zip(robot.masses, robot.centres_of_mass, strict=True), start=1):
        centres = placed(pose[:, i], centre_of_mass(robot, c.chain, i, c.stance))
        turn = (pose[:, i] if robot.convention == "mdh" else pose[:, i] @ c.chain.link[i])[:, :3, :3]
        off = CENTRE_OFF + MASS_SHARE * np.abs(centre)
        weight = np.full(len(centres), mass)[:, None] * gravity
        add(f"link {i}", MASS_SHARE, about.by_mass(i, weight, centres, turn), off)
    flange, weight = pose[:, n + 1], c.load_mass[:, None] * gravity
    of_load = about.by_mass(n, weight, placed(flange, c.load_centre), flange[:, :3, :3])
    add("load", LOAD_SHARE, of_load, np.full(3, LOAD_OFF))
    return out if any(p.terms for p in out) else []
