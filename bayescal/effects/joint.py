"""Joint level: only zeros and scales of the joints; every length and twist is nominal.

The first of the three levels of Mooring, Roth and Driels (Fundamentals of Manipulator Calibration, 1991):
the relation of a joint's reading and its angle. It shares its parameters and their priors with `geometry` and
`encoder-scale`. A diagnosis does not name it.
"""

from __future__ import annotations

from bayescal.effects.encoder_scale import ENCODER_SCALE
from bayescal.effects.geometry import GEOMETRY
from bayescal.effects.location import BASE
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter


def _parameters(c: Circumstances) -> list[Parameter]:
    geometry = GEOMETRY.parameters(c)
    zeros = [p for p in geometry if p.site == BASE or (p.site.kind == "joint" and _zero(c, p))]
    return [*zeros, *ENCODER_SCALE.parameters(c)]


def _zero(c: Circumstances, p: Parameter) -> bool:
    """Whether a parameter displaces a joint along or about its axis of motion."""
    return all(term.axis == c.robot.axes[term.frame - 1] for term in p.terms)


JOINT = Effect(
    "joint",
    "zeros and scales of the joints, lengths and twists nominal",
    _parameters,
    part_of=("geometry", "encoder-scale"),
    remedy=("Set the joint zeros again at the reference marks, and check the gear ratios in the controller."),
    in_robot_file=True,
    simulated_within=5e-8,
)
