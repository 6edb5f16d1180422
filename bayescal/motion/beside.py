"""Causes beside the list: general products, events, and relatives of the names of the best set.

Events are no function of the motion: torques that change at once and come back. A relative is what a name
predicts, times a function of any other quantity of the log. As for contacts (`bayescal.gap.search.verdict`) a
*modulated* relative is the prediction of the name and, in addition, this prediction times smooth functions of
the quantity; a *replaced* one is the prediction times a positive function, without the name.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import correlate
from scipy.special import gammaln, logsumexp

from bayescal.motion.bank import Bank, Gains, Product, averaged, consecutive
from bayescal.motion.effects import Form, joint
from bayescal.motion.linear import Dots, Fit, Sparse, Temporary, predicted
from bayescal.motion.noise import Noise
from bayescal.motion.pool import Pool, Unlisted
from bayescal.motion.quantities import RESPONSES, UNKNOWN, Argument
from bayescal.motion.search import SCALE_PRIOR, SCALES, Hypothesis, Member, Search
from bayescal.motion.settings import EVENTS, NOISE, RELATIVES, SEARCH
from bayescal.motion.signals import Signals, root_mean_square


def beside(
    pool: Pool, noise: Noise, whole: Search, hypotheses: tuple[Hypothesis, ...]
) -> tuple[Pool, tuple[Hypothesis, ...]]:
    """The pool with columns of the strongest causes beside the list, and the hypotheses with them."""
    best = next(h for h in hypotheses if UNKNOWN not in h.names)
    bank = pool.bank(noise, [m.form for m in best.members])
    hypotheses = tuple(in_place_of_a_name(h, hypotheses) for h in hypotheses)
    less = [(m, base) for m in best.members if (base := _without(best, m, hypotheses))]
    bases = [best, *(base for _, base in less)]
    of_best, *of_less = bank.gains([whole.fit(base.members) for base in bases])
    h, unlisted = _unknown(bank, whole, best, of_best)
    new, further = [h], [unlisted]
    for (m, base), gains in zip(less, of_less, strict=True):
        h, unlisted = _unknown(bank, whole, base, gains)
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

    Its general functions have the scale that explains most.

    Names are found before unknown causes are: in place of a strong one there may be several.
    """
    first = h = search.scaled(hypotheses[0])
    while UNKNOWN in h.names and len(h.members) > 1:
        fewer = [_less(search, h, m) for m in h.members if m.form.effect != UNKNOWN]
        best = max(fewer, key=lambda f: f.score)
        if best.score < h.score:
            break
        h = best
    return (h, *hypotheses[1:]) if h is first else (h, first, *hypotheses[1:])


def _less(search: Search, h: Hypothesis, m: Member) -> Hypothesis:
    """A set without one of its names."""
    members = tuple(o for o in h.members if o is not m)
    added = search.additions(Hypothesis(members, 0.0, 0.0)).get(m.form.effect)
    evidence = h.log_evidence - added[1] if added else h.log_evidence
    before, after = (search.prior([o.form.effect for o in of]) for of in (h.members, members))
    return Hypothesis(members, evidence, h.log_prior + after - before)


def in_place_of_a_name(h: Hypothesis, hypotheses: Sequence[Hypothesis]) -> Hypothesis:
    """A set with a general function, less a share of what a name in its place explains."""
    if UNKNOWN not in h.names:
        return h
    others = sorted(m.form.effect for m in h.members if m.form.effect != UNKNOWN)
    sets = {tuple(sorted(m.form.effect for m in o.members)): o.log_evidence for o in hypotheses}
    more = [nats - sets[tuple(others)] for names, nats in sets.items() if _one_more(others, names)]
    explained = max(more, default=0.0)
    return replace(h, log_evidence=h.log_evidence - SEARCH.instead * max(explained, 0.0))


def _one_more(few: Sequence[str], many: Sequence[str]) -> bool:
    """Whether there is one effect more, which is in the list."""
    added = Counter(many) - Counter(few)
    return len(many) == len(few) + 1 == len(few) + added.total() and UNKNOWN not in added


def _without(best: Hypothesis, m: Member, hypotheses: Sequence[Hypothesis]) -> Hypothesis | None:
    """The set in which an effect of the best is missing: an unknown cause may be in its place."""
    names = sorted(o.form.effect for o in best.members if o is not m)
    return next((h for h in hypotheses if sorted(o.form.effect for o in h.members) == names), None)


def _free(bank: Bank, m: Member, gains: Gains) -> tuple[Product, float] | None:
    """Free relatives of an effect at one site: products of quantities of this site in its place.

    The one that explains most, and the evidence of all, nats, with their prior odds.
    """

    def free(p: Product) -> bool:
        a = bank.first[p.argument]
        free = (p.terms and not a.log_prior) or a.times == tuple(RESPONSES)
        return m.form.site == p.form.site == a.site and bool(free)

    chosen = [(p, nats) for p, nats in gains if free(p)]
    if not chosen:
        return None
    nats = float(logsumexp([value for _, value in chosen]) - np.log(len(chosen)))
    return max(chosen, key=lambda c: c[1])[0], nats + float(np.log(RELATIVES.free))


