"""Errors of a carriage (prismatic joint) as smooth functions of its position, `common.along_travel`."""

from __future__ import annotations

from bayescal.effects.common import along_travel, without_slides
from bayescal.effects.sizes import Size, length
from bayescal.effects.vocabulary import Effect

STRAIGHTNESS_SD = 1e-4  # m
STRAIGHTNESS_AXES = {"x": "tx", "y": "ty"}


STRAIGHTNESS = Effect(
    "straightness",
    "the carriage of a linear axis leaves its straight line",
    lambda c: along_travel(c, "straightness", STRAIGHTNESS_AXES, 2, ("m", STRAIGHTNESS_SD)),
    without_slides,
    sizes={"m": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "is not straight"),
    remedy=(
        "Align the guide rails against a straight edge or a laser line, and check the bolts and the "
        "joints of rail segments. What remains is compensated with the calibrated model."
    ),
    confusable_with=("angular-motion",),
)
r"""Straightness: the carriage of a prismatic joint leaves its straight line, as a function of its position.

Formula: $`\delta_{a,k} = \sum_{m=2}^{16} x_{a,m} \sqrt{2m+1}\, P_m(u_k), \quad a \in \{x, y\}`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). A straight line is the direction of the
axis, which `geometry` has. Prior: 0.1 mm of the second order along each axis, falling with the order as its
power -2 (assumed: mounted linear guides are straight within 0.02 to 0.1 mm/m). As of ISO 230-1, which
calls these straightness error motions.
"""


ANGULAR_MOTION_SD = 1e-4  # rad
ANGULAR_MOTION_AXES = {"about x": "rx", "about y": "ry", "roll": "rz"}


ANGULAR_MOTION = Effect(
    "angular-motion",
    "the carriage of a linear axis rolls, pitches and yaws",
    lambda c: along_travel(c, "angular-motion", ANGULAR_MOTION_AXES, 1, ("rad", ANGULAR_MOTION_SD)),
    without_slides,
    sizes={"rad": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "turns its carriage along the travel"),
    remedy=(
        "Check that the guide rails are parallel and of equal height, and the preload of the carriages. What "
        "remains is compensated with the calibrated model."
    ),
    confusable_with=("straightness",),
)
r"""Angular motion: the carriage of a prismatic joint rolls, pitches and yaws, as a function of its position.

Formula: $`\rho_{a,k} = \sum_{m=1}^{16} x_{a,m} \sqrt{2m+1}\, P_m(u_k), \quad a \in \{x, y, z\}`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). A constant angle is one of `geometry`. The
tool is displaced by the angle times its distance from the carriage. Prior: 0.1 mrad of the first order about
each axis, falling with the order as its power -2 (assumed: a straightness of 0.1 mm over a carriage of 0.5
m is 0.2 mrad). As of ISO 230-1, which calls these angular error motions.
"""


POSITIONING_SD = 5e-5  # m


POSITIONING = Effect(
    "positioning",
    "a linear axis stands beside its reading, by its position",
    lambda c: along_travel(c, "positioning", {"order": "tz"}, 2, ("m", POSITIONING_SD)),
    without_slides,
    sizes={"m": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "has a positioning error by its position"),
    remedy=(
        "Measure the axis with a laser interferometer and load its compensation table, and check the "
        "joints of rack segments."
    ),
    confusable_with=("encoder-scale",),
)
r"""Positioning: a prismatic joint stands beside its reading, as a smooth function of its position.

Formula: $`\delta_{z,k} = \sum_{m=2}^{16} x_m \sqrt{2m+1}\, P_m(u_k)`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). An error in proportion to the position is
`encoder-scale`, one that repeats with the pinion or screw `gear-mesh`. Prior: 0.05 mm of the second order,
falling with the order as its power -2 (assumed: racks are accurate within 0.03 to 0.1 mm/m).
"""
