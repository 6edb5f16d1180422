"""A fitted arm that can be evaluated at any pose, with all its fitted effects.

A pose is a row appended to the session in which the arm was fitted (`unmodelled.posed_rows`). The drivers of
its effects are therefore those of the model: gravity moments at the deflected pose, torques, angles,
direction of motion, payload, time. What a pose does not state is that of a row of the session, its *state*.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.arm.chain import frames
from bayescal.arm.motion import Motion
from bayescal.effects.selection import plain
from bayescal.effects.tool import TOOL
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.estimate.solver import root
from bayescal.fitted import gate
from bayescal.fitted.gate import NOTHING, Use
from bayescal.fitted.unmodelled import Circumstance, Unmodelled, driven_by, posed_rows
from bayescal.model import ARM, USUAL, FitOptions, Model
from bayescal.model.equilibrium import standing_model

if TYPE_CHECKING:
    from bayescal.assess.inputs import Basis
    from bayescal.calibration import Fit
    from bayescal.dataset import Dataset
    from bayescal.effects import Parameter
    from bayescal.gap.result import Gap

NOMINAL = "nominal"


@dataclass(frozen=True)
class Origin:
    """How an arm was fitted: what a refit repeats."""

    command: str = "fit"
    options: FitOptions = USUAL


@dataclass(frozen=True)
class Poses:
    """C poses of an arm, in F0, SI.

    `motion` is the motion of these rows, of `model`, by deviations of the arm's P parameters. `spread` is
    their covariance without the part of the K errors of `unmodelled`, which move the points as well.
    """

    readings: np.ndarray  # (C, n) rad
    points: np.ndarray  # (C, 3) m, of the tool
    flange: np.ndarray  # (C, 4, 4)
    motion: Motion
    values: np.ndarray  # (P,)
    spread: np.ndarray  # (P, P)
    model: Model
    rows: np.ndarray  # (C,) of the model's scene
    unmodelled: Unmodelled
    driven: Callable[[Parameter], Parameter]  # what the rows make of the drivers of a parameter

    @cached_property
    def by_parameters(self) -> np.ndarray:
        """Derivatives of the points by the arm's parameters, (C, 3, P), SI, at constant gravity moments."""
        return slopes_of(self.motion, self.values)

    @cached_property
    def wide(self) -> Model:
        """The model with the K errors as its last parameters."""
        return self.unmodelled.widened(self.model, self.values, self.driven)

    @cached_property
    def by_all(self) -> np.ndarray:
        """Derivatives (C, 3, P + K) by the parameters, and displacements by the K unit errors."""
        if not len(self.readings) or not self.unmodelled.shifts.size:
            return self.by_parameters
        return slopes_of(self.wide.motion(self.rows), padded(self.values, self.wide)) * unit_errors(
            self.wide, len(self.values)
        )

    @property
    def covariance(self) -> np.ndarray:
        """Stated covariance of each point, (C, 3, 3), m2."""
        return self.spread_by(self.by_all)

    def spread_by(self, by: np.ndarray) -> np.ndarray:
        """Covariance (C, 3, 3), m2, of points with derivatives (C, 3, P + K); see `by_all`."""
        errors = self.errors_by(by)
        return errors @ np.swapaxes(errors, -1, -2) + self.unmodelled.excess**2 * np.eye(3)

    def errors_by(self, by: np.ndarray) -> np.ndarray:
        """Displacements (C, 3, P + K), m, by independent errors of unit variance that all points share."""
        count = len(self.values)
        unmodelled = by[..., count:] - by[..., :count] @ self.unmodelled.shifts[:, : by.shape[-1] - count]
        return np.concatenate([by[..., :count] @ root(self.spread), unmodelled], axis=-1)

    def dof_by(self, by: np.ndarray, total: np.ndarray) -> np.ndarray:
        """Effective degrees of freedom (C,) of the variances `total` (C,) of these points."""
        squares = np.sum(self.errors_by(by)[..., len(self.values) :] ** 2, axis=1)
        names = [p.name for p in self.wide.parameters[len(self.values) :]] if squares.size else []
        parts = {name: squares[:, np.array(names) == name].sum(axis=1) for name in names}
        return self.unmodelled.dof_of(total, parts)


def padded(values: np.ndarray, wide: Model) -> np.ndarray:
    """Values (P,) of a model's parameters, followed by zeros for the further ones of a wide model."""
    return np.concatenate([values, np.zeros(len(wide.parameters) - len(values))])


def unit_errors(wide: Model, count: int) -> np.ndarray:
    """Factors (P + K,) from derivatives by parameters to changes: 1 of the first, their sd of the others."""
    return np.array([1.0 if k < count else p.sd for k, p in enumerate(wide.parameters)])


