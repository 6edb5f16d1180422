r"""Straightness: the carriage of a prismatic joint leaves its straight line, as a function of its position.

Formula: $`\delta_{a,k} = \sum_{m=2}^{16} x_{a,m} \sqrt{2m+1}\, P_m(u_k), \quad a \in \{x, y\}`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). A straight line is the direction of the
axis, which `geometry` has. Prior: 0.1 mm of the second order along each axis, falling with the order as its
power -2 (assumed: mounted linear guides are straight within 0.02 to 0.1 mm/m). As of ISO 230-1, which
calls these straightness error motions.
"""

from __future__ import annotations

from bayescal.effects.common import along_travel, without_slides
from bayescal.effects.sizes import Size, length
from bayescal.effects.vocabulary import Effect

SD = 1e-4  # m
AXES = {"x": "tx", "y": "ty"}


STRAIGHTNESS = Effect(
    "straightness",
    "the carriage of a linear axis leaves its straight line",
    lambda c: along_travel(c, "straightness", AXES, 2, ("m", SD)),
    without_slides,
    sizes={"m": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "is not straight"),
    remedy=(
        "Align the guide rails against a straight edge or a laser line, and check the bolts and the "
        "joints of rail segments. What remains is compensated with the calibrated model."
    ),
    confusable_with=("angular-motion",),
)
