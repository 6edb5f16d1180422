"""Closed forms for cameras: poses of a board in images, and where camera and board are on an arm.

Poses of a board follow from a homography of a flat board, or a projection of any other, (Z. Zhang, A flexible
new technique for camera calibration, PAMI 22, 2000), refined by Gauss-Newton. Where camera and board are
follows from F X = Z Q, with F the pose of the flange and Q what the camera saw (M. Shah, Solving the
robot-world/hand-eye calibration problem using the Kronecker product, J. Mech. Robotics 5, 2013), with Cauchy
weights, so that a bad image does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FLAT = 1e-6
"""Thickness over width up to which a board is flat (rounding)."""
FEWEST_FLAT, FEWEST = 4, 6
"""Points of a flat board, and of another, from which an image gives a pose."""
IN_LINE = 1e-9
"""Second eigenvalue of the equations of a pose over the largest, below which the points lie on a line."""
PASSES = 8
"""Of the refinement of poses, and of the reweighting of images."""
SAME_AXIS = 0.999
"""Second singular value over the first from which on rotations have one common axis or none (assumed)."""
FEWEST_IMAGES = 3
LEVER = 0.3
"""m: arm of a turn where an image is judged by a length."""
CLEAR = 0.2
"""rad: angles that differ by more are equally bad (assumed)."""
FLIPPED = np.radians(5.0)
"""Angle from which on two poses of a board are different ones."""
AS_GOOD = 2.0
"""Misfit over that of the other pose, or of most images, up to which an image does not tell two poses apart
(assumed)."""


def board_poses(corner: np.ndarray, xy: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Poses of a board in the frame of the camera.

    Parameters
    ----------
    corner : np.ndarray, shape (R, 3)
        Points of the board, m, in its frame.
    xy : np.ndarray, shape (R, 2)
        Directions x / z, y / z in which they are seen.
    image : np.ndarray of int, shape (R,)
        Of each row, from 0.

    Returns
    -------
    np.ndarray, shape (I, 3, 4)
        Orientation and origin, m; nan of an image with too few points.
    """
    order, count = np.argsort(image, kind="stable"), np.bincount(image)
    poses = np.full((len(count), 3, 4), np.nan)
    if np.max(count, initial=0) < FEWEST_FLAT:
        return poses
    corner, xy, image = corner[order], xy[order], image[order]
    middle = corner.mean(axis=0)
    _, size, axes = np.linalg.svd(corner - middle, full_matrices=False)
    axes[2] *= np.linalg.det(axes)
    wide = float(size[0] / np.sqrt(len(corner)))
    local = (corner - middle) @ axes.T / wide
    flat = size[2] <= FLAT * size[0]
    enough = count >= (FEWEST_FLAT if flat else FEWEST)
    some = enough[image]
    if not some.any():
        return poses
    start = _linear(local[some], xy[some], np.cumsum(enough)[image[some]] - 1, flat)
    poses[enough] = refined(start, local[some], xy[some], np.cumsum(enough)[image[some]] - 1)
    out = np.empty_like(poses)
    out[..., :3] = poses[..., :3] @ axes
    out[..., 3] = wide * poses[..., 3] - out[..., :3] @ middle
    return out


