"""The vocabulary of errors: one effect a file, each a table of terms (site x driver) with prior scales."""

from __future__ import annotations

from dataclasses import replace

from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.geometry import GEOMETRY
from bayescal.effects.plane_form import PLANE_FORM
from bayescal.effects.tool import TOOL
from bayescal.effects.vocabulary import UNITS, Circumstances, Effect, Face, Parameter
from bayescal.errors import BayescalError

EFFECTS = {effect.name: effect for effect in (GEOMETRY, COMPLIANCE, PLANE_FORM)}
"""What `--model` may name. The tool belongs to every model and is not among them."""

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
