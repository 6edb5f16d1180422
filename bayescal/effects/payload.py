"""Payload: the mass on the flange differs from the stated mass, and deflects every joint.

Driver: the torques of one kilogram at the tool's centre of mass times the joints' compliances. These are
the fitted ones, else those of the robot file, else typical ones: the value in kilograms is only as accurate
as they are. Prior: 0.3 kg (assumed: the mass of a probe, its cable and its bracket is an estimate).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.arm.motion import Term
from bayescal.arm.statics import gravity_moments
from bayescal.effects.base_compliance import BASE_COMPLIANCE
from bayescal.effects.bending import BENDING
from bayescal.effects.compliance import expected
from bayescal.effects.joints import carries, without_masses
from bayescal.effects.location import TOOL, Driver
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 0.3  # kg


def _parameters(c: Circumstances) -> list[Parameter]:
    count, n = c.q.shape
    known = expected(c.robot) if c.compliance is None else c.compliance
    weightless = replace(c.robot, masses=np.zeros(n), centres_of_mass=np.zeros((n, 3)))
    moments = gravity_moments(weightless, c.chain, c.q, c.gravity, np.ones(count), c.load_centre)
    terms = tuple(
        Term(j, "rz", compliance * moments[:, j, 2])
        for j, compliance in enumerate(known, start=1)
        if carries(moments[:, j, 2])
    )
    lighter = replace(c, moments=moments)  # a massless arm that carries one kilogram
    terms += tuple(
        replace(term, driver=c.yields[p.name] * np.asarray(term.driver))
        for effect in (BENDING, BASE_COMPLIANCE)
        for p in effect.parameters(lighter)
        if c.yields.get(p.name)
        for term in p.terms
    )
    return [Parameter("payload mass", "kg", terms, SD, site=TOOL, driver=Driver("mass"))] if terms else []


PAYLOAD = Effect(
    "payload",
    "payload mass or centre of mass differs from what was stated",
    _parameters,
    without_masses,
    phrase=("the tool", "carries a payload that differs from what was stated"),
    requires=("compliance",),
)
