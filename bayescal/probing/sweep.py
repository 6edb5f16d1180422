"""Distances of segments from convex shapes: the axis of a capsule from what it may collide with; compiled.

The signed distance from a convex shape is a convex function of the point, negative inside. Along a segment it
has one minimum, which a golden-section search encloses.

Smallest distances on motions of an arm, by bounds: nothing between two configurations is left unchecked.

While the joints before it turn by small angles, no point of a capsule moves farther than the sum of the
angles times its distances from their axes, and of the shifts of prismatic joints. A part of a motion is free
if the distance of a pair of shapes in its middle exceeds the required one by more than that; otherwise it is
halved. For most pairs a bound of the distance decides, from the middle of a capsule; only for the others is
the distance computed (`exact`).
"""

import math
from dataclasses import dataclass

import numpy as np

from bayescal.arm.chain import link_angles
from bayescal.arm.motion import NominalArm
from bayescal.arm.shapes import BALLS, BOX, CYLINDER, HALF_SPACE, Capsule, Shape
from bayescal.arm.transforms import compiled

_jit = compiled(error_model="numpy")
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
STEPS = 30  # of the search: the minimum is enclosed to 6e-7 of the segment


@_jit
def point(kind, row, planes, x, y, z):
    """Signed distance, m, of a point from a shape of `kind` with the numbers `row` (see `shapes`)."""
    if kind == BALLS:
        dx, dy, dz = row[3] - row[0], row[4] - row[1], row[5] - row[2]
        x, y, z = x - row[0], y - row[1], z - row[2]
        square = dx * dx + dy * dy + dz * dz
        if square > 0.0:
            part = min(max((x * dx + y * dy + z * dz) / square, 0.0), 1.0)
            x, y, z = x - part * dx, y - part * dy, z - part * dz
        return math.sqrt(x * x + y * y + z * z) - row[6]
    if kind == BOX:
        x, y, z = x - row[9], y - row[10], z - row[11]
        outside, inside = 0.0, -math.inf
        for k in range(3):
            beyond = abs(x * row[k] + y * row[3 + k] + z * row[6 + k]) - row[12 + k]
            inside = max(inside, beyond)
            outside += max(beyond, 0.0) ** 2
        return math.sqrt(outside) + min(inside, 0.0)
    if kind == HALF_SPACE:
        return x * row[0] + y * row[1] + z * row[2] - row[3]
    if kind == CYLINDER:
        x, y, z = x - row[3], y - row[4], z - row[5]
        along = x * row[0] + y * row[1] + z * row[2]
        over = abs(along) - row[6]
        x, y, z = x - along * row[0], y - along * row[1], z - along * row[2]
        beside = math.sqrt(x * x + y * y + z * z) - row[7]
        return math.hypot(max(over, 0.0), max(beside, 0.0)) + min(max(over, beside), 0.0)
    most = -math.inf
    for k in range(int(row[0]), int(row[1])):
        most = max(most, x * planes[k, 0] + y * planes[k, 1] + z * planes[k, 2] - planes[k, 3])
    return most


@_jit
def _points(kind, row, planes, points):
    """Signed distances (N,), m, of points (N, 3) from a shape."""
    out = np.empty(len(points))
    for k in range(len(points)):
        out[k] = point(kind, row, planes, points[k, 0], points[k, 1], points[k, 2])
    return out


