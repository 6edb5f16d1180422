"""Validation errors: residuals of validation data, their predicted covariance, and which are gross.

Errors of certified distances between located targets, and their predicted uncertainty.

Distances between points of the workspace: pairs, lengths, and their slopes by the arm.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayescal.arm.motion import Motion
from bayescal.dataset import Certificate
from bayescal.dataset.contacts import errors_of_distances
from bayescal.estimate.outliers import rejected, scale
from bayescal.model import Model
from bayescal.model.scene import Scene
from bayescal.predict.targets import LocatedTarget


@dataclass(frozen=True)
class CentreDistances:
    """D distances between located centres, m; `by_...` are factors of covariances."""

    names: tuple[tuple[str, str], ...]
    error: np.ndarray  # (D,) measured by the arm minus certified
    by_parameters: np.ndarray  # (D, F) by standard normals: posterior of the arm, priors of the targets
    by_noise: np.ndarray  # (D, M) by standard normals: noise of the rows that located the targets
    by_certificates: np.ndarray  # (D, C) by standard normals: errors of the certificates
    along: np.ndarray  # (D, 3) unit vectors in F0, from the second centre to the first

    @property
    def by_centres(self) -> np.ndarray:
        """Slopes (D, 3 N) of the distances by errors of the N centres, three coordinates for each centre."""
        ends = [name for pair in self.names for name in pair]
        centres = list(dict.fromkeys(ends))
        out = np.zeros((len(self.names), len(centres), 3))
        for d, (first, second) in enumerate(self.names):
            out[d, centres.index(first)] += self.along[d]
            out[d, centres.index(second)] -= self.along[d]
        return out.reshape(len(self.names), 3 * len(centres))

    def predicted_sd(self) -> np.ndarray:
        """Predicted standard deviations (D,), m."""
        by = np.hstack([self.by_parameters, self.by_noise, self.by_certificates])
        return np.sqrt(np.sum(by**2, axis=1))


def certified_pairs(
    scene: Scene, located: Mapping[str, LocatedTarget]
) -> Iterator[tuple[Certificate, LocatedTarget, LocatedTarget]]:
    """Certificates of a distance between two located targets that have a centre, with both targets."""
    centres = {k: t for k, t in located.items() if scene.declared_of(k).centred}
    for c in scene.dataset.certificates:
        if c.kind == "distance" and all(name in centres for name in c.targets):
            a, b = (centres[name] for name in c.targets)
            yield c, a, b


def centre_distances(scene: Scene, located: Mapping[str, LocatedTarget], arm: np.ndarray) -> CentreDistances:
    """Errors of certified distances; `arm` (P, F): rows of the arm in a factor of the covariance."""
    pairs = list(certified_pairs(scene, located))
    used = list(dict.fromkeys(t for _, *ends in pairs for t in ends))
    rows = np.cumsum([0, *(len(t.noise) for t in used)])
    unknowns = np.cumsum([0, *(len(t.by_prior) for t in used)]) + arm.shape[1]
    by_parameters = np.zeros((len(pairs), unknowns[-1] if used else arm.shape[1]))
    by_noise = np.zeros((len(pairs), rows[-1]))
    names, error, directions = [], [], [np.zeros((0, 3))]
    for i, (c, a, b) in enumerate(pairs):
        apart = a.centre - b.centre
        length = float(np.linalg.norm(apart))
        names.append((c.targets[0], c.targets[1]))
        error.append(length - (c.distance or 0.0))
        directions.append((apart / length)[None])
        for t, sign in ((a, 1.0), (b, -1.0)):
            k, by = used.index(t), sign * (apart / length) @ t.to_state[:3]
            by_parameters[i, : arm.shape[1]] += by @ t.by_arm @ arm
            by_parameters[i, unknowns[k] : unknowns[k + 1]] = by @ t.by_prior
            by_noise[i, rows[k] : rows[k + 1]] = by @ t.by_noise
    along = np.concatenate(directions)
    by_certificates = errors_of_distances([c for c, _, _ in pairs])
    return CentreDistances(tuple(names), np.array(error), by_parameters, by_noise, by_certificates, along)


USUAL = {"kind": 0.9, "target": 0.75}
"""Share of all measurements of a kind, and of a target, that gives the scale of their errors, if above 1.

