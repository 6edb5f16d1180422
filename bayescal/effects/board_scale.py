r"""Board scale: a board is larger or smaller than stated, along each of its axes.

Formula: $`\delta p = (x_x \, a, x_y \, b, 0)`$ of a point (a, b) of the board, from its middle.

Driver: the place on the board. Prior: five times the stated uncertainty (assumed, `imaging.TIMES`), at
least 0.2 %: a printer stretches its print by some tenths of a percent.
"""

from __future__ import annotations

from bayescal.effects.imaging import LEAST_SCALE, beyond

BOARD_SCALE = beyond(
    "scale",
    "board-scale",
    "size of a board in error",
    size=("1", "relative error of the size"),
    phrase=("the board", "has another size than stated"),
    remedy="Measure the board over several squares along both axes, and write the size of its squares.",
    confusable_with=("focal-length",),
    least=LEAST_SCALE,
)
