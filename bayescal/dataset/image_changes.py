"""What may be wrong with all images of a camera: changes of the session, for `plausibility.explanation`.

The calibration of another resolution, lines that were exposed one after another while the arm moved, and the
joint readings of another image.

What may be wrong with one image of a camera: the order of its corners, or its size.

Each change is tried on the corners of the image. That which brings it to where the other images and the arm
put the board is named.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bayescal.dataset import cameras
from bayescal.dataset.cameras import stated
from bayescal.dataset.types import Dataset

RESOLUTIONS = (1.25, 4 / 3, 1.5, 1.6, 2.0, 2.25, 8 / 3, 3.0, 4.0, 6.0)
"""Ratios of the sizes of usual images."""
RATIOS = (*RESOLUTIONS, *(1 / f for f in RESOLUTIONS))
"""Those, and their inverses."""
LINES = (1e-5, 2e-5, 3e-5, 5e-5, 8e-5)
"""s: times from one line of an image to the next that are tried."""
FALLS = 3.0
"""By which another lens must reduce how far corners are from where the arm has them (assumed)."""
WIDE, OTHER = 30.0, 8.0
"""Times the stated u of a lens: within which another is searched, from which on it is another (assumed)."""
OFF, FEWEST = 0.02, 3
"""m: an image that is off by more may be of other joint readings; and the fewest such images."""
STEP = 1e-3
"""s: of the motion, for the speed of a corner in the image."""

Change = tuple[str, tuple[str, ...], str, np.ndarray, Dataset]
"""In words, its place in dataset.yaml, the remedy, the rows concerned (N,), the session that then holds."""
Tried = Iterator[tuple[str, str, np.ndarray, Dataset]]
"""Changes of one camera, without the place."""


def changes(dataset: Dataset) -> Iterator[Change]:
    """Each change of each camera."""
    m = dataset.measurements
    for k, t in enumerate(dataset.targets):
        rows = np.flatnonzero(m.target == k)
        tried = (_resolutions, _other_lens, _shutters, _neighbours)
        for changes_of in tried if t.kind == "camera" and len(rows) else ():
            for what, remedy, concerned, other in changes_of(dataset, k, rows):
                yield what, ("targets", t.name), remedy, concerned, other


def _resolutions(dataset: Dataset, target: int, rows: np.ndarray) -> Tried:
    """A lens that was calibrated with images of another size."""
    t, m = dataset.targets[target], dataset.measurements
    _, before, stated = cameras.closed_form(dataset, target, rows, m.readings)
    for factor in RATIOS:
        values = {key: t.values[key] / factor for key in cameras.PINHOLE}
        other = cameras.restated(dataset, target, values=values)
        _, good, solution = cameras.closed_form(other, target, rows, m.readings)
        if solution is None or stated is None or np.sum(good) < np.sum(before):
            continue  # images that cannot be placed are not off
        if solution.misfit > stated.misfit:
            continue
        what = f"the calibration of `{t.name}` is of images {factor:.3g} times as large as these"
        divide = f"divide fx_px, fy_px, cx_px and cy_px by {factor:.3g}"
        yield what, f"{divide}, or calibrate with images of this size", m.target == target, other


def _other_lens(dataset: Dataset, target: int, rows: np.ndarray) -> Tried:
    """A lens with focal lengths or an optical axis far from those stated, as of images that were cropped."""
    t, m = dataset.targets[target], dataset.measurements
    values = cameras.best_lens(dataset, target, rows, m.readings, WIDE)
    if values is None:
        return
    other = cameras.with_lens(dataset, target, values)
    before, after = (cameras.pixels_off(of, target, rows, m.readings) for of in (dataset, other))
    if before is None or after is None or _usual(after[0]) > _usual(before[0]) / FALLS:
        return  # images that cannot be placed are not off
    start, u = cameras.lens_numbers(cameras.lens_of(t)), np.concatenate([stated(t).focal, stated(t).centre])
    far = [k for k in range(4) if u[k] and abs(values[k] - start[k]) > OTHER * u[k]]
    if far and np.all(values[:2] > 0):
        each = [f"{cameras.PINHOLE[k]} {values[k]:.0f} px, stated {start[k]:.0f} (u {u[k]:.2g})" for k in far]
        what = f"the images of `{t.name}` were taken with another lens or part of the sensor"
        remedy = "calibrate the camera with images of this size and crop, at this focus"
        yield f"{what}: {', '.join(each)}", remedy, m.target == target, other


def _usual(off: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(off, axis=1)))


def _shutters(dataset: Dataset, target: int, rows: np.ndarray) -> Tried:
    """Images whose lines are of different times, if the session has the speeds of the joints."""
    m, t = dataset.measurements, dataset.targets[target]
    if m.velocity is None or m.pixel is None or not np.any(m.velocity[rows]):
        return
    solution = cameras.closed_form(dataset, target, rows, m.readings)[2]
    if solution is None:
        return
    later = m.readings[rows] + STEP * m.velocity[rows]
    flanges = (cameras.flange_poses(dataset, q) for q in (m.readings[rows], later))
    poses = (solution.predicted(flange, cameras.carried(t)) for flange in flanges)
    now, then = (cameras.projected(t, pose, m.pixel[rows, 2]) for pose in poses)
    speed = (then - now) / STEP
    line, middle = m.pixel[rows, 1], float(np.mean(m.pixel[rows, 1]))
    for time in LINES:
        for first in (0.0, middle, 2 * middle):
            pixel = m.pixel.copy()
            pixel[rows, :2] -= time * (line - first)[:, None] * speed
            what = f"images of `{t.name}` were exposed line by line while the arm moved"
            what += f" (rolling shutter, about {1e6 * time:.0f} µs a line)"
            remedy = "take the images with the arm at rest, or with a global shutter"
            yield what, remedy, m.target == target, replace(dataset, measurements=replace(m, pixel=pixel))


def _neighbours(dataset: Dataset, target: int, rows: np.ndarray) -> Tried:
    """Images that are off, with the joint readings of the image before or after them."""
    m, t = dataset.measurements, dataset.targets[target]
    seen = cameras.closed_form(dataset, target, rows, m.readings)[0]
    order = np.argsort(seen.first)
    wrong = np.flatnonzero(seen.off[order] > OFF)
    for step, which in ((-1, "before"), (1, "after")) if len(wrong) >= FEWEST else ():
        positions = wrong[(wrong + step >= 0) & (wrong + step < len(order))]
        readings, concerned = m.readings.copy(), np.zeros(len(m.readings), bool)
        for image, other in zip(order[positions], order[positions + step], strict=True):
            image_rows = rows[seen.image == image]
            readings[image_rows], concerned[image_rows] = m.readings[seen.first[other]], True
        what = f"{len(positions)} of {len(order)} images of `{t.name}` fit "
        what += f"the joint readings of the image {which}"
        remedy = "pair images and joint readings anew: rows were shifted"
        yield what, remedy, concerned, replace(dataset, measurements=replace(m, readings=readings))


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
    seen, good, _ = cameras.closed_form(dataset, target, rows, dataset.measurements.readings)
    finite = np.isfinite(seen.misfit)
    if not finite.any() or np.mean(good[finite]) < 0.5:
        return
    usual = float(np.median(seen.misfit[finite]))
    most = seen.scatter > cameras.BLURRED * np.median(seen.scatter[finite])  # not of a few wild corners
    for k in np.flatnonzero(finite & most & (seen.misfit > max(cameras.FOREIGN, WORSE * usual))):
        image_rows = rows[seen.image == k]
        cause = explained(dataset, target, image_rows)
        yield Odd(image_rows, name_of(dataset, image_rows), seen.misfit[k], usual, *cause)


def name_of(dataset: Dataset, rows: np.ndarray) -> str:
    """The name of an image, or the ids of its first and last row (C,)."""
    m = dataset.measurements
    if m.stop is not None and m.stop[rows[0]]:
        return f"`{m.stop[rows[0]]}`"
    return f"of rows `{m.ids[rows[0]]}` to `{m.ids[rows[-1]]}`"


def image_of(dataset: Dataset, target: int, row: int) -> np.ndarray:
    """The rows of the image that a row is of."""
    rows = np.flatnonzero(dataset.measurements.target == target)
    image = cameras.closed_form(dataset, target, rows, dataset.measurements.readings)[0].image
    return rows[image == image[np.flatnonzero(rows == row)[0]]]


def explained(dataset: Dataset, target: int, rows: np.ndarray) -> tuple[str, str]:
    """The change of an image, rows (C,), with which it fits, in words, and what to do; "" where none does."""
    m = dataset.measurements
    assert m.pixel is not None
    every = np.flatnonzero(m.target == target)
    best = ("", "", np.inf)
    for what, remedy, pixels in _changes(dataset, target, m.pixel[rows]):
        pixel = m.pixel.copy()
        pixel[rows] = pixels
        changed = replace(dataset, measurements=replace(m, pixel=pixel))
        seen, good, solution = cameras.closed_form(changed, target, every, m.readings)
        k = seen.image[np.flatnonzero(every == rows[0])[0]]
        usual = float(np.median(seen.misfit[good])) if good.any() else 0.0
        if solution is not None and good[k] and seen.misfit[k] < AS_OTHERS * usual and seen.off[k] < NEAR:
            best = min(best, (what, remedy, float(solution.away[np.sum(good[:k])])), key=lambda each: each[2])
    return best[:2]


def _changes(dataset: Dataset, target: int, pixel: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """In words, the remedy, and the pixels and numbers (C, 3) that then hold."""
    of, number = cameras.board(dataset.targets[target]), pixel[:, 2].astype(int)
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
    for factor in RATIOS:
        what = f"it fits when its pixels are multiplied by {factor:.3g}: it has another size than the others"
        yield what, "give its corners in pixels of the size of the others", pixel * [factor, factor, 1.0]


def by_corners(dataset: Dataset, target: int, rows: np.ndarray, off: np.ndarray) -> np.ndarray:
    """How far rows (C,) are off, m: 0 in images whose corners agree with the arm as well as most do.

    Where most images agree. The pose of a small tag is poor, or mirrored; its corners are not.
    """
    if dataset.targets[target].kind != "camera" or not len(off) or np.median(off) > NEAR:
        return off
    seen = cameras.closed_form(dataset, target, rows, dataset.measurements.readings)[0]
    return np.where(seen.alike[seen.image], 0.0, off)


def impossible(dataset: Dataset, rows: np.ndarray, off: np.ndarray) -> tuple[str, bool, str]:
    """Of the first of images that are off: its name and what explains it, whether anything does, a remedy."""
    target = int(dataset.measurements.target[rows[0]])
    image_rows = image_of(dataset, target, int(rows[0]))
    what, remedy = explained(dataset, target, image_rows)
    said = f" (image {name_of(dataset, image_rows)}, {len(image_rows)} rows{f': {what}' if what else ''})"
    check = "check the joint readings, the order of the corners and the size of this image, and the "
    return said, bool(what), remedy or f"{check}calibration of the camera and its u; or leave its rows out"