Where more of them are off, they are not slips but model error. A fit uses the median instead: there, model
error inflates the noise that is estimated.
"""


@dataclass(frozen=True)
class Joint:
    """C measurements of one or more residuals each, under their predicted covariance."""

    rows: np.ndarray  # (C,) of the session, ascending
    first: np.ndarray  # (C,) index of the first residual of each
    size: np.ndarray  # (C,) number of residuals
    chi2: np.ndarray  # (C,)
    logdet: np.ndarray  # (C,) of the covariance, m2


@dataclass(frozen=True)
class ValidationErrors:
    """R residuals of validation contacts, three for a point, in the order of rows, and the distances."""

    how: str  # VALIDATED, LEFT_OUT, IMAGES_LEFT_OUT, BLOCKED or BY_REGION
    main: str  # noise group that the gap is compared with: the first of `GROUPS` that is fitted
    residual: np.ndarray  # (R,) m
    noise: np.ndarray  # (R,) m, of one residual, by the noise scale of the fit
    by_parameters: np.ndarray  # (R, F) m, by posterior standard normals; 0 where `noise` includes them
    rows: np.ndarray  # (R,) of the session
    kind: np.ndarray  # (R,) "planes" or "points"
    group: np.ndarray  # (R,) noise group: of `GROUPS`
    target: np.ndarray  # (R,) names
    block: np.ndarray  # (R,) labels for the bootstrap
    distances: CentreDistances
    noise_covariance: np.ndarray | None = None  # (R, K) m2, with the K residuals of a row; None: independent
    dof: Mapping[str, float] = field(default_factory=dict)  # of the noise scale of each group; else known
    fold: np.ndarray | None = None  # (R,) block of a blocked cross-validation; None: one fit predicts all
    by_readings: np.ndarray | None = None  # (R, n) m, part of `noise` that the rows of an image share

    @property
    def sd(self) -> np.ndarray:
        """Predicted standard deviations (R,), m."""
        return np.sqrt(self.noise**2 + np.sum(self.by_parameters**2, axis=1))

    @property
    def joint(self) -> Joint:
        """The measurements: the residuals of one row together."""
        order = np.argsort(self.rows, kind="stable")
        rows, size = np.unique(self.rows, return_counts=True)
        start = np.cumsum(size) - size
        chi2, logdet = np.empty(len(rows)), np.empty(len(rows))
        for k in np.unique(size):
            mine = size == k
            index = order[start[mine][:, None] + np.arange(k)]
            by, r = self.by_parameters[index], self.residual[index]
            covariance = np.eye(k) * self.noise[index][..., None] ** 2
            if self.noise_covariance is not None:
                covariance = self.noise_covariance[index][..., :k]
            covariance = covariance + by @ np.swapaxes(by, 1, 2)
            chi2[mine] = np.sum(r * np.linalg.solve(covariance, r[..., None])[..., 0], axis=1)
            logdet[mine] = np.linalg.slogdet(covariance)[1]
        return Joint(rows, order[start], size, chi2, logdet)

    @property
    def gross(self) -> np.ndarray:
        """Which residuals (R,) belong to measurements that no calibration explains.

        By the rule for outliers of a fit (`estimate.outliers`), with the predicted covariance. Where the
        errors of many measurements are larger than predicted (`USUAL`), they are relative to these.
        """
        j = self.joint
        usual = np.ones(len(j.rows))
        for label, share in USUAL.items():
            of = getattr(self, label)[j.first]
            for value in np.unique(of):
                mine = of == value
                usual[mine] = np.maximum(usual[mine], scale(j.chi2[mine], j.size[mine], share=share))
        out, group = np.zeros(len(j.rows), bool), self.group[j.first]
        for name in np.unique(group):
            mine = group == name
            dof = self.dof.get(name, np.inf)
            out[mine] = rejected(j.chi2[mine], j.size[mine], usual[mine], dof)
        return np.isin(self.rows, j.rows[out])


PREDICTED = ("residual", "noise", "by_parameters", "noise_covariance", "by_readings")
"""Arrays of `ValidationErrors` that depend on the model; the others are of the session."""
OF_SESSION = ("rows", "kind", "group", "target", "block", "fold")


def without_rows(held: ValidationErrors, rows: Sequence[int]) -> ValidationErrors:
    """The same errors without the residuals of some rows of the session."""
    use = ~np.isin(held.rows, rows)
    arrays = ((name, getattr(held, name)) for name in (*PREDICTED, *OF_SESSION))
    return held if use.all() else replace(held, **{k: v[use] for k, v in arrays if v is not None})


def with_rows_of(held: ValidationErrors, other: ValidationErrors, rows: Sequence[int]) -> ValidationErrors:
    """The same errors with the residuals of some rows of the session as another model predicts them."""
    mine = np.isin(held.rows, rows)
    arrays = ((name, getattr(held, name), getattr(other, name)) for name in PREDICTED)
    joined = {k: np.where(mine.reshape(-1, *[1] * (a.ndim - 1)), b, a) for k, a, b in arrays if a is not None}
    return replace(held, **joined)


def kept(*held: ValidationErrors) -> np.ndarray:
    """Which residuals (R,) of one session are used: all except those that are gross under every model."""
    return ~np.logical_and.reduce([h.gross for h in held])


SHORTEST = 0.2
"""Shortest distance, relative to the longest: shorter distances give little information on the arm."""


def evenly(count: int, most: int) -> np.ndarray:
    """At most `most` indices, evenly among `count`."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def far_pairs(points: np.ndarray) -> np.ndarray:
    """Pairs (K, 2) of points (3, N) with a distance that is long enough."""
    pairs = np.stack(np.triu_indices(points.shape[1], 1), axis=1)
    apart = lengths(points, pairs)
    return pairs[apart > SHORTEST * np.max(apart, initial=0.0)]


def lengths(points: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Distances (..., K) between points (..., 3, N)."""
    return np.linalg.norm(points[..., pairs[:, 0]] - points[..., pairs[:, 1]], axis=-2)


def by_points(motion: Motion, values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Slopes (3, P, N) of the TCP positions (3, N) of a motion by the parameters, at `values` (P,)."""
    axes = [np.repeat(axis[:, None], points.shape[1], axis=1) for axis in np.eye(3)]
    return np.stack([motion.columns(values, points, axis) for axis in axes])


def slopes(model: Model, motion: Motion, values: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Slopes (K, P), m, of the distances of pairs (K, 2) of TCP positions by z of the arm.

    Parameters
    ----------
    model : Model
    motion : Motion
        Of N rows, under this model's parameters.
    values : np.ndarray, shape (P,)
        Deviations of the arm's parameters, SI.
    pairs : np.ndarray, shape (K, 2)
        Of the rows.
    """
    points = motion.points(values)
    first, second = pairs.T
    along = (points[:, first] - points[:, second]) / lengths(points, pairs)
    by_point = by_points(motion, values, points)
    by = np.einsum("ak,apk->kp", along, by_point[..., first] - by_point[..., second])
    return np.asarray(by * model.sd)
