r"""Board bow: a board is bent along its axes.

Formula: $`\delta p = (0, 0, x_x (1 - (a / A)^2) + x_y (1 - (b / B)^2))`$ of a point (a, b) of a board of the
half size (A, B), from its middle.

Driver: the place on the board. Prior: five times the stated flatness (assumed, `imaging.TIMES`).
"""

from __future__ import annotations

from bayescal.effects.imaging import beyond

BOARD_BOW = beyond(
    "bow",
    "board-bow",
    "board not flat",
    size=("m", "height of the middle"),
    phrase=("the board", "is not flat"),
    remedy="Mount the board on a stiff, flat plate, and check it with a straightedge.",
    confusable_with=("lens-distortion",),
)
