r"""Angular motion: the carriage of a prismatic joint rolls, pitches and yaws, as a function of its position.

Formula: $`\rho_{a,k} = \sum_{m=1}^{16} x_{a,m} \sqrt{2m+1}\, P_m(u_k), \quad a \in \{x, y, z\}`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). A constant angle is one of `geometry`. The
tool is displaced by the angle times its distance from the carriage. Prior: 0.1 mrad of the first order about
each axis, falling with the order as its power -2 (assumed: a straightness of 0.1 mm over a carriage of 0.5
m is 0.2 mrad). As of ISO 230-1, which calls these angular error motions.
"""

from __future__ import annotations

from bayescal.effects.common import along_travel, without_slides
from bayescal.effects.sizes import Size, length
from bayescal.effects.vocabulary import Effect

SD = 1e-4  # rad
AXES = {"about x": "rx", "about y": "ry", "roll": "rz"}


ANGULAR_MOTION = Effect(
    "angular-motion",
    "the carriage of a linear axis rolls, pitches and yaws",
    lambda c: along_travel(c, "angular-motion", AXES, 1, ("rad", SD)),
    without_slides,
    sizes={"rad": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "turns its carriage along the travel"),
    remedy=(
        "Check that the guide rails are parallel and of equal height, and the preload of the carriages. What "
        "remains is compensated with the calibrated model."
    ),
    confusable_with=("straightness",),
)
