"""Locate a target from its own rows, with its tool where no other target was measured with that tool.

The search is damped and uses several starting points.

Starting points of the search for a target: its stated position and closed-form solutions from its rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from bayescal.arm.transforms import rigid_alignment
from bayescal.errors import BayescalError
from bayescal.estimate.estimate import LARGEST_STEP
from bayescal.estimate.outliers import rejected, scale, student_weights
from factors.camera import Instrument
from factors.contacts import Cylinder, Distance, Sphere
from factors.kind import Kind, rotation_vector


def starts(kind: Kind, p: np.ndarray) -> np.ndarray:
    """Initial states (K, size) of the search, the stated one first; p (3, C) are the ball centres, m."""
    further = [x for of, states in STARTS.items() if isinstance(kind, of) for x in states(kind, p)]
    return np.where(kind.sd > 0, np.stack([np.zeros(len(kind.sd)), *further]), 0.0)


def centres(p: np.ndarray, length: np.ndarray) -> list[np.ndarray]:
    """Points (d,) at distances near length (C,) from points p (d, C): by least squares, and two mirrored.

    |p|^2 - L^2 = 2 p.c + const is linear in c (I. D. Coope, Circle fitting by linear and nonlinear least
    squares, J. Optim. Theory Appl. 76, 1993). Where the points nearly share a plane (a line, of d = 2),
    their centre may lie on either side of it: the two images start at the distance that the lengths give.
    """
    middle = p.mean(axis=1)
    q = p - middle[:, None]
    square = np.sum(q**2, axis=0) - length**2
    axes = np.linalg.svd(q)[0]
    out = [middle + _linear(q, square)]
    across, normal = axes[:, :-1], axes[:, -1]
    flat = across @ _linear(across.T @ q, square)
    height = np.sqrt(max(float(np.mean(length**2 - np.sum((q - flat[:, None]) ** 2, axis=0))), 0.0))
    return [*out, middle + flat + height * normal, middle + flat - height * normal]


def _linear(q: np.ndarray, square: np.ndarray) -> np.ndarray:
    design = np.column_stack([2.0 * q.T, np.ones(q.shape[1])])
    return np.linalg.lstsq(design, square, rcond=None)[0][:-1]


def _sphere(kind: Sphere, p: np.ndarray) -> Sequence[np.ndarray]:
    return [np.append(c - kind.centre, 0.0) for c in centres(p, 0.5 * kind.diameter + kind.radius)]


def _distance(kind: Distance, p: np.ndarray) -> Sequence[np.ndarray]:
    return [c - kind.centre for c in centres(p, kind.length)]


def _cylinder(kind: Cylinder, p: np.ndarray) -> Sequence[np.ndarray]:
    across = kind.tangents @ (p - kind.point[:, None])
    return [np.array([0, 0, *c, 0]) for c in centres(across, 0.5 * kind.diameter + kind.radius)]


def _instrument(kind: Instrument, p: np.ndarray) -> Sequence[np.ndarray]:
    """The frame that best turns the readings into the points (Arun et al., PAMI 9, 1987)."""
    if p.shape[1] < 3:
        return []
    placed = rigid_alignment(p.T, kind.xyz)
    apart, origin = placed[:3, :3] @ kind.frame[:3, :3].T, placed[:3, 3]
    return [np.append(rotation_vector(apart), origin - kind.pivot - apart @ (kind.frame[:3, 3] - kind.pivot))]


STARTS: dict[type, Callable[..., Sequence[np.ndarray]]] = {
    Sphere: _sphere,
    Distance: _distance,
    Cylinder: _cylinder,
    Instrument: _instrument,
}
"""Closed-form solutions by kind; planes and fixed points are (nearly) linear in their state."""

ITERATIONS = 100
RESTS = 1e-4
"""Length of a Newton step, in posterior standard deviations, below which a search ends."""
DAMPING, EASED, RAISED = 1e-4, 0.1, 10.0
"""Initial damping, relative to the Hessian's diagonal; its factors after an accepted and a rejected step."""
RIVAL = 4.6
"""Difference in log posterior, nats (odds of 100 to 1), from which on the better solution is accepted."""
APART = 5.0
"""Distance of two solutions, in posterior standard deviations, from which on they are different positions."""
SLOW = 1e6
"""Assumed: what a search still takes off its cost is below this times what its next step does; at a saddle
beside the optimum it was ten thousand."""
SUSPICIOUS = 2.0
"""Least-squares residual over the noise, from which on slipped contacts are searched for."""


class UnlocatedError(BayescalError):
    """A target, by its name, cannot be located from its rows."""

    def __init__(self, target: str, why: str) -> None:
        remedy = "state its position and u_mm more accurately, or measure it from more directions"
        super().__init__(f"target {target} cannot be located from its rows: {why}", "dataset.yaml", remedy)
        self.target = target


class AmbiguousPositionError(UnlocatedError):
    """Two positions of a target explain its rows equally well."""


