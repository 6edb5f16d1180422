r"""Second harmonic: a joint has an error twice per revolution, from an oval gear or a tilted encoder scale.

Formula: $`\rho_{z,k} = a_k \sin 2 q_k + b_k \cos 2 q_k`$.

Driver: sine and cosine of twice the link-relative angle. Prior: 0.07 mrad each, from amplitudes of
0.03 to 0.19 mrad (an ABB IRB 120 measured with a laser tracker).
"""

from __future__ import annotations

import numpy as np

from bayescal.effects.common import waves
from bayescal.effects.sizes import WAVE
from bayescal.effects.vocabulary import Effect

SD = 7e-5  # rad


SECOND_HARMONIC = Effect(
    "second-harmonic",
    "error twice per revolution of joint k",
    lambda c: waves(c, "second-harmonic", np.array([[2]]), SD),
    sizes={"rad": WAVE},
    phrase=("every joint", "has an error twice per revolution"),
    remedy=(
        "Check the reduction: an oval wave generator or flexspline that is clamped out of round, and "
        "two bolts of a flange that are tighter than the others. Check the tilt of the encoder disc. "
        "Otherwise compensate with the model."
    ),
    confusable_with=("eccentricity", "encoder-scale"),
    simulated_within=5e-8,
)
