"""Whose error it is in images: of the arm, the camera, the board, a mount or the clock, each in pixels.

The part of a side is what its estimated parameters change in the images, less what another place of the
camera and of the board would change: hand-eye and place are estimated anew without it. What calibration
corrects (geometry, compliance, what is stated of lens and board) is apart from each further effect.

Points of a board that are not where the board is stated to have them, in all images.

The residuals of one point are compared between images: an error of the board displaces it alike in each,
along the axes of the board. Bayes factor of such displacements, normal with one variance for all points,
over none; what the fit absorbs is neglected. A point of which most measurements are outliers is judged with
these.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.assess import WORDS
from bayescal.effects import BASELINE, EFFECTS, Parameter, View
from bayescal.effects.location import BOARD, CAMERA
from bayescal.errors import listed
from bayescal.estimate import Estimate, linearise
from bayescal.model import ARM
from bayescal.model.block import Posed
from factors.camera import Camera

SITES = (CAMERA.kind, BOARD.kind)
"""Sites that are sides by themselves; all others are of the arm."""
PLACE = "tool"
"""Effect of the parameters of hand-eye."""
CALIBRATED = (*BASELINE, "camera")
"""Effects of which each parameter is known within its tolerance only: no error of what is measured."""


@dataclass(frozen=True)
class Part:
    """RMS of what one side changes in the images, px, its standard uncertainty, and the largest, px and m.

    By an effect, or "" what calibration corrects. Lengths are across the line of sight.
    """

    side: str
    effect: str
    rms: float
    u: float
    largest: float
    length: float


@dataclass(frozen=True)
class Images:
    """Fitted images and corners of a camera, noise of a coordinate, px, and the parts of all sides."""

    target: str
    images: int
    corners: int
    noise: float
    parts: tuple[Part, ...]


def side(parameter: Parameter) -> str:
    """Whether a parameter is of the arm, the camera, the board, a mount or the clock."""
    effect, site = EFFECTS.get(parameter.effect), parameter.site.kind
    return (effect.side if effect else "") or (site if site in SITES else "arm")


def images(fitted: Estimate) -> Iterator[Images]:
    """What every side changes in the images of each camera of a fit, effects and the largest first."""
    for block in fitted.model.blocks:
        if isinstance(block, Posed) and isinstance(block.kind, Camera):
            of_camera = _of(fitted, block, block.kind)
            if of_camera.corners:
                yield of_camera


def _of(fitted: Estimate, block: Posed, kind: Camera) -> Images:
    model = fitted.model
    kept = fitted.weights.row[block.name] > 0
    both = np.tile(kept, kind.rows)
    scale, whitening = np.tile(kind.scale, kind.rows), fitted.weights.whitening(block)[both]
    mine = fitted.linear.of_block[block.name]
    linear = fitted.linear
    if fitted.weights.shared:  # of the corners themselves, whatever they share
        linear = linearise(model, fitted.z, fitted.weights.apart)
    jacobian, in_px, count = linear.jacobian[mine][both], scale[both], int(np.sum(kept))
    arm = model.slices[ARM]
    names = [(side(p), "" if p.effect in CALIBRATED else p.effect) for p in model.parameters]
    free = np.array([p.effect == PLACE for p in model.parameters], bool)
    place = np.concatenate([jacobian[:, arm][:, free], jacobian[:, model.slices[block.target]]], axis=1)
    basis = np.linalg.qr(place[:, np.any(place, axis=0)])[0]
    value = fitted.arm / model.sd
    parts = []
    for name in dict.fromkeys(names):
        index = np.flatnonzero([each == name for each in names] & ~free)
        if not len(index):
            continue
        columns = jacobian[:, arm][:, index]
        columns = (columns - basis @ (basis.T @ columns)) / (whitening * in_px)[:, None]  # px
        moved = columns @ value[index]
        rms = float(np.sqrt(np.sum(moved**2) / max(count, 1)))
        slope = columns.T @ moved / max(count * rms, np.finfo(float).tiny)
        covariance = fitted.covariance[arm, arm][np.ix_(index, index)]
        u = float(np.sqrt(slope @ covariance @ slope))
        every = np.linalg.norm(moved.reshape(kind.rows, -1), axis=0)
        lengths = np.linalg.norm((moved * in_px).reshape(kind.rows, -1), axis=0)
        parts.append(Part(*name, rms, u, float(every.max(initial=0)), float(lengths.max(initial=0))))
    parts.sort(key=lambda p: (not p.effect, -p.rms))
    stated = float(np.median(block.sigma / kind.scale))  # few images are blurred
    noise = stated * fitted.weights.scale[block.group]
    return Images(block.target, len(np.unique(block.images[1][kept])), count, noise, tuple(parts))


TOLD = 10.0
"""Log Bayes factor from which on it is told (assumed)."""
SIZES = 1e-4 * 2.0 ** np.arange(-3, 7)
"""Standard deviations of the points from their places that are tried, m (assumed)."""
LARGE = 5.0
"""Times the RMS of the other points from which on a point is told by itself (convention)."""
SHOWN = 6
"""Blurred images that are named."""
ACROSS = 2.0
"""Ratio of the RMS across the plane of a board to that within it, from which on it is called not flat."""


def blurred(fitted: Estimate) -> str:
    """The images that are blurred, as a sentence; "" where none is."""
    scene = fitted.model.scene
    stop, factor = scene.dataset.measurements.stop, scene.blur
    rows = np.flatnonzero(factor > 1.0)
    if stop is None or not len(rows):
        return ""
    names, first = np.unique(stop[rows], return_index=True)
    each = [f"{name} {factor[rows[k]]:.2g} times" for name, k in zip(names, first, strict=True)]
    shown = listed(each[:SHOWN]) + ", ..." * (len(each) > SHOWN)
    return f"noise of blurred images over that of the others: {shown}; each is weighted by its own"


def lost_images(fitted: Estimate) -> str:
    """The images of which most corners are outliers, as a sentence; "" where none is."""
    m, each = fitted.model.scene.dataset.measurements, []
    views = {v.name for v in fitted.model.scene.circumstances(fitted.model.scene.rows("calibrate")).views}
    for b in fitted.model.blocks:
        if b.target not in views or m.stop is None:
            continue
        image, of = np.unique(m.stop[b.rows], return_inverse=True)
        count, lost = np.bincount(of), np.bincount(of, fitted.weights.row[b.name] == 0)
        each += [f"{image[k]} ({lost[k]:.0f} of {count[k]})" for k in np.flatnonzero(2 * lost > count)]
    if not each:
        return ""
    return str(WORDS["lost_images"].format(images=listed(each, SHOWN)))


@dataclass(frozen=True)
class Displaced:
    """What a board's points are off in all images."""

    target: str
    point: np.ndarray  # (Q,) their numbers
    shift: np.ndarray  # (Q, 3) m, along the axes of the board
    count: np.ndarray  # (Q,) images of each
    outliers: np.ndarray  # (Q,) measurements of each that the fit rejects

    @property
    def words(self) -> str:
        """A sentence about one point, or about all of them."""
        size = np.linalg.norm(self.shift, axis=1)
        k = int(np.argmax(size))
        others = float(np.sqrt(np.mean(np.delete(size, k) ** 2))) if len(size) > 1 else 0.0
        which = {"target": self.target, "point": self.point[k]}
        if size[k] > LARGE * others:
            few = f" ({self.outliers[k]} of its {self.count[k]} rows are outliers)"
            lost = few if self.outliers[k] else ""
            return str(WORDS["displaced_point"].format(**which, size=1e3 * size[k], lost=lost))
        parts = self.shift[:, :2], self.shift[:, 2:]
        within, across = (1e3 * float(np.sqrt(np.mean(np.sum(part**2, axis=1)))) for part in parts)
        flat = "the board is not flat" if across > ACROSS * within else "its pattern is not as stated"
        sizes = {"size": np.hypot(within, across), "within": within, "across": across}
        return str(WORDS["displaced_points"].format(**which, **sizes, flat=flat))


