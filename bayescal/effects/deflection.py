"""Deflection by an added mass: its gravity moments act on every compliant site, not on the joints alone.

A site that the model contains deflects by its fitted (or true) compliance: joints, bearings, links and the
base. A joint of unknown compliance has the value of the robot file, or a typical one; any other site whose
compliance is unknown is rigid. Measured torques contain the torque of every mass: then only links and base
deflect by an added one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayescal.arm.motion import Term
from bayescal.arm.statics import Loads
from bayescal.effects.base_compliance import BASE_COMPLIANCE
from bayescal.effects.bending import BENDING
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.vocabulary import Circumstances, Parameter

COMPLIANT = (COMPLIANCE, BENDING, BASE_COMPLIANCE)
"""Effects whose parameters are compliances: displacement = value x gravity moment."""


def compliances(parameters: Sequence[Parameter], deviations: np.ndarray) -> Mapping[str, float]:
    """Values (SI) of all compliances among P parameters, by name, at deviations (P,) from nominal."""
    names = {effect.name for effect in COMPLIANT}
    out: dict[str, float] = {}
    for p, value in zip(parameters, deviations.tolist(), strict=True):
        if p.effect not in names:
            continue
        out |= {own.name: own.nominal + value * own.centre for own in p.stands_for} or {
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
