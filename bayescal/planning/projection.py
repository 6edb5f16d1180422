"""Columns of effects, projected off the model by the contacts that are chosen so far.

With the whitened Jacobian J (R, D) of the chosen contacts, certificates and measurements, the columns X
(R, K) of effects, and C = inv(I + J'J), the model leaves X - J C J'X of them, and G = X'X - X'J C J'X is the
detectability of their combinations. A further residual with the row j and the columns x has the variance
v = j'Cj and the error e = x - j'C J'X; it increases G by e e' / (1 + v) (Sherman and Morrison). No step
needs a refit.

The effects that a model lacks, at every site that the candidates of a pool can show, as columns.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import EFFECTS, Circumstances, Parameter, named
from bayescal.effects.gravity import masses
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, unfitted
from bayescal.estimate.families import with_compliances
from bayescal.gap.advise import Seat, seats
from bayescal.gap.linear.problem import problem
from bayescal.gap.result import Side, Suspect
from bayescal.gap.search.beam import COMPLIANCE
from bayescal.gap.search.candidates import unscreened
from bayescal.model import Scene, build
from bayescal.model.options import FitOptions, Part
from bayescal.planning.pool import Pool, condensed


@dataclass(frozen=True)
class CandidateColumns:
    """Residuals of candidates, and of what is known without them, whitened by their stated noise.

    Attributes
    ----------
    design : np.ndarray, shape (R, D)
        By the parameters of the model and the masses, in units of their prior standard deviations.
    columns : np.ndarray, shape (R, K)
        By the parameters of effects that the model lacks, in the same units.
    candidate : np.ndarray of int, shape (R,)
        Number of the candidate of each residual, ascending.
    known_design, known_columns : np.ndarray, shapes (Q, D), (Q, K)
        The same of certificates and of rows that were measured already.
    """

    design: np.ndarray
    columns: np.ndarray
    candidate: np.ndarray
    known_design: np.ndarray
    known_columns: np.ndarray

    @property
    def count(self) -> int:
        """Number of candidates."""
        return int(self.candidate[-1]) + 1 if len(self.candidate) else 0

    def residuals(self, candidates: Sequence[int] | np.ndarray) -> np.ndarray:
        """Residuals of some candidates, in their order; a candidate that is given twice has them twice."""
        chosen = np.asarray(candidates, int)
        if len(self.candidate) == self.count:
            return chosen
        first, last = (np.searchsorted(self.candidate, chosen, side=side) for side in ("left", "right"))
        return np.concatenate([np.empty(0, int), *map(np.arange, first, last)])


class Projection:
    """The candidates' residuals as the chosen contacts determine the model.

    Attributes
    ----------
    error : np.ndarray, shape (K, R)
        What the model leaves of each column at every residual.
    variance : np.ndarray, shape (R,)
        Of the prediction of each residual, in units of the noise.
    information : np.ndarray, shape (K, K)
        G of the chosen contacts.
    """

    def __init__(self, linear: CandidateColumns, chosen: Sequence[int] | np.ndarray = ()) -> None:
        rows = linear.residuals(chosen)
        design = np.concatenate([linear.known_design, linear.design[rows]])
        columns = np.concatenate([linear.known_columns, linear.columns[rows]])
        self.linear = linear
        self.covariance = np.linalg.inv(np.eye(design.shape[1]) + design.T @ design)
        across = design.T @ columns
        absorbed = self.covariance @ across
        self.information = columns.T @ columns - across.T @ absorbed
        self.error = np.ascontiguousarray(linear.columns.T - absorbed.T @ linear.design.T)
        self.variance = np.sum((linear.design @ self.covariance) * linear.design, axis=1)

    def change(self, candidate: int, sign: float) -> None:
        """Choose a candidate (1), also once more, or drop (-1) one that was chosen."""
        for row in self.linear.residuals([candidate]).tolist():
            j = self.linear.design[row]
            gain = self.covariance @ j
            across, by = self.linear.design @ gain, sign + float(j @ gain)  # of a removed one: v - 1
            wrong = self.error[:, row].copy()
            self.information += np.outer(wrong, wrong / by)
            self.error -= np.outer(wrong / by, across)
            self.variance -= across**2 / by
            self.covariance -= np.outer(gain, gain / by)


@dataclass(frozen=True)
class Vocabulary:
    """Effects as columns; `seats` are those of the usual setting, each column in one of them.

    `parameters` are those of all columns; after those of the seats follow those of suspects in a setting,
    whose columns `settings` are given by the text of the suspect.
    """

    seats: tuple[Seat, ...]
    parameters: tuple[Parameter, ...]
    settings: Mapping[str, np.ndarray]
    columns: CandidateColumns

    @property
    def names(self) -> tuple[str, ...]:
        """Every effect once."""
        return tuple(dict.fromkeys(s.effect for s in self.seats))

    def of(self, effect: str) -> np.ndarray:
        """Columns of an effect, in its usual setting."""
        return np.concatenate([s.columns for s in self.seats if s.effect == effect])

    def confusable(self, effect: str) -> tuple[str, ...]:
        """Effects with a similar form, of those that the session can show."""
        return tuple(n for n in self.names if n in EFFECTS[effect].confusable_with)

    def shown(self, one: Suspect) -> np.ndarray:
        """Columns (k,) of a suspect; none if it is not among the columns."""
        usual = np.flatnonzero([_is(one, p) for p in self.parameters])
        return self.settings.get(one.model, usual)

    def side(self, side: Side) -> tuple[np.ndarray, np.ndarray | None]:
        """Columns (k,) of suspects, and their amplitudes (k, 1) in units of their priors, where stated."""
        if not side:
            return np.empty(0, int), None
        columns = [self.shown(one) for one in side]
        if not any(one.values for one in side):
            return np.concatenate(columns), None
        amplitudes = [
            one.values.get(p.name, 0.0) / p.sd if one.values else 1.0
            for one, columns_of_one in zip(side, columns, strict=True)
            for p in (self.parameters[k] for k in columns_of_one)
        ]
        return np.concatenate(columns), np.array(amplitudes)[:, None]


def nominal(session: Dataset, effects: tuple[str, ...], without: Sequence[Part] = ()) -> Estimate:
    """A model of a session's rows at the mean of its prior, with the stated noise, as if it were fitted."""
    model = build(Scene(session, oriented=True), effects, FitOptions(tuple(without)))
    return unfitted(model, np.zeros(model.size))


