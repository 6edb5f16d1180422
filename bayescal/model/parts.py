"""Parts of a scene: what is computed once, what cameras see, what certificates state of two targets.

Quantities are computed once for all poses of an arm, and for rows that another scene has. What cameras see is
as the effects of cameras and boards need it: slopes where camera and board are seen. A certificate states
values of two targets, one residual each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cached_property, wraps
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from bayescal.arm.statics import Stance
from bayescal.dataset import Certificate, Dataset, Target
from bayescal.dataset.cameras import FEWEST_SHARP, blur, board, closed_form, is_stated, placed, stated
from bayescal.dataset.contacts import bodies
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.write import taken
from bayescal.effects import View
from bayescal.effects.vocabulary import ImageErrors
from bayescal.statistics import grouped
from factors.camera import NAMES, NEAREST, Camera
from factors.certificate import Relation, aligned, apart, between_faces, off_plane, square

if TYPE_CHECKING:
    from bayescal.model.scene import Scene


T = TypeVar("T")


def bodies_of(scene: Scene, fitted: np.ndarray) -> dict[str, tuple[tuple[str, np.ndarray, np.ndarray], ...]]:
    """`instruments`, `artefacts` and `pieces` of `Circumstances`; a body is in the middle of its contacts.

    Pieces are those of all placements together, and each of one placement.
    """
    d, target = scene.dataset, scene.dataset.measurements.target
    index = {d.targets[t].name: t for t in np.unique(target[fitted]).tolist()}
    read = {name: t for name, t in index.items() if scene.declared[t].of_instrument}
    instruments = [
        (name, (target == t).astype(float), np.asarray(d.targets[t].values["xyz"]))
        for name, t in read.items()
    ]
    touched = [name for name in index if name not in read]

    def placed_of(groups: Mapping[str, Sequence[str]]) -> tuple[tuple[str, np.ndarray, np.ndarray], ...]:
        on = {name: np.isin(target, [index[each] for each in group]) for name, group in groups.items()}
        middle = {name: scene.points[fitted[rows[fitted]]].mean(axis=0) for name, rows in on.items()}
        return tuple((name, rows.astype(float), middle[name]) for name, rows in on.items())

    whole = bodies(d, touched)
    pieces = grouped((name.partition("@")[0], name) for name in touched) | {name: [name] for name in touched}
    pieces = {name: group for name, group in pieces.items() if group not in whole.values()}
    return {"instruments": tuple(instruments), "artefacts": placed_of(whole), "pieces": placed_of(pieces)}


class unposed(cached_property[T]):
    """A cached quantity that scenes of one dataset share at all poses of an arm; see `Scene.posed_at`."""

    def __get__(self, scene: Any, owner: Any = None) -> T:  # type: ignore[override]
        """The quantity of the scene from which this one was posed."""
        return super().__get__(scene if scene is None or scene.origin is None else scene.origin, owner)


class rowwise(cached_property[T]):
    """A cached quantity of single rows: of a continued scene, that of the rows before and of the new ones."""

    def __get__(self, scene: Any, owner: Any = None) -> T:  # type: ignore[override]
        """The quantity of all rows."""
        scene = scene if scene is None or scene.origin is None or self.posed else scene.origin
        name = self.attrname
        if scene is None or scene.parts is None or name is None or name in vars(scene):
            return super().__get__(scene, owner)
        vars(scene)[name] = stacked([getattr(part, name) for part in scene.parts])
        return super().__get__(scene, owner)

    posed = False


class posed_rowwise(rowwise[T]):
    """The same of a quantity that depends on the pose of the arm."""

    posed = True


def once_for_rows(compute: Callable[[Any, np.ndarray], T]) -> Callable[..., T]:
    """A method of a scene and rows, calibration ones by default, that is computed once for the same rows."""

    @wraps(compute)
    def method(scene: Any, rows: np.ndarray | None = None) -> T:
        rows = scene.rows("calibrate") if rows is None else rows
        values = vars(scene).setdefault(f"_{compute.__name__}", {})
        if (key := rows.tobytes()) not in values:
            values[key] = compute(scene, rows)
        return values[key]

    return method


def stacked(parts: list[Any]) -> Any:
    """Arrays one below the other, or dataclasses of such arrays; None where there are none."""
    first = parts[0]
    if first is None:
        return None
    if is_dataclass(first):
        each = {f.name: stacked([getattr(part, f.name) for part in parts]) for f in fields(first)}
        return replace(first, **each)  # type: ignore[type-var]
    return np.concatenate(parts)


def continued(scene: Scene, dataset: Dataset, stance: Callable[[Scene], Stance]) -> Scene:
    """The scene of a session with further rows: what single rows determine is computed for these alone.

    Parameters
    ----------
    scene : Scene
        Of the rows before, which cannot be continued again.
    dataset : Dataset
        Its first rows are those of the scene, in all columns but the role.
    stance : callable
        Where the arm stands in the further rows, from their scene; where it stands in the others is kept.
    """
    before, m = len(scene.dataset.measurements.ids), dataset.measurements
    rows = np.arange(before, len(m.ids))
    later = replace(scene, dataset=replace(dataset, measurements=taken(m, rows)), stance=None)
    there = scene.stance
    if there is not None:
        later = replace(later, stance=stance(later))
        there = stacked([there, later.stance])
    out = replace(scene, dataset=dataset, stance=there)
    object.__setattr__(scene, "parts", None)  # what it has from the rows before it is computed by now
    object.__setattr__(out, "parts", (scene, later))
    return out


def blur_of(dataset: Dataset) -> np.ndarray:
    """Factor on the noise of each row of a session, (N,): of a corner in a blurred image, else 1."""
    m, out = dataset.measurements, np.ones(len(dataset.measurements.target))
    if m.pixel is None:
        return out
    for t, item in enumerate(dataset.targets):
        rows = np.flatnonzero((m.target == t) & ~np.isnan(m.pixel[:, 0]))
        if KINDS[item.kind].posed and len(rows):
            out[rows] = blur(dataset, t, rows)
    return out


def as_seen(dataset: Dataset) -> Dataset:
    """The session with cameras, boards and tools where the images tell, also where they are stated with u."""
    m, out = dataset.measurements, dataset
    for target, t in enumerate(dataset.targets):
        rows = np.flatnonzero(m.target == target)
        if not KINDS[t.kind].posed or not len(rows):
            continue
        k = int(np.bincount(m.tool[rows]).argmax())
        if is_stated(t) or is_stated(dataset.tools[k]):
            transform = closed_form(dataset, target, rows[m.tool[rows] == k], m.readings)[2]
            out = out if transform is None or not transform.determined else placed(out, target, k, transform)
    return out


def sighted(dataset: Dataset) -> np.ndarray:
    """Pose of the board in the camera by the image of each row, (N, 3, 4); nan where few corners tell it."""
    m, out = dataset.measurements, np.full((len(dataset.measurements.target), 3, 4), np.nan)
    for t, item in enumerate(dataset.targets):
        rows = np.flatnonzero(m.target == t)
        if m.pixel is not None and KINDS[item.kind].posed and len(rows):
            rows = rows[~np.isnan(m.pixel[rows, 0])]
            seen, good, _ = closed_form(dataset, t, rows, m.readings)
            sure = (good & (np.bincount(seen.image) >= FEWEST_SHARP))[seen.image]
            out[rows[sure]] = seen.poses[seen.image[sure]]
    return out


def views_of(scene: Scene, fitted: np.ndarray) -> tuple[View, ...]:
    """What the cameras of fitted rows see, where the images tell that camera and board are."""
    seen, target = scene.as_seen, scene.dataset.measurements.target
    count = len(target)
    views = tuple(
        view(
            seen.dataset.targets[t],
            replace(camera, scale=kind.scale),
            rows,
            seen.nominal(t, rows),
            count,
            scene.sighted[rows],
        )
        for t in np.unique(target[fitted]).tolist()
        for rows in (np.flatnonzero(target == t),)
        if isinstance(kind := scene.kind(t, rows), Camera)
        and isinstance(camera := seen.kind(t, rows), Camera)
    )
    return tuple(replace(v, several=True) for v in views) if len(views) > 1 else views


def view(
    t: Target, kind: Camera, rows: np.ndarray, pose: np.ndarray, count: int, sighted: np.ndarray
) -> View:
    """The view of a camera.

    Parameters
    ----------
    t : Target
    kind : Camera
        Of all its rows.
    rows : np.ndarray of int, shape (C,)
    pose : np.ndarray, shape (3, 4, C)
        Poses of its tool in these rows.
    count : int
        N rows of the session.
    sighted : np.ndarray, shape (C, 3, 4)
        As of `sighted`: the slopes are taken there, since the arm may be rough.
    """
    lens, u, points = kind.lens, stated(t), board(t).points
    # directions as they were seen
    xy = lens.directions(kind.pixel.T)
    sure = np.isfinite(sighted[:, 0, 0])
    depth = np.sum(sighted[:, 2, :3] * kind.corner, axis=1) + sighted[:, 2, 3]
    depth = np.maximum(np.where(sure, depth, kind.seen(np.zeros(6), pose)[2]), NEAREST)

    def spread(by: np.ndarray) -> np.ndarray:
        """Slopes (2, K, C), px, as lengths of all rows, (N, 2, K)."""
        out = np.zeros((count, *by.shape[:2]))
        out[rows] = np.moveaxis(by * kind.scale, -1, 0)
        return out

    distorted, zero = lens.distorted(xy), np.zeros(len(rows))
    focal = np.array([[distorted[0], zero], [zero, distorted[1]]])
    centre = np.array([[zero + 1, zero], [zero, zero + 1]])
    coefficients = np.swapaxes(lens.by_coefficients(xy), 0, 1) * lens.focal[:, None, None]
    slopes = lens.slopes(xy) * lens.focal[:, None, None] / depth
    inward = -np.sum(slopes * xy, axis=1, keepdims=True)
    by_camera = np.concatenate([slopes, inward], axis=1)  # (2, 3, C) by a shift in the camera's frame
    axes = np.moveaxis(pose[:, :3], -1, 0)
    to_camera = np.swapaxes(axes, 1, 2) @ kind.frame[:3, :3] if kind.carried else kind.frame[:3, :3].T @ axes
    to_camera = np.where(sure[:, None, None], sighted[:, :, :3], to_camera)
    board_slopes = spread(np.einsum("ikc,ckj->ijc", by_camera, to_camera))
    middle = 0.5 * (points.max(axis=0) + points.min(axis=0))
    corner, every, number = np.zeros((count, 1, 2)), np.zeros(count), np.zeros(count, int)
    number[rows] = np.argmin(np.linalg.norm(kind.corner[:, None] - points, axis=2), axis=1)
    corner[rows, 0], every[rows] = (kind.corner - middle)[:, :2], 1.0
    half = np.maximum(0.5 * np.ptp(points, axis=0)[:2], 1e-3)
    bends = np.concatenate(
        [1.0 - (corner / half) ** 2, np.prod(corner / half, axis=2, keepdims=True)], axis=2
    )
    by_scale, by_bow = board_slopes[..., :2] * corner, board_slopes[..., 2:] * bends
    by_scale = np.append(by_scale, board_slopes[..., :1] * corner[..., 1:], axis=2)
    return View(
        t.name, every,
        ImageErrors(("fx", "fy"), "px", spread(focal), u.focal, lens.focal),
        ImageErrors(("cx", "cy"), "px", spread(centre), u.centre, lens.centre),
        ImageErrors(NAMES[lens.model], "1", spread(coefficients), u.coefficients, lens.coefficients),
        ImageErrors(("scale x", "scale y", "skew"), "1", by_scale, np.full(3, u.scale), of_board=True),
        ImageErrors(("bow x", "bow y", "twist"), "m", by_bow, np.full(3, u.flatness), of_board=True),
        number, board_slopes,
    )  # fmt: skip


STATED: dict[str, dict[Relation, tuple[tuple[str, str], ...]]] = {
    "parallel": {
        aligned: (("parallel 1", "rad"), ("parallel 2", "rad")),
        square: (("parallel", "rad"),),
        between_faces: (("distance", "m"),),
        off_plane: (("distance", "m"),),
        apart: (("distance", "m"),),
    },
    "perpendicular": {square: (("square", "rad"),), aligned: (("square 1", "rad"), ("square 2", "rad"))},
    "distance": {off_plane: (("distance", "m"),), apart: (("distance", "m"),)},
}
"""Values that a certificate of two targets states, one residual each, and their units, by relation."""


POINTS = "points"
"""Kind of the certificate of an artefact's coordinates, of which a fit uses those of the fitted targets."""


def u_of(entry: Certificate, stated: Sequence[tuple[str, str]]) -> np.ndarray:
    """Standard uncertainties, rad and m, of all values of a certificate."""
    return np.array([entry.u_angle if unit == "rad" else entry.u_distance for _, unit in stated], float)
