r"""Positioning: a prismatic joint stands beside its reading, as a smooth function of its position.

Formula: $`\delta_{z,k} = \sum_{m=2}^{16} x_m \sqrt{2m+1}\, P_m(u_k)`$;
u is the position over the limits of the joint, from -1 to 1, and P the Legendre polynomials.

Driver: smooth functions of the position (`common.along_travel`). An error in proportion to the position is
`encoder-scale`, one that repeats with the pinion or screw `gear-mesh`. Prior: 0.05 mm of the second order,
falling with the order as its power -2 (assumed: racks are accurate within 0.03 to 0.1 mm/m).
"""

from __future__ import annotations

from bayescal.effects.common import along_travel, without_slides
from bayescal.effects.sizes import Size, length
from bayescal.effects.vocabulary import Effect

SD = 5e-5  # m


POSITIONING = Effect(
    "positioning",
    "a linear axis stands beside its reading, by its position",
    lambda c: along_travel(c, "positioning", {"order": "tz"}, 2, ("m", SD)),
    without_slides,
    sizes={"m": Size("root mean square over the travel", length)},
    phrase=("the linear axis", "has a positioning error by its position"),
    remedy=(
        "Measure the axis with a laser interferometer and load its compensation table, and check the "
        "joints of rack segments."
    ),
    confusable_with=("encoder-scale",),
)
