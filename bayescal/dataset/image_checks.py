"""What images of a camera cannot be: refusals of a session, and how far its images are off the arm."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bayescal.arm import hand_eye
from bayescal.dataset.cameras import (
    FIXED,
    FLANGE,
    FOREIGN,
    Images,
    best_lens,
    board,
    closed_form,
    flange_poses,
    is_stated,
    placed,
    transposed,
    with_lens,
)
from bayescal.dataset.types import Dataset, Target
from bayescal.errors import BayescalError

if TYPE_CHECKING:
    from bayescal.dataset.table import Table
    from bayescal.storage.files import Document

OTHER_SIZE = 0.04
"""Relative error of the size of a board that no print has (assumed)."""
FEWEST_IMAGES = 4
"""Images from which a hand-eye is judged."""
STILL = 6.0
"""deg: joints that vary by less do not tell where things are; a full turn in rad is 6.3 (convention)."""
MISFIT = 0.05
"""m: by which most images must fit the arm."""


def misfit(dataset: Dataset, target: int, rows: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """How far the images of some rows (C,) are off, m, with camera and board at their best; 0 if unknown.

    The lens is taken within its stated u, as the images have it.
    """
    seen, good, _ = closed_form(dataset, target, rows, readings)
    if np.sum(good) < FEWEST_IMAGES:
        return np.zeros(len(rows))
    off = seen.off
    if np.max(off) > MISFIT >= np.median(off):  # most images agree: the lens may be stated roughly
        lens = best_lens(dataset, target, rows, readings, 1.0)
        if lens is not None:
            best = closed_form(with_lens(dataset, target, lens), target, rows, readings)[0].off
            off = np.minimum(off, best)
    return off[seen.image]


def prepared(dataset: Dataset, target: int, table: Table, document: Document) -> Dataset:
    """The session with a camera and its board placed by its rows, or what is wrong with these.

    Raises
    ------
    BayescalError
        With the line, for corners that are not of the board or of the image; for a board of another size,
        mirrored or numbered otherwise; and where neither the rows nor dataset.yaml say where things are.
    """
    t, m = dataset.targets[target], dataset.measurements
    rows = np.flatnonzero(m.target == target)
    where = document.where(("targets", t.name))
    if not len(rows):
        return dataset
    assert m.pixel is not None
    _check_rows(t, rows, m.pixel, table)
    _check_doubled(dataset, target, rows, table)
    rough = not (np.isnan(t.values["xyz"]).any() or np.isnan(t.values["rpy"]).any())
    if t.u is not None and rough:
        return dataset
    used = rows[m.tool[rows] == np.bincount(m.tool[rows]).argmax()]
    seen, _, found = closed_form(dataset, target, used, m.readings)
    _check_board(dataset, target, used, seen, where)
    if found is None or not found.determined:
        if rough:
            return dataset
        what = f"the images of `{t.name}` do not tell where camera and board are"
        remedy = "add images with the flange turned about two axes, or `xyz_mm` and `rpy_deg`"
        turning = np.ptp(m.readings[used], axis=0)[~dataset.robot.slides]
        if len(turning) and (most := float(np.degrees(turning.max()))) < STILL:
            what += f": no joint reading varies by more than {most:.2g} deg"
            remedy = f"are the readings deg, as the columns say? or {remedy}"
        raise BayescalError(what, where, remedy)
    _check_arm(dataset, target, used, found, where)
    k = int(m.tool[used[0]])
    return placed(dataset, target, None if is_stated(dataset.tools[k]) else k, found)


def _check_rows(t: Target, rows: np.ndarray, pixel: np.ndarray, table: Table) -> None:
    count, read = len(board(t).points), pixel[rows]

    def refuse(bad: np.ndarray, what: str, remedy: str) -> None:
        mask = np.zeros(len(table.line), bool)
        mask[rows] = bad
        table.first(mask, what, remedy)

    number = read[:, 2]
    refuse(
        (number != np.round(number)) | (number < 0) | (number >= count),
        f"`point` is {{point}}, but the board of `{t.name}` has points 0 to {count - 1}",
        "check `board`, or the numbers of the corners",
    )
    if not np.isnan(size := np.asarray(t.values["size"], float)).any():
        outside = np.any((read[:, :2] < -1) | (read[:, :2] > size), axis=1)
        if not np.any((read[:, 1::-1] < -1) | (read[:, 1::-1] > size)):
            refuse(
                outside,
                f"a corner at ({{u_px}}, {{v_px}}) px, but images of `{t.name}` have {size[0]:g} x "
                f"{size[1]:g} px; with both columns interchanged all corners are inside",
                "exchange the headings `u_px` (to the right) and `v_px` (down)",
            )
        refuse(
            outside,
            f"a corner at ({{u_px}}, {{v_px}}) px, but images of `{t.name}` have "
            f"{size[0]:g} x {size[1]:g} px",
            "the calibration of the camera is of another resolution: give that of these images",
        )


def _check_doubled(dataset: Dataset, target: int, rows: np.ndarray, table: Table) -> None:
    """Refuse a point that a named image has twice."""
    m = dataset.measurements
    assert m.pixel is not None
    if m.stop is None:
        return
    named = rows[m.stop[rows] != ""]
    image = np.unique(m.stop[named], return_inverse=True)[1]
    keys = np.column_stack([image, m.tool[named], m.pixel[named, 2].astype(int)])
    first, of = np.unique(keys, axis=0, return_index=True, return_inverse=True)[1:]
    again = np.flatnonzero(first[of.ravel()] != np.arange(len(named)))
    if len(again):
        row, other = named[again[0]], m.ids[named[first[of.ravel()[again[0]]]]]
        more = f", and {len(again) - 1} more rows repeat a point of their image" if len(again) > 1 else ""
        what = f"point {int(m.pixel[row, 2])} is twice in image `{m.stop[row]}` (as row `{other}`){more}"
        raise table.error(row, what, "correct `point` or `stop`, or remove one of both rows")


def _check_board(dataset: Dataset, target: int, rows: np.ndarray, seen: Images, where: str) -> None:
    t, m = dataset.targets[target], dataset.measurements
    some = np.isfinite(seen.poses).all(axis=(1, 2))
    if not some.any():
        return
    if np.mean(seen.misfit[some] < FOREIGN) < 0.5:
        fit = int(np.sum(seen.misfit[some] < FOREIGN))
        what = f"the corners of {fit} of {len(seen.misfit)} images of `{t.name}` fit its board"
        remedy = (
            "check the number of squares, the order of the corners, and the resolution of the calibration"
        )
        if other := transposed(t.texts.get("board", "")):
            turned = replace(t, texts=dict(t.texts) | {"board": other})
            every = tuple(turned if k == target else one for k, one in enumerate(dataset.targets))
            then = closed_form(replace(dataset, targets=every), target, rows, m.readings)[0]
            if (many := int(np.sum(then.misfit < FOREIGN))) > 0.5 * len(then.misfit):
                what += f", those of {many} images a board {other}"
                remedy = f"write `board: {other}`, or check the order of the corners"
        raise BayescalError(what, where, remedy)
    front = board(t).front
    good = some & (seen.misfit < FOREIGN)
    if front and np.mean(front * seen.poses[good, 2, 2] < 0) > 0.5:
        what = f"`{t.name}` sees its board from behind: the image or the order of its corners is mirrored"
        remedy = "number corners row by row from the upper left, as docs/cameras.md says"
        raise BayescalError(what, where, remedy)


def _check_arm(dataset: Dataset, target: int, rows: np.ndarray, found: hand_eye.HandEye, where: str) -> None:
    """Refuse the other mount, and a board of another size."""
    t, m = dataset.targets[target], dataset.measurements
    off = found.misfit
    if off > MISFIT:
        other = FIXED if t.texts["mount"] == FLANGE else FLANGE
        turned = replace(t, texts=dict(t.texts) | {"mount": other})
        session = replace(
            dataset, targets=tuple(turned if k == target else one for k, one in enumerate(dataset.targets))
        )
        swapped = closed_form(session, target, rows, m.readings)[2]
        assert swapped is not None
        if swapped.misfit < off / 3:
            both = f"{1e3 * off:.0f} mm off; {1e3 * swapped.misfit:.1f} mm"
            what = f"the images of `{t.name}` are {both} if its mount is"
            raise BayescalError(f"{what} `{other}`", where, f"write `mount: {other}`")
    factor = board_factor(dataset, target, rows)
    if abs(factor - 1.0) > OTHER_SIZE:
        flange, poses, _ = _poses_of(dataset, target, rows)
        if off > MISFIT and hand_eye.hand_eye(flange, poses * [1.0, 1.0, 1.0, factor]).misfit > off / 3:
            return  # nor with one of another size: `plausibility` says what may be wrong
        size = 1e3 * board(t).size
        like = f" (squares of {factor * size:.2g} mm, not {size:g} mm)" if size else ""
        what = f"the board of `{t.name}` looks {factor:.3f} times as large as stated{like}"
        raise BayescalError(what, where, "measure the board, and write its size")


def _poses_of(
    dataset: Dataset, target: int, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, hand_eye.HandEye | None]:
    """Poses (I, 3, 4) of the flange, of what it carries in what is fixed, and the hand-eye of both."""
    seen, good, found = closed_form(dataset, target, rows, dataset.measurements.readings)
    poses, carried = seen.poses[good], dataset.targets[target].texts["mount"] == FLANGE
    flange = flange_poses(dataset, dataset.measurements.readings[seen.first[good]])
    return flange, hand_eye.inverse(poses) if carried else poses, found


def board_factor(dataset: Dataset, target: int, rows: np.ndarray) -> float:
    """Size of the board over its stated one, as the motions of the arm tell; 1 where they do not."""
    flange, poses, found = _poses_of(dataset, target, rows)
    if found is None:
        return 1.0
    # F_R x + f = Z_R (s q) + z, in which distances in the images are to the scale s of the board
    turned = poses[:, :, 3] @ found.fixed[:, :3].T
    near = (found.off <= 3 * np.median(found.off) + 1e-9).astype(float)[:, None]
    fixed = np.broadcast_to(-np.eye(3), (len(flange), 3, 3))
    rows_of = np.concatenate([flange[:, :, :3], fixed, -turned[:, :, None]], axis=2)
    design = (rows_of * near[:, None]).reshape(-1, 7)
    if np.linalg.cond(design) > 1e4:
        return 1.0
    return float(np.linalg.lstsq(design, (-flange[:, :, 3] * near).ravel(), rcond=None)[0][6])
