"""Boards that cameras see: their points by the text of dataset.yaml, in the numbering of OpenCV."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

LENGTH = r"(\d+(?:\.\d+)?)mm"
FORMS = {
    "charuco": re.compile(rf"charuco:(\d+)x(\d+):{LENGTH}:{LENGTH}"),
    "checkerboard": re.compile(rf"checkerboard:(\d+)x(\d+):{LENGTH}"),
    "apriltag": re.compile(rf"apriltag:(16h5|25h9|36h10|36h11):{LENGTH}"),
}
EXAMPLES = "charuco:7x5:30mm:22mm, checkerboard:9x6:25mm or apriltag:36h11:40mm"
MOST = 100
"""Squares along an edge."""


@dataclass(frozen=True)
class Board:
    """Points (K, 3), m, in the frame of the board; `front` is the sign of its z axis away from who sees it.

    ChArUco and checkerboards: inner corners row by row, x to the right, y down, z into the board. A tag:
    corners clockwise from the upper left, x to the right, y up, z out of the tag. `front` is 0 of a list.
    """

    points: np.ndarray
    front: int
    kind: str = ""
    squares: tuple[int, int] = (0, 0)
    size: float = 0.0
    """m, of a square or a tag."""
    marker: float = 0.0
    """m, of the markers of a ChArUco board."""
    family: str = ""


def board_of(text: str) -> Board:
    """The board of a text, as ``charuco:7x5:30mm:22mm``: squares, their size, and that of the markers.

    Raises
    ------
    ValueError
        With what is wrong.
    """
    kind = text.partition(":")[0]
    match = FORMS[kind].fullmatch(text) if kind in FORMS else None
    if match is None:
        raise ValueError(f"write {EXAMPLES}")
    if kind == "apriltag":
        side = 1e-3 * float(match[2])
        half = 0.5 * side
        points = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
        return Board(points, -1, kind, (1, 1), side, family=match[1])
    across, down, side = int(match[1]), int(match[2]), 1e-3 * float(match[3])
    first = 1 if kind == "charuco" else 0
    columns, rows = across - first, down - first
    if not (2 <= columns <= MOST and 2 <= rows <= MOST):
        raise ValueError("it needs 2 to 100 inner corners along each edge")
    marker = 1e-3 * float(match[4]) if kind == "charuco" else 0.0
    if marker >= side > 0 or side <= 0:
        raise ValueError("its markers are smaller than its squares")
    y, x = np.mgrid[0:rows, 0:columns]
    points = side * np.column_stack([x.ravel() + first, y.ravel() + first, np.zeros(rows * columns)])
    return Board(points, 1, kind, (across, down), side, marker)


def transposed(text: str) -> str:
    """The board with columns and rows interchanged; "" of one that is none, or the same."""
    kind, _, rest = text.partition(":")
    squares, _, sizes = rest.partition(":")
    across, by, down = squares.partition("x")
    return f"{kind}:{down}x{across}:{sizes}" if by and across != down else ""
