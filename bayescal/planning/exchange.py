"""Selection of contacts for accurate distances: a D-optimal start, then exchanges by the I criterion.

From nothing, the I criterion is blind: a face that is new has three unknowns, and its first three contacts
do not improve any distance. The determinant rewards them. A selection therefore begins with contacts that
maximise the determinant, and exchanges then minimise the mean variance of the distances (Fedorov 1972; Cook
and Nachtsheim, Technometrics 22, 1980).

The observability indices O1 to O5 of a selection are of the information of the arm's parameters, in units of
their prior standard deviations, with the states of the targets eliminated and the prior included as one
observation of each parameter. Without the scaling, a length and an angle cannot be compared. Combinations of
the parameters of which even all candidates together tell less than the prior are left out: they would make O2
to O5 the same for every selection.
"""

from collections.abc import Callable, Sequence

import numpy as np

from bayescal.planning.goals import Goal
from bayescal.planning.pool import Linearised, inverse


def arm_information(linear: Linearised, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
    """Information (L, L) of the L identifiable combinations of the arm's parameters after a selection.

    Identifiable are the principal axes of the information of all candidates that exceed the prior.
    """
    every = _marginal(linear, np.arange(linear.count))
    values, axes = np.linalg.eigh(every)
    axes = axes[:, values > 2.0]
    return inverse(axes.T @ inverse(_marginal(linear, chosen)) @ axes)


def _marginal(linear: Linearised, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
    """Information (P, P) of the arm's parameters, with the states of the targets eliminated."""
    size = len(linear.model.parameters)
    return inverse(linear.covariance(chosen)[:size, :size])


def mean_variance(slopes: np.ndarray, covariance: np.ndarray) -> float:
    """Criterion I: mean variance of K quantities with slopes (K, D), for the covariance (D, D) of z."""
    return float(np.mean(np.sum(slopes @ covariance * slopes, axis=1))) if len(slopes) else 0.0


def observability(information: np.ndarray, count: int) -> dict[str, float]:
    """Observability indices of `count` contacts, from their information matrix (P, P).

    With the singular values s_1 >= ... >= s_P of a Jacobian J of information J'J. Larger is better.

    Notes
    -----
    O1: geometric mean of s over the square root of the number of contacts (Borm and Menq, Int. J. Robotics
    Research 10, 1991). O2: s_P / s_1 (Driels and Pathre, J. Robotic Systems 7, 1990). O3: s_P (Nahvi,
    Hollerbach and Hayward, ICRA 1994). O4: s_P^2 / s_1 (Nahvi and Hollerbach, ICRA 1996). O5: 1 / sum(1 / s)
    (Sun and Hollerbach, Observability index selection for robot calibration, ICRA 2008; names all).
    """
    s = np.sqrt(np.maximum(np.linalg.eigvalsh(information), 0.0))[::-1]
    with np.errstate(divide="ignore"):
        return {
            "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(count)),
            "O2": float(s[-1] / s[0]),
            "O3": float(s[-1]),
            "O4": float(s[-1] ** 2 / s[0]),
            "O5": float(1 / np.sum(1 / s)),
        }


def observability_of(linear: Linearised, chosen: Sequence[int] | np.ndarray) -> dict[str, float]:
    """Observability indices of the arm's parameters after a selection; rows measured already count."""
    fitted = len(linear.model.scene.rows("calibrate"))
    return observability(arm_information(linear, chosen), len(chosen) + fitted - linear.count)


FRESH = 25
"""Changes of a selection after which its covariance is computed anew, against rounding."""
BETTER = 1e-9
"""Relative improvement below which an exchange is rounding error."""
SWEEPS = 3
"""Maximum number of rounds in which every contact of a plan is replaced by the best candidate."""
COORDINATES = 120
"""Number of contacts up to which plans are improved in this way; larger plans only by adding and dropping."""
POWER = 4
"""Power of the relative variances of several goals whose sum is minimised: the largest counts most."""

Rate = Callable[["Selection"], np.ndarray]
"""Benefit (C,) of adding each candidate to a selection."""


class Selection:
    """Chosen candidates, the covariance of z, and what every candidate would change.

    The criterion is tr(B'CB), with the covariance C (D, D) and the weighted slopes B' (k, D) of the goals.
    For the block J of a candidate, S = J C J' and H = J C B: adding it lowers the criterion by
    tr((I + S)^-1 H H'), dropping it raises it by tr((I - S)^-1 H H').
    """

    def __init__(self, linear: Linearised, chosen: Sequence[int] | np.ndarray, root: np.ndarray) -> None:
        """Begin with `chosen` (M,), and `root`, B (D, k)."""
        self.linear, self.root = linear, root
        self.blocks = linear.blocks
        self.chosen = [int(k) for k in chosen]
        self.changes = 0
        self._refresh()

    def _refresh(self) -> None:
        count, r, size = self.blocks.shape
        flat = self.blocks.reshape(count * r, size)
        self.covariance = self.linear.covariance(self.chosen)
        across = flat @ self.covariance
        self.spread = across.reshape(count, r, size) @ np.swapaxes(self.blocks, 1, 2)  # S, (C, r, r)
        self.moved = across @ self.root  # H, (C r, k)

    @property
    def value(self) -> float:
        """The criterion."""
        return float(np.sum((self.covariance @ self.root) * self.root))

    @property
    def free(self) -> np.ndarray:
        """Which candidates are not chosen, (C,)."""
        out = np.ones(len(self.blocks), bool)
        out[self.chosen] = False
        return out

    def gains(self) -> np.ndarray:
        """By how much each candidate would lower the criterion, (C,)."""
        return self._traces(np.arange(len(self.blocks)), 1.0)

    def losses(self, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
        """By how much the criterion would rise without each of some chosen contacts, (M,)."""
        return self._traces(np.asarray(chosen, int), -1.0)

    def _traces(self, candidates: np.ndarray, sign: float) -> np.ndarray:
        """tr((I + sign S)^-1 H H') of some candidates, (M,); infinite where I + sign S is not positive."""
        r = self.spread.shape[1]
        inside = np.eye(r) + sign * self.spread[candidates]
        moved = self.moved.reshape(len(self.spread), r, -1)[candidates]
        size = np.linalg.det(inside) if r > 1 else inside[:, 0, 0]
        if r > 1:
            moved = moved * np.linalg.solve(inside, moved)
            return np.where(size > 0, np.sum(moved, axis=(1, 2)), np.inf)
        square = np.einsum("crk,crk->c", moved, moved)
        return np.where(size > 0, square / np.where(size > 0, size, 1.0), np.inf)

    def determinants(self) -> np.ndarray:
        """By how much each candidate would raise the log determinant of the information, (C,) nats."""
        return np.asarray(np.linalg.slogdet(np.eye(self.spread.shape[1]) + self.spread)[1])

    def change(self, k: int, sign: float) -> None:
        """Add (1) or drop (-1) a candidate."""
        if sign > 0:
            self.chosen.append(k)
        else:
            self.chosen.remove(k)
        self.changes += 1
        if self.changes % FRESH == 0:
            self._refresh()
            return
        j = self.blocks[k]
        gain = self.covariance @ j.T  # (D, r)
        inside = np.linalg.inv(np.eye(len(j)) + sign * (j @ gain))
        count, r, size = self.blocks.shape
        across = self.blocks.reshape(count * r, size) @ gain
        weighted = sign * (across @ inside)
        self.covariance -= sign * (gain @ inside @ gain.T)
        self.moved -= weighted @ (gain.T @ self.root)
        self.spread -= weighted.reshape(count, r, r) @ np.swapaxes(across.reshape(count, r, r), 1, 2)


def grow(selection: Selection, count: int, rate: Rate) -> None:
    """Add the candidate of the largest benefit until `count` contacts are chosen, or all candidates."""
    while len(selection.chosen) < count and np.any(free := selection.free):
        benefit = np.where(free, rate(selection), -np.inf)
        selection.change(int(np.argmax(benefit)), 1.0)


def shrink(selection: Selection, count: int) -> None:
    """Drop the contact that matters least until `count` are chosen."""
    while len(selection.chosen) > count:
        chosen = np.sort(selection.chosen)
        selection.change(int(chosen[np.argmin(selection.losses(chosen))]), -1.0)


def exchange(selection: Selection, rng: np.random.Generator) -> None:
    """Exchange contacts until no exchange lowers the criterion.

    First the best candidate is added and the contact that then matters least is dropped, repeatedly; in
    small plans each contact in turn is then replaced by the best candidate.
    """
    count = len(selection.chosen)
    _add_and_drop(selection)
    for _ in range(SWEEPS if count <= COORDINATES else 0):
        before = selection.value
        for k in rng.permutation(np.sort(selection.chosen)):
            selection.change(int(k), -1.0)
            grow(selection, count, Selection.gains)
        if selection.value > before * (1 - 1e-4):
            break
    _add_and_drop(selection)


def _add_and_drop(selection: Selection) -> None:
    count = len(selection.chosen)
    if count in (0, len(selection.blocks)):
        return
    for _ in range(10 * count):  # each lowers the criterion: an end is certain, the limit is for rounding
        before = selection.value
        grow(selection, count + 1, Selection.gains)
        added = selection.chosen[-1]
        shrink(selection, count)
        if added not in selection.chosen or selection.value > before * (1 - BETTER):
            break


def relative(goals: Sequence[Goal], covariance: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Mean variance of each goal by the arm, (G,), at a covariance (D, D), relative to a reference (D, D)."""
    both = [[mean_variance(g.slopes, c) for c in (covariance, reference)] for g in goals]
    return np.array([now / max(before, 1e-30) for now, before in both])


def root_of(goals: Sequence[Goal], reference: np.ndarray, covariance: np.ndarray | None = None) -> np.ndarray:
    """Weighted slopes B (D, k), so that tr(B'CB) is a weighted mean of the relative variances of the goals.

    Parameters
    ----------
    goals : sequence of Goal
    reference : np.ndarray, shape (D, D)
        Covariance of z of a selection; the variance of each goal is relative to that of this selection.
    covariance : np.ndarray, shape (D, D), optional
        Of the selection to improve: a goal that is behind gets a larger weight, by the slope of
        the sum over goals of (relative variance)^`POWER`. Equal weights if not given.
    """
    weights = np.ones(len(goals))
    if covariance is not None:
        weights = relative(goals, covariance, reference) ** (POWER - 1)
    square = np.zeros_like(reference)
    for goal, weight in zip(goals, weights / weights.sum(), strict=True):
        mean = goal.slopes.T @ goal.slopes / len(goal.slopes)
        square += weight * mean / max(float(np.sum(mean * reference)), 1e-30)
    values, vectors = np.linalg.eigh(square)
    used = values > 1e-12 * values[-1]
    return np.asarray(vectors[:, used] * np.sqrt(values[used]))


def select(
    linear: Linearised,
    goals: Sequence[Goal],
    count: int,
    rng: np.random.Generator,
    starts: int = 3,
    progress: Callable[[float], None] = lambda fraction: None,
) -> np.ndarray:
    """Choose contacts so that the distances of all goals are accurate.

    Parameters
    ----------
    linear : Linearised
    goals : sequence of Goal
        Their variances, relative to those of a D-optimal selection, become small and about equal.
    count : int
        Number of contacts.
    rng : np.random.Generator
    starts : int
        Number of searches. The first begins with a D-optimal selection, the others with random contacts
        that are completed to the largest determinant.
    progress : callable
        Called with the completed fraction.

    Returns
    -------
    np.ndarray, shape (count,)
        Numbers of the candidates, ascending.
    """
    rounds = 2 if len(goals) > 1 else 1
    reference: np.ndarray | None = None
    best: tuple[float, list[int]] | None = None
    for k in range(max(starts, 1)):
        some = rng.choice(linear.count, count // 2 if k else 0, replace=False)
        begun = Selection(linear, some, np.zeros((len(linear.z), 0)))
        grow(begun, count, Selection.determinants)
        chosen = begun.chosen
        covariance = linear.covariance(chosen)
        reference = covariance if reference is None else reference
        for n in range(rounds):
            selection = Selection(linear, chosen, root_of(goals, reference, covariance if n else None))
            exchange(selection, rng)
            chosen = selection.chosen
            covariance = linear.covariance(chosen)
            value = float(np.sum(relative(goals, covariance, reference) ** POWER))
            if best is None or value < best[0]:
                best = value, list(chosen)
            progress((k * rounds + n + 1) / (max(starts, 1) * rounds))
    assert best is not None
    return np.sort(best[1])
