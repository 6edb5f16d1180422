"""What a plan is made from: the setup of a session, and its candidate contacts.

Information of candidate contacts: the model linearised, in closed form.

The vector z of a model is standard normal a priori. With the whitened Jacobian J of some contacts, that of
the certificates Jc and that of the rows measured already Jm, the information of a selection is

    I + Jc'Jc + Jm'Jm + J'J,

and its inverse is the covariance of z, at the stated noise and assuming the model is correct. Nothing is
simulated. A contact has one residual, a point that an instrument reads three, a pose six: selections are of
contacts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayescal.dataset import Box, Dataset
from bayescal.dataset.regions import Region
from bayescal.dataset.target_kinds import KINDS
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, linearise, unfitted, unit_weights
from bayescal.estimate.estimate import check_length
from bayescal.estimate.solver import factored, solved
from bayescal.model import ARM, Model, Scene, build
from bayescal.model.options import FitOptions, Part
from bayescal.probing.contacts import Hand
from bayescal.probing.motions import CLEAR, CONE
from bayescal.probing.scene import Scene as SolidScene
from bayescal.probing.scene import scene_of


@dataclass(frozen=True)
class Setup:
    """A session before it is measured, or continued.

    Attributes
    ----------
    dataset : Dataset
        Robot, tools, targets, certificates and noise; its rows are those that were measured already.
    regions : mapping of str to Region
        Of every target with a place of its own, by its name: all but instruments.
    volume : Box or None
        Volume of interest, in which distances must be accurate.
    payloads : tuple of float
        Masses, kg, that can be attached in addition to the tool.
    table : float or None
        Height, m, of the table in F0, against gravity; None if none is stated.
    cone : float
        Greatest angle, rad, between the axis of the tool and the inward normal.
    validated : frozenset of str
        Targets that are not calibrated on: spheres of certified distances, which validate.
    clearance : float
        Smallest clearance, m, of motions between contacts.
    poses : np.ndarray, shape (M, n)
        Readings, rad, of poses between which distances must be accurate; M = 0 if none are stated.
    notes : tuple of str
        What the user should know about the setup.
    noise_scale : mapping of str to float
        Factors on the stated noise by noise group, as a diagnosis of the session found them.
    """

    dataset: Dataset
    regions: Mapping[str, Region]
    volume: Box | None = None
    payloads: tuple[float, ...] = ()
    table: float | None = None
    cone: float = CONE
    validated: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    clearance: float = CLEAR
    poses: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    noise_scale: Mapping[str, float] = field(default_factory=dict)

    @property
    def at_its_noise(self) -> Dataset:
        """The dataset with the noise to expect: that which was found, or else that which is stated."""
        stated, m = self.dataset.noise, self.dataset.measurements
        kinds, scale = [KINDS[t.kind] for t in self.dataset.targets], self.noise_scale
        usual = {kind.noise: kind.usual for kind in kinds if np.isfinite(kind.usual)}
        sd = {group: getattr(stated, group, None) or usual.get(group) for group in scale}
        noise: dict[str, Any] = {group: scale[group] * each for group, each in sd.items() if each}
        of = [scale.get(kind.noise, 1.0) for kind in kinds]
        u = None if m.u is None else m.u * np.array(of)[m.target]
        return replace(self.dataset, noise=replace(stated, **noise), measurements=replace(m, u=u))

    @cached_property
    def scene(self) -> SolidScene:
        """The solids: boxes, spheres, walls, cylinders, posts of seats, the table, those of the session."""
        return scene_of(self.dataset, self.regions, self.table)

    @cached_property
    def hands(self) -> tuple[Hand, ...]:
        """The arm with each tool of the session."""
        every = range(len(self.dataset.tools))
        return tuple(Hand.of(self.dataset, k, self.scene, self.cone, self.clearance) for k in every)


@dataclass(frozen=True)
class Pool:
    """Candidate contacts, as rows of a session.

    Attributes
    ----------
    setup : Setup
    session : Dataset
        Its first `measured` rows were measured already. Those that follow are possible: with the role
        calibrate a candidate, with the role validate a contact that locates a sphere of a certified distance
        and belongs to every plan. Readings are those at which the nominal arm touches the nominal target.
        Times are random within the session, so that a drift is not along any other coordinate.
    measured : int
    approach : np.ndarray, shape (N, n)
        Readings, rad, from which the tool moves straight to each contact, and to which it retracts; those
        of the row itself where nothing is touched, or that was measured already.
    dropped : mapping of str to int
        Reasons why contacts were not candidates, with their number.
    warnings : tuple of str
        Targets with few candidates or none, and why.
    """

    setup: Setup
    session: Dataset
    measured: int
    approach: np.ndarray
    dropped: Mapping[str, int]
    warnings: tuple[str, ...] = ()

    @cached_property
    def candidates(self) -> np.ndarray:
        """Rows of the session that are candidates, (C,): of an image, its first."""
        return self._new[self._first]

    @cached_property
    def _new(self) -> np.ndarray:
        role = self.session.measurements.role
        return np.flatnonzero((role == "calibrate") & (np.arange(len(role)) >= self.measured))

    @cached_property
    def _first(self) -> np.ndarray:
        """Which of the rows that may be chosen begin a candidate: others are of the stop before."""
        stop, point = self.session.measurements.stop, self.session.measurements.pixel
        if stop is None or point is None:
            return np.ones(len(self._new), bool)
        label = stop[self._new]
        alone = np.isnan(point[self._new, 0]) | (label == "")
        return alone | (label != np.append("", label[:-1]))

    def numbers(self, rows: np.ndarray) -> np.ndarray:
        """Number of the candidate of some rows (R,) of the session; -1 of a row of none."""
        out = np.full(len(self.session.measurements.role), -1)
        out[self._new] = np.cumsum(self._first) - 1
        return np.asarray(out[rows])

    def rows_of(self, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
        """All rows of the session of some candidates, ascending."""
        return self._new[np.isin(np.cumsum(self._first) - 1, np.asarray(chosen, int))]

    @cached_property
    def validation(self) -> np.ndarray:
        """Rows of the session that belong to every plan, (V,)."""
        role = self.session.measurements.role
        return np.flatnonzero((role == "validate") & (np.arange(len(role)) >= self.measured))


POSE = 6
"""What a pose of the tool tells of an arm at most, however many corners of a board are seen from it."""
LITTLE = 1e-3
"""Information of a residual, relative to that of a prior, that is left out (rounding)."""
RESERVE = 40
"""Contacts beyond the number of unknowns, below which a plan is warned of."""


@dataclass(frozen=True)
class Linearised:
    """The candidates of a pool under a model, whitened by the stated noise.

    Attributes
    ----------
    model : Model
        Of all rows with the role calibrate: those measured already and the candidates.
    z : np.ndarray, shape (D,)
        Where it is linearised.
    jacobian : np.ndarray, shape (R, D)
        Of the residuals of the candidates by z, ordered by candidate.
    contact : np.ndarray, shape (R,)
        Number of the candidate of each residual, ascending.
    count : int
        Number of candidates, C.
    certificates, measured : np.ndarray, shape (D, D)
        Information of the certificates, and of the rows that were measured already.
    residuals : int
        Number of residuals of those rows.
    """

    model: Model
    z: np.ndarray
    jacobian: np.ndarray
    contact: np.ndarray
    count: int
    certificates: np.ndarray
    measured: np.ndarray
    residuals: int = 0

    @cached_property
    def base(self) -> np.ndarray:
        """Information (D, D) without any candidate: prior, certificates, measurements."""
        return np.eye(self.jacobian.shape[1]) + self.certificates + self.measured

    @cached_property
    def blocks(self) -> np.ndarray:
        """The Jacobian by candidate, (C, r, D), with rows of zeros where a candidate has fewer residuals."""
        begin = np.searchsorted(self.contact, np.arange(self.count))
        place = np.arange(len(self.contact)) - begin[self.contact]
        out = np.zeros((self.count, int(place.max(initial=0)) + 1, self.jacobian.shape[1]))
        out[self.contact, place] = self.jacobian
        return out

    def selected(self, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
        """Information (D, D) of candidates alone; a candidate that is given twice counts twice."""
        rows = self.blocks[np.asarray(chosen, int)].reshape(-1, self.jacobian.shape[1])
        return np.asarray(rows.T @ rows)

    def information(self, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
        """Information (D, D) of candidates, with that of the base."""
        return np.asarray(self.base + self.selected(chosen))

    def covariance(self, chosen: Sequence[int] | np.ndarray) -> np.ndarray:
        """Covariance (D, D) of z after a selection."""
        return inverse(self.information(chosen))

    @cached_property
    def estimate(self) -> Estimate:
        """The base as an estimate at z, for functions that predict from one."""
        return unfitted(self.model, self.z, inverse(self.base))


def linearised(pool: Pool, effects: tuple[str, ...], without: Sequence[Part] = ()) -> Linearised:
    """Linearise the candidates of a pool at the nominal arm, which touches the nominal targets.

    The mean of a prior may be elsewhere: compliances deflect the arm by up to a millimetre.

    Parameters
    ----------
    pool : Pool
    effects : tuple of str
        The model: names of `effects.MODELS`.
    without : sequence of Part
        Parts that the model lacks.

    Notes
    -----
    The states of targets without a row to calibrate (validation spheres) are not part of z. Gravity acts at
    the nominal pose: the difference, some 10 µm of deflection, does not change an information matrix.

    Raises
    ------
    BayescalError
        If there is no candidate, the stated noise is missing or zero, no length is known, or the session
        lacks data for an effect.
    """
    if not len(pool.candidates):
        raise BayescalError("no candidate contact", pool.session.name, "check the targets and the reach")
    model = build(Scene(pool.session, oriented=True), effects, FitOptions(tuple(without)))
    check_length(model)
    z = np.zeros(model.size)
    z[model.slices[ARM]] = -model.shift / model.sd
    weights = unit_weights(model, z)
    for block in model.blocks:
        if not np.all(weights.sigma[block.name] > 0):  # nan where none is stated
            remedy = f"state the noise of a {block.group} above 0"
            raise BayescalError(f"the noise of {block.target} is not stated", "dataset.yaml: noise", remedy)
    linear = linearise(model, z, weights)
    fitted = sum(block.residuals for block in model.blocks)
    row = np.concatenate([np.tile(block.rows, block.kind.rows) for block in model.blocks])
    new = row >= pool.measured
    jacobian, certificates = linear.jacobian[:fitted], linear.jacobian[fitted:]
    contact = pool.numbers(row[new])
    order = np.argsort(contact, kind="stable")
    measured = jacobian[~new]
    fresh, number = condensed(jacobian[new][order], contact[order])
    return Linearised(
        model, z, fresh, number, len(pool.candidates), certificates.T @ certificates,
        measured.T @ measured, len(measured),
    )  # fmt: skip


def condensed(columns: np.ndarray, candidate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fewer rows with the same information, of candidates with many residuals, as the corners of an image.

    Parameters
    ----------
    columns : np.ndarray, shape (R, K)
        Whitened slopes of residuals, in units of prior standard deviations.
    candidate : np.ndarray of int, shape (R,)
        Of each residual, ascending.

    Returns
    -------
    np.ndarray, shape (Q, K)
    np.ndarray of int, shape (Q,)

    Notes
    -----
    With the eigenvectors U of the Gram matrix of a candidate's rows X, the rows U'X have the same X'X. Those
    whose squares sum to less than `LITTLE` are left out: they tell less than that share of a prior.
    """
    begin = np.flatnonzero(np.diff(candidate, prepend=-1))
    end = np.append(begin[1:], len(candidate))
    parts, numbers = [], []
    for a, b in zip(begin, end, strict=True):
        rows = columns[a:b]
        if b - a > POSE:
            size, turn = np.linalg.eigh(rows @ rows.T)
            rows = turn[:, size > LITTLE].T @ rows
        parts.append(rows)
        numbers.append(np.full(len(rows), candidate[a]))
    return np.concatenate(parts), np.concatenate(numbers)