@dataclass(frozen=True)
class States:
    """S solutions: states of a target, shifts of the centre of its tool, and their cost."""

    x: np.ndarray  # (S, size) m and rad
    tool: np.ndarray  # (S, 3) m; (S, 0) where it is known
    cost: np.ndarray  # (S,) negative log posterior, nats, up to a constant
    step_length: np.ndarray  # (S,) length of the remaining Newton step, posterior standard deviations
    information: np.ndarray  # (S, m, m) of the unknowns over their prior standard deviations

    def some(self, places: Sequence[int] | np.ndarray) -> States:
        """The solutions with these indices."""
        return States(*(getattr(self, f.name)[places] for f in fields(States)))


NO_SHIFTS = np.zeros((0, 3, 1))
"""Of a tool that is known."""


@dataclass(frozen=True)
class Rows:
    """C rows that locate a target, and the point of its tool where that is unknown.

    Attributes
    ----------
    kind : Kind
        Of the rows; its `sd` is the prior.
    p : np.ndarray, shape (3, C)
        Ball centres, m, tools nominal; (S, 3, C) of a search with other centres from each start. Poses of
        the tool (3, 4, C) for a kind that judges them.
    sigma : np.ndarray, shape (rows, C)
        Standard uncertainties of the residuals, m.
    shifts : np.ndarray, shape (3, 3, C)
        Change of p (axis 1) by the three shifts of the tool (axis 0), where the tool is also unknown.
    tool_sd : float
        Prior standard deviation of those shifts, m.
    """

    kind: Kind
    p: np.ndarray
    sigma: np.ndarray
    shifts: np.ndarray = field(default_factory=lambda: NO_SHIFTS)
    tool_sd: float = 0.0

    def points(self, tool: np.ndarray) -> np.ndarray:
        """Ball centres (S, 3, C), m, with shifts (S, 3) of the tool, m."""
        shape = self.p.shape[-3:] if self.posed else self.p.shape[-2:]
        if not len(self.shifts):
            return np.broadcast_to(self.p, (len(tool), *shape))
        shifts = np.einsum("sj,jkc->skc", tool, self.shifts)
        if not self.posed:
            return self.p + shifts
        out = np.repeat(self.p[None], len(tool), axis=0)
        out[:, :, 3] += shifts
        return out

    @property
    def posed(self) -> bool:
        """Whether `p` holds poses."""
        return self.p.shape[-2] == 4

    def chi2(self, solution: States) -> np.ndarray:
        """Chi-square (C,) of each row's residuals at the first solution, over their standard uncertainty."""
        residual = self.kind.residual(solution.x[:1], self.points(solution.tool[:1]))[0]
        return np.sum((residual / self.sigma) ** 2, axis=0)


