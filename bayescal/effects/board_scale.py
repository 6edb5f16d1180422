r"""Board scale: a board is larger or smaller than stated, along each of its axes.

Formula: $`\delta p = (x_x \, a, x_y \, b, 0)`$ of a point (a, b) of the board, from its middle.

Driver: the place on the board. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`), at
least 0.2 %: a printer stretches its print by some tenths of a percent.
"""

from __future__ import annotations

from bayescal.effects.imaging import errors, scale, without_camera
from bayescal.effects.sizes import Size
from bayescal.effects.vocabulary import Circumstances, Effect, Parameter


def _parameters(c: Circumstances) -> list[Parameter]:
    return errors(c, scale, "board-scale")


BOARD_SCALE = Effect(
    "board-scale",
    "size of a board in error",
    _parameters,
    without_camera,
    sizes={"1": Size("relative error of the size")},
    phrase=("the board", "has another size than stated"),
    remedy="Measure the board over several squares along both axes, and write the size of its squares.",
    confusable_with=("focal-length",),
    in_robot_file=True,
    beside_arm=True,
)