def slopes_of(motion: Motion, values: np.ndarray) -> np.ndarray:
    """Derivatives (C, 3, P) of the points of a motion by its parameters, at their values (P,), SI."""
    p = motion.points(values)
    if not p.shape[1]:
        return np.zeros((0, 3, len(values)))
    ways = np.repeat(np.eye(3)[:, :, None], p.shape[1], axis=2)
    return np.stack([motion.columns(values, p, np.ascontiguousarray(u)) for u in ways], axis=1).T


@dataclass(frozen=True)
class FittedArm:
    """A model with the values of its arm's parameters.

    Parameters
    ----------
    model : Model
        Of the session; its gravity moments are those of the arm as it stands for `values`.
    values : np.ndarray, shape (P,)
        Deviations from nominal, SI, in the order of `model.parameters`.
    covariance : np.ndarray, shape (P, P)
        Their stated covariance, with the model discrepancy.
    effects : tuple of str
        The model, in the form of ``--model``.
    states : mapping
        Displacement of each fitted target, SI, in the order of its kind's parts.
    rejected : tuple of str
        Rows of the session that the fit excluded, by their ids.
    origin : Origin
    use : Use
        What may be used of it: reasons against it, what a user should know, what was changed.
    unmodelled : Unmodelled, optional
        Errors beyond the parameters, of which the covariance has a part; default: none.
    """

    model: Model
    values: np.ndarray
    covariance: np.ndarray
    effects: tuple[str, ...]
    states: Mapping[str, np.ndarray]
    rejected: tuple[str, ...] = ()
    origin: Origin = Origin()
    use: Use = NOTHING
    unmodelled: Unmodelled | None = None

    @property
    def dataset(self) -> Dataset:
        """The session."""
        return self.model.scene.dataset

    def at(
        self,
        readings: np.ndarray,
        *,
        tool: str | None = None,
        payload_kg: np.ndarray | float = 0.0,
        direction: np.ndarray | None = None,
        previous: np.ndarray | None = None,
        time: np.ndarray | float | None = None,
        row: str | int | None = None,
    ) -> Poses:
        """TCP positions and flange of an arm that stands at any poses.

        Parameters
        ----------
        readings : np.ndarray, shape (C, n)
            rad, as the controller shows them.
        tool : str, optional
            Name; default: that of the state.
        payload_kg : float or np.ndarray, shape (C,)
            kg, beyond the tool.
        direction : np.ndarray, shape (n,) or (C, n), optional
            Sign of the motion of each reading before the pose; 0: in the middle of the lost motion.
        previous : np.ndarray, shape (n,) or (C, n), optional
            rad, the readings from which the pose is approached: the direction follows from them.
        time : float or np.ndarray, shape (C,), optional
            s since the session began: the state is that of the last row before.
        row : str or int, optional
            id or index of the row whose state applies: time, temperature, events, tool; default:
            the last fitted row.

        Raises
        ------
        BayescalError
            For a tool or a row that the session does not have, or an arm without equilibrium under gravity.
        """
        readings = np.atleast_2d(np.asarray(readings, float))
        here = Circumstance.of(self.model.scene.dataset, len(readings), tool, payload_kg, time, row)
        if previous is not None:
            direction = np.sign(np.round(readings - previous, 9))
        return self._poses(here.changed(readings, direction), here.source, True)

    def at_rows(self, rows: np.ndarray) -> Poses:
        """TCP positions and flange in rows (C,) of the session, with all that was measured there."""
        return self._poses({}, np.asarray(rows, int), False)

    def _poses(self, changed: Mapping[str, Any], source: np.ndarray, still: bool) -> Poses:
        model, rows = posed_rows(self.model, self.values, source, changed, still)
        motion = model.motion(rows)
        delta = motion.displacements(self.values)
        delta[:, -1] = 0.0  # the tool's own offset
        return Poses(
            model.scene.dataset.measurements.readings[rows],
            motion.points(self.values).T,
            frames(model.scene.chain, model.scene.q[rows], delta)[:, -1],
            motion,
            self.values,
            self.spread,
            model,
            rows,
            self.beyond,
            driven_by(self.dataset.measurements, source, still),
        )

    @property
    def beyond(self) -> Unmodelled:
        """Errors beyond the parameters; none where the arm has none."""
        return self.unmodelled or Unmodelled(np.zeros((len(self.values), 0)))

    @cached_property
    def spread(self) -> np.ndarray:
        """Covariance (P, P) of the parameters without the part of these errors."""
        return self.covariance if self.unmodelled is None else self.unmodelled.without(self.covariance)

    @property
    def levels(self) -> tuple[str, ...]:
        """Model levels: nominal, the first effect, then each effect in addition to those before."""
        return (NOMINAL, *(name if k == 0 else f"+ {name}" for k, name in enumerate(self.effects)))

    def level(self, name: str) -> FittedArm:
        """The arm of a model level: parameters of further effects are at their nominal values.

        All levels have the fitted tool, except nominal.
        """
        if name not in self.levels:
            raise BayescalError(f"there is no level `{name}`", "", f"levels: {', '.join(self.levels)}")
        count = self.levels.index(name)
        used = {plain(e) for e in self.effects[:count]} | ({TOOL.name} if count else set())
        return self.valued(np.where([p.effect in used for p in self.model.parameters], self.values, 0.0))

    def at_level(self, name: str, readings: np.ndarray, **state: Any) -> Poses:
        """TCP positions and flange at any poses, of one level; see `at`."""
        return self.level(name).at(readings, **state)

    def valued(self, values: np.ndarray) -> FittedArm:
        """The arm with other values (P,) of its parameters, in equilibrium."""
        return replace(self, model=standing_model(self.model, values), values=values)


