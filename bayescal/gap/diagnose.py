"""A complete diagnosis: fit, search, verdict, refit, and all results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import EFFECTS, Circumstances, Parameter
from bayescal.effects.base_compliance import BASE_COMPLIANCE
from bayescal.effects.bending import BENDING
from bayescal.effects.compliance import expected
from bayescal.estimate import Estimate, calibrated, check_enough, estimate
from bayescal.gap.design.advise import advise
from bayescal.gap.design.blind_spots import blind_spots, unseen
from bayescal.gap.linear.masses import masses
from bayescal.gap.linear.problem import (
    Problem,
    Slopes,
    State,
    again,
    fit_state,
    of_certificate,
    without_nuisance,
)
from bayescal.gap.outcome.levels import model_levels
from bayescal.gap.outcome.magnitude import magnitude, noise_floor
from bayescal.gap.outcome.margins import margins
from bayescal.gap.outcome.notes import cautions, play_or_late, warnings
from bayescal.gap.outcome.shrinkage import shrinkage
from bayescal.gap.outcome.where import places, places_named
from bayescal.gap.result import Gap, Hypothetical, Named, Place, Verdict
from bayescal.gap.search.beam import COMPLIANCE, Hypothesis, Member, Search
from bayescal.gap.search.candidates import Candidates, candidates, wide
from bayescal.gap.search.cells import cells
from bayescal.gap.search.gate import confirmed
from bayescal.gap.search.refit import model_name, refit
from bayescal.gap.search.screen import screened
from bayescal.gap.search.unknown import Pool
from bayescal.gap.search.verdict import Decision, decide
from bayescal.gap.settings import VERDICT
from bayescal.model import ORIENTATION, check_asked, with_parameters
from bayescal.model.length_blocks import length_blocks, main_group
from bayescal.model.parts import Part, parts_of
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import ValidationErrors, validation_errors
from bayescal.streams import spawned

UNSEEN = "not detectable with these contacts at any plausible amplitude"
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Examined:
    """A baseline and all hypotheses that were evaluated with it."""

    fitted: Estimate
    circumstances: Circumstances
    candidates: Candidates
    problem: Problem
    pool: Pool
    search: Search
    decision: Decision


def with_compliance(c: Circumstances, fitted: Estimate) -> Circumstances:
    """Circumstances with the fitted compliances: other effects act through them."""
    known = expected(c.robot).copy()
    values = fitted.model.physical(fitted.z)
    for value, p in zip(values, fitted.model.parameters, strict=False):
        if p.effect == COMPLIANCE:
            known[p.site.number - 1] = max(value, 0.2 * p.centre)
    yields = {
        p.name: value
        for value, p in zip(values.tolist(), fitted.model.parameters, strict=False)
        if p.effect in (BENDING.name, BASE_COMPLIANCE.name)
    }
    return replace(c, compliance=known, yields=yields)


def examine(
    scene: Scene,
    effects: tuple[str, ...],
    robust: bool,
    prior_width: float,
    without: Sequence[Part] = (),
    further: bool = False,
) -> Examined:
    """Fit a baseline at the deflected pose of the arm, and evaluate all effects that it lacks.

    `further`: an effect was named before.
    """
    fitted = calibrated(scene, effects, prior_width, robust, without)
    stands = fitted.model.scene
    c = with_compliance(stands.circumstances(stands.rows("calibrate")), fitted)
    nuisance = masses(c, stands.delta) if COMPLIANCE in effects else []
    known = candidates(c, effects, without)
    found = _weighed(fitted, fitted, c, known, nuisance, robust, further)
    members = found.decision.members
    if members and ORIENTATION in fitted.weights.scale:
        final = refit(fitted, found.candidates.pool, members, robust)
        if not _alike(fitted, final):
            found = _weighed(fitted, final, c, known, nuisance, robust, further)
    return found


def _weighed(
    fitted: Estimate, noise: Estimate, c: Circumstances, known: Candidates, nuisance: Sequence[Parameter],
    robust: bool, further: bool,
) -> Examined:  # fmt: skip
    """Evaluate all effects that a fit lacks, with the noise ratio of orientations to lengths of `noise`."""
    effects, generic = fitted.model.effects, cells(c)
    scale = dict(fitted.weights.scale)
    if ORIENTATION in scale:
        main = main_group(fitted.model)
        scale[ORIENTATION] = scale[main] * _looseness(noise)
    slopes = Slopes.of(
        replace(fitted, weights=replace(fitted.weights, scale=scale)),
        [p for p in known.pool if of_certificate(p)],
    )
    p = slopes.problem(fitted.z, known.pool, nuisance)
    if any(wide(effect, c) for effect in EFFECTS.values()):
        states = [fit_state(p, (), (), robust=r) for r in ((True, False) if robust else (False,))]
        known = screened(known, slopes, states, c, effects)
        p = slopes.problem(fitted.z, known.pool, nuisance)
    pool = Pool.of(
        generic, slopes.columns([q for cell in generic for own in cell.sets for q in own]), p.count
    )
    search = Search(p, known, robust, further)
    search.run()
    return Examined(fitted, c, known, p, pool, search, decide(search, pool))


def _looseness(fitted: Estimate) -> float:
    """Noise scale of the orientations over that of the lengths."""
    return fitted.weights.scale[ORIENTATION] / fitted.weights.scale[main_group(fitted.model)]


def _alike(a: Estimate, b: Estimate) -> bool:
    """Whether the noise ratio is equal in both: an error of orientations only first looks like noise."""
    return bool(abs(np.log(_looseness(a) / _looseness(b))) < np.log(VERDICT.alike))


@dataclass(frozen=True)
class Explained:
    """A baseline, the named effects, and the validation residuals of both models."""

    first: Examined
    last: Examined  # the same, or with compliance in the model where that was `promoted`
    promoted: bool
    before: ValidationErrors  # of the baseline
    final: Estimate  # with the named effects
    after: ValidationErrors

    @property
    def verdict(self) -> Verdict:
        """Which effect."""
        return _verdict(self.last, self.first.decision if self.promoted else None)


def explain(
    scene: Scene,
    effects: tuple[str, ...],
    robust: bool = True,
    prior_width: float = 1.0,
    without: Sequence[Part] = (),
    progress: Progress = lambda stage, fraction: None,
) -> Explained:
    """Name effects that a baseline lacks, if validation measurements confirm them; see `diagnose`."""
    progress("estimate", 0.0)
    first = examine(scene, effects, robust, prior_width, without)
    progress("search", 0.3)
    last, promoted = first, COMPLIANCE not in effects and _promoted(first)
    if promoted:
        last = examine(scene, (*effects, COMPLIANCE), robust, prior_width, without, further=True)
    progress("refit", 0.6)
    before = validation_errors(first.fitted)
    last, final, after = _confirmed(last, validation_errors(last.fitted) if promoted else before, robust)
    return Explained(first, last, promoted, before, final, after)


def diagnose(
    dataset: Dataset,
    effects: tuple[str, ...] = ("geometry", COMPLIANCE),
    seed: int = 0,
    robust: bool = True,
    prior_width: float = 1.0,
    progress: Progress = lambda stage, fraction: None,
    without: Sequence[str] = (),
) -> Gap:
    """Diagnose the gap between a calibrated model and the machine.

    Parameters
    ----------
    dataset : Dataset
    effects : tuple of str
        The baseline model: names of `effects.EFFECTS`.
    seed : int
        Of intervals; the same seed gives the same result.
    robust : bool
        Exclude the outliers of every hypothesis.
    prior_width : float
        Factor on the prior standard deviations of the arm.
    progress : callable
        Called with the stage and its completed fraction.
    without : sequence of str
        Parts of the effects that the model lacks and that are candidates: 'geometry at joint 4'; see `Part`.

    Raises
    ------
    BayescalError
        If the session cannot be fitted, or the model has no such part, with the reason.
    """
    check_asked(effects, prior_width)
    parts = parts_of(without, effects)
    scene = Scene(dataset, oriented=True)
    check_enough(scene)
    found = explain(scene, effects, robust, prior_width, parts, progress)
    first, last, promoted, final = found.first, found.last, found.promoted, found.final
    before, after, members = found.before, found.after, last.decision.members
    noise = noise_floor(final, after.main)
    progress("report", 0.8)
    of_magnitude, of_shrinkage = spawned(seed, 2)
    size = magnitude(first.fitted, final, before, after, of_magnitude)
    chosen = last.decision.hypothesis
    changed = bool(members) or promoted
    levels = _levels(scene, effects, prior_width, robust, parts, found)
    known = {id(first.fitted): before, id(final): after}
    errors = [known.get(id(e)) or validation_errors(e) for _, e in levels]
    plain = without_nuisance(last.problem, last.fitted.model.size)
    named = tuple(m.effect for m in members)
    spots = blind_spots(last.fitted, last.candidates, plain, again(chosen.state, plain), named)
    pairs = [
        (replace(a, state=again(a.state, plain)), replace(b, state=again(b.state, plain)))
        for a, b in _rivals(last)
    ]
    return Gap(
        dataset=dataset,
        baseline=effects,
        seed=seed,
        magnitude=size,
        where=_where(first, last, promoted, noise.sd),
        margins=margins(first.fitted, before, noise.sd, noise.dof),
        verdict=found.verdict,
        shrinkage=shrinkage(before, after, noise.sd, of_shrinkage, noise.dof) if changed else (),
        levels=model_levels(levels, errors),
        advice=advise(last.fitted, last.candidates, pairs),
        blind_spots=unseen(spots),
        residuals=_residuals(first.fitted, final),
        warnings=warnings(first.fitted, final, before, after),
        without=tuple(map(str, parts)),
    )


def _confirmed(
    e: Examined, before: ValidationErrors, robust: bool
) -> tuple[Examined, Estimate, ValidationErrors]:
    """The refit with the named effects, without those that increase the validation errors."""

    def fitted(members: Sequence[Member]) -> tuple[Estimate, ValidationErrors]:
        if not members:
            return e.fitted, before
        final = refit(e.fitted, e.candidates.pool, members, robust)
        return final, validation_errors(final)

    found, d = confirmed(e.decision.members, fitted, before), e.decision
    if found.withheld:
        kind = "ambiguous" if d.kind == "named" else d.kind if found.members else "unknown"
        withheld = (
            f"{m.effect} explains the calibration rows but increases the validation error: {reason}"
            for m, reason in found.withheld
        )
        hypothesis = e.search.hypothesis(found.members)
        d = replace(d, kind=kind, hypothesis=hypothesis, footnotes=(*d.footnotes, *withheld))
    return replace(e, decision=d), found.fitted, found.errors


def _where(first: Examined, last: Examined, promoted: bool, noise: float) -> tuple[Place, ...]:
    """Locations of compliance where that was missing, then all others; shares of the same excess."""
    out: tuple[Place, ...] = ()
    null = first.search.hypotheses[frozenset()].state
    chosen, size = last.decision.hypothesis, last.fitted.model.size
    excess = _excess(null, chosen.state, noise)
    if promoted:
        every = max(first.candidates.variants[COMPLIANCE], key=lambda v: len(v.columns))
        own = first.search.hypothesis([Member(every, 1.0, 0.0)])
        pool, absorbs = first.candidates.pool, first.fitted.model.size
        out = places_named(own, pool, first.circumstances, excess, absorbs)
    return (*out, *places(chosen, last.pool, last.candidates.pool, last.circumstances, excess, size))


def _excess(null: State, chosen: State, noise: float) -> float:
    """Excess variance of the lengths of a contact under the baseline, m2.

    Over the noise or, where that is less certain, over the residual variance of the chosen hypothesis.
    """
    p = null.problem
    keep = chosen.weight[: p.lengths] > 0
    square, left = (float(np.mean((s.residual[: p.lengths] * p.sigma)[keep] ** 2)) for s in (null, chosen))
    own = noise**2 * (1.0 - null.effective_dof / max(float(np.sum(chosen.weight[: p.count] > 0)), 1.0))
    return max(square - min(own, left), 0.0)


def _promoted(first: Examined) -> bool:
    """Whether compliance is added to a model without it: many effects act through compliance."""
    if COMPLIANCE not in first.candidates.variants:
        return False
    sets = first.search.hypotheses
    own = sets.get(frozenset((COMPLIANCE,)))
    best = max(sets.values(), key=lambda h: h.score)
    gained = own is not None and own.score - sets[frozenset()].score > VERDICT.promoted
    return gained and COMPLIANCE in best.names


def _verdict(e: Examined, without: Decision | None) -> Verdict:
    """The verdict; `without` is the decision for the model without compliance, if that was missing."""
    d = e.decision
    probability = dict(d.probability)
    named = [_named(m, d, e) for m in d.members]
    kind, credible = d.kind, d.credible
    if without is not None:
        sure = without.probability[COMPLIANCE]
        probability |= {COMPLIANCE: sure, "null": without.probability["null"]}
        compliance = Named(COMPLIANCE, COMPLIANCE, (), "", sure, without.lost(COMPLIANCE))
        named = [compliance, *named]
        # without any further effect, no effect is confounded with it
        credible = (COMPLIANCE,) if kind == "null" else (COMPLIANCE, *credible)
        kind = {"null": "named", "unknown": "named+unexplained"}.get(kind, kind)
    return Verdict(
        kind,
        tuple(named),
        probability,
        credible,
        tuple(Hypothetical(w.effects, w.probability, w.log_evidence) for w in d.weighed[: VERDICT.listed]),
        d.footnotes,
        e.candidates.missing | dict.fromkeys(e.search.unseen, UNSEEN),
        (*play_or_late(d.alone, e.pool, d.credible), *cautions(e.fitted.model.scene.dataset)),
    )


def _named(member, d: Decision, e: Examined) -> Named:
    v = member.variant
    setting = EFFECTS[v.effect].words(v.setting)
    return Named(v.effect, model_name(member), v.sites, setting, d.probability[v.effect], d.lost(v.effect))


def _levels(
    scene: Scene, effects: tuple[str, ...], width: float, robust: bool, without: Sequence[Part],
    found: Explained,
) -> list[tuple[tuple[str, ...], Estimate]]:  # fmt: skip
    """Nominal, each effect of the baseline, then each named effect in the order of the search."""
    out: list[tuple[tuple[str, ...], Estimate]]
    out = [(("nominal",), estimate(with_parameters(scene, (), ()), robust=robust))]
    if effects[:1] == ("geometry",):
        out.append((("joint",), calibrated(scene, ("joint",), width, robust)))
    for k in range(1, len(effects)):
        out.append((effects[:k], calibrated(scene, effects[:k], width, robust, without)))
    last, members = found.last, found.last.decision.members
    if effects:
        out.append((effects, found.first.fitted))
    if found.promoted:
        out.append(((*effects, COMPLIANCE), last.fitted))
    for k in range(1, len(members) + 1):
        e = (
            found.final
            if k == len(members)
            else refit(last.fitted, last.candidates.pool, members[:k], robust)
        )
        out.append((e.model.effects, e))
    return out


def _rivals(e: Examined) -> list[tuple[Hypothesis, Hypothesis]]:
    """Pairs of hypotheses that the data do not distinguish: the most probable and its alternatives."""
    named = [w for w in e.decision.weighed if w.cell is None]
    leader = named[0]
    rivals = [
        w
        for w in named[1:]
        if w.probability > VERDICT.doubt and w.hypothesis.names != leader.hypothesis.names
    ]
    return [(leader.hypothesis, w.hypothesis) for w in rivals[: VERDICT.advised]]


def _residuals(before: Estimate, after: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the session, and residual lengths before and after at each, m."""
    rows, old, new = [], [], []
    for a, b in zip(length_blocks(before.model), length_blocks(after.model), strict=True):
        rows.append(np.tile(a.rows, a.kind.rows))
        old.append(before.residuals(a).ravel())
        new.append(after.residuals(b).ravel())
    return np.concatenate(rows), np.concatenate(old), np.concatenate(new)
