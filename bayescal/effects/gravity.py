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
from bayescal.effects.bending import AXIS_BENDING, BENDING
from bayescal.effects.common import by_session, without_masses
from bayescal.effects.compliance import BASE_COMPLIANCE, COMPLIANCE
from bayescal.effects.location import TOOL, Driver, Size, length
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter

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


PAYLOAD_SD, MOMENT_SD = 0.3, 0.03  # kg, kg m
SHARE_SD, SHIFT_SD = 0.3, 0.06  # of the mass, m
ADDED = 0.05  # kg, from which on a row carries an added load


def _loads(c: Circumstances, mass: np.ndarray) -> list[Loads]:
    """Loads by a mass (N,), kg, in the centre of the load, and by its shifts along the axes of the flange."""
    delta = None if c.stance is None else c.stance.delta
    pose = frames(c.chain, link_angles(c.robot, c.readings), delta)
    flange, weight = pose[:, -1], mass[:, None] * gravity_in_f0(c.chain, pose, c.gravity, c.stance)
    centre = placed(flange, c.load_centre)
    return hinges(c.chain, pose, delta).by_mass(c.robot.n, weight, centre, flange[:, :3, :3])


def _parameter(c: Circumstances, name: str, unit: str, sd: float, loads: Loads) -> list[Parameter]:
    terms = deflections(c, loads)
    return [Parameter(f"payload {name}", unit, terms, sd, site=TOOL, driver=Driver("mass"))] if terms else []


def _shifted(c: Circumstances, name: str, unit: str, sd: float, loads: Sequence[Loads]) -> list[Parameter]:
    """Parameters of the centre of a mass, by the loads of its shifts."""
    return [
        p
        for axis, by in zip("xyz", loads, strict=True)
        for p in _parameter(c, f"{name} {axis}", unit, sd, by)
    ]


def _payload(c: Circumstances) -> list[Parameter]:
    return _parameter(c, "mass", "kg", PAYLOAD_SD, _loads(c, np.ones(len(c.q)))[0])


def _elsewhere(c: Circumstances) -> list[Parameter]:
    of_mass, *of_shifts = _loads(c, np.ones(len(c.q)))
    return [
        *_parameter(c, "mass", "kg", PAYLOAD_SD, of_mass),
        *_shifted(c, "moment", "kg m", MOMENT_SD, of_shifts),
    ]


def _added(c: Circumstances) -> list[Parameter]:
    """The load beyond the least with the same tool; nothing where the rows to fit carry the same load."""
    least = {t: np.min(c.load_mass[c.tool == t]) for t in np.unique(c.tool).tolist()}
    mass = c.load_mass - np.array([least[t] for t in c.tool.tolist()])
    if not np.any(mass[c.fitted] > ADDED):
        return []
    of_mass, *of_shifts = _loads(c, mass)
    share = _parameter(c, "added share", "1", SHARE_SD, of_mass)
    return [*share, *_shifted(c, "added centre", "m", SHIFT_SD, of_shifts)]


def _payload_missing(c: Circumstances) -> str:
    measured = "the torques are measured: they contain the payload"
    return without_masses(c) if c.measured_torques is None else measured


PAYLOAD = Effect(
    "payload",
    "payload mass or centre of mass differs from what was stated",
    _payload,
    _payload_missing,
    sizes={
        "kg": Size("additional mass"),
        "kg m": Size("first moment", length),
        "1": Size("additional share of the added load"),
        "m": Size("shift of the centre of the added load", length),
    },
    phrase=("the tool", "carries a payload that differs from what was stated"),
    remedy=(
        "Weigh the tool with its cables and bracket, and find its centre of mass. Correct the load in "
        "the controller and in dataset.yaml, and fasten loose loads."
    ),
    requires=("compliance",),
    forms=(
        by_session(_payload),
        Form("elsewhere", "a mass that hangs elsewhere than the tool's centre of mass", _elsewhere),
        Form("added", "an added load that hangs elsewhere, or differs in mass", _added),
    ),
    simulated_within=2e-8,
)
r"""Payload: the mass on the flange differs from the stated mass, and deflects every compliant site.

Formula: $`\rho_k = c_k \, m \, \frac{\partial M_k}{\partial m}`$;
at every compliant site k, with its compliance c.

Driver: the gravity moments of one kilogram at the tool's centre of mass times the compliances of all sites
(`deflection`). The value in kilograms is only as accurate as these compliances. Prior: 0.3 kg (assumed: the
mass of a probe, its cable and its bracket is an estimate).

Two further forms have more unknowns, and pay for them in the evidence. In ``payload@elsewhere`` the mass
hangs elsewhere than the tool's centre of mass: its first moment about that centre is free, with a prior of
0.03 kg m (0.3 kg at 0.1 m). In ``payload@added`` the load that some rows carry beyond the others differs from
the stated one: its mass by a share (prior 0.3) and its centre by a shift (prior 0.06 m; assumed: a load that
is clamped by hand hangs some centimetres off).
"""
