"""The diagnosis of a log: which effects explain what the baseline leaves, where, and how errors shrink.

Its result as frozen records, in SI. What to log next for a cause that is left open: what a person does.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayescal.assess.findings import FAR
from bayescal.errors import BayescalError
from bayescal.logs import Log
from bayescal.logs.types import CALIBRATE, SERVO, VALIDATE
from bayescal.motion.beside import beside, simplified
from bayescal.motion.controller import with_torques
from bayescal.motion.effects import EFFECTS, Form
from bayescal.motion.estimate import Estimate, contradicted, estimate_of, noise_about
from bayescal.motion.expected import Expected, expected_of
from bayescal.motion.linear import Fit, Normal, joined, normal
from bayescal.motion.pool import Pool
from bayescal.motion.possible import NamedArm, named_arm
from bayescal.motion.search import Member, Search, Verdict, confirmed, decide
from bayescal.motion.settings import NOISE, OUTCOME, SEARCH, VERDICT
from bayescal.motion.signals import root_mean_square as rms
from bayescal.motion.signals import where_moving
from bayescal.motion.terms import DELAY
from bayescal.storage.reading import table_beside
from bayescal.storage.stopping import Progress, silent


@dataclass(frozen=True)
class Place:
    """Where an effect, or an unknown cause, acts, and its part of the torque residuals."""

    form: Form
    nats: float  # that the leading set loses without it; of others, gain over noise only
    kind: str  # of the residuals in which it is shown, see `bayescal.motion.terms`
    rms: float  # N m or rad, by which it changes what is left of all motions, in its largest joint
    joint: int  # of that, from 0
    explained_by: str  # the named effect, or ""


@dataclass(frozen=True)
class Amplitude:
    """The amplitude of a named effect at one site, SI."""

    form: Form
    value: float  # of several components the length of the vector, or the most significant one: `part`
    u: float
    unit: str
    components: Mapping[str, tuple[float, float]]  # by name, with u; () of a single one
    relevant: bool  # whether the withheld error shrinks by `OUTCOME.relevant`
    removed: float  # share by which the withheld RMS of the joint with most shrinks
    units: Mapping[str, str] = field(default_factory=dict)  # of components of several units
    part: str = ""  # the component that the value is of, where they have several units


@dataclass(frozen=True)
class Course:
    """Torque residuals of the withheld motion with most error, N m, at some of its rows; NaN at rest."""

    motion: str
    time: np.ndarray  # (R,) s since the motion began
    before: np.ndarray  # (R, n)
    after: np.ndarray


@dataclass(frozen=True)
class Shrinkage:
    """RMS of the torque residuals on moving rows of validation motions, N m, by joint (n,)."""

    before: np.ndarray
    after: np.ndarray
    expected: Expected
    removed: float  # share of the excess variance, over all joints in units of the noise; nan without excess
    removed_interval95: tuple[float, float]
    gain: float  # log predictive density of the validation motions, nats, over the baseline
    course: Course


@dataclass(frozen=True)
class Tracking:
    """Errors of withheld motions that a simulator moves by the logged commands, on moving rows."""

    rms: np.ndarray  # (n,) rad, of positions
    torque: np.ndarray  # (n,) N m
    blocks: np.ndarray  # (B, n) rad2, mean squares of parts of the motions
    motions: int  # that were simulated

    def removed(self, before: Tracking) -> tuple[float, tuple[float, float]]:
        """Share of the mean square of all joints that an arm has less than another, and its 95 % interval."""
        first, last = before.blocks.sum(axis=1), self.blocks.sum(axis=1)
        picked = np.random.default_rng(0).integers(0, len(first), (OUTCOME.draws, len(first)))
        draws = 1.0 - last[picked].sum(axis=1) / first[picked].sum(axis=1)
        low, high = np.quantile(draws, (0.025, 0.975))
        return float(1.0 - last.sum() / first.sum()), (float(low), float(high))


@dataclass(frozen=True)
class MotionGap:
    """A diagnosis of a joint log."""

    estimate: Estimate
    verdict: Verdict
    where: tuple[Place, ...]
    amplitudes: tuple[Amplitude, ...]
    shrinkage: Shrinkage
    hypotheses: tuple[tuple[tuple[str, ...], float, float], ...]  # effects, probability, nats; best first
    not_assessed: Mapping[str, str]  # by effect, why
    advice: tuple[str, ...]
    values: Mapping[str, float]  # of all terms of the model with the names
    u: Mapping[str, float]
    warnings: tuple[str, ...]
    model: NamedArm  # without effects
    arm: NamedArm  # with the named ones
    unseen: tuple[Form, ...]  # of the leading set, that fitted motions show at no plausible size
    tracking: Mapping[str, Tracking] | str = ""  # of arms nominal, model, effects; or why there is none


Motions = Sequence[np.ndarray]
"""Of each motion (N, n)."""
TO_DO = tuple(table_beside(__file__, "to_do.toml").items())
"""Words in the name of a quantity, a regular expression, and what to log; the first counts."""


def to_do(form: Form) -> str:
    """What to log, for an error that varies with a quantity at a site."""
    who = form.site if form.site.startswith("joint ") else "each joint"
    of = re.search(r"\bof (joint \d+)", form.driver)
    other = of[1] if of else who
    driver = form.driver.replace(f" of {other}", "") if other == form.site else form.driver
    what = next(text for words, text in TO_DO if re.search(rf"\b{words}\b", driver))
    site = f" at {form.site}" if who == form.site else ""
    return f"{what.format(who=who, other=other)} (to tell what varies with {form.driver}{site})"


def diagnose(log: Log, progress: Progress = silent) -> MotionGap:
    """Diagnose a joint log.

    Raises
    ------
    BayescalError
        If the log has no torques with a sign, or no motion of a role that is needed.
    """
    log = with_torques(log)
    if not log.of_role(VALIDATE):
        raise BayescalError("no motion has the role validate", log.name, "withhold one or more")
    progress("signals", 0.0)
    estimate = estimate_of(log)
    progress("columns", 0.2)
    pool = Pool.of(estimate)
    noise = estimate.noise
    motions = pool.table.of_role(CALIBRATE)
    for k in range(NOISE.repeats):
        progress("search", 0.4 + 0.2 * k)
        search = pool.search(normal(motions, noise))
        fit = search.fit(members := search.run()[0].members)
        if any(m.form.effect == DELAY for m in members) and log.torque_kind != SERVO:
            pool = Pool.of(estimate := estimate.relinearised(fit))
            motions = pool.table.of_role(CALIBRATE)
        noise = noise_about(motions, fit)
    seen, held = normal(motions, noise), normal(pool.table.of_role(VALIDATE), noise)
    # all motions tell which effects there are; how large they are, those of role `calibrate` alone
    whole = pool.search(joined(seen, held))
    hypotheses = whole.run()
    progress("causes beside the list", 0.7)
    pool, hypotheses = beside(pool, noise, whole, hypotheses)
    seen = normal(pool.table.of_role(CALIBRATE), noise, seen)
    held = normal(pool.table.of_role(VALIDATE), noise, held)
    search, whole = pool.search(seen), pool.search(joined(seen, held))
    hypotheses = simplified(whole, hypotheses)
    verdict = confirmed(decide(whole, hypotheses), search, held)
    progress("result", 0.8)
    named = search.fit(verdict.named.members)
    model = named_arm(estimate, search.fit(), pool.scale)
    far = [n for n, z in zip(named.names, named.z, strict=True) if n in whole.base and abs(z) > FAR]
    score = np.array([h.score for h in hypotheses])
    weight = np.exp(score - np.max(score))
    ranked = zip(hypotheses[: VERDICT.listed], weight / np.sum(weight), strict=False)
    return MotionGap(
        estimate=estimate,
        verdict=verdict,
        where=places(whole, pool, verdict),
        amplitudes=amplitudes(search, pool, verdict),
        shrinkage=shrinkage(search, pool, verdict, held),
        hypotheses=tuple((h.names, float(w), h.log_evidence) for h, w in ranked),
        not_assessed=not_assessed(search, pool),
        advice=tuple(advice(pool, verdict)),
        values=named.values,
        u=named.u,
        warnings=(*estimate.limits, *contradicted(far)),
        model=model,
        arm=named_arm(estimate, named, pool.scale) if verdict.named.members else model,
        unseen=tuple(m.form for m in verdict.leading.members if not search.seen_forms.get(m.form, True)),
    )


def places(whole: Search, pool: Pool, v: Verdict) -> tuple[Place, ...]:
    """Sites of the leading set, the largest first, and further cells; by all motions, as the set is."""
    out = []
    fit = whole.fit(v.leading.members)
    for m in v.leading.members:
        without = whole.fit([o for o in v.leading.members if o is not m])
        effect = m.form.effect if m.form.effect in v.named.names else ""
        out.append(_place(pool, without, fit, m.form, fit.log_evidence - without.log_evidence, effect))
    out.sort(key=lambda place: -place.nats)
    taken = {place.form.site for place in out}
    for form, gain in whole.cells(v.leading.members)[: OUTCOME.places]:
        if form.site not in taken and gain > SEARCH.gain:
            wide = whole.fit((*v.leading.members, Member(form, 1.0)))
            out.append(_place(pool, fit, wide, form, gain, ""))
            taken.add(form.site)
    return tuple(out)


def _place(pool: Pool, without: Fit, fit: Fit, form: Form, nats: float, explained_by: str) -> Place:
    """The place of a form, and by how much it changes the residuals of a fit without it.

    What other parameters would take of it is no part of that. Kind and joint of the residuals are those that
    it changes most, in units of the noise.
    """
    log = pool.estimate.parts[0].log
    residuals = zip(pool.table.residuals(without.values), pool.table.residuals(fit.values), strict=True)
    size = rms(before - after for before, after in residuals)
    k = int(np.argmax(size / pool.estimate.noise.sd))
    return Place(form, nats, log.kinds[k // log.n], float(size[k]), k % log.n, explained_by)


def amplitudes(search: Search, pool: Pool, v: Verdict) -> tuple[Amplitude, ...]:
    """Amplitudes of the named effects, and whether they matter on withheld motions."""
    fit, out = search.fit(v.named.members), []
    after = _withheld(pool, fit)
    for m in v.named.members:
        names = search.terms[m.form]
        units = {_part(m.form, n): search.normal.terms[search.normal.index[n]].unit for n in names}
        parts = {_part(m.form, n): (fit.values[n], fit.u[n]) for n in names}
        for p, (size, sd) in parts.items() if EFFECTS[m.form.effect].by_load else ():
            j = int((p if m.form.of_each else m.form.site).split()[1]) - 1
            parts[p] = size, float(np.hypot(sd, size * _of_load(pool, fit, j)))
        unit = next(iter(units.values()))
        if several := len(set(units.values())) > 1:
            part = max(parts, key=lambda p: abs(parts[p][0]) / parts[p][1])
            (value, u), unit = parts[part], units[part]
        else:
            value, u = parts.popitem()[1] if len(parts) == 1 else _length(fit, names)
        before = _withheld(pool, search.fit([o for o in v.named.members if o is not m]))
        removed = float(np.max(1.0 - after / np.where(before > 0.0, before, np.inf)))
        further = (units, part) if several else ()
        out.append(Amplitude(m.form, value, u, unit, parts, removed >= OUTCOME.relevant, removed, *further))
    return tuple(out)


def _withheld(pool: Pool, fit: Fit) -> np.ndarray:
    """RMS (C,) of what a fit leaves of validation motions, by channel: an effect matters where it shows."""
    n, beside = pool.estimate.parts[0].log.n, pool.table.of_role(VALIDATE).residuals(fit.values)
    return np.concatenate([rms(moving(pool, fit)), rms(residual[:, n:] for residual in beside)])


def _part(form: Form, term: str) -> str:
    """The part of a form that a term is: an axis, a wave, or the joint of a form in all joints."""
    stem = form.term("", 0.0).name
    return term.removeprefix(stem).strip() if term.startswith(stem) else " ".join(term.split()[1:3])


def _of_load(pool: Pool, fit: Fit, j: int) -> float:
    """Relative standard uncertainty of the torque that a gear carries, by the bodies of a fit."""
    table = pool.table.of_role(CALIBRATE)
    bodies = [k for k, term in enumerate(table.terms) if " of link " in term.name]
    along, size = np.zeros(len(table.terms)), 0.0
    for part in table.parts:
        s, (numbers, x) = part.signals, part.of(j)
        load = s.kept(s.weight[:, j] * pool.estimate.model.load(s)[:, j])
        along[numbers] += load @ x
        size += float(load @ load)
    chosen = [fit.names.index(table.terms[k].name) for k in bodies]
    by = along[bodies] / max(size, 1e-300) * fit.sd[chosen]
    return float(np.sqrt(by @ fit.covariance[np.ix_(chosen, chosen)] @ by))


def _length(fit: Fit, names: Sequence[str]) -> tuple[float, float]:
    """Length of a vector of terms of one unit, and its standard uncertainty along the vector."""
    terms = fit.names
    indices = [terms.index(name) for name in names]
    sd = fit.sd[indices]
    vector = fit.z[indices] * sd
    covariance = fit.covariance[np.ix_(indices, indices)] * np.outer(sd, sd)
    size = float(np.linalg.norm(vector))
    along = vector / max(size, 1e-300)
    return size, float(np.sqrt(along @ covariance @ along))


def moving(pool: Pool, fit: Fit) -> list[np.ndarray]:
    """What a fit leaves of the torques of validation motions, N m, each (N, n), NaN of joints at rest."""
    return [where_moving(residual, s) for s, residual in pool.unfiltered(fit.values)]


def shrinkage(search: Search, pool: Pool, v: Verdict, held: Normal) -> Shrinkage:
    """Torque error on validation motions with the baseline and with the named effects."""
    null, named = search.fit(), search.fit(v.named.members)
    before, after = moving(pool, null), moving(pool, named)
    off = pool.unfiltered(search.fit(v.leading.members).values, CALIBRATE)
    expected = expected_of(pool.estimate.model, off, pool.table.of_role(VALIDATE), named)
    gain = 0.5 * (null.chi2(held) - named.chi2(held))
    share, low, high = np.nan, np.nan, np.nan
    if v.named.members:
        size = expected.rms
        first, last = (np.concatenate([_blocks(x / size, pool) for x in of]) for of in (before, after))
        share = float(_removed(first, last))
        picked = np.random.default_rng(0).integers(0, len(first), (OUTCOME.draws, len(first)))
        draws = _removed(first[picked], last[picked])
        if np.any(np.isfinite(draws)):
            low, high = map(float, np.nanquantile(draws, (0.025, 0.975)))
    shown = course(pool, expected.floor, before, after)
    return Shrinkage(rms(before), rms(after), expected, share, (low, high), gain, shown)


def course(pool: Pool, floor: np.ndarray, before: Motions, after: Motions) -> Course:
    """What is left in the validation motion with most error, at some of its rows."""
    size = np.where(floor > 0.0, floor, np.inf)  # of a joint that never moves it is not known
    k = int(np.argmax([np.nansum((x / size) ** 2) / len(x) for x in before]))
    s = [s for s in pool.estimate.parts if s.role == VALIDATE][k]
    rows = slice(None, None, max(len(before[k]) // OUTCOME.drawn, 1))
    return Course(s.name, s.unfiltered(s.time)[rows] - s.time[0], before[k][rows], after[k][rows])


def _blocks(x: np.ndarray, pool: Pool) -> np.ndarray:
    """Mean squares (B, n) of blocks of residuals (N, n) that are long against their correlation."""
    size = max(round(OUTCOME.block / pool.estimate.parts[0].step), 1)
    count = max(len(x) // size, 1)
    masked = np.ma.masked_invalid(x) ** 2
    return np.array([part.mean(axis=0).filled(np.nan) for part in np.array_split(masked, count)])


def _removed(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Shares (...) of the excess variance, in units of the noise (..., B, n), removed, at most all of it."""
    over, gone = (_means(x).sum(axis=-1) for x in (before - 1.0, before - after))
    share = np.divide(gone, over, out=np.full(np.shape(over), np.nan), where=over > 0.0)
    return np.minimum(share, 1.0)


