"""Payload: the mass on the flange differs from the stated mass, and deflects every compliant site.

Driver: the gravity moments of one kilogram at the tool's centre of mass times the compliances of all sites
(`deflection`). The value in kilograms is only as accurate as these compliances. Prior: 0.3 kg (assumed: the
mass of a probe, its cable and its bracket is an estimate).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.arm.chain import link_angles
from bayescal.arm.statics import gravity_loads
from bayescal.effects.deflection import deflections
from bayescal.effects.joints import without_masses
from bayescal.effects.location import TOOL, Driver
from bayescal.effects.sessions import by_session
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 0.3  # kg


def _parameters(c: Circumstances) -> list[Parameter]:
    count, n = c.q.shape
    weightless = replace(c.robot, masses=np.zeros(n), centres_of_mass=np.zeros((n, 3)))
    q, kilogram = link_angles(c.robot, c.readings), np.ones(count)
    terms = deflections(
        c, gravity_loads(weightless, c.chain, q, c.gravity, kilogram, c.load_centre, c.stance)
    )
    return [Parameter("payload mass", "kg", terms, SD, site=TOOL, driver=Driver("mass"))] if terms else []


def _missing(c: Circumstances) -> str:
    measured = "the torques are measured: they contain the payload"
    return without_masses(c) if c.measured_torques is None else measured


PAYLOAD = Effect(
    "payload",
    "payload mass or centre of mass differs from what was stated",
    _parameters,
    _missing,
    sizes={"kg": Size("additional mass")},
    phrase=("the tool", "carries a payload that differs from what was stated"),
    requires=("compliance",),
    forms=(by_session(_parameters),),
)
