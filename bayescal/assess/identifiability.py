"""Identifiability: which parameters and combinations the contacts determine, and which they do not.

Information of a session measured again with changes: poses, directions, length, payload, tool.

Directions in space that the fitted data probe: a residual measures the ball along one direction only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from bayescal.dataset.target_kinds import KINDS
from bayescal.effects import UNITS, Parameter
from bayescal.effects.geometry import TOOL
from bayescal.effects.vocabulary import unit_label
from bayescal.estimate import Estimate
from bayescal.estimate.unexplained import FORM
from bayescal.model import ORIENTATION, Model
from bayescal.predict.forecast import elsewhere, joint_range, point_slopes
from bayescal.statistics import rms

DETERMINED = 0.9  # contraction from which on the data count as having decided
PRIOR_ONLY = 0.1
WEAK = 1.0  # singular value below which a direction stays wider than 71 % of its prior
SHOWN = 0.25  # loadings smaller than this are not named
LARGEST = 4  # loadings that are named if all are smaller
LEAK = 0.1  # share of a combination that may be in weak directions for it to count as identifiable


@dataclass(frozen=True)
class Direction:
    """A combination of arm parameters that is not identifiable or weakly identifiable."""

    singular_value: float
    loadings: tuple[tuple[str, float], ...]  # largest first, in units of prior sds
    words: str
    vector: np.ndarray  # (P,) unit vector, of the parameters of `Identifiability.index`


@dataclass(frozen=True)
class Identifiability:
    """Of the arm's parameters, targets eliminated."""

    singular_values: np.ndarray  # (P,) of the whitened Jacobian, largest first
    weak: tuple[Direction, ...]
    determined: tuple[str, ...]
    partly: tuple[str, ...]
    prior_only: tuple[str, ...]
    index: np.ndarray  # (P,) of the arm's parameters in the model
    information: np.ndarray  # (P, P) of the rows, by z, without the prior
    parameters: tuple[Parameter, ...]  # (P,) of the index

    def direction(self, v: np.ndarray) -> Direction:
        """A unit vector (P,) among the weak directions, with its words."""
        return _direction(self.parameters, v, self.information, np.array([d.vector for d in self.weak]).T)


def identifiability(fitted: Estimate, covariance: np.ndarray | None = None) -> Identifiability:
    """Singular values of the whitened Jacobian of the arm, its targets projected out.

    A direction of singular value s has 1 / (1 + s^2) of its prior variance left.

    Parameters
    ----------
    fitted : Estimate
    covariance : np.ndarray, shape (D, D), optional
        Of z as it is stated, with the discrepancy of the model: a parameter whose stated u is that of its
        prior is not identifiable, however many rows there are. Default: that of the estimate.
    """
    covariance = fitted.covariance if covariance is None else covariance
    model = fitted.model
    # the form of a face is not the arm's: it is projected out with the targets
    arm = np.array([k for k, p in enumerate(model.parameters) if p.effect != FORM], int)
    j = fitted.linear.jacobian
    by_arm, other = j[:, arm], np.delete(j, arm, axis=1)
    shared = other.T @ by_arm
    prior = other.T @ other + np.eye(other.shape[1])
    information = by_arm.T @ by_arm - shared.T @ np.linalg.solve(prior, shared)
    eigenvalues, vectors = np.linalg.eigh(information)
    singular = np.sqrt(np.maximum(eigenvalues, 0.0))
    parameters = [model.parameters[k] for k in arm]
    names = [p.name for p in parameters]
    weak = vectors[:, singular < WEAK]
    turned = simplified(weak).T if weak.size else ()
    weak_directions = [_direction(parameters, v, information, weak) for v in turned]
    contraction = 1.0 - np.diag(covariance)[arm]
    weak_directions.sort(key=lambda d: d.singular_value)
    return Identifiability(
        singular[::-1],
        tuple(weak_directions),
        tuple(n for n, c in zip(names, contraction, strict=True) if c >= DETERMINED),
        tuple(n for n, c in zip(names, contraction, strict=True) if PRIOR_ONLY <= c < DETERMINED),
        tuple(n for n, c in zip(names, contraction, strict=True) if c < PRIOR_ONLY),
        arm,
        information,
        tuple(parameters),
    )


