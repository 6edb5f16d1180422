"""The effects that a model lacks, at every site that the candidates of a pool can show, as columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayescal.effects import EFFECTS, Circumstances, Parameter, named
from bayescal.effects.selection import Selection
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.gap.design.blind_spots import Seat, seats
from bayescal.gap.linear.known import with_compliances
from bayescal.gap.linear.masses import masses
from bayescal.gap.linear.slopes import problem
from bayescal.gap.search.beam import COMPLIANCE
from bayescal.gap.search.candidates import Candidates, candidates, extended, wide
from bayescal.model.parts import Part
from bayescal.planning.pool import Pool
from bayescal.planning.projection import CandidateColumns


@dataclass(frozen=True)
class Suspect:
    """An effect that may be true: the form of --model, "bending at link 3", and values of its parameters, SI.

    Without values they are a random draw of their priors.
    """

    model: str
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def selection(self) -> Selection:
        """Effect, setting and sites."""
        return Selection.read(self.model)


Side = tuple[Suspect, ...]
"""Effects that are true together; () is noise only."""


@dataclass(frozen=True)
class Vocabulary:
    """Effects as columns; `seats` are those of the usual setting, each column in one of them.

    `parameters` are those of all columns; after those of the seats follow those of suspects in a setting.
    """

    seats: tuple[Seat, ...]
    parameters: tuple[Parameter, ...]
    suspects: Mapping[str, np.ndarray]  # columns by the text of the suspect
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

    def side(self, side: Side) -> tuple[np.ndarray, np.ndarray | None]:
        """Columns (k,) of suspects, and their amplitudes (k, 1) in units of their priors, where stated."""
        if not side:
            return np.empty(0, int), None
        columns = np.concatenate([self.suspects[one.model] for one in side])
        values = {k: v for one in side for k, v in one.values.items()}
        if not values:
            return columns, None
        own = [self.parameters[k] for k in columns]
        return columns, np.array([[values.get(p.name, 0.0) / p.sd] for p in own])


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
    c = with_compliances(scene.circumstances(scene.rows("calibrate")), fitted)
    known = _known(c, effects, without)
    groups: list[Seat] = []
    parameters: list[Parameter] = []
    for seat in seats(known):
        at = len(parameters) + np.arange(len(seat.columns))
        groups.append(replace(seat, columns=at))
        parameters += [known.pool[k] for k in seat.columns]
    columns_of: dict[str, np.ndarray] = {}
    for one in suspects:
        usual = one.selection.setting is None
        own = [k for k, p in enumerate(parameters) if usual and _is(one, p)]
        if not own:
            more = _shown(one, c)
            own = [len(parameters) + k for k in range(len(more))]
            parameters += more
        columns_of[one.model] = np.array(own)
    nuisance = masses(c) if COMPLIANCE in effects else []
    p = problem(fitted, parameters, nuisance)
    row = p.rows[p.contact]
    new = np.flatnonzero(np.isin(row, pool.candidates))
    number = np.searchsorted(pool.candidates, row[new])
    order = np.argsort(number, kind="stable")
    rest = np.setdiff1d(np.arange(len(p.residual)), new)
    new, number = new[order], number[order]
    columns = CandidateColumns(p.jacobian[new], p.pool[new], number, p.jacobian[rest], p.pool[rest])
    return Vocabulary(tuple(groups), tuple(parameters), columns_of, columns)


def _known(c: Circumstances, effects: tuple[str, ...], without: Sequence[Part]) -> Candidates:
    """The candidates of a diagnosis; of a scan that it screens by residuals, one setting."""
    known = candidates(c, effects, without)
    for effect in EFFECTS.values():
        if effect.name not in known.variants and wide(effect, c) and effect.scan is not None:
            lacks, values = effect.missing(c), effect.scan.values(c)
            known = extended(known, effect, [float(values[len(values) // 2]) if lacks else None], c, lacks)
    return known


def _is(one: Suspect, p: Parameter) -> bool:
    """Whether a column is one of a suspect in its usual setting."""
    asked = one.selection
    if one.values:
        return p.effect == asked.effect and p.name in one.values
    return p.effect == asked.effect and asked.holds(p) and asked.together == bool(p.stands_for)


def _shown(one: Suspect, c: Circumstances) -> list[Parameter]:
    """Parameters of a suspect in its setting."""
    effect, setting = named(one.model)
    found = one.selection.of(effect.at(c, setting), "--after")
    if not found:
        what = f"no candidate contact shows {one.model}"
        raise BayescalError(what, "--after", "check the columns of the setup, and its payloads")
    return found
