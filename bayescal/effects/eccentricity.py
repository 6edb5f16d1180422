r"""Eccentricity: a joint has an error once per revolution, from an off-centre gear or encoder scale.

Formula: $`\rho_{z,k} = a_k \sin q_k + b_k \cos q_k`$; ``eccentricity@third-order`` adds
$`c_k \sin 3 q_k + d_k \cos 3 q_k`$, as of a scale whose marks are not exactly sinusoidal.

Driver: sine and cosine of the link-relative angle. Prior: 0.1 mrad each, from amplitudes of 0.05 to
0.25 mrad (an ABB IRB 120 measured with a laser tracker; gravity masks those of the shoulder and the elbow);
0.3 of it for the third order (assumed).
"""

from __future__ import annotations

import numpy as np

from bayescal.effects.common import waves
from bayescal.effects.sizes import WAVE
from bayescal.effects.vocabulary import Circumstances, Effect, Form, Parameter

SD = 1e-4  # rad
THIRD = 0.3  # of it


def _parameters(c: Circumstances) -> list[Parameter]:
    return waves(c, "eccentricity", np.array([[1]]), SD)


def _with_third(c: Circumstances) -> list[Parameter]:
    return [*_parameters(c), *waves(c, "eccentricity third order", np.array([[3]]), THIRD * SD)]


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
    forms=(Form("third-order", "with a part of the third order", _with_third),),
    simulated_within=5e-8,
)
