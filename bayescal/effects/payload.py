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

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.arm.chain import frames, link_angles
from bayescal.arm.statics import Loads, gravity_in_f0, hinges, placed
from bayescal.effects.common import by_session, without_masses
from bayescal.effects.gravity import deflections
from bayescal.effects.location import TOOL, Driver
from bayescal.effects.sizes import Size, length
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter

SD, MOMENT_SD = 0.3, 0.03  # kg, kg m
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


def _parameters(c: Circumstances) -> list[Parameter]:
    return _parameter(c, "mass", "kg", SD, _loads(c, np.ones(len(c.q)))[0])


def _elsewhere(c: Circumstances) -> list[Parameter]:
    of_mass, *of_shifts = _loads(c, np.ones(len(c.q)))
    return [*_parameter(c, "mass", "kg", SD, of_mass), *_shifted(c, "moment", "kg m", MOMENT_SD, of_shifts)]


def _added(c: Circumstances) -> list[Parameter]:
    """The load beyond the least with the same tool; nothing where the rows to fit carry the same load."""
    least = {t: np.min(c.load_mass[c.tool == t]) for t in np.unique(c.tool).tolist()}
    mass = c.load_mass - np.array([least[t] for t in c.tool.tolist()])
    if not np.any(mass[c.fitted] > ADDED):
        return []
    of_mass, *of_shifts = _loads(c, mass)
    share = _parameter(c, "added share", "1", SHARE_SD, of_mass)
    return [*share, *_shifted(c, "added centre", "m", SHIFT_SD, of_shifts)]


def _missing(c: Circumstances) -> str:
    measured = "the torques are measured: they contain the payload"
    return without_masses(c) if c.measured_torques is None else measured


PAYLOAD = Effect(
    "payload",
    "payload mass or centre of mass differs from what was stated",
    _parameters,
    _missing,
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
        by_session(_parameters),
        Form("elsewhere", "a mass that hangs elsewhere than the tool's centre of mass", _elsewhere),
        Form("added", "an added load that hangs elsewhere, or differs in mass", _added),
    ),
    simulated_within=2e-8,
)