def _sums(values: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Sums of values (R, ...) by image, in whose order they are."""
    return np.add.reduceat(values, np.flatnonzero(np.diff(image, prepend=-1)), axis=0)


def _linear(local: np.ndarray, xy: np.ndarray, image: np.ndarray, flat: bool) -> np.ndarray:
    """Poses (I, 3, 4) by the direct linear transformation; points (R, 3) have unit size."""
    count = np.bincount(image)
    mean = _sums(xy, image) / count[:, None]
    spread = np.sqrt(_sums(np.sum((xy - mean[image]) ** 2, axis=1), image) / count) + 1e-12
    scaled = (xy - mean[image]) / spread[image, None]
    point = np.column_stack([local[:, :2] if flat else local, np.ones(len(local))])
    none = np.zeros_like(point)
    rows = np.stack(
        [np.hstack([point, none, -scaled[:, :1] * point]), np.hstack([none, point, -scaled[:, 1:] * point])],
        axis=1,
    )
    values, vectors = np.linalg.eigh(_sums(np.einsum("rki,rkj->rij", rows, rows), image))
    h = vectors[:, :, 0].reshape(len(count), 3, -1)
    h[values[:, 1] <= IN_LINE * values[:, -1]] = np.nan
    to_xy = np.zeros((len(count), 3, 3))
    to_xy[:, 0, 0] = to_xy[:, 1, 1] = spread
    to_xy[:, :2, 2], to_xy[:, 2, 2] = mean, 1.0
    h = to_xy @ h
    h *= np.sign(h[:, 2, -1])[:, None, None]  # in front of the camera
    h /= np.mean(np.linalg.norm(h[:, :, :-1], axis=1), axis=1)[:, None, None]
    first = h[:, :, :-1]
    if flat:
        first = np.concatenate([first, np.cross(first[..., 0], first[..., 1])[..., None]], axis=-1)
    return np.concatenate([_nearest_rotation(first), h[:, :, -1:]], axis=-1)


def _nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) nearest to matrices."""
    bad = ~np.isfinite(matrix).all(axis=(-1, -2))
    u, _, v = np.linalg.svd(np.where(bad[..., None, None], np.eye(3), matrix))
    u[..., -1] *= np.linalg.det(u @ v)[..., None]
    out = u @ v
    out[bad] = np.nan
    return np.asarray(out)


def decided(
    poses: np.ndarray, start: np.ndarray, corner: np.ndarray, xy: np.ndarray, image: np.ndarray
) -> np.ndarray:
    """Poses (I, 3, 4) of a board; those near `start` (I, 3, 4) instead where an image leaves it open.

    A flat board that is seen from afar has two poses that fit its image almost alike. Points (R, 3), m,
    directions (R, 2) and images (R,) as in `board_poses`.
    """
    order = np.argsort(image, kind="stable")
    corner, xy, image = corner[order], xy[order], image[order]
    other = refined(start, corner, xy, image)
    open_ = (angle(other, poses) > FLIPPED) & as_good(other, poses, corner, xy, image)
    return np.where(open_[:, None, None], other, poses)


def as_good(
    other: np.ndarray, poses: np.ndarray, corner: np.ndarray, xy: np.ndarray, image: np.ndarray,
    as_most: bool = False,
) -> np.ndarray:  # fmt: skip
    """Which images (I,) agree with other poses (I, 3, 4) too, or `as_most`: as well as most images do.

    Points as in `board_poses`. The pose of a blurred image, or of a small tag, is poor where the board is
    seen frontally; its corners are not.
    """
    count = np.bincount(image)
    misfit, reference = (np.bincount(image, off(p, corner, xy, image)) / count for p in (other, poses))
    usual = np.median(misfit if as_most else reference)
    return np.asarray(misfit < AS_GOOD**2 * np.maximum(reference, usual))


def off(poses: np.ndarray, corner: np.ndarray, xy: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Squared distance (R,) of directions xy (R, 2) from those of corners (R, 3) at poses (I, 3, 4)."""
    points = np.einsum("rij,rj->ri", poses[image, :, :3], corner) + poses[image, :, 3]
    return np.sum((points[:, :2] / points[:, 2:] - xy) ** 2, axis=1)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles (...,), rad, between the orientations of poses (..., 3, 4)."""
    trace = np.einsum("...ij,...ij->...", a[..., :3], b[..., :3])
    return np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))