def vocabulary(
    pool: Pool, fitted: Estimate, suspects: Iterable[Suspect] = (), without: Sequence[Part] = ()
) -> Vocabulary:
    """Linearise every effect that a model lacks.

    Parameters
    ----------
    pool : Pool
    fitted : Estimate
        Of the model of the pool's session: where it is linearised.
    suspects : iterable of Suspect
        Effects that must be among the columns, also in a setting that is not the usual.
    without : sequence of Part
        Parts that the model lacks; they are effects like others.

    Raises
    ------
    BayescalError
        If a suspect is not an effect that the candidates show.
    """
    scene, effects = fitted.model.scene, fitted.model.effects
    c = with_compliances(scene.circumstances(), fitted)
    assessed = unscreened(c, effects, without)
    sites: list[Seat] = []
    parameters: list[Parameter] = []
    for seat in seats(assessed):
        sites.append(replace(seat, columns=len(parameters) + np.arange(len(seat.columns))))
        parameters += [assessed.pool[k] for k in seat.columns]
    usual, settings = tuple(parameters), {}
    for one in suspects:
        if not any(_is(one, p) for p in usual) and one.model not in settings:
            more = _shown(one, c)
            settings[one.model] = len(parameters) + np.arange(len(more))
            parameters += more
    nuisance = masses(c) if COMPLIANCE in effects else []
    p = problem(fitted, parameters, nuisance)
    row = p.rows[p.contact]
    every = pool.numbers(row)
    new = np.flatnonzero(every >= 0)
    number = every[new]
    order = np.argsort(number, kind="stable")
    others = np.setdiff1d(np.arange(len(p.residual)), new)
    new, number = new[order], number[order]
    both, number = condensed(np.hstack([p.jacobian[new], p.pool[new]]), number)
    size = p.jacobian.shape[1]
    columns = CandidateColumns(
        np.ascontiguousarray(both[:, :size]), np.ascontiguousarray(both[:, size:]), number,
        p.jacobian[others], p.pool[others],
    )  # fmt: skip
    return Vocabulary(tuple(sites), tuple(parameters), settings, columns)


def _is(one: Suspect, p: Parameter) -> bool:
    """Whether a column is one of a suspect in its usual setting."""
    asked = one.selection
    if p.effect != asked.effect or asked.setting is not None:
        return False
    return p.name in one.values if one.values else asked.holds(p) and asked.together == bool(p.stands_for)


def _shown(one: Suspect, c: Circumstances) -> list[Parameter]:
    """Parameters of a suspect in its setting."""
    effect, setting = named(one.model)
    shown = one.selection.of(effect.at(c, setting), "--after")
    if not shown:
        what = f"no candidate contact shows {one.model}"
        raise BayescalError(what, "--after", "check the columns of the setup, and its payloads")
    return shown