def _unknown(bank: Bank, whole: Search, base: Hypothesis, gains: Gains) -> tuple[Hypothesis, Unlisted | None]:
    """A set with an unknown cause: the best of cells, products and events, with the evidence of all."""
    least = whole.of_form(base)
    nats = np.array([value - least(bank.channels(product)) for product, value in gains])
    product = gains[int(np.argmax(nats))][0]
    general: list[tuple[float, Member, Unlisted | None]] = []

    def add(value: float, form: Form, columns: Sparse) -> None:
        general.append((value, Member(form, 1.0), _unlisted(form, columns, 1.0)))

    add(float(logsumexp(nats) - np.log(len(nats))), product.form, bank.columns(product))
    if cell := whole.additions(base).get(UNKNOWN):
        general.append((cell[1], cell[0], None))
    if event := max(events(bank, whole.fit(base.members)), key=lambda e: e[1], default=None):
        form, value, columns = event
        value -= least(frozenset().union(*columns)) + float(np.log(len(bank.size)))
        add(value, form, columns)
    # the second test of general functions: half the odds, shared by their kinds
    evidence = float(logsumexp([value for value, _, _ in general])) - np.log(2.0 * len(general))
    evidence += base.log_evidence
    _, member, unlisted = max(general, key=lambda g: g[0])
    prior = whole.prior((*(m.form.effect for m in base.members), UNKNOWN))
    return Hypothesis((*base.members, member), evidence, prior), unlisted


def _unlisted(form: Form, columns: Sparse, sd: float) -> Unlisted:
    count = next(iter(columns[0].values()))().shape[1]
    terms = tuple(form.term("1", sd, part=f"function {k + 1}") for k in range(count))
    return Unlisted(form, terms, columns)


Found = tuple[Form, float, Sparse]
"""A form, its evidence, nats, and its columns."""


@dataclass(frozen=True)
class _Event:
    gain: float  # nats
    motion: int
    row: int  # at which it begins
    pulse: np.ndarray  # rows of it


def events(bank: Bank, fit: Fit) -> Iterator[Found]:
    """Torques of each joint that change at once and come back, where these explain what a fit leaves."""
    order, n = bank.noise.order, len(bank.size)
    parts, every = bank.table.parts, bank.table.residuals(fit.values)
    pairs = zip(parts, every, strict=True)
    white = [[part.whitened(bank.noise, r[:, j], j) for j in range(n)] for part, r in pairs]
    there = [part.weight[:, :n] > NOISE.there for part in parts]
    nats = surprise(np.concatenate([np.column_stack(e)[rows] for e, rows in zip(white, there, strict=True)]))
    tried = np.log(len(EVENTS.constants) * sum(map(len, every)))
    first = parts[0].signals
    pulses = [_pulse(first, c) for c in EVENTS.constants if c > EVENTS.samples * first.step]
    for j in range(n):
        candidates = []
        for pulse in pulses:
            shape = bank.noise.whitened(np.r_[np.zeros(order), pulse], j)[order:] * bank.size[j]
            for p, residual in enumerate(white):
                if len(shape) > len(residual[j]) - order:
                    continue
                e, ones = residual[j][order:], np.ones(len(shape))
                gain = _averaged(correlate(e, shape, "valid") ** 2, float(shape @ shape))
                # rows that noise with such tails has now and then are no event
                gain *= correlate(nats(e), ones, "valid") / correlate(0.5 * e**2 + 1e-9, ones, "valid")
                gain -= tried
                rows = np.flatnonzero(gain > 0.0).tolist()
                candidates += [_Event(float(gain[k]), p, k + order, pulse) for k in rows]
        chosen: list[_Event] = []
        for c in sorted(candidates, key=lambda c: -c.gain):
            beside_it = (o for o in chosen if o.motion == c.motion)
            apart = all(abs(c.row - o.row) > max(len(c.pulse), len(o.pulse)) for o in beside_it)
            if apart and len(chosen) < EVENTS.most:
                chosen.append(c)
        # a single row that is off is a wrong reading
        if chosen and (len(chosen) > 1 or len(chosen[0].pulse) > len(pulses[0])):
            s = parts[chosen[0].motion].signals
            since = s.kept(s.time)[chosen[0].row] - s.time[0]
            when = f"{len(chosen)} of them, the strongest {since:.1f} s after the start of motion {s.name}"
            form = Form(UNKNOWN, joint(j), "time, single events", when)
            columns = [np.zeros((len(part.residual), len(chosen))) for part in parts]
            for k, event in enumerate(chosen):
                end = event.row + len(event.pulse)
                weight = parts[event.motion].weight[event.row : end, j]
                columns[event.motion][event.row : end, k] = weight * event.pulse * bank.size[j]
            put = Temporary().put
            yield form, sum(c.gain for c in chosen), [{j: put(x)} for x in columns]