def displaced(fitted: Estimate) -> tuple[Displaced, ...]:
    """Boards of fitted cameras with points that are off in all images."""
    scene = fitted.model.scene
    views = {v.name: v for v in scene.circumstances(scene.rows("calibrate")).views}
    of_target: dict[str, list[tuple[np.ndarray, ...]]] = {}
    for b in fitted.model.blocks:
        if b.target in views:
            kept, residual = fitted.weights.row[b.name] > 0, fitted.residuals(b).T
            sigma = b.sigma * fitted.weights.scale[b.group]
            of_target.setdefault(b.target, []).append((b.rows, residual, sigma, kept))
    joined = ((name, map(np.concatenate, zip(*parts, strict=True))) for name, parts in of_target.items())
    every = (_of_board(views[name], *parts) for name, parts in joined)
    return tuple(one for one in every if one is not None)


def _of_board(
    view: View, rows: np.ndarray, residual: np.ndarray, sigma: np.ndarray, kept: np.ndarray
) -> Displaced | None:
    """The points of a board by residuals (C, 2), m, of rows (C,) with noise (C,), m."""
    number, of = np.unique(view.point[rows], return_inverse=True)
    count, lost = np.bincount(of), np.bincount(of, ~kept)
    used = kept | (2 * lost > count)[of]
    by, r = view.shift[rows] / sigma[:, None, None], residual / sigma[:, None]
    information, score = np.zeros((len(number), 3, 3)), np.zeros((len(number), 3))
    np.add.at(information, of[used], np.einsum("cki,ckj->cij", by[used], by[used]))
    np.add.at(score, of[used], -np.einsum("cki,ck->ci", by[used], r[used]))
    nats, shift = np.empty(len(SIZES)), np.empty((len(SIZES), *score.shape))
    for k, sd in enumerate(SIZES):
        precision = information + np.eye(3) / sd**2
        shift[k] = np.linalg.solve(precision, score[..., None])[..., 0]
        nats[k] = 0.5 * np.sum(score * shift[k]) - 0.5 * np.sum(np.linalg.slogdet(precision * sd**2)[1])
    best = int(np.argmax(nats))
    if nats[best] - np.log(len(SIZES)) < TOLD:
        return None
    return Displaced(view.name, number, shift[best], count, lost.astype(int))
