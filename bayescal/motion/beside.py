"""Causes beside the list: general products, and relatives of the names of the best set."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from bayescal.motion.cells import UNKNOWN
from bayescal.motion.effects import Form
from bayescal.motion.events import events
from bayescal.motion.noise import Noise
from bayescal.motion.pool import Pool, Unlisted
from bayescal.motion.products import Bank
from bayescal.motion.relatives import relative
from bayescal.motion.search import Hypothesis, Member, Search
from bayescal.motion.settings import RELATIVES, SEARCH


def beside(
    pool: Pool, noise: Noise, whole: Search, hypotheses: tuple[Hypothesis, ...]
) -> tuple[Pool, tuple[Hypothesis, ...]]:
    """The pool with columns of the strongest causes beside the list, and the hypotheses with them."""
    bank = pool.bank(noise)
    best = next(h for h in hypotheses if UNKNOWN not in h.names)
    general = _general(bank, whole, best)
    evidence = best.log_evidence - SEARCH.form * max(best.log_evidence, 0.0)
    # the second test of general functions: half the odds, shared by their kinds
    evidence += float(logsumexp([nats for _, nats, _ in general])) - np.log(2.0 * len(general))
    member, _, unlisted = max(general, key=lambda g: g[1])
    further = [unlisted] if unlisted else []
    prior = whole.prior((*(m.form.effect for m in best.members), UNKNOWN))
    new = [Hypothesis((*best.members, member), evidence, prior)]
    for m in best.members:
        r = relative(bank, whole, best.members, m)
        others = [o for o in best.members if o is not m or not r.replaces]
        sd = 1.0 if r.replaces else RELATIVES.share
        further.append(_unlisted(r.form, r.columns, sd))
        nats = best.log_evidence + r.gain
        new.append(Hypothesis((*others, Member(r.form, 1.0)), nats, best.log_prior))
    ranked = sorted((*hypotheses, *new), key=lambda h: -h.score)
    return pool.extended(further), tuple(ranked)


def _general(bank: Bank, whole: Search, best: Hypothesis) -> list[tuple[Member, float, Unlisted | None]]:
    """Cells, products and events: the strongest of each, and the evidence of all of its kind, nats."""
    fit = whole.fit(best.members)
    gains = bank.gains(fit)
    nats = np.array([value for _, value in gains])
    product = gains[int(np.argmax(nats))][0]
    unlisted = _unlisted(product.form, bank.columns(product), 1.0)
    out: list[tuple[Member, float, Unlisted | None]] = [
        (Member(product.form, 1.0), float(logsumexp(nats) - np.log(len(nats))), unlisted)
    ]
    cell = whole.additions(best.members).get(UNKNOWN)
    out.append((*cell, None) if cell else (Member(product.form, 1.0), -np.inf, unlisted))
    found = max(events(bank, fit), key=lambda e: e[1], default=None)
    if found:
        out.append(
            (
                Member(found[0], 1.0),
                found[1] - np.log(bank.table.parts[0].signals.log.n),
                _unlisted(found[0], found[2], 1.0),
            )
        )
    return out


def _unlisted(form: Form, columns: tuple[np.ndarray, ...], sd: float) -> Unlisted:
    terms = tuple(form.term("N m", sd, part=f"function {k + 1}") for k in range(columns[0].shape[2]))
    return Unlisted(form, terms, columns)
