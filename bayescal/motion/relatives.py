"""Relatives of a named effect: what it predicts, times a function of any other quantity of the log.

As for contacts (`bayescal.gap.search.relatives`): a *modulated* relative is the prediction of the name and,
in addition, this prediction times smooth functions of another quantity; a *replaced* one is the prediction
times a positive function, without the name. A name is only as sure as the data exclude both.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.motion.cells import UNKNOWN
from bayescal.motion.effects import Form
from bayescal.motion.linear import Fit, added
from bayescal.motion.products import Bank
from bayescal.motion.quantities import Argument
from bayescal.motion.search import SCALE_PRIOR, SCALES, Member, Search
from bayescal.motion.settings import RELATIVES, SEARCH


@dataclass(frozen=True)
class Relative:
    """A relative of a member of a hypothesis, with its columns by motion, each (M, C, k)."""

    member: Member
    form: Form
    gain: float  # nats over the hypothesis with the name, averaged over all quantities
    columns: tuple[np.ndarray, ...]
    replaces: bool  # whether the name is left out


def relative(bank: Bank, search: Search, members: Sequence[Member], member: Member) -> Relative:
    """The strongest relative of a member, with the evidence of all of its relatives."""
    fit, rest = search.fit(members), search.fit([m for m in members if m is not member])
    predicted = _predicted(bank, fit, search.terms[member.form])
    size = np.sqrt(np.mean(np.concatenate(predicted) ** 2, axis=0))
    live = np.flatnonzero(size > RELATIVES.least * np.max(size))
    given, count = bank.given, len(bank.given[0])
    modulated = _nats(bank, fit, live, [
        [p[:, :, None] * RELATIVES.share * a.functions[:, None] for a in of_motion]
        for p, of_motion in zip(predicted, given, strict=True)
    ])  # fmt: skip
    factors = [[f for a in of_motion for f in _factors(a)] for of_motion in given]
    origin = [k for k, a in enumerate(given[0]) for _ in _factors(a)]
    replaced = _nats(bank, rest, live, [
        [p[:, :, None], *(p[:, :, None] * f[:, None, None] for f in of_motion)]
        for p, of_motion in zip(predicted, factors, strict=True)
    ])  # fmt: skip
    replaced = replaced[1:] - replaced[0] + np.log(RELATIVES.replaced / len(origin))
    modulated += np.log(RELATIVES.modulated / count)
    k, i = int(np.argmax(modulated)), int(np.argmax(replaced))
    instead = bool(replaced[i] > modulated[k])
    other = given[0][origin[i] if instead else k].name
    form = Form(UNKNOWN, member.form.site, f"{member.form.driver} times {other}", member.form.setting)
    columns = tuple(
        p[:, :, None] * (f[i][:, None, None] if instead else of_motion[k].functions[:, None])
        for p, f, of_motion in zip(predicted, factors, given, strict=True)
    )
    # a part of what a name explains may belong to its form
    forgiven = SEARCH.form * max(fit.log_evidence - rest.log_evidence, 0.0)
    gain = float(logsumexp(np.r_[modulated, replaced])) - forgiven
    return Relative(member, form, gain, columns, instead)


def _factors(a: Argument) -> list[np.ndarray]:
    """Positive functions (M,) of a quantity: from 0 at one end of its range to 1 at the other, both ways."""
    f = a.functions[:, 0]
    return [(1.0 + f) / 2.0, (1.0 - f) / 2.0]


def _predicted(bank: Bank, fit: Fit, terms: Sequence[str]) -> list[np.ndarray]:
    """What terms of a fit predict in each motion (M, C)."""
    values = {name: fit.values[name] for name in terms}
    left = bank.table.residuals(values)
    return [part.residual - r for part, r in zip(bank.table.parts, left, strict=True)]


def _nats(bank: Bank, fit: Fit, channels: np.ndarray, columns: list[list[np.ndarray]]) -> np.ndarray:
    """Log Bayes factors of sets of columns beside a fit; `columns[motion][set]` is (M, C, k)."""
    ends = np.cumsum([0, *(x.shape[2] for x in columns[0])])
    sets = [np.arange(low, high) for low, high in itertools.pairwise(ends)]
    wide = [np.concatenate(of_motion, axis=2) for of_motion in columns]
    gram, score = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1])
    cross = np.zeros((len(fit.chosen), ends[-1]))
    for j in channels.tolist():
        white = np.concatenate([bank.noise.whitened(x[:, j], j) for x in wide])
        gram += white.T @ white
        score += bank.residual[j] @ white
        cross += bank.whitened(j, fit.chosen).T @ white
    nats = added(fit, gram, cross, score, sets, SCALES)[0]
    return np.asarray(logsumexp(nats + SCALE_PRIOR, axis=1))