def search(rows: Rows, start: np.ndarray, weight: np.ndarray | float = 1.0, beside: float = np.inf) -> States:
    """Levenberg-Marquardt for S problems at once.

    Parameters
    ----------
    rows : Rows
    start : np.ndarray, shape (S, size)
        Initial states of the target.
    weight : np.ndarray, shape (C,), optional
        Factors on the residuals of the rows; 0 leaves a row out.
    beside : float
        Cost, nats, beyond that of the first problem: once that rests, a search that is not expected to come
        below it ends early. Where no place explains the rows, a search may rest only after a hundred steps.
    """
    kind, free, count = rows.kind, rows.kind.sd > 0, len(start)
    size = int(free.sum())
    sd = np.append(kind.sd[free], np.full(len(rows.shifts), rows.tool_sd))
    identity, inverse_sigma = np.eye(len(sd)), weight / rows.sigma

    def physical(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = np.zeros((count, len(kind.sd)))
        x[:, free] = y[:, :size] * sd[:size]
        return x, y[:, size:] * rows.tool_sd

    def evaluated(y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cost (S,), gradient (S, m) and information (S, m, m)."""
        x, tool = physical(y)
        r, u, dx = kind.linearise(x, rows.points(tool))
        r = (r * inverse_sigma).reshape(count, -1)
        slopes = dx[..., free]
        if len(rows.shifts):
            of_tool = np.einsum("srkc,jkc->srcj", u[..., :3, :], rows.shifts)
            slopes = np.concatenate([slopes, of_tool], axis=-1)
        j = (slopes * inverse_sigma[..., None]).reshape(*r.shape, len(sd)) * sd
        gradient = np.einsum("sri,sr->si", j, r) + y
        cost = 0.5 * (np.sum(r**2, axis=1) + np.sum(y**2, axis=1))
        return cost, gradient, np.swapaxes(j, 1, 2) @ j + identity

    y = np.zeros((count, len(sd)))
    y[:, :size] = start[:, free] / sd[:size]
    cost, gradient, information = evaluated(y)
    damping = np.full(count, DAMPING)
    for k in range(ITERATIONS + 1):
        diagonal = np.einsum("sii->si", information) * damping[:, None]
        damped = information + diagonal[:, :, None] * identity
        newton, step = np.linalg.solve(np.stack([information, damped]), gradient[..., None])[..., 0]
        step_length = np.sqrt(np.sum(gradient * newton, axis=1))
        limit = cost[0] + beside if step_length[0] <= RESTS else np.inf
        active = (step_length > RESTS) & (cost - SLOW * step_length**2 < limit)
        if k == ITERATIONS or not active.any():
            break
        trial = y - np.where(active[:, None], step, 0.0)
        cost_there, gradient_there, information_there = evaluated(trial)
        good = cost_there <= cost * (1 + 1e-12)
        damping = np.minimum(np.maximum(damping * np.where(good, EASED, RAISED), 1e-12), 1e12)
        y = np.where(good[:, None], trial, y)
        cost = np.where(good, cost_there, cost)
        gradient = np.where(good[:, None], gradient_there, gradient)
        information = np.where(good[:, None, None], information_there, information)
    x, tool = physical(y)
    return States(x, tool, cost, step_length, information)


def locate(name: str, rows: Rows, strict: bool = True) -> tuple[States, np.ndarray]:
    """The most probable position of a target by its rows, and the rows that were used, (C,) of 0 and 1.

    Parameters
    ----------
    name : str
        Of the target.
    rows : Rows
    strict : bool
        Refuse a target with another position that is nearly as probable.

    Raises
    ------
    UnlocatedError
        If the search does not converge.
    AmbiguousPositionError
        If another position explains the rows equally well.
    """
    kind = rows.kind
    begin = starts(kind, rows.p)

    def best(keep: np.ndarray) -> tuple[States, States]:
        solutions = search(rows, begin, keep, RIVAL)
        further = 1 + np.flatnonzero(_plausible(kind, solutions.some([0]), begin[1:]))
        solutions = solutions.some(np.append(0, further))
        return solutions, solutions.some([int(np.nanargmin(solutions.cost))])

    keep = np.ones(rows.p.shape[-1])
    solutions, chosen = best(keep)
    chi2 = rows.chi2(chosen)
    if chi2.max(initial=0.0) > SUSPICIOUS**2 * kind.rows * max(scale(chi2, kind.rows), 1.0) ** 2:
        keep = robust_rows(rows, chosen.x)
        solutions, chosen = best(keep)
    _check(name, solutions, chosen, kind, strict)
    return chosen, keep


def _plausible(kind: Kind, first: States, begin: np.ndarray) -> np.ndarray:
    """Which (K,) of further starts count beside that from the stated place.

    All where that did not converge. Else those from which half the way to the stated place has a log prior
    that could make a rival: a stated place with a small uncertainty leaves none. A start beside the
    solution would find it again.
    """
    if not _rests(first)[0]:
        return np.ones(len(begin), bool)
    free = kind.sd > 0
    nearest = 0.5 * begin[:, free] / kind.sd[free]
    rivals = 0.5 * np.sum(nearest**2, axis=1) < first.cost[0] + RIVAL
    return np.asarray(rivals & (_apart(kind, first, begin) > APART))


def _rests(solutions: States) -> np.ndarray:
    """Which (S,) of the searches have converged."""
    return np.asarray((solutions.step_length < LARGEST_STEP) & np.isfinite(solutions.cost))


def _apart(kind: Kind, solution: States, x: np.ndarray) -> np.ndarray:
    """Distances (S,) of states (S, size) from a solution, in its posterior standard deviations."""
    free = kind.sd > 0
    away, size = (x - solution.x)[:, free] / kind.sd[free], int(free.sum())
    # of the target alone: its tool's shift takes part through the information that is left without it
    h = solution.information[0]
    h = h[:size, :size] - h[:size, size:] @ np.linalg.solve(h[size:, size:], h[size:, :size])
    return np.sqrt(np.maximum(np.einsum("si,ij,sj->s", away, h, away), 0.0))


def _check(name: str, solutions: States, chosen: States, kind: Kind, strict: bool) -> None:
    """Raise an error where the search did not converge, or another position is nearly as probable."""
    if not chosen.step_length[0] < LARGEST_STEP:
        raise UnlocatedError(name, f"the search from {len(solutions.x)} starts did not reach an optimum")
    distance = _apart(kind, chosen, solutions.x)
    probable = solutions.cost < chosen.cost + RIVAL
    rival = probable & (solutions.step_length < LARGEST_STEP) & (distance > APART)
    if strict and np.any(rival):
        other = int(np.argmax(rival))
        lengths = np.array([unit == "m" for _, unit in kind.parts])
        apart = 1e3 * float(np.linalg.norm((solutions.x[other] - chosen.x[0])[lengths]))
        raise AmbiguousPositionError(name, f"two places {apart:.3g} mm apart explain them equally well")


def robust_rows(rows: Rows, start: np.ndarray) -> np.ndarray:
    """Rows that are used to locate a target, (C,) of 0 and 1: those that are no outliers of a Student t fit.

    `start` (1, size) as for `search`. A scatter above the stated one is estimated by the median.
    """
    kind, weight = rows.kind, np.ones(rows.p.shape[-1])
    unknowns = int(np.sum(kind.sd > 0)) + len(rows.shifts)
    for _ in range(8):
        solution = search(rows, start, np.sqrt(weight))
        start, chi2 = solution.x, rows.chi2(solution)
        size = max(scale(chi2, kind.rows, unknowns), 1.0)
        weight = student_weights(chi2, kind.rows, size)
    return 1.0 - rejected(chi2, kind.rows, size)