def inverse(information: np.ndarray) -> np.ndarray:
    """Inverse (D, D) of a positive definite matrix, symmetric."""
    out = solved(factored(information), np.eye(len(information)))
    return np.asarray(0.5 * (out + out.T))


def check_count(linear: Linearised, count: int) -> str:
    """Refuse a plan with too few contacts; a warning if it has hardly enough, else "".

    Unknowns are the parameters of the arm and the states of the targets that are touched.

    Raises
    ------
    BayescalError
        If the residuals of the plan and of the rows measured already are not more than the unknowns, or the
        pool has fewer candidates.
    """
    size, each = linear.model.size, min(len(linear.contact) / linear.count, POSE)
    needed = int(np.floor((size - linear.residuals) / each)) + 1
    unknowns = f"{len(linear.model.parameters)} parameters and {len(linear.model.states)} targets"
    if count < max(needed, 1):
        remedy = f"give {max(needed, 1)} or more, better {_ample(size, linear.residuals, each)}"
        what = f"{count} contacts are not more than the {size} unknowns ({unknowns})"
        raise BayescalError(what, "--contacts", remedy)
    if count > linear.count:
        what = f"{count} contacts of {linear.count} candidates"
        raise BayescalError(what, "--contacts", f"give {linear.count} or fewer, or enlarge the targets")
    if count < (ample := _ample(size, linear.residuals, each)):
        return (
            f"{count} contacts for {size} unknowns ({unknowns}): the noise cannot be checked well and a "
            f"single outlier matters; {ample} or more are recommended"
        )
    return ""


def _ample(size: int, residuals: int, each: float) -> int:
    return int(np.ceil((size + RESERVE - residuals) / each))
