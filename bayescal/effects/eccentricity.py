r"""Eccentricity: a joint has an error once per revolution, from an off-centre gear or encoder scale.

Formula: $`\rho_{z,k} = a_k \sin q_k + b_k \cos q_k`$.

Driver: sine and cosine of the link-relative angle. Prior: 0.1 mrad each, from amplitudes of 0.05 to
0.25 mrad (an ABB IRB 120 measured with a laser tracker; gravity masks those of the shoulder and the elbow).
"""

from __future__ import annotations

from bayescal.effects.joints import waves
from bayescal.effects.sizes import WAVE
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter

SD = 1e-4  # rad


def _parameters(c: Circumstances) -> list[Parameter]:
    return [p for j in range(1, c.robot.n + 1) for p in waves(c, "eccentricity", j, 1, SD)]


ECCENTRICITY = Effect(
    "eccentricity",
    "error once per revolution of joint k",
    _parameters,
    sizes={"rad": WAVE},
    phrase=("every joint", "has an error once per revolution"),
    remedy=(
        "Check the reduction of the joint and the seat of its output gear, and whether the encoder is "
        "centred on its shaft. If neither can be adjusted, compensate with the calibrated model."
    ),
    confusable_with=("second-harmonic", "encoder-scale"),
)
