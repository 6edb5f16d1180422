"""The vocabulary of errors: one effect a file, each a table of terms (site x driver) with prior scales."""

from __future__ import annotations

from dataclasses import replace

from bayescal.effects.backlash import BACKLASH
from bayescal.effects.ball_radius import BALL_RADIUS
from bayescal.effects.base_compliance import BASE_COMPLIANCE
from bayescal.effects.bending import BENDING
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.coupling import COUPLING
from bayescal.effects.eccentricity import ECCENTRICITY
from bayescal.effects.encoder_scale import ENCODER_SCALE
from bayescal.effects.gear_mesh import GEAR_MESH
from bayescal.effects.geometry import GEOMETRY
from bayescal.effects.hardening import HARDENING
from bayescal.effects.hysteresis import HYSTERESIS
from bayescal.effects.latency import LATENCY
from bayescal.effects.lobing import LOBING
from bayescal.effects.payload import PAYLOAD
from bayescal.effects.plane_form import PLANE_FORM
from bayescal.effects.second_harmonic import SECOND_HARMONIC
from bayescal.effects.step import STEP
from bayescal.effects.thermal_drift import THERMAL_DRIFT
from bayescal.effects.tool import TOOL
from bayescal.effects.vocabulary import UNITS, Circumstances, Effect, Face, Parameter
from bayescal.errors import BayescalError

EFFECTS = {
    effect.name: effect
    for effect in (
        GEOMETRY,
        COMPLIANCE,
        HARDENING,
        BENDING,
        BASE_COMPLIANCE,
        PAYLOAD,
        ECCENTRICITY,
        SECOND_HARMONIC,
        GEAR_MESH,
        BACKLASH,
        HYSTERESIS,
        ENCODER_SCALE,
        COUPLING,
        THERMAL_DRIFT,
        STEP,
        LOBING,
        LATENCY,
        PLANE_FORM,
        BALL_RADIUS,
    )
}
"""What `--model` may name. The tool belongs to every model and is not among them.

Of the vocabulary `artefact` is not among them either: it moves no frame and no contact, but the value of a
certificate.
"""

__all__ = ["EFFECTS", "UNITS", "Circumstances", "Effect", "Face", "Parameter", "parameters_of"]


def parameters_of(names: tuple[str, ...], circumstances: Circumstances) -> tuple[Parameter, ...]:
    """Parameters of a model: the tool's and those of the named effects, in order.

    Raises
    ------
    BayescalError
        For an unknown effect, or one for which the session lacks what it needs.
    """
    chosen = []
    for name in names:
        if name not in EFFECTS:
            raise BayescalError(f"no effect is called '{name}'", "--model", f"known: {', '.join(EFFECTS)}")
        chosen.append(EFFECTS[name])
    out: list[Parameter] = []
    for effect in (*chosen, TOOL):
        if lacks := effect.missing(circumstances):
            remedy = "leave it out, or add what is missing"
            raise BayescalError(f"{effect.name} cannot be judged: {lacks}", "--model", remedy)
        out += [replace(p, effect=effect.name) for p in effect.parameters(circumstances)]
    return tuple(out)
