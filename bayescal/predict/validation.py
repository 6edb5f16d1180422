"""Validation data: planes by their contacts, spheres by distance and diameter, points by their reading.

No parameter of the arm is fitted here. A target that was not fitted (a sphere, the frame of an instrument,
a socket) is located from its own rows. Posterior draws are propagated by the slopes of `rows` and `targets`,
with simulated noise of the rows: the spread over draws is the predicted uncertainty.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayescal.dataset.contacts import errors_of_distances
from bayescal.estimate import Estimate
from bayescal.estimate.families import poses
from bayescal.model import ARM, Block, Model
from bayescal.model.model import noise_groups
from bayescal.predict import targets
from bayescal.predict.crossvalidation import interval95
from bayescal.predict.errors import certified_pairs
from bayescal.statistics import rms


@dataclass(frozen=True)
class Errors:
    """Errors of one kind of validation measurement; figures of none are nan.

    Parameters
    ----------
    values : np.ndarray, shape (N,)
        Signed errors of contacts and distances, m; lengths of the error vectors of points, m, and of
        orientations, rad.
    predicted : np.ndarray, shape (S, N)
        Draws of them.
    """

    values: np.ndarray
    predicted: np.ndarray

    @property
    def rms(self) -> float:
        """Root mean square."""
        return rms(self.values)

    @property
    def mean(self) -> float:
        """Mean."""
        return float(np.mean(self.values)) if len(self.values) else float("nan")

    @property
    def maximum(self) -> float:
        """Largest absolute value."""
        return float(np.max(np.abs(self.values))) if len(self.values) else float("nan")

    @property
    def interval95(self) -> np.ndarray:
        """Ends (2,) of the central 95 % interval of all draws."""
        return np.array(interval95(self.predicted.ravel()))


@dataclass(frozen=True)
class RowCheck:
    """Validation measurements of one target; m, or rad for orientations."""

    target: str
    residuals: np.ndarray  # (C,) of a surface, else (3, C), at the estimate
    predicted: np.ndarray  # (S, C) or (S, 3, C) draws of the residual, from arm, target and noise

    @property
    def errors(self) -> Errors:
        """The residuals of a surface, else their lengths."""
        if self.residuals.ndim == 1:
            return Errors(self.residuals, self.predicted)
        return Errors(np.linalg.norm(self.residuals, axis=0), np.linalg.norm(self.predicted, axis=1))


@dataclass(frozen=True)
class DistanceCheck:
    """Distance between two located centres, m."""

    between: tuple[str, str]
    certified: float
    u_certified: float
    error: float  # measured by the arm minus certified
    predicted: np.ndarray  # (S,) draws of that error


@dataclass(frozen=True)
class DiameterCheck:
    """Diameter of a sphere, m."""

    target: str
    certified: float
    error: float
    predicted: np.ndarray


@dataclass(frozen=True)
class Validation:
    """Errors and predictions of one model for all validation measurements."""

    effects: tuple[str, ...]
    planes: tuple[RowCheck, ...]  # contacts of surfaces
    distances: tuple[DistanceCheck, ...]
    diameters: tuple[DiameterCheck, ...]
    points: tuple[RowCheck, ...]  # instrument readings, sockets
    turns: tuple[RowCheck, ...] = ()  # rotation vectors in the frame of the tool

    @property
    def contacts(self) -> Errors:
        """Errors of contacts, m."""
        return _joined([p.errors for p in self.planes])

    @property
    def distance_errors(self) -> Errors:
        """Errors of distances, m."""
        return _joined([Errors(np.array([d.error]), d.predicted[:, None]) for d in self.distances])

    @property
    def point_lengths(self) -> Errors:
        """Lengths of the error vectors of points, m."""
        return _joined([p.errors for p in self.points])

    @property
    def turn_angles(self) -> Errors:
        """Angles between measured and predicted orientations, rad."""
        return _joined([t.errors for t in self.turns])


def _joined(some: Sequence[Errors]) -> Errors:
    if not some:
        return Errors(np.zeros(0), np.zeros((0, 0)))
    values, predicted = zip(*((e.values, e.predicted) for e in some), strict=True)
    return Errors(np.concatenate(values), np.concatenate(predicted, axis=1))


@dataclass(frozen=True)
class _Draws:
    """S draws of all unknowns of an estimate; the unknowns of each target are drawn only once."""

    estimate: Estimate
    away: np.ndarray  # (S, D) posterior draws minus the estimate
    kappa: np.ndarray  # (S, G)
    excess: float  # m, unexplained error of a ball centre
    rng: np.random.Generator
    of_target: dict[targets.LocatedTarget, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def normal(self, *shape: int) -> np.ndarray:
        """Standard normals (S, ...)."""
        return self.rng.standard_normal((len(self.kappa), *shape))

    def scale(self, group: str) -> np.ndarray:
        """Noise (S, 1) over that of the estimate; the stated noise for a group that was not fitted."""
        scales, model = self.estimate.weights.scale, self.estimate.model
        if group not in scales:
            return np.ones((len(self.kappa), 1))
        return self.kappa[:, noise_groups(model).index(group), None] / scales[group]

    def of_instrument(self, block: Block) -> bool:
        """Whether an instrument reads the rows of a block."""
        return self.estimate.model.scene.declared_of(block.target).of_instrument

    def located(self, t: targets.LocatedTarget) -> tuple[np.ndarray, np.ndarray]:
        """Deviations of the unknowns of a target (S, m), and noise of its rows (S, R), m."""
        if t not in self.of_target:
            arm = self.estimate.model.slices[ARM]
            noise = self.noise(t.block.group, t.noise)
            if self.excess and self.of_instrument(t.block):
                noise = noise + self.excess * self.normal(len(t.noise))
            off = self.away[:, arm] @ t.by_arm.T - noise @ t.gain.T
            off += self.normal(len(t.by_prior)) @ t.by_prior.T
            if self.excess and not self.of_instrument(t.block):
                off += self.excess * self.normal(3) @ t.by_shift.T
            self.of_target[t] = off, noise
        return self.of_target[t]

    def noise(self, group: str, sd: np.ndarray) -> np.ndarray:
        """Errors (S, R) of measurements with standard uncertainties (R,)."""
        return self.scale(group) * sd * self.normal(len(sd))

    def residuals(self, r: targets.RowPrediction) -> np.ndarray:
        """Residuals (S, rows, C) at the estimate of rows simulated with the parameters of each draw."""
        out = -self.away @ r.by_z.T
        if r.target is None:
            out += self._of_fitted(r)
        else:
            off, noise = self.located(r.target)
            out -= off @ r.by_target.T
            out += noise if r.locates_target else self._of_others(r)
        return out.reshape(len(out), *r.in_rows.shape)

    def _of_fitted(self, r: targets.RowPrediction) -> np.ndarray:
        """Noise (S, R) of rows of a fitted target; errors of its readings are common to an image."""
        by = targets.by_readings(self.estimate, r.block)
        if not by.size:
            return self.noise(r.block.group, r.noise)
        out = self.noise(r.block.group, np.sqrt(np.maximum(r.noise**2 - np.sum(by**2, axis=1), 0.0)))
        m, scale = self.estimate.model.scene.dataset.measurements, self.scale(r.block.group)
        image = np.tile(poses(m, r.block.rows), r.block.kind.rows)
        for one in np.unique(image):
            out[:, image == one] += scale * (self.normal(by.shape[1]) @ by[image == one].T)
        return out

    def _of_others(self, r: targets.RowPrediction) -> np.ndarray:
        """Noise and unexplained error (S, R) of rows that did not locate their target."""
        out = self.noise(r.block.group, r.noise)
        if self.excess and self.of_instrument(r.block):
            out += self.excess * self.normal(len(r.noise))
        elif self.excess:
            out += self.excess * self.normal(3) @ r.by_point.T
        return out


def validate(
    estimate: Estimate,
    z: np.ndarray,
    kappa: np.ndarray,
    excess: float = 0.0,
    seed: int = 0,
    strict: bool = True,
    linearised: targets.Prepared | None = None,
) -> Validation:
    """Predict every validation measurement under a fitted model.

    Parameters
    ----------
    estimate : Estimate
    z : np.ndarray, shape (S, D)
        Posterior draws.
    kappa : np.ndarray, shape (S, G)
        Their noise scales, in the order of `noise_groups`.
    excess : float
        Standard deviation of the unexplained error (`unexplained`), m per coordinate. Contacts of the same
        sphere or socket share it; every point read by an instrument has an independent one.
    seed : int
        Of the simulated noise.
    strict : bool
        As for `prepared`.
    linearised : Prepared, optional
        All of the estimate's `prepared` rows and targets, with loose spheres, where they are known.

    Raises
    ------
    BayescalError
        If a target cannot be located from its rows.
    """
    d = _Draws(estimate, z - estimate.z, kappa, excess, np.random.default_rng(seed))
    linearised = linearised or targets.prepared(estimate, loose=True, strict=strict)
    planes = [r for r in linearised.rows if r.block.kind.rows == 1]
    points = [r for r in linearised.rows if r.block.kind.rows > 1]
    return Validation(
        estimate.model.effects,
        tuple(RowCheck(r.block.target, r.residual, d.residuals(r)[:, 0]) for r in planes),
        tuple(_distances(d, linearised)),
        tuple(_diameters(d, linearised)),
        tuple(RowCheck(r.block.target, r.in_rows, d.residuals(r)) for r in points),
        tuple(RowCheck(r.block.target, r.in_rows, d.residuals(r)) for r in _turns(estimate, linearised)),
    )


def _turns(estimate: Estimate, linearised: targets.Prepared) -> Iterator[targets.RowPrediction]:
    """Orientations that validation measurements measure together with their points."""
    model = estimate.model
    for r in linearised.rows:
        rows = _known_turns(model, r.block.rows)
        if len(rows):
            block = model.turned(model.scene.index[r.block.target], rows)
            yield targets.predicted_rows(estimate, block, r.target)


def _known_turns(model: Model, rows: np.ndarray) -> np.ndarray:
    """Rows with an orientation of a tool whose orientation on the flange is fitted, or stated."""
    scene, m = model.scene, model.scene.dataset.measurements
    posed = rows[scene.posed[rows]]
    fitted = scene.rows("calibrate")
    oriented = np.array([tool.rpy is not None and tool.u_angle is not None for tool in scene.dataset.tools])
    oriented[m.tool[fitted[scene.posed[fitted]]]] = True
    return posed[oriented[m.tool[posed]]]


def _distances(d: _Draws, linearised: targets.Prepared) -> Iterator[DistanceCheck]:
    pairs, normals = list(certified_pairs(d.estimate.model.scene, linearised.located)), list[np.ndarray]()
    by_certificates = errors_of_distances([c for c, _, _ in pairs])
    for k, (c, a, b) in enumerate(pairs):
        measured = float(np.linalg.norm(a.centre - b.centre))
        drawn = [t.centre + d.located(t)[0] @ t.to_state[:3].T for t in (a, b)]
        normals.append(d.normal())
        off = by_certificates[k, : k + 1] @ np.array(normals)
        predicted = measured - np.linalg.norm(drawn[0] - drawn[1], axis=1) + off
        assert c.distance is not None
        names = (c.targets[0], c.targets[1])
        yield DistanceCheck(names, c.distance, c.u_distance or 0.0, measured - c.distance, predicted)


def _diameters(d: _Draws, linearised: targets.Prepared) -> Iterator[DiameterCheck]:
    certified = targets.certified_diameters(d.estimate.model.scene)
    for name, t in linearised.loose.items():
        names = [part for part, _ in t.block.kind.parts]
        if "diameter" not in names:
            continue
        k = names.index("diameter")
        nominal = float(t.block.kind.describe(np.zeros(len(names)))["diameter"])
        u = certified.get(name, 0.0)
        predicted = -d.located(t)[0] @ t.to_state[k] + u * d.normal()
        yield DiameterCheck(name, nominal, float(t.state[k]), predicted)
