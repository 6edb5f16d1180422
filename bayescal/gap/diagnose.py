"""A complete diagnosis: fit, search, verdict, refit, and all results.

Effects are named and confirmed first (`explain`): baseline, compliance where it was missing, refit, errors on
validation data. Then the model levels are fitted: nominal, the baseline by effects, and each named effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from bayescal.assess.identifiability import identifiability
from bayescal.assess.shared_causes import judged_level
from bayescal.assess.undetermined import undetermined
from bayescal.dataset import Dataset
from bayescal.effects import BASELINE, levels_of
from bayescal.errors import FAILURES, BayescalError, Otherwise, T, attempted, reason
from bayescal.estimate import Estimate, check_enough
from bayescal.estimate.bounds import UNCHANGED, bounded
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.unexplained import FORM
from bayescal.gap.advise import advise, blind_spots, rivals, undecided, unseen
from bayescal.gap.candidate_contacts import stated_masses
from bayescal.gap.concluded import concluded, doubted, events_of, refused
from bayescal.gap.examine import Examined, examine, where
from bayescal.gap.linear.problem import without_nuisance
from bayescal.gap.linear.state import again
from bayescal.gap.outcome.events import errors_with, uncertain
from bayescal.gap.outcome.magnitude import Level, magnitude, model_levels, noise_floor, shrinkage
from bayescal.gap.outcome.margins import margins, residuals_in_time
from bayescal.gap.outcome.statements import Change, amplitudes, displaced, warnings, wrong_masses
from bayescal.gap.result import Advice, BlindSpot, Event, Gap, Shrinkage, Verdict
from bayescal.gap.search.beam import COMPLIANCE, Member
from bayescal.gap.search.candidates import Variant
from bayescal.gap.search.gate import Tests, confirmed, contradiction
from bayescal.gap.search.refit import model_name, refit, still_without
from bayescal.gap.settings import GATE, VERDICT
from bayescal.model import USUAL, FitOptions
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import FOLDED, LEFT_OUT, VALIDATED
from bayescal.predict.errors import ValidationErrors, kept
from bayescal.predict.targets import check_located, leaving_out
from bayescal.statistics import spawned
from bayescal.storage.stopping import Progress, silent


@dataclass(frozen=True)
class Explained:
    """A baseline, the named effects, and the validation residuals of both models."""

    first: Examined
    last: Examined  # the same, or with compliance in the model where that was `promoted`
    promoted: bool
    before: ValidationErrors  # of the baseline
    final: Estimate  # with the named effects
    after: ValidationErrors
    events: Mapping[str, tuple[Event, ...]] = field(default_factory=dict)  # sudden changes, by effect
    lost: tuple[str, ...] = ()  # what failed on the way, as sentences
    flat: bool = False  # the form of faces is one of the names, and no part of the models beside it

    @property
    def baseline(self) -> Estimate:
        """The baseline that the refit is compared with."""
        return _beside(self.first, self.flat)

    @property
    def beside(self) -> Estimate:
        """The same with compliance where that was `promoted`."""
        return _beside(self.last, self.flat)

    def refit(self, members: Sequence[Member]) -> Estimate:
        """The baseline with some effects."""
        e = self.last
        return refit(e.fitted, e.candidates, members, e.options, self.flat) if members else self.beside

    @property
    def verdict(self) -> Verdict:
        """Which effect."""
        return concluded(self.last, self.first.decision if self.promoted else None)


def explain(
    scene: Scene, effects: tuple[str, ...], options: FitOptions = USUAL, progress: Progress = silent
) -> Explained:
    """Name effects that a baseline lacks, if validation measurements confirm them; see `diagnose`."""
    lost = list[str]()
    progress("estimate", 0.0)
    first = examine(scene, effects, options)
    progress("search", 0.3)
    last, promoted = first, COMPLIANCE not in effects and _promoted(first)
    if promoted:
        further = partial(examine, scene, (*effects, COMPLIANCE), options, further=True)
        last = attempted("the search with compliance in the model", further, first, lost)
        promoted = last is not first
    progress("refit", 0.6)
    events = attempted("rows of sudden changes", partial(events_of, last), {}, lost)

    def errors(fitted: Estimate, without: str = LEFT_OUT) -> ValidationErrors:
        return errors_with(fitted, events, without)

    def compared(flat: bool) -> Explained:
        """Test the names with the form of uneven faces in all models, or in none."""
        before = errors(_beside(first, flat))
        bare = Explained(first, last, promoted, before, _beside(last, flat), before, events, (), flat)
        alone: Tests = (before if last is first else errors(bare.beside),)
        if alone[0].how != VALIDATED:
            tests = (
                attempted(f"{how} of the baseline", partial(errors, bare.beside, how), None, lost)
                for how in FOLDED
            )
            alone = tuple(test for test in tests if test is not None) or alone
        fits: dict[tuple[Variant, ...], tuple[Estimate, Tests]] = {(): (bare.beside, alone)}

        def fitted(members: Sequence[Member]) -> tuple[Estimate, Tests]:
            key = tuple(m.variant for m in members)
            if key not in fits:
                try:
                    final = bare.refit(members)
                    fits[key] = final, tuple(errors(final, test.how) for test in alone)
                except FAILURES as error:
                    raise (
                        error if isinstance(error, BayescalError) else BayescalError(reason(error))
                    ) from None
            return fits[key]

        admitted, final, after = _admitted(last, alone, fitted)
        if after.how != VALIDATED:
            what = "cross-validation of the refit one by one: that by blocks is stated"
            same = final is bare.baseline
            after = before if same else attempted(what, partial(errors, final), after, lost)
        return replace(bare, last=admitted, final=final, after=after)

    def fewer(explained: Explained) -> Explained:
        """The same without names that are refused: the form of faces is that of `fit`."""
        bare = replace(explained, flat=False)
        final = bare.refit(bare.last.decision.members)
        return replace(bare, before=errors(bare.baseline), final=final, after=errors(final))

    explained = compared(flat=_names_form(last))
    if explained.flat and not _names_form(explained.last):
        explained = fewer(explained)
    change = Change.of(explained.before, explained.after)
    if change.refuted:  # all names together, though none alone
        explained = replace(explained, last=refused(explained.last, change))
        explained = explained if explained.last.decision.members else fewer(explained)
    return replace(explained, lost=tuple(lost))


def _names_form(e: Examined) -> bool:
    """Whether the form of faces is one of the names."""
    return any(m.effect == FORM for m in e.decision.members)


def _beside(e: Examined, flat: bool) -> Estimate:
    """The baseline without the form of faces, where that is a name, or with it."""
    return e.fitted if flat else e.complete


def _admitted(
    e: Examined, before: Tests, fitted: Callable[[Sequence[Member]], tuple[Estimate, Tests]]
) -> tuple[Examined, Estimate, ValidationErrors]:
    """The refit with the named effects that the validation data admit, and the decision with its reasons."""
    d = e.decision
    # beside an unmodelled effect, what a name explains may be part of that effect
    complete = d.kind == "named"
    tested = confirmed(
        d.members,
        fitted,
        before,
        lambda m: complete and d.probability[m.effect] > VERDICT.certain,
        e.search.instead,
    )
    notes = [f"{a.member.effect} {a.words}; it is not named" for a in tested.withheld]
    notes += [f"{a.member.effect} {a.words}; no reduction of errors is claimed" for a in tested.unclaimed]
    c = e.candidates
    notes += [
        f"{model_name(a.member, c)} {a.words}; in the form {model_name(m, c)} it does not"
        for a, m in tested.replaced
    ]
    kind, changed = d.kind, tested.withheld or tested.replaced
    if tested.withheld:
        alone = len(d.weighed[0].names) == 1
        refused = "class" if alone else "ambiguous"
        kind = refused if kind == "named" else kind if tested.members or kind == "class" else "unknown"
    if kind == "named" and (p := contradiction(before[0], tested.errors)) < GATE.contradicted:
        kind = "named+unexplained"
        notes.append(
            f"the validation data contradict the refit: by it, so large errors have p {max(p, 1e-99):.0e}"
        )
    d = replace(
        d,
        kind=kind,
        hypothesis=e.search.hypothesis(tested.members) if changed else d.hypothesis,
        footnotes=(*d.footnotes, *notes),
        unclaimed=frozenset(a.member.effect for a in tested.unclaimed),
        withheld=frozenset(a.member.effect for a in tested.withheld),
        replaced=frozenset(m.effect for _, m in tested.replaced),
    )
    return replace(e, decision=d), tested.fitted, tested.errors


def _promoted(first: Examined) -> bool:
    """Whether compliance is added to a model without it: many effects act through compliance."""
    if COMPLIANCE not in first.candidates.variants:
        return False
    sets = first.search.hypotheses
    compliant = sets.get(frozenset((COMPLIANCE,)))
    best = max(sets.values(), key=lambda h: h.score)
    gained = compliant is not None and compliant.score - sets[frozenset()].score > VERDICT.promoted
    sure = first.decision.probability.get(COMPLIANCE, 0.0) >= VERDICT.sure
    return gained and sure and COMPLIANCE in best.names


def fitted_levels(
    scene: Scene, effects: tuple[str, ...], options: FitOptions, explained: Explained
) -> tuple[list[Level], list[str]]:
    """Nominal, each effect of the baseline, then each named effect in the order of the search.

    A level that cannot be fitted is left out, with the reason as text: the diagnosis does not need it.
    """
    last, members = explained.last, explained.last.decision.members
    fits: list[tuple[tuple[str, ...], Callable[[], Estimate]]] = []
    for level in levels_of(effects)[:-1] or [()]:
        of_model = effects[: len(level)] == level  # a simpler model has all of its parameters
        level_options = options if of_model else replace(options, without=())
        fits.append((level or ("nominal",), partial(judged_level, scene, level, level_options)))
    if effects:
        fits.append((effects, lambda: explained.baseline))
    if explained.promoted:
        fits.append(((*effects, COMPLIANCE), lambda: explained.beside))
    names = [model_name(m, last.candidates) for m in members]
    for k in range(1, len(members) + 1):
        further = partial(explained.refit, members[:k]) if k < len(members) else lambda: explained.final
        fits.append(((*last.fitted.model.effects, *names[:k]), further))
    out, lost = list[Level](), list[str]()
    for model, fit in fits:
        try:
            e = fit()
            formed = FORM in e.model.effects and FORM not in model
            out.append(Level((*model, FORM) if formed else model, e, _errors_of(e, explained)))
        except FAILURES as error:
            what = f"the model level {' + '.join(model)} is left out: it cannot be fitted"
            lost.append(f"{what} ({reason(error)})")
    return out, lost


def diagnose(
    dataset: Dataset,
    effects: tuple[str, ...] = BASELINE,
    options: FitOptions = USUAL,
    *,
    without: Sequence[str] = (),
    progress: Progress = silent,
) -> Gap:
    """Diagnose the gap between a calibrated model and the machine.

    Parameters
    ----------
    dataset : Dataset
    effects : tuple of str
        The baseline model: names of `effects.EFFECTS`.
    options : FitOptions
        Of all fits; the seed is that of intervals.
    without : sequence of str
        Parts of the effects that the model lacks and that are candidates: 'geometry at joint 4'; see `Part`.
    progress : callable
        Called with the stage and its completed fraction.

    Raises
    ------
    BayescalError
        If the session cannot be fitted, or the model has no such part, with the reason.
    """
    gap, unlocated = leaving_out(dataset, lambda some: _diagnosed(some, effects, options, without, progress))
    return replace(gap, unlocated=tuple(unlocated), warnings=(*unlocated.values(), *gap.warnings))


def _diagnosed(
    dataset: Dataset,
    effects: tuple[str, ...],
    options: FitOptions,
    without: Sequence[str],
    progress: Progress,
) -> Gap:
    """The diagnosis of a session whose validation targets can all be located."""
    scene = Scene(dataset, oriented=True)
    options = options.omitting(without, scene, effects)
    check_enough(scene)
    check_located(scene)
    explained = explain(scene, effects, options, progress)
    first, last, final = explained.first, explained.last, explained.final
    before, after, decision = explained.before, explained.after, explained.last.decision
    noise = noise_floor(final, after.main)
    unsure = uncertain(explained.events, last.problem.rows)
    progress("report", 0.8)
    of_magnitude, of_shrinkage = spawned(options.seed, 2)
    size = magnitude(explained.baseline, final, before, after, of_magnitude)
    verdict = explained.verdict
    levels, left_out = fitted_levels(scene, effects, last.options, explained)
    lost = [*explained.lost, *left_out]

    def either(what: str, compute: Callable[[], T], otherwise: Otherwise) -> T | Otherwise:
        return attempted(what, compute, otherwise, lost)

    free = either("the refit with the confirmed names alone", partial(_confirmed, explained), final)
    arm, rigid = either("limits of compliances", partial(bounded, free), (free, UNCHANGED))
    if rigid.parameters and free is final and decision.members:  # one arm in all that follows
        final, after = arm, either("errors of the limited refit", partial(_errors_of, arm, explained), after)
        levels[-1:] = [replace(level, fitted=arm, errors=after) for level in levels[-1:]]
    if decision.members:
        keep = partial(doubted, arm, explained.beside, verdict)
        refitted = either("the discrepancy that the names may not explain", keep, arm)
        arm, final = refitted, refitted if arm is final else final
    wide = either("the stated uncertainty of the arm, and with it the arm", lambda: stated(arm).limited, None)
    of_final = wide
    if wide is None or arm is not final:
        of_final = either("the stated uncertainty of the refit", lambda: stated(final).limited, None)
    of_final = final.covariance if of_final is None else of_final
    of_masses = partial(wrong_masses, decision.hypothesis.state, stated_masses(last.fitted))
    masses = "" if decision.weighed[0].unmodelled else either("errors of masses", of_masses, "")
    determined = partial(undetermined, final)
    lacking = either("what is not determined", lambda: determined(identifiability(final, of_final)), ())
    reduction: tuple[Shrinkage, ...] = ()
    if decision.members or explained.promoted:
        compare = partial(shrinkage, before, after, noise.sd, of_shrinkage, noise.dof)
        reduction = either("the reduction of errors", compare, ())
    if not all(n.confirmed for n in verdict.named):
        reduction = tuple(replace(s, claimed=False) for s in reduction)
    return Gap(
        dataset=dataset,
        baseline=effects,
        options=last.options,
        magnitude=size,
        verdict=verdict,
        shrinkage=reduction,
        levels=model_levels(levels, kept(before, after)),
        where=either("locations", partial(where, first, last, explained.promoted, noise.sd), ()),
        margins=either("groups", partial(margins, explained.baseline, before, noise.sd, noise.dof), {}),
        advice=either("what to measure next", partial(_advice, last), ()),
        blind_spots=either("effects that would not be seen", partial(_unseen, last), ()),
        amplitudes=either("amplitudes", lambda: amplitudes(final, of_final, verdict.named), ()),
        undecided=either("effects that are not told from each other", partial(undecided, last), ()),
        residuals=residuals_in_time(explained.baseline, final),
        excluded=(explained.baseline.rejected, final.rejected),
        warnings=(
            *(f"{cause.words}: they are no outliers, and all models use them" for cause in first.causes),
            *last.options.contrary,
            *filter(None, (masses,)),
            *warnings(explained.baseline, final, before, after, lacking, unsure),
            *lost,
        ),
        refit=final.model.effects,
        still_without=still_without(last.options.without, decision.members),
        arm=None if wide is None else arm,
        calibrated=explained.baseline,
        covariance=wide,
        displaced=either("what the names left out displace", lambda: displaced(arm, final, wide), ()),
        rigid=rigid,
        undetermined=lacking,
        scatter=last.scatter,
        masses=masses,
    )


def _advice(last: Examined) -> tuple[Advice, ...]:
    """What to measure next, by pairs of hypotheses that may use errors of the stated masses."""
    plain = without_nuisance(last.problem, last.fitted.model.size + len(stated_masses(last.fitted)))
    states = [[replace(h, state=again(h.state, plain)) for h in pair] for pair in rivals(last)]
    pairs = [(one, other) for one, other in states]
    return advise(last.fitted, last.candidates, pairs)


def _unseen(last: Examined) -> tuple[BlindSpot, ...]:
    """Effects that the session would not show."""
    named = tuple(m.effect for m in last.decision.members)
    plain = without_nuisance(last.problem, last.fitted.model.size)
    chosen = again(last.decision.hypothesis.state, plain)
    return unseen(blind_spots(last.fitted, last.candidates, chosen, named))


def _errors_of(e: Estimate, explained: Explained) -> ValidationErrors:
    """Validation errors of a level, which are known of the baseline and of the refit."""
    if e is explained.final:
        return explained.after
    if e is explained.baseline:
        return explained.before
    return errors_with(e, explained.events, strict=False)


def _confirmed(explained: Explained) -> Estimate:
    """The refit with those of the named effects that the validation data confirm."""
    d = explained.last.decision
    members = [m for m in d.members if m.effect not in d.unclaimed]
    if len(members) == len(d.members):
        return explained.final
    try:
        return explained.refit(members)
    except FAILURES:  # without the others, none of them can be fitted
        return explained.beside