def _direction(
    parameters: Sequence[Parameter], v: np.ndarray, information: np.ndarray, weak: np.ndarray
) -> Direction:
    """A direction (P,) among weak ones (P, K), with its words."""
    size = float(np.sqrt(max(v @ information @ v, 0.0)))
    order = np.argsort(-np.abs(v))
    v = v * np.sign(v[order[0]])
    loadings = tuple((parameters[k].name, float(v[k])) for k in order if abs(v[k]) > SHOWN)
    return Direction(size, loadings, _words(parameters, v, size, weak), v)


def _words(parameters: Sequence[Parameter], v: np.ndarray, size: float, weak: np.ndarray) -> str:
    """A weak direction as what the data leave open, in the units of files.

    Parameters
    ----------
    parameters : sequence of Parameter, (P,)
    v : np.ndarray, shape (P,)
        The direction, a unit vector, normalised by the prior standard deviations.
    size : float
        Its singular value.
    weak : np.ndarray, shape (P, K)
        Basis of all weak directions: what it holds is not identifiable in any other combination either.
    """
    state = "not" if size**2 / (1.0 + size**2) < PRIOR_ONLY else "weakly"
    order = [int(k) for k in np.argsort(-np.abs(v))]
    shown = [k for k in order if abs(v[k]) > SHOWN] or order[:LARGEST]  # of many alike, each is small
    units = [UNITS[p.unit] for p in parameters]
    if len(shown) == 1:
        return f"{parameters[shown[0]].name} is {state} identifiable"
    if len(shown) == 2:
        i, j = sorted(shown, key=lambda k: parameters[k].name)
        across = np.zeros(len(v))
        across[[i, j]] = np.array([v[j], -v[i]]) / np.hypot(v[i], v[j])
        if np.sum((weak.T @ across) ** 2) < LEAK:
            sd = [parameters[k].sd * units[k][1] for k in (i, j)]
            kept = _combination(parameters[i].name, parameters[j].name, -v[i] * sd[0] / (v[j] * sd[1]))
            if units[i][0] != units[j][0]:
                kept = kept.replace("*", f" {unit_label(units[i][0])}/{unit_label(units[j][0])} ")
            kept = kept.replace("*", " ")
            if state == "not":
                return f"only the combination {kept} is identifiable"
            both = f"{parameters[i].name} and {parameters[j].name}"
            return f"the combination {kept} is identifiable, {both} singly weakly"
    sizes = [f"{v[k] * parameters[k].sd * units[k][1]:+.2g} {unit_label(units[k][0])}" for k in shown]
    changes = [f"{parameters[k].name} by {size.rstrip()}" for k, size in zip(shown, sizes, strict=True)]
    return f"a common change of {', '.join(changes[:-1])} and {changes[-1]} is {state} identifiable"


def _combination(first: str, second: str, factor: float) -> str:
    """``first + factor*second``; a factor that rounds to 1 is left out."""
    size = f"{abs(factor):.2g}"
    return f"{first} {'+' if factor > 0 else '-'} {'' if size == '1' else size + '*'}{second}"


def simplified(basis: np.ndarray, rounds: int = 60) -> np.ndarray:
    """Rotate an orthonormal basis (P, k) so that each vector loads on few parameters (Kaiser 1958)."""
    turn = np.eye(basis.shape[1])
    for _ in range(rounds):
        loading = basis @ turn
        square = loading**2
        u, _, vt = np.linalg.svd(basis.T @ (loading * (square - square.mean(axis=0))))
        turn = u @ vt
    return basis @ turn


PLANNED = 120
"""Rows of a session with changes; as many again with a second tool, and with a payload."""
SECOND_TOOL = np.array([0.08, 0.05, 0.06])
"""m, from the TCP: the point of a second tool (assumed)."""
PAYLOAD = 2.0
"""kg: an attached mass (assumed)."""
ANGLE = 1e-3
"""rad: of the last joint, to measure the distance of the TCP from its axis."""
SEED = 20
"""Of the poses."""