def surprise(white: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Nats by which whitened rows are less dense than 0, by Student's t with the tails of all rows.

    Those of a normal density, e^2 / 2, are not exceeded.
    """
    variance = float(np.mean(white**2))

    def density(e: np.ndarray, nu: float) -> np.ndarray:
        scaled = np.log1p(e**2 / (variance * (nu - 2.0)))
        return np.asarray(0.5 * (nu + 1.0) * scaled)

    def whole(nu: float) -> float:
        level = gammaln((nu + 1.0) / 2.0) - gammaln(nu / 2.0) - 0.5 * np.log(nu - 2.0)
        return float(np.sum(level - density(white, nu)))

    best = max(EVENTS.tails, key=whole)
    return lambda e: np.minimum(density(e, best), 0.5 * e**2)


def _pulse(s: Signals, constant: float) -> np.ndarray:
    """A torque that changes at once and comes back with a time constant, as rows that are kept show it."""
    since = s.time - s.time[len(s.time) // 3]
    rows = s.kept(np.where(since < 0.0, 0.0, np.exp(-np.maximum(since, 0.0) / constant)))
    first = int(np.argmax(np.abs(rows) > EVENTS.visible))
    return rows[first : first + round(EVENTS.length * constant / (s.step * s.every)) + 2]


def _averaged(square: np.ndarray, size: float) -> np.ndarray:
    """Log Bayes factors of single columns by their squared scores and information, averaged over scales."""
    by = SCALES**2 * size
    nats = 0.5 * square[..., None] * SCALES**2 / (1.0 + by) - 0.5 * np.log1p(by)
    return np.asarray(logsumexp(nats + SCALE_PRIOR, axis=-1))


@dataclass(frozen=True)
class Relative:
    """A relative of a member of a hypothesis, with its columns."""

    form: Form
    gain: float  # nats over the hypothesis with the name, averaged over all quantities
    columns: Sparse
    replaces: bool  # whether the name is left out


def relative(bank: Bank, search: Search, members: Sequence[Member], member: Member) -> Relative:
    """The strongest relative of a member, with the evidence of all of its relatives."""
    fit, without = search.fit(members), search.fit([m for m in members if m is not member])
    rows = predicted(bank.table, fit, search.terms[member.form])
    size = root_mean_square(rows)
    live = np.flatnonzero(size > RELATIVES.least * np.max(size))
    given, share = bank.first, RELATIVES.share

    def modulations(p: np.ndarray, of_motion: Sequence[Argument]) -> list[np.ndarray]:
        return [p * (share * a.functions) for a in of_motion]

    def replacements(p: np.ndarray, of_motion: Sequence[Argument]) -> list[np.ndarray]:
        return [p, *(p * f[:, None] for a in of_motion for f in _factors(a))]

    origin = [k for k, a in enumerate(given) for _ in _factors(a)]
    modulated = _nats(bank, fit, live, rows, modulations)
    replaced = _nats(bank, without, live, rows, replacements)
    replaced = replaced[1:] - replaced[0] + np.log(RELATIVES.replaced / len(origin))
    modulated += np.log(RELATIVES.modulated / len(given))
    i = int(np.argmax(replaced))
    instead = bool(replaced[i] > np.max(modulated))
    k = origin[i] if instead else int(np.argmax(modulated))
    form = replace(member.form, effect=UNKNOWN, driver=f"{member.form.driver} times {given[k].name}")
    columns, put = [], Temporary().put
    for p, (_, _, of_motion) in zip(rows, bank.motions(), strict=True):
        by = _factors(of_motion[k])[i % 2][:, None] if instead else of_motion[k].functions
        columns.append({c: put(p[:, c, None] * by) for c in live.tolist()})
    # a part of what a name explains may belong to its form
    forgiven = SEARCH.form * max(fit.log_evidence - without.log_evidence, 0.0)
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
    """Log Bayes factors of sets beside a fit; `columns` has them (M, k), of a prediction (M, 1)."""
    dots: dict[int, Dots] = {}
    sets: tuple[np.ndarray, ...] = ()
    for p, (part, _, given) in zip(rows, bank.motions(), strict=True):
        for c in channels.tolist():
            every = columns(p[:, c, None], given)
            sets = consecutive([x.shape[1] for x in every])
            bank.count(dots, part, fit.names, c, np.hstack(every), sets, into=0)
    return averaged(fit, dots[0], sets)