def of_estimate(estimate: Estimate, covariance: np.ndarray, origin: Origin = Origin()) -> FittedArm:
    """The arm of an estimate; `covariance` (D, D) is the stated one of its z."""
    model = estimate.model
    arm = model.slices[ARM]
    values = model.deviations(estimate.z[arm])
    return FittedArm(
        standing_model(model, values),
        values,
        covariance[arm, arm] * np.outer(model.sd, model.sd),
        model.effects,
        {b.target: b.state(estimate.z[model.slices[b.target]]) for b in model.states},
        tuple(model.scene.dataset.measurements.ids[row] for row in estimate.rejected),
        origin,
    )


def of_basis(basis: Basis, origin: Origin = Origin()) -> FittedArm:
    """The arm of a fit with its stated uncertainty."""
    stated = basis.stated
    return replace(of_estimate(stated.plain, stated.limited, origin), unmodelled=Unmodelled.of(basis))


def of_fit(fit: Fit) -> FittedArm:
    """The arm of a calibration."""
    return replace(of_basis(fit.basis, Origin("fit", fit.options)), use=gate.of_fit(fit))


def of_gap(gap: Gap, with_: Sequence[str] = (), without: Sequence[str] = ()) -> FittedArm:
    """The arm of a diagnosis: its refit with the named effects that the validation data confirm.

    With `with_` or `without`, that of a fit with other effects; see `refitted`.
    """
    from bayescal.calibration import basis_of

    assert gap.arm is not None, "a diagnosis has its refit"
    origin = Origin("gap", replace(gap.options, without=gap.still_without))
    arm = replace(of_basis(basis_of(gap.arm, gap.options.seed), origin), use=gate.of_gap(gap))
    return refitted(arm, with_, without) if with_ or without else arm


def refitted(arm: FittedArm, with_: Sequence[str] = (), without: Sequence[str] = ()) -> FittedArm:
    """Fit the session of an arm again, with further effects, or without some of its effects or their parts.

    Parameters
    ----------
    arm : FittedArm
    with_ : sequence of str
        Effects, in the form of ``--model``.
    without : sequence of str
        Effects of the model, or parts of them that stay nominal: 'geometry at joint 4'.

    Raises
    ------
    BayescalError
        If the model has an effect already, or does not have it, or the session cannot be fitted so.
    """
    from bayescal.calibration import fit

    names = [plain(name) for name in arm.effects]
    for name in with_:
        if plain(name) in names:
            raise BayescalError(f"the model has {plain(name)} already", f"--with {name}", "leave it out")
    whole = [name for name in without if name in names or name in arm.effects]
    effects = [name for name in arm.effects if name not in whole and plain(name) not in whole]
    options = arm.origin.options
    parts = (*options.omitted, *(name for name in without if name not in whole))
    found = fit(arm.dataset, (*effects, *with_), options, without=parts, samples=0)
    refit = of_fit(found)
    against = (*refit.use.against, *gate.not_gained(_gains(found, with_)))
    return replace(
        refit, origin=Origin(arm.origin.command, found.options), use=replace(refit.use, against=against)
    )


def _gains(fit: Fit, names: Sequence[str]) -> list[tuple[str, float]]:
    """Gain of log density of the validation measurements, nats, by each of the last effects of a fit."""
    if not names:
        return []
    from bayescal.gap.search.gate import gain
    from bayescal.predict.crossvalidation import validation_errors

    errors = [validation_errors(e.estimate, strict=False) for e in fit.levels[-len(names) - 1 :]]
    return [
        (name, gain(errors[0], less, more))
        for name, less, more in zip(names, errors, errors[1:], strict=False)
    ]