class Conditions:
    """A fitted session, and the information that it would have with changes.

    All targets are taken as fixed to one body whose place, and without a known length whose size, is not
    known: both are eliminated.

    Parameters
    ----------
    fitted : Estimate
    index : np.ndarray of int, shape (P,)
        The parameters of the model that count.
    """

    def __init__(self, fitted: Estimate, index: np.ndarray) -> None:
        self.model, self.index, self._values = fitted.model, index, fitted.arm
        scene = self.model.scene
        rows = np.setdiff1d(scene.rows("calibrate"), fitted.rejected)
        self.rows = rows[np.linspace(0, len(rows) - 1, PLANNED).round().astype(int)]
        self.readings = scene.dataset.measurements.readings
        self._look = np.zeros((len(scene.points), 3, 3))
        noise = []
        for block in self.model.blocks:
            if block.group == ORIENTATION:
                continue
            u = scene.looks(scene.index[block.target], block.rows)
            self._look[block.rows, : len(u)] = np.moveaxis(u, 2, 0)
            noise.append(fitted.weights.sigma[block.name] * fitted.weights.scale[block.group])
        self.noise = float(np.median(np.concatenate(noise)))
        self.values_per_row = float(np.mean(np.sum(np.any(self._look[self.rows], axis=2), axis=1)))
        # an instrument reads lengths; what certificates state is information of the session alone
        fitted_targets = {b.target for b in self.model.blocks}
        self._metric = any(KINDS[t.kind].metric for t in scene.dataset.targets if t.name in fitted_targets)
        self._slopes: dict[tuple[bool, str], tuple[np.ndarray, np.ndarray]] = {}
        self._information: dict[tuple[str, ...], np.ndarray] = {}

    def possible(self, changes: Sequence[str]) -> list[tuple[str, ...]]:
        """Sets of changes that the session may have, the smallest first, from none to all."""
        robot, looks = self.model.scene.dataset.robot, np.any(self._look[self.rows], axis=2)
        excluded = {"directions"} if np.all(looks) else set()
        excluded |= {"length"} if self._metric else set()
        excluded |= {"payload"} if robot.masses is None else set()
        allowed = [c for c in changes if c not in excluded]
        return [subset for size in range(len(allowed) + 1) for subset in combinations(allowed, size)]

    def information(self, changes: tuple[str, ...]) -> np.ndarray:
        """Information (P, P) of a session with changes, by z, with the place of its targets eliminated."""
        if changes not in self._information:
            a = self._seen(changes)
            self._information[changes] = a.T @ a
        return self._information[changes]

    def displacement(self, covariance: np.ndarray) -> float:
        """RMS displacement, m, of TCPs over the range of all joints, for a covariance (P, P) of z."""
        points, slopes = self._points(True, "")
        a = _free_of(slopes[..., self.index].reshape(-1, len(self.index)), _body(points, False))
        return float(np.sqrt(max(np.sum((a @ covariance) * a), 0.0) / len(points)))

    @property
    def lever(self) -> float:
        """Largest distance of a TCP from the last axis, m."""
        turned = self.readings[self.rows].copy()
        turned[:, -1] += ANGLE
        moved = elsewhere(self.model, self.rows, turned).points(self._values).T - self._points(False, "")[0]
        return float(np.max(np.linalg.norm(moved, axis=1)) / ANGLE)

    @cached_property
    def _everywhere(self) -> np.ndarray:
        robot = self.model.scene.dataset.robot
        return joint_range(robot, PLANNED, np.random.default_rng(SEED))

    def _points(self, everywhere: bool, other: str) -> tuple[np.ndarray, np.ndarray]:
        """TCP positions (N, 3), m, and their slopes (N, 3, P') by z; `other`: payload, tool, or ""."""
        if (everywhere, other) not in self._slopes:
            payload = self.model.scene.dataset.measurements.payload
            load = np.zeros(PLANNED) if payload is None else payload[self.rows]
            readings = self._everywhere if everywhere else self.readings[self.rows]
            heavier = load + PAYLOAD if other == "payload" else None
            offset = SECOND_TOOL if other == "tool" else None
            motion = elsewhere(self.model, self.rows, readings, heavier, offset)
            slopes = point_slopes(self.model, motion, self._values)
            self._slopes[everywhere, other] = motion.points(self._values).T, slopes
        return self._slopes[everywhere, other]

    def _seen(self, changes: tuple[str, ...]) -> np.ndarray:
        """Whitened rows (R, P) of a session with changes, free of the place of its targets."""
        points, rows, second = [], [], []
        ours = np.array([p.effect == TOOL.name for p in self.model.parameters])
        for other in ("", *(c for c in ("payload", "tool") if c in changes)):
            positions, slopes = self._points("poses" in changes, other)
            points.append(positions)
            second.append(slopes[..., ours] * (other == "tool"))
            rows.append(np.where(ours, 0.0, slopes) if other == "tool" else slopes)
        look = np.eye(3) if "directions" in changes else np.tile(self._look[self.rows], (len(points), 1, 1))
        place = _body(np.concatenate(points), not (self._metric or "length" in changes))
        unknown = np.concatenate([place.reshape(-1, 3, place.shape[1]), np.concatenate(second)], axis=2)
        a = look @ np.concatenate(rows)[..., self.index]
        unknown = look @ unknown
        return _free_of(a.reshape(-1, a.shape[2]), unknown.reshape(-1, unknown.shape[2])) / self.noise