def refined(poses: np.ndarray, local: np.ndarray, xy: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Poses (I, 3, 4) of least misfit near others, by Gauss-Newton with Cauchy weights of the points.

    Points `local` (R, 3), m, in the frame of the board, and directions (R, 2) are in order of images.
    """
    good = np.isfinite(poses).all(axis=(1, 2))
    if not good.any():
        return poses
    some = good[image]
    local, xy, number = local[some], xy[some], (np.cumsum(good) - 1)[image[some]]
    now, count = poses[good], np.bincount(number)
    # as many places in every image, so that its equations are one product; those left over weigh nothing
    shape = len(count), int(np.max(count))
    first = shape[1] * np.arange(len(count)) + count - np.cumsum(count)
    place = np.arange(len(number)) + first[number]
    point, seen, weight = np.zeros((*shape, 3)), np.zeros((*shape, 2)), np.zeros(shape)
    point.reshape(-1, 3)[place], seen.reshape(-1, 2)[place] = local, xy
    by = np.zeros((*shape, 2, 7))  # derivatives by shift and turn, and what is off
    for _ in range(PASSES):
        turned = point @ np.swapaxes(now[..., :3], 1, 2)
        near = 1.0 / np.maximum(turned[..., 2:] + now[:, None, 2:, 3], 1e-3)
        projected = (turned[..., :2] + now[:, None, :2, 3]) * near
        x, y, z = np.moveaxis(turned, -1, 0)
        by[..., 0, 0] = by[..., 1, 1] = near[..., 0]
        by[..., 2] = -projected * near
        by[..., 3] = y[..., None] * by[..., 2] - z[..., None] * by[..., 1]
        by[..., 4] = z[..., None] * by[..., 0] - x[..., None] * by[..., 2]
        by[..., 5] = x[..., None] * by[..., 1] - y[..., None] * by[..., 0]
        by[..., 6] = projected - seen
        size = np.hypot(by[..., 0, 6], by[..., 1, 6]).ravel()[place]
        weight.ravel()[place] = 1.0 / (1.0 + (size / (3.0 * float(np.median(size)) + 1e-12)) ** 2)
        rows = by.reshape(len(now), -1, 7)
        normal = np.swapaxes((by[..., :6] * weight[..., None, None]).reshape(len(now), -1, 6), 1, 2) @ rows
        information = normal[..., :6]
        information += 1e-12 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        step = np.linalg.solve(information, normal[..., 6:])[..., 0]
        now[..., 3] -= step[:, :3]
        now[..., :3] = _turned(-step[:, 3:]) @ now[..., :3]
    out = poses.copy()
    out[good] = now
    return out


def _turned(v: np.ndarray) -> np.ndarray:
    """Rotation matrices (I, 3, 3) of rotation vectors (I, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(v, axis=1)[:, None, None]
    k = np.zeros((len(v), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    k = k - np.swapaxes(k, 1, 2)
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)
    )


def inverse(poses: np.ndarray) -> np.ndarray:
    """Inverse (..., 3, 4) of poses."""
    turn = np.swapaxes(poses[..., :3], -1, -2)
    return np.concatenate([turn, -turn @ poses[..., 3:]], axis=-1)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Poses (..., 3, 4) of b in the frame of a."""
    turn = a[..., :3] @ b[..., :3]
    return np.concatenate([turn, a[..., :3] @ b[..., 3:] + a[..., 3:]], axis=-1)


@dataclass(frozen=True)
class HandEye:
    """Poses (3, 4) of what is on the flange, in its frame, and of what is fixed, in F0.

    `off` (I,) m and `turned` (I,) rad are how far each image is off; `determined`: the rotations of the
    flange have more than one axis.
    """

    on_flange: np.ndarray
    fixed: np.ndarray
    off: np.ndarray
    turned: np.ndarray
    determined: bool

    @property
    def away(self) -> np.ndarray:
        """How far each image is off, turned included, (I,), m."""
        return np.hypot(self.off, LEVER * self.turned)

    @property
    def misfit(self) -> float:
        """How far most images are off, m."""
        return float(np.median(self.away))

    def predicted(self, flange: np.ndarray, inverted: bool) -> np.ndarray:
        """Poses (I, 3, 4) of what is carried in the frame of what is fixed, at poses of the flange."""
        pose = product(inverse(self.fixed), product(flange, self.on_flange))
        return inverse(pose) if inverted else pose


def half_turns(flange: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """In which images (I,) a board is numbered from its other end; the fewer of both kinds.

    The flange turns between two images by the same angle as the board in the camera, wherever both are. What
    favours another end of one of the two, summed over all pairs, is largest for the signs of the first
    eigenvector (a relaxation).

    Parameters
    ----------
    flange, seen : np.ndarray, shape (I, 3, 4)
        Poses of the flange, and of the board in the frame of the camera.
    """

    def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return angle(a[:, None], b[None])

    other = seen * np.array([-1.0, -1.0, 1.0, 1.0])
    wanted = between(flange, flange)
    gain = np.abs(wanted - between(seen, other)) - np.abs(wanted - between(seen, seen))
    sign = np.linalg.eigh(np.clip(gain, -CLEAR, CLEAR))[1][:, -1] < 0
    return sign if 2 * np.sum(sign) <= len(sign) else ~sign


def hand_eye(flange: np.ndarray, seen: np.ndarray) -> HandEye:
    """X and Z with F X = Z Q.

    Parameters
    ----------
    flange : np.ndarray, shape (I, 3, 4)
        Poses F of the flange in F0.
    seen : np.ndarray, shape (I, 3, 4)
        Poses Q of what is on the flange in the frame of what is fixed.
    """
    weight = np.ones(len(flange))
    f, q = flange[:, :, :3], seen[:, :, :3]
    for _ in range(PASSES):
        # vec(Z) = (Q x F) vec(X), summed over images; both are rotations, so that the best has the first
        # singular value
        k = np.einsum("nij,nkl,n->ikjl", f, q, weight).reshape(9, 9) / np.sum(weight)
        u, size, v = np.linalg.svd(k)
        first, second = v[0].reshape(3, 3), u[:, 0].reshape(3, 3)
        sign = np.sign(np.linalg.det(first)) or 1.0
        x, z = _nearest_rotation(sign * first), _nearest_rotation(sign * second)
        turned = angle(f @ x, z @ q)
        rows = np.concatenate([f, np.broadcast_to(-np.eye(3), f.shape)], axis=2)
        right = seen[:, :, 3] @ z.T - flange[:, :, 3]
        root = np.sqrt(weight)[:, None, None]
        t = np.linalg.lstsq((rows * root).reshape(-1, 6), (right * root[..., 0]).ravel(), rcond=None)[0]
        off = np.linalg.norm(rows @ t - right, axis=1)
        weight = 1.0 / (1.0 + (off / (3 * np.median(off) + 1e-9)) ** 2)
        weight /= 1.0 + (turned / (3 * np.median(turned) + 1e-9)) ** 2
    determined = len(flange) >= FEWEST_IMAGES and bool(size[1] < SAME_AXIS * size[0])
    return HandEye(np.column_stack([x, t[:3]]), np.column_stack([z, t[3:]]), off, turned, determined)
