"""Causes beside the list: general products, and relatives of the names of the best set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from bayescal.motion.cells import UNKNOWN
from bayescal.motion.effects import Form, joint
from bayescal.motion.events import events
from bayescal.motion.linear import Sparse
from bayescal.motion.noise import Noise
from bayescal.motion.pool import Pool, Unlisted
from bayescal.motion.products import Bank, Gains, Product
from bayescal.motion.relatives import relative
from bayescal.motion.search import Hypothesis, Member, Search
from bayescal.motion.settings import PRODUCTS, RELATIVES, SEARCH


def beside(
    pool: Pool, noise: Noise, whole: Search, hypotheses: tuple[Hypothesis, ...]
) -> tuple[Pool, tuple[Hypothesis, ...]]:
    """The pool with columns of the strongest causes beside the list, and the hypotheses with them."""
    bank = pool.bank(noise)
    best = next(h for h in hypotheses if UNKNOWN not in h.names)
    hypotheses = tuple(in_place_of_a_name(h, hypotheses) for h in hypotheses)
    h, unlisted, _ = _unknown(bank, whole, best)
    new, further = [h], [unlisted]
    for m in best.members:
        base = _without(best, m, hypotheses)
        if base is None:
            continue
        h, unlisted, gains = _unknown(bank, whole, base)
        explained = max(best.log_evidence - base.log_evidence, 0.0)
        new.append(replace(h, log_evidence=h.log_evidence - SEARCH.instead * explained))
        further.append(unlisted)
        if free := _free(bank, m, gains):
            product, nats = free
            further.append(_unlisted(product.form, bank.columns(product), 1.0))
            members = (*base.members, Member(product.form, 1.0))
            nats += base.log_evidence - SEARCH.instead * explained
            new.append(Hypothesis(members, nats, best.log_prior))
    for m in best.members:
        r = relative(bank, whole, best.members, m)
        others = [o for o in best.members if o is not m or not r.replaces]
        further.append(_unlisted(r.form, r.columns, 1.0 if r.replaces else RELATIVES.share))
        members = (*others, Member(r.form, 1.0))
        new.append(Hypothesis(members, best.log_evidence + r.gain, best.log_prior))
    ranked = sorted((*hypotheses, *new), key=lambda h: -h.score)
    return pool.extended(list({u.form: u for u in further if u}.values())), tuple(ranked)


def simplified(search: Search, hypotheses: tuple[Hypothesis, ...]) -> tuple[Hypothesis, ...]:
    """The hypotheses, with the leading one without the names that an unknown cause beside them replaces.

    Names are found before unknown causes are: in place of a strong one there may be several.
    """
    h = hypotheses[0]
    while UNKNOWN in h.names and len(h.members) > 1:
        fewer = [_less(search, h, m) for m in h.members if m.form.effect != UNKNOWN]
        best = max(fewer, key=lambda f: f.score)
        if best.score < h.score:
            break
        h = best
    return hypotheses if h is hypotheses[0] else (h, *hypotheses)


def _less(search: Search, h: Hypothesis, m: Member) -> Hypothesis:
    """A set without one of its names."""
    members = tuple(o for o in h.members if o is not m)
    added = search.additions(members).get(m.form.effect)
    evidence = h.log_evidence - added[1] if added else h.log_evidence
    before, after = (search.prior([o.form.effect for o in of]) for of in (h.members, members))
    return Hypothesis(members, evidence, h.log_prior + after - before)


def in_place_of_a_name(h: Hypothesis, hypotheses: Sequence[Hypothesis]) -> Hypothesis:
    """A set with a general function, less a share of what a name in its place explains."""
    if UNKNOWN not in h.names:
        return h
    others = sorted(m.form.effect for m in h.members if m.form.effect != UNKNOWN)
    sets = {tuple(sorted(m.form.effect for m in o.members)): o.log_evidence for o in hypotheses}
    explained = max(
        (nats - sets[tuple(others)] for names, nats in sets.items() if _one_more(others, names)), default=0.0
    )
    return replace(h, log_evidence=h.log_evidence - SEARCH.instead * max(explained, 0.0))


def _one_more(few: Sequence[str], many: Sequence[str]) -> bool:
    """Whether there is one effect more, which is in the list."""
    rest = Counter(many) - Counter(few)
    return len(many) == len(few) + 1 == len(few) + rest.total() and UNKNOWN not in rest


def _without(best: Hypothesis, m: Member, hypotheses: Sequence[Hypothesis]) -> Hypothesis | None:
    """The set in which an effect of the best is missing: an unknown cause may be in its place."""
    names = sorted(o.form.effect for o in best.members if o is not m)
    return next((h for h in hypotheses if sorted(o.form.effect for o in h.members) == names), None)


def _free(bank: Bank, m: Member, gains: Gains) -> tuple[Product, float] | None:
    """Free relatives of an effect of one joint: products of quantities of this joint in its place.

    The one that explains most, and the evidence of all, nats, with their prior odds.
    """
    chosen = [
        (p, nats)
        for p, nats in gains
        if p.form.site == m.form.site
        and joint(bank.first[p.argument].joint or 0) == p.form.site
        and bank.first[p.argument].times == PRODUCTS.responses
    ]
    if not chosen:
        return None
    nats = float(logsumexp([value for _, value in chosen]) - np.log(len(chosen)))
    return max(chosen, key=lambda c: c[1])[0], nats + float(np.log(RELATIVES.free))


def _unknown(bank: Bank, whole: Search, base: Hypothesis) -> tuple[Hypothesis, Unlisted | None, Gains]:
    """A set with an unknown cause: the best of cells, products and events, with the evidence of all."""
    fit = whole.fit(base.members)
    gains = bank.gains(fit)
    nats = np.array([value for _, value in gains])
    product = gains[int(np.argmax(nats))][0]
    general: list[tuple[float, Member, Unlisted | None]] = []

    def add(value: float, form: Form, columns: Sparse) -> None:
        general.append((value, Member(form, 1.0), _unlisted(form, columns, 1.0)))

    add(float(logsumexp(nats) - np.log(len(nats))), product.form, bank.columns(product))
    if cell := whole.additions(base.members).get(UNKNOWN):
        general.append((cell[1], cell[0], None))
    if event := max(events(bank, fit), key=lambda e: e[1], default=None):
        form, value, columns = event
        add(value - float(np.log(len(bank.size))), form, columns)
    # the second test of general functions: half the odds, shared by their kinds
    evidence = float(logsumexp([value for value, _, _ in general])) - np.log(2.0 * len(general))
    evidence += base.log_evidence - SEARCH.form * max(base.log_evidence, 0.0)
    _, member, unlisted = max(general, key=lambda g: g[0])
    prior = whole.prior((*(m.form.effect for m in base.members), UNKNOWN))
    return Hypothesis((*base.members, member), evidence, prior), unlisted, gains


def _unlisted(form: Form, columns: Sparse, sd: float) -> Unlisted:
    count = next(iter(columns[0].values())).shape[1]
    terms = tuple(form.term("1", sd, part=f"function {k + 1}") for k in range(count))
    return Unlisted(form, terms, columns)