def _body(points: np.ndarray, size: bool) -> np.ndarray:
    """Displacements (3 N, 6 or 7) of points (N, 3) by the place of a body, and by its size."""
    centred = points - points.mean(axis=0)
    scale = max(rms(centred), 1e-3)
    moved = [np.broadcast_to(axis, centred.shape) for axis in np.eye(3)]
    turned = [np.cross(axis, centred) / scale for axis in np.eye(3)]
    return np.stack([*moved, *turned, *([centred / scale] if size else [])], axis=2).reshape(centred.size, -1)


def _free_of(a: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    """Rows (R, P) without what unknowns (R, K) explain."""
    u, s, _ = np.linalg.svd(unknown, full_matrices=False)
    u = u[:, s > 1e-9 * max(float(s[0]), 1e-30)]
    return np.asarray(a - u @ (u.T @ a))


BARELY = 0.15
"""Share of the best-seen direction's amplitude below which a direction counts as not probed."""
AN_AXIS = 0.98
"""Cosine from which on a direction goes by the name of an axis of the base."""


@dataclass(frozen=True)
class Directions:
    """How well each direction is probed."""

    axes: np.ndarray  # (3, 3) rows: unit vectors in F0, the best-seen first
    share: np.ndarray  # (3,) of the best-seen one's amplitude
    images: bool = False  # all are of images, which see what is across the line of sight

    @property
    def missing(self) -> np.ndarray:
        """Directions (K, 3) that are hardly probed."""
        return self.axes[self.share < BARELY]


def directions(model: Model) -> Directions:
    """Principal axes of the directions in which a model's fitted residuals see the ball."""
    seen, images = [], []
    for block in model.states:
        images.append(model.scene.in_images[block.rows].all())
        u = model.scene.looks(model.scene.index[block.target], block.rows)
        seen.append(np.moveaxis(u, 1, 2).reshape(-1, 3))
    # at least three rows, so that the thin decomposition has all three axes; memory linear in the rows
    _, share, axes = np.linalg.svd(np.concatenate([*seen, np.zeros((3, 3))]), full_matrices=False)
    return Directions(axes, share / max(share[0], 1e-30), bool(images) and all(images))


def in_words(seen: Directions) -> str:
    """What is missing, by the names of F0's axes: ``hardly a row looks along (0.71, 0.00, 0.71)``; or ""."""
    if not len(seen.missing):
        return ""
    if seen.images:
        return f"all images are taken along about {_name(seen.axes[-1])} of the base"
    if len(seen.missing) == 1:
        return f"hardly a row looks along {_name(seen.missing[0])} of the base"
    return f"all measurements look along {_name(seen.axes[0])} of the base"


def _name(axis: np.ndarray) -> str:
    k = int(np.argmax(np.abs(axis)))
    if abs(axis[k]) > AN_AXIS:
        return "xyz"[k]
    return "({})".format(", ".join(f"{v + 0.0:.2f}" for v in axis * np.sign(axis[k])))
