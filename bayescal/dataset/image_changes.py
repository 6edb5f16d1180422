"""What may be wrong with all images of a camera: changes of the session, for `plausibility.explanation`.

The calibration of another resolution, lines that were exposed one after another while the arm moved, and the
joint readings of another image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from bayescal.arm.hand_eye import HandEye
from bayescal.dataset.cameras import (
    FLANGE,
    best_lens,
    board,
    closed_form,
    flange_poses,
    lens_names,
    lens_numbers,
    lens_of,
    pixels_off,
    stated,
    with_lens,
)
from bayescal.dataset.types import Dataset

RESOLUTIONS = (1.25, 4 / 3, 1.5, 1.6, 2.0, 2.25, 8 / 3, 3.0, 4.0, 6.0)
"""Ratios of the sizes of usual images."""
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


def changes(dataset: Dataset) -> Iterator[Change]:
    """Each change of each camera."""
    m = dataset.measurements
    for k, t in enumerate(dataset.targets):
        rows = np.flatnonzero(m.target == k)
        if t.kind == "camera" and len(rows):
            where, every = ("targets", t.name), m.target == k
            for what, remedy, other in chain(
                _resolutions(dataset, k, rows), _other_lens(dataset, k, rows), _shutters(dataset, k, rows)
            ):
                yield what, where, remedy, every, other
            for what, remedy, concerned, other in _neighbours(dataset, k, rows):
                yield what, where, remedy, concerned, other


def _resolutions(dataset: Dataset, target: int, rows: np.ndarray) -> Iterator[tuple[str, str, Dataset]]:
    """A lens that was calibrated with images of another size."""
    t, m = dataset.targets[target], dataset.measurements
    _, before, stated = closed_form(dataset, target, rows, m.readings)
    for factor in (*RESOLUTIONS, *(1 / f for f in RESOLUTIONS)):
        values = t.values | {key: t.values[key] / factor for key in ("fx", "fy", "cx", "cy")}
        targets = list(dataset.targets)
        targets[target] = replace(t, values=values)
        other = replace(dataset, targets=tuple(targets))
        _, good, found = closed_form(other, target, rows, m.readings)
        if found is None or stated is None or np.sum(good) < np.sum(before) or found.misfit > stated.misfit:
            continue  # images that cannot be placed are not off
        what = f"the calibration of `{t.name}` is of images {factor:.3g} times as large as these"
        remedy = (
            f"divide fx_px, fy_px, cx_px and cy_px by {factor:.3g}, or calibrate with images of this size"
        )
        yield what, remedy, other


def _other_lens(dataset: Dataset, target: int, rows: np.ndarray) -> Iterator[tuple[str, str, Dataset]]:
    """A lens with focal lengths or an optical axis far from those stated, as of images that were cropped."""
    t, readings = dataset.targets[target], dataset.measurements.readings
    values = best_lens(dataset, target, rows, readings, WIDE)
    if values is None:
        return
    other = with_lens(dataset, target, values)
    before, after = (pixels_off(of, target, rows, readings) for of in (dataset, other))
    if before is None or after is None or _usual(after[0]) > _usual(before[0]) / FALLS:
        return  # images that cannot be placed are not off
    start, u = lens_numbers(lens_of(t)), np.concatenate([stated(t).focal, stated(t).centre])
    far = [k for k in range(4) if u[k] and abs(values[k] - start[k]) > OTHER * u[k]]
    if far and np.all(values[:2] > 0):
        name = lens_names(lens_of(t))
        each = [f"{name[k]} {values[k]:.0f} px, stated {start[k]:.0f} (u {u[k]:.2g})" for k in far]
        what = (
            f"the images of `{t.name}` were taken with another lens or part of the sensor: {', '.join(each)}"
        )
        remedy = "calibrate the camera with images of this size and crop, at this focus"
        yield what, remedy, other


def _usual(off: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(off, axis=1)))


def _shutters(dataset: Dataset, target: int, rows: np.ndarray) -> Iterator[tuple[str, str, Dataset]]:
    """Images whose lines are of different times, if the session has the speeds of the joints."""
    m, t = dataset.measurements, dataset.targets[target]
    if m.velocity is None or m.pixel is None or not np.any(m.velocity[rows]):
        return
    found = closed_form(dataset, target, rows, m.readings)[2]
    if found is None:
        return
    later = m.readings[rows] + STEP * m.velocity[rows]
    now, then = (_pixels(dataset, target, rows, q, found) for q in (m.readings[rows], later))
    speed = (then - now) / STEP
    line, middle = m.pixel[rows, 1], float(np.mean(m.pixel[rows, 1]))
    for time in LINES:
        for first in (0.0, middle, 2 * middle):
            pixel = m.pixel.copy()
            pixel[rows, :2] -= time * (line - first)[:, None] * speed
            what = (
                f"images of `{t.name}` were exposed line by line while the arm moved (rolling shutter, about "
                f"{1e6 * time:.0f} µs a line)"
            )
            remedy = "take the images with the arm at rest, or with a global shutter"
            yield what, remedy, replace(dataset, measurements=replace(m, pixel=pixel))


def _neighbours(
    dataset: Dataset, target: int, rows: np.ndarray
) -> Iterator[tuple[str, str, np.ndarray, Dataset]]:
    """Images that are off, with the joint readings of the image before or after them."""
    m, t = dataset.measurements, dataset.targets[target]
    seen = closed_form(dataset, target, rows, m.readings)[0]
    order = np.argsort(seen.first)
    wrong = np.flatnonzero(seen.off[order] > OFF)
    for step, which in ((-1, "before"), (1, "after")) if len(wrong) >= FEWEST else ():
        at = wrong[(wrong + step >= 0) & (wrong + step < len(order))]
        readings, concerned = m.readings.copy(), np.zeros(len(m.readings), bool)
        for image, other in zip(order[at], order[at + step], strict=True):
            own = rows[seen.image == image]
            readings[own], concerned[own] = m.readings[seen.first[other]], True
        what = f"{len(at)} of {len(order)} images of `{t.name}` fit the joint readings of the image {which}"
        remedy = "pair images and joint readings anew: rows were shifted"
        yield what, remedy, concerned, replace(dataset, measurements=replace(m, readings=readings))


def _pixels(
    dataset: Dataset, target: int, rows: np.ndarray, readings: np.ndarray, found: HandEye
) -> np.ndarray:
    """Corners (C, 2), px, as the hand-eye has them at readings (C, n)."""
    t, m = dataset.targets[target], dataset.measurements
    assert m.pixel is not None
    poses = found.predicted(flange_poses(dataset, readings), t.texts["mount"] == FLANGE)
    corner = board(t).points[m.pixel[rows, 2].astype(int)]
    at = np.einsum("cij,cj->ci", poses[..., :3], corner) + poses[..., 3]
    return lens_of(t).pixels((at[:, :2] / at[:, 2:]).T).T
