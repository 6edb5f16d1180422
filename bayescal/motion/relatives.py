"""Relatives of a named effect: what it predicts, times a function of any other quantity of the log.

As for contacts (`bayescal.gap.search.verdict`): a *modulated* relative is the prediction of the name and,
in addition, this prediction times smooth functions of another quantity; a *replaced* one is the prediction
times a positive function, without the name. A name is only as sure as the data exclude both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from bayescal.motion.cells import UNKNOWN
from bayescal.motion.effects import Form
from bayescal.motion.linear import Fit, Sparse, predicted
from bayescal.motion.products import Bank, Dots, averaged, consecutive
from bayescal.motion.quantities import Argument
from bayescal.motion.search import Member, Search
from bayescal.motion.settings import RELATIVES, SEARCH
from bayescal.motion.signals import root_mean_square


@dataclass(frozen=True)
class Relative:
    """A relative of a member of a hypothesis, with its columns."""

    form: Form
    gain: float  # nats over the hypothesis with the name, averaged over all quantities
    columns: Sparse
    replaces: bool  # whether the name is left out


def relative(bank: Bank, search: Search, members: Sequence[Member], member: Member) -> Relative:
    """The strongest relative of a member, with the evidence of all of its relatives."""
    fit, rest = search.fit(members), search.fit([m for m in members if m is not member])
    rows = predicted(bank.table, fit, search.terms[member.form])
    size = root_mean_square(rows)
    live = np.flatnonzero(size > RELATIVES.least * np.max(size))
    given, share = bank.first, RELATIVES.share

    def modulations(p: np.ndarray, of_motion: Sequence[Argument]) -> list[np.ndarray]:
        return [p[:, :, None] * (share * a.functions[:, None]) for a in of_motion]

    def replacements(p: np.ndarray, of_motion: Sequence[Argument]) -> list[np.ndarray]:
        return [p[:, :, None], *(p[:, :, None] * f[:, None, None] for a in of_motion for f in _factors(a))]

    origin = [k for k, a in enumerate(given) for _ in _factors(a)]
    modulated = _nats(bank, fit, live, rows, modulations)
    replaced = _nats(bank, rest, live, rows, replacements)
    replaced = replaced[1:] - replaced[0] + np.log(RELATIVES.replaced / len(origin))
    modulated += np.log(RELATIVES.modulated / len(given))
    i = int(np.argmax(replaced))
    instead = bool(replaced[i] > np.max(modulated))
    k = origin[i] if instead else int(np.argmax(modulated))
    form = replace(member.form, effect=UNKNOWN, driver=f"{member.form.driver} times {given[k].name}")
    columns = []
    for p, (_, _, of_motion) in zip(rows, bank.motions(), strict=True):
        by = _factors(of_motion[k])[i % 2][:, None] if instead else of_motion[k].functions
        columns.append({c: (p[:, c, None] * by).astype(np.float32) for c in live.tolist()})
    # a part of what a name explains may belong to its form
    forgiven = SEARCH.form * max(fit.log_evidence - rest.log_evidence, 0.0)
    gain = float(logsumexp(np.r_[modulated, replaced])) - forgiven
    return Relative(form, gain, columns, instead)


def _factors(a: Argument) -> list[np.ndarray]:
    """Positive functions (M,) of a quantity: from 0 at one end of its range to 1 at the other, both ways."""
    f = a.functions[:, 0]
    return [(1.0 + f) / 2.0, (1.0 - f) / 2.0]


def _nats(
    bank: Bank, fit: Fit, channels: np.ndarray, rows: Sequence[np.ndarray],
    columns: Callable[[np.ndarray, Sequence[Argument]], list[np.ndarray]],
) -> np.ndarray:  # fmt: skip
    """Log Bayes factors of sets beside a fit; `columns` has each (M, C, k), of the prediction of a motion."""
    dots: dict[int, Dots] = {}
    sets: tuple[np.ndarray, ...] = ()
    for p, (part, _, given) in zip(rows, bank.motions(), strict=True):
        every = columns(p, given)
        sets = consecutive([x.shape[2] for x in every])
        wide = np.concatenate(every, axis=2)
        for c in channels.tolist():
            bank.count(dots, part, fit, c, wide[:, c], sets, into=0)
    return averaged(fit, dots[0], sets)