def _means(x: np.ndarray) -> np.ndarray:
    """Means (..., n) of the finite values of (..., B, n), 0 where there are none."""
    finite = np.isfinite(x)
    return np.where(finite, x, 0.0).sum(axis=-2) / np.maximum(finite.sum(axis=-2), 1)


def not_assessed(search: Search, pool: Pool) -> dict[str, str]:
    """Effects that this log does not show, and why."""
    log = pool.estimate.parts[0].log
    out = {name: why for name, effect in EFFECTS.items() if (why := effect.lacks(log))}
    unseen = "not detectable in the fitted motions at any plausible amplitude"
    out |= {name: unseen for name in EFFECTS if name not in out and not search.seen.get(name, False)}
    return out


def advice(pool: Pool, v: Verdict) -> Iterator[str]:
    """What to log next."""
    parts, log = pool.estimate.parts, pool.estimate.parts[0].log
    if len({s.same_as for s in parts}) == len(parts):
        yield "repeat one motion three times: the noise is then known without the model"
    if not any(m.loaded for m in log.motions):
        yield "log motions with a known payload, in turn with unloaded ones"
    elif all(m.loaded for m in log.motions):
        yield "log motions without the payload, in turn with loaded ones"
    if log.motions[0].temperature is None:
        yield "log the temperature of the joints"
    slow = [np.sum((np.abs(s.dq) > 0.002) & (np.abs(s.dq) < OUTCOME.slow), axis=0) for s in parts]
    slow = np.sum(slow, axis=0) / sum(len(s.dq) for s in parts)
    if np.any(slow < OUTCOME.slow_share):
        joints = ", ".join(str(j + 1) for j in np.flatnonzero(slow < OUTCOME.slow_share))
        yield f"cross the range slowly (below {OUTCOME.slow:g} rad/s) with joint {joints}"
    if v.left_open:
        yield to_do(v.leading.members[-1].form)
