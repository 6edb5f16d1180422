"""A complete diagnosis: fit, search, verdict, refit, and all results.

Fits of the model levels: nominal, the baseline effect by effect, then each named effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.assess.identifiability import identifiability
from bayescal.assess.undetermined import undetermined
from bayescal.dataset import Dataset
from bayescal.effects import BASELINE, levels_of
from bayescal.estimate import Estimate, check_enough, fitted_level
from bayescal.estimate.bounds import bounded
from bayescal.estimate.discrepancy import stated
from bayescal.gap.design.advise import advise, rivals, undecided
from bayescal.gap.design.blind_spots import blind_spots, places_of, unseen
from bayescal.gap.examine import where
from bayescal.gap.explain import Explained, Progress, explain
from bayescal.gap.linear.problem import without_nuisance
from bayescal.gap.linear.state import again
from bayescal.gap.outcome.magnitude import magnitude, model_levels, noise_floor
from bayescal.gap.outcome.margins import margins
from bayescal.gap.outcome.notes import amplitudes, warnings
from bayescal.gap.outcome.shrinkage import shrinkage
from bayescal.gap.result import Gap
from bayescal.gap.search.beam import COMPLIANCE
from bayescal.gap.search.refit import model_name, refit, still_without
from bayescal.model import USUAL, FitOptions
from bayescal.model.model import length_blocks
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.errors import ValidationErrors, kept
from bayescal.predict.targets import check_located
from bayescal.statistics import spawned


def fitted_levels(
    scene: Scene, effects: tuple[str, ...], options: FitOptions, found: Explained
) -> list[tuple[tuple[str, ...], Estimate]]:
    """Nominal, each effect of the baseline, then each named effect in the order of the search."""
    out = []
    for level in levels_of(effects)[:-1] or [()]:
        of_model = effects[: len(level)] == level  # a simpler model has all of its parameters
        own = options if of_model else replace(options, without=())
        out.append((level or ("nominal",), fitted_level(scene, level, own)))
    last, members = found.last, found.last.decision.members
    if effects:
        out.append((effects, found.first.fitted))
    if found.promoted:
        out.append(((*effects, COMPLIANCE), last.fitted))
    for k in range(1, len(members) + 1):
        final = k == len(members)
        e = found.final if final else refit(last.fitted, last.candidates, members[:k], options)
        names = (model_name(m, last.candidates) for m in members[:k])
        out.append(((*last.fitted.model.effects, *names), e))
    return out


def diagnose(
    dataset: Dataset,
    effects: tuple[str, ...] = BASELINE,
    options: FitOptions = USUAL,
    *,
    without: Sequence[str] = (),
    progress: Progress = lambda stage, fraction: None,
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
    scene = Scene(dataset, oriented=True)
    options = options.omitting(without, scene, effects)
    check_enough(scene)
    check_located(scene)
    found = explain(scene, effects, options, progress)
    first, last, final = found.first, found.last, found.final
    before, after, decision = found.before, found.after, found.last.decision
    noise = noise_floor(final, after.main)
    progress("report", 0.8)
    of_magnitude, of_shrinkage = spawned(options.seed, 2)
    size = magnitude(first.fitted, final, before, after, of_magnitude)
    verdict = found.verdict
    levels = fitted_levels(scene, effects, options, found)
    errors = [_errors_of(e, found) for _, e in levels]
    plain = without_nuisance(last.problem, last.fitted.model.size)
    named = tuple(m.effect for m in decision.members)
    spheres = places_of(last.fitted)
    chosen = again(decision.hypothesis.state, plain)
    spots = blind_spots(last.fitted, last.candidates, plain, chosen, named, spheres)
    pairs = [
        (replace(a, state=again(a.state, plain)), replace(b, state=again(b.state, plain)))
        for a, b in rivals(last)
    ]
    free = _confirmed(found, options)
    arm, rigid = bounded(free)
    if rigid.parameters and free is final and decision.members:  # one arm in all that follows
        final, after = arm, validation_errors(arm, strict=False)
        levels[-1], errors[-1] = (levels[-1][0], arm), after
    wide = stated(arm)
    of_final = wide.limited if arm is final else stated(final).limited
    lacking = undetermined(final, identifiability(final))
    changed = bool(decision.members) or found.promoted
    reduction = shrinkage(before, after, noise.sd, of_shrinkage, noise.dof) if changed else ()
    if not all(n.confirmed for n in verdict.named):
        reduction = tuple(replace(s, claimed=False) for s in reduction)
    return Gap(
        dataset=dataset,
        baseline=effects,
        options=options,
        magnitude=size,
        where=where(first, last, found.promoted, noise.sd),
        margins=margins(first.fitted, before, noise.sd, noise.dof),
        verdict=verdict,
        shrinkage=reduction,
        levels=model_levels(levels, errors, kept(before, after)),
        advice=advise(last.fitted, last.candidates, pairs, places=spheres),
        blind_spots=unseen(spots),
        residuals=_residuals(first.fitted, final),
        warnings=(
            *(f"{cause.words}: they are no outliers, and all models use them" for cause in first.causes),
            *warnings(first.fitted, final, before, after, lacking),
        ),
        amplitudes=amplitudes(final, of_final, verdict.named) if verdict.named else (),
        refit=final.model.effects,
        still_without=still_without(options.without, decision.members),
        undecided=undecided(last),
        arm=arm,
        calibrated=first.fitted,
        covariance=wide.limited,
        rigid=rigid,
        undetermined=lacking,
    )


def _errors_of(e: Estimate, found: Explained) -> ValidationErrors:
    """Validation errors of a level, which are known of the baseline and of the refit."""
    if e is found.final:
        return found.after
    return found.before if e is found.first.fitted else validation_errors(e, strict=False)


def _confirmed(found: Explained, options: FitOptions) -> Estimate:
    """The refit with those of the named effects that the validation data confirm."""
    d = found.last.decision
    members = [m for m in d.members if m.effect not in d.unclaimed]
    if len(members) == len(d.members):
        return found.final
    return refit(found.last.fitted, found.last.candidates, members, options)


def _residuals(before: Estimate, after: Estimate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the session in the order of time, and residuals before and after at each, m."""
    rows, old, new = [], [], []
    for a, b in zip(length_blocks(before.model), length_blocks(after.model), strict=True):
        rows.append(np.tile(a.rows, a.kind.rows))
        old.append(before.residuals(a).ravel())
        new.append(after.residuals(b).ravel())
    at = np.concatenate(rows)
    m = before.model.scene.dataset.measurements
    order = np.lexsort((at, at if m.time is None else m.time[at]))
    return at[order], np.concatenate(old)[order], np.concatenate(new)[order]
