"""What may be wrong with one image of a camera: the order of its corners, or its size.

Each change is tried on the corners of the image. That which brings it to where the other images and the arm
put the board is named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bayescal.dataset.cameras import BLURRED, FOREIGN, board, closed_form
from bayescal.dataset.image_changes import RESOLUTIONS
from bayescal.dataset.types import Dataset

NEAR = 0.05
"""m: an image that is off by less agrees with the arm."""
WORSE, AS_OTHERS = 5.0, 2.0
"""Misfit over that of most images: from which on corners do not fit the board, and up to which they do
(assumed)."""

CHECK_IMAGE = "check the size of this image, the numbers of its corners and its focus, or leave its rows out"


@dataclass(frozen=True)
class Odd:
    """An image: its rows of the session, its name, misfits, what is wrong and what to do ("" if unknown)."""

    rows: np.ndarray
    name: str
    misfit: float  # of its corners, over the width of the board
    usual: float  # of most images
    what: str
    remedy: str


def odd_images(dataset: Dataset, target: int) -> Iterator[Odd]:
    """Images whose corners do not fit the board, where those of most images do."""
    rows = np.flatnonzero(dataset.measurements.target == target)
    seen, good, _ = closed_form(dataset, target, rows, dataset.measurements.readings)
    known = np.isfinite(seen.misfit)
    if not known.any() or np.mean(good[known]) < 0.5:
        return
    usual = float(np.median(seen.misfit[known]))
    most = seen.scatter > BLURRED * np.median(seen.scatter[known])  # not of a few wild corners
    for k in np.flatnonzero(known & most & (seen.misfit > max(FOREIGN, WORSE * usual))):
        own = rows[seen.image == k]
        yield Odd(own, name_of(dataset, own), seen.misfit[k], usual, *explained(dataset, target, own))


def name_of(dataset: Dataset, rows: np.ndarray) -> str:
    """The name of an image, or the ids of its first and last row (C,)."""
    m = dataset.measurements
    if m.stop is not None and m.stop[rows[0]]:
        return f"`{m.stop[rows[0]]}`"
    return f"of rows `{m.ids[rows[0]]}` to `{m.ids[rows[-1]]}`"


def image_of(dataset: Dataset, target: int, row: int) -> np.ndarray:
    """The rows of the image that a row is of."""
    rows = np.flatnonzero(dataset.measurements.target == target)
    image = closed_form(dataset, target, rows, dataset.measurements.readings)[0].image
    return rows[image == image[np.flatnonzero(rows == row)[0]]]


def explained(dataset: Dataset, target: int, rows: np.ndarray) -> tuple[str, str]:
    """The change of an image, rows (C,), with which it fits, in words, and what to do; "" where none does."""
    m = dataset.measurements
    assert m.pixel is not None
    every = np.flatnonzero(m.target == target)
    best = ("", "", np.inf)
    for what, remedy, own in _changes(dataset, target, m.pixel[rows]):
        pixel = m.pixel.copy()
        pixel[rows] = own
        changed = replace(dataset, measurements=replace(m, pixel=pixel))
        seen, good, found = closed_form(changed, target, every, m.readings)
        k = seen.image[np.flatnonzero(every == rows[0])[0]]
        usual = float(np.median(seen.misfit[good])) if good.any() else 0.0
        if found is not None and good[k] and seen.misfit[k] < AS_OTHERS * usual and seen.off[k] < NEAR:
            best = min(best, (what, remedy, float(found.away[np.sum(good[:k])])), key=lambda each: each[2])
    return best[:2]


def _changes(dataset: Dataset, target: int, pixel: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """In words, the remedy, and the pixels and numbers (C, 3) that then hold."""
    of, number = board(dataset.targets[target]), pixel[:, 2].astype(int)
    count = len(of.points)
    last, order = count - 1 - number, "number the corners of this image as those of the others"
    orders = {"from the other end": last}
    if of.kind == "apriltag":
        orders |= {"from another corner on": (number + 1) % count, "from a corner on": (number + 3) % count}
    elif of.kind:
        across = len(np.unique(of.points[:, 0].round(9)))
        flipped = number - 2 * (number % across) + across - 1
        orders |= {"with every line reversed": flipped, "from the last line on": count - 1 - flipped}
    for words, numbers in orders.items():
        yield f"its corners are numbered {words}", order, np.column_stack([pixel[:, :2], numbers])
    for factor in (*RESOLUTIONS, *(1 / f for f in RESOLUTIONS)):
        what = f"it fits when its pixels are multiplied by {factor:.3g}: it has another size than the others"
        yield what, "give its corners in pixels of the size of the others", pixel * [factor, factor, 1.0]


def impossible(dataset: Dataset, row: int) -> tuple[str, bool, str]:
    """Of an image that is far off: its name and what explains it, whether something does, and what to do."""
    target = int(dataset.measurements.target[row])
    own = image_of(dataset, target, row)
    what, remedy = explained(dataset, target, own)
    said = f" (image {name_of(dataset, own)}, {len(own)} rows{f': {what}' if what else ''})"
    check = "check the joint readings, the order of the corners and the size of this image, and the "
    return said, bool(what), remedy or f"{check}calibration of the camera and its u; or leave its rows out"