def signed_distances(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Distances (...), m, of points (..., 3) from a shape, in its frame; of a hull, or less."""
    flat = np.ascontiguousarray(points, float).reshape(-1, 3)
    return np.asarray(_points(shape.kind, *shape.numbers, flat).reshape(points.shape[:-1]))


@_jit
def least(kind, row, planes, a, b):
    """Least signed distance, m, of a segment from `a` to `b` (3,), or less: by 6e-7 of its length."""
    x, y, z = a[0], a[1], a[2]
    dx, dy, dz = b[0] - x, b[1] - y, b[2] - z
    best = point(kind, row, planes, x, y, z)
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length == 0.0:
        return best
    best = min(best, point(kind, row, planes, b[0], b[1], b[2]))
    low, width = 0.0, 1.0
    t, s = 1 - GOLDEN, GOLDEN
    at_t = point(kind, row, planes, x + t * dx, y + t * dy, z + t * dz)
    at_s = point(kind, row, planes, x + s * dx, y + s * dy, z + s * dz)
    for _ in range(STEPS):
        best = min(best, at_t, at_s)
        if at_t < at_s:
            width *= GOLDEN
            at_s = at_t
            t = low + (1 - GOLDEN) * width
            at_t = point(kind, row, planes, x + t * dx, y + t * dy, z + t * dz)
        else:
            low += (1 - GOLDEN) * width
            width *= GOLDEN
            at_t = at_s
            s = low + GOLDEN * width
            at_s = point(kind, row, planes, x + s * dx, y + s * dy, z + s * dz)
    return best - width * length


HALVINGS = 14
"""Of a motion: parts that are undecided then, 0.1 mm of a motion of 1.6 m, count as too near."""
SHARE = 0.1
"""Of a distance, by which the bound of it may be too small."""


@dataclass(frozen=True)
class Pair:
    """Two shapes that must not overlap: a capsule of the arm (its index), and one of a solid or of the arm.

    `solid` is the index of the solid, -1 if the other is part of the arm, with index `other`. `surface`: the
    shape is the surface that a contact touches.
    """

    capsule: int
    shape: Shape
    solid: int = -1
    other: int = -1
    surface: bool = False


class Pairs:
    """P pairs of the capsules of an arm, as arrays for the compiled check."""

    def __init__(self, arm: NominalArm, capsules: tuple[Capsule, ...], pairs: tuple[Pair, ...]) -> None:
        shapes: dict[int, Shape] = {id(p.shape): p.shape for p in pairs if p.other < 0}
        number = {key: k for k, key in enumerate(shapes)}
        self.arm = arm
        chain = arm.chain
        self.chain = chain.base, chain.link, np.asarray(chain.d, float), chain.theta, arm.robot.slides
        self.capsules = (
            np.array([c.frame for c in capsules], np.int64),
            np.array([(c.a, c.b) for c in capsules], float).reshape(-1, 2, 3),
            np.array([c.radius for c in capsules], float),
        )
        rows = [(p.capsule, p.other, number.get(id(p.shape), -1)) for p in pairs]
        self.pairs = np.array(rows, np.int64).reshape(-1, 3)
        self.kinds = np.array([shape.kind for shape in shapes.values()], np.int64)
        self.numbers, planes, count = np.zeros((len(shapes), 15)), [np.empty((0, 4))], 0
        for k, shape in enumerate(shapes.values()):
            row, more = shape.numbers
            self.numbers[k, : len(row)] = row
            if len(more):
                self.numbers[k, :2] += count
            planes.append(more)
            count += len(more)
        self.planes = np.concatenate(planes)

    def closest(
        self,
        begin: np.ndarray,
        end: np.ndarray,
        compared: np.ndarray,
        slack: np.ndarray | None = None,
        floor: float = -np.inf,
        tolerance: float = 0.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Smallest distances (M,), m, from below, and the pairs (M,) that come nearest.

        Parameters
        ----------
        begin, end : np.ndarray, shape (M, n)
            Readings, rad, between which all joints move at the same time.
        compared : np.ndarray of bool, shape (M, P)
            Which pairs are compared, in which motions.
        slack : np.ndarray, shape (M, n), optional
            rad: how far joints may be off.
        `floor` : float
            A motion that comes nearer, m, is given up. Otherwise its distance is at least this.
        tolerance : float
            m: by how much distances above `floor` may be too small, or `SHARE` of them if that is more.
        """
        coupling = self.arm.robot.link_from_reading
        off = np.zeros(begin.shape) if slack is None else slack @ np.abs(coupling).T
        both = np.broadcast_arrays(begin, end)  # the compiled code checks no index
        first, last = (np.ascontiguousarray(link_angles(self.arm.robot, q)) for q in both)
        smallest, nearest = np.full(len(begin), np.inf), np.zeros(len(begin), np.int64)
        _closest(
            *self.chain, *self.capsules, self.pairs, self.kinds, self.numbers, self.planes, first, last, off,
            np.ascontiguousarray(compared), floor, tolerance, smallest, nearest,
        )  # fmt: skip
        return smallest, nearest


@_jit
def _place(base, link, d, theta, slides, frame, ends, q, axes, placed):
    """Axes and origins of the joints (n, 2, 3), and ends of the capsules (C, 2, 3), m, at angles q (n,)."""
    n = len(q)
    pose, behind = base.copy(), np.empty((3, 4))
    for f in range(n + 2):
        if f > 0:
            for i in range(3):
                for j in range(4):
                    behind[i, j] = pose[i, 3] if j == 3 else 0.0
                    for k in range(3):
                        behind[i, j] += pose[i, k] * link[f - 1, k, j]
            for i in range(3):  # numba compiles assignments of arrays to arrays for seconds
                for j in range(4):
                    pose[i, j] = behind[i, j]
        if 0 < f <= n:
            angle = theta[f - 1] if slides[f - 1] else q[f - 1]
            shift = d[f - 1] + q[f - 1] if slides[f - 1] else d[f - 1]
            c, s = math.cos(angle), math.sin(angle)
            for i in range(3):
                x, y = pose[i, 0], pose[i, 1]
                pose[i, 0], pose[i, 1] = c * x + s * y, c * y - s * x
                pose[i, 3] += pose[i, 2] * shift
                axes[f - 1, 0, i], axes[f - 1, 1, i] = pose[i, 2], pose[i, 3]
        for k in range(len(frame)):
            if frame[k] == f:
                for e in range(2):
                    x, y, z = ends[k, e, 0], ends[k, e, 1], ends[k, e, 2]
                    for i in range(3):
                        placed[k, e, i] = pose[i, 3] + pose[i, 0] * x + pose[i, 1] * y + pose[i, 2] * z


@_jit
def _displaced(slides, frame, axes, placed, turns, moved):
    """How far capsules move at most against each frame, (n + 1, C), m, by joints moved by `turns` (n,).

    A joint that turns by an angle moves a point by at most the angle times its distance from the axis, which
    the joints behind it increase by at most as much as they move the point.
    """
    n = len(turns)
    moved[:] = 0.0
    for k in range(len(frame)):
        for e in range(2):
            far = 0.0
            for f in range(min(frame[k], n), 0, -1):
                if slides[f - 1]:
                    far += turns[f - 1]
                    moved[f - 1, k] = max(moved[f - 1, k], far)
                    continue
                u, v, w = axes[f - 1, 0, 0], axes[f - 1, 0, 1], axes[f - 1, 0, 2]
                x, y = placed[k, e, 0] - axes[f - 1, 1, 0], placed[k, e, 1] - axes[f - 1, 1, 1]
                z = placed[k, e, 2] - axes[f - 1, 1, 2]
                x, y, z = y * w - z * v, z * u - x * w, x * v - y * u
                far += turns[f - 1] * (math.sqrt(x * x + y * y + z * z) + far)
                moved[f - 1, k] = max(moved[f - 1, k], far)


@_jit
def _needed(best, floor, tolerance):
    """The bound, m, that ends the search where the least distance known is `best`."""
    wide = max(tolerance, SHARE * abs(best)) if tolerance > 0.0 else 0.0
    return max(floor, best - wide)


@_jit
def _closest(
    base, link, d, theta, slides, frame, ends, radius, pairs, kinds, numbers, planes, first, last, slack,
    compared, floor, tolerance, smallest, nearest,
):  # fmt: skip
    """`Pairs.closest`, into `smallest` and `nearest` (M,); angles of the links `first`, `last` (M, n)."""
    n, count = first.shape[1], len(pairs)
    q, turns, length = np.empty(n), np.empty(n), np.empty(len(frame))
    axes, placed = np.empty((n, 2, 3)), np.empty((len(frame), 2, 3))
    for k in range(len(frame)):
        length[k] = math.sqrt(np.sum((ends[k, 1] - ends[k, 0]) ** 2))
    moved, other = np.empty((n + 1, len(frame))), np.zeros(15)
    undecided, number = np.empty((HALVINGS + 1, count), np.int64), np.zeros(HALVINGS + 1, np.int64)
    levels, middles = np.empty(2 * HALVINGS, np.int64), np.empty(2 * HALVINGS)
    for m in range(len(first)):
        best = math.inf
        number[0] = 0
        for p in range(count):
            if compared[m, p]:
                undecided[0, number[0]] = p
                number[0] += 1
        levels[0], middles[0], waiting = 0, 0.5, 1
        while waiting and best >= floor:
            waiting -= 1
            level, middle = levels[waiting], middles[waiting]
            half = 0.5 ** (level + 1)
            for j in range(n):
                turn = last[m, j] - first[m, j]
                q[j], turns[j] = first[m, j] + middle * turn, half * abs(turn) + slack[m, j]
            _place(base, link, d, theta, slides, frame, ends, q, axes, placed)
            _displaced(slides, frame, axes, placed, turns, moved)
            number[level + 1] = 0
            for i in range(number[level]):
                p = undecided[level, i]
                a, b, shape = pairs[p, 0], pairs[p, 1], pairs[p, 2]
                if b >= 0:
                    for j in range(3):
                        other[j], other[3 + j] = placed[b, 0, j], placed[b, 1, j]
                    kind, row, off, gap = BALLS, other, moved[frame[a], b], radius[a] + radius[b]
                else:
                    kind, row, off, gap = kinds[shape], numbers[shape], moved[0, a], radius[a]
                x, y = 0.5 * (placed[a, 0, 0] + placed[a, 1, 0]), 0.5 * (placed[a, 0, 1] + placed[a, 1, 1])
                upper = point(kind, row, planes, x, y, 0.5 * (placed[a, 0, 2] + placed[a, 1, 2])) - gap
                lower = upper - 0.5 * length[a]
                if upper < best:
                    best = upper
                    nearest[m] = p
                need = _needed(best, floor, tolerance)
                final = level + 1 == HALVINGS
                if lower - off < need and (upper - off >= need or lower < floor or final):
                    lower = least(kind, row, planes, placed[a, 0], placed[a, 1]) - gap
                    if lower < best:
                        best = lower
                        nearest[m] = p
                        need = _needed(best, floor, tolerance)
                if lower - off >= need or final:
                    smallest[m] = min(smallest[m], lower - off)
                else:
                    undecided[level + 1, number[level + 1]] = p
                    number[level + 1] += 1
                if best < floor:
                    break
            if number[level + 1]:
                for sign in (1.0, -1.0):
                    levels[waiting], middles[waiting] = level + 1, middle + sign * 0.5 * half
                    waiting += 1
        if best < floor:
            smallest[m] = best
