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
from bayescal.effects import parameters_of
from bayescal.estimate import Estimate, calibrated, check_enough, estimate
from bayescal.estimate.bounds import bounded
from bayescal.estimate.discrepancy import stated
from bayescal.gap.design.advise import advise, rivals, undecided
from bayescal.gap.design.blind_spots import blind_spots, places_of, unseen
from bayescal.gap.examine import where
from bayescal.gap.explain import Explained, explain
from bayescal.gap.linear.problem import without_nuisance
from bayescal.gap.linear.state import again
from bayescal.gap.outcome.magnitude import magnitude, model_levels, noise_floor
from bayescal.gap.outcome.margins import margins
from bayescal.gap.outcome.notes import amplitudes, warnings
from bayescal.gap.outcome.shrinkage import shrinkage
from bayescal.gap.result import Gap
from bayescal.gap.search.beam import COMPLIANCE
from bayescal.gap.search.refit import model_name, refit, still_without
from bayescal.model import check_asked, with_parameters
from bayescal.model.block import Part, parts_of
from bayescal.model.model import length_blocks
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.errors import kept
from bayescal.predict.targets import check_located
from bayescal.statistics import spawned
from bayescal.storage.stopping import Progress, silent


def fitted_levels(
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
            else refit(last.fitted, last.candidates, members[:k], robust, width, without)
        )
        names = (model_name(m, last.candidates) for m in members[:k])
        out.append(((*last.fitted.model.effects, *names), e))
    return out


def diagnose(
    dataset: Dataset,
    effects: tuple[str, ...] = ("geometry", COMPLIANCE),
    seed: int = 0,
    robust: bool = True,
    prior_width: float = 1.0,
    progress: Progress = silent,
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
    scene = Scene(dataset, oriented=True)
    parts = parts_of(
        without,
        effects,
        parameters_of(effects, scene.circumstances(scene.rows("calibrate"))) if without else (),
    )
    check_enough(scene)
    check_located(scene)
    found = explain(scene, effects, robust, prior_width, parts, progress)
    first, last, promoted, final = found.first, found.last, found.promoted, found.final
    before, after, members = found.before, found.after, last.decision.members
    noise = noise_floor(final, after.main)
    progress("report", 0.8)
    of_magnitude, of_shrinkage = spawned(seed, 2)
    size = magnitude(first.fitted, final, before, after, of_magnitude)
    chosen, verdict = last.decision.hypothesis, found.verdict
    changed = bool(members) or promoted
    levels = fitted_levels(scene, effects, prior_width, robust, parts, found)
    known = {id(first.fitted): before, id(final): after}
    errors = [known.get(id(e)) or validation_errors(e, strict=False) for _, e in levels]
    plain = without_nuisance(last.problem, last.fitted.model.size)
    named = tuple(m.effect for m in members)
    spheres = places_of(last.fitted)
    spots = blind_spots(last.fitted, last.candidates, plain, again(chosen.state, plain), named, spheres)
    pairs = [
        (replace(a, state=again(a.state, plain)), replace(b, state=again(b.state, plain)))
        for a, b in rivals(last)
    ]
    verdict = found.verdict
    free = _confirmed(found, robust, prior_width, parts)
    arm, rigid = bounded(free)
    if rigid.parameters and free is final and members:  # one arm in all that follows
        final, after = arm, validation_errors(arm, strict=False)
        levels[-1], errors[-1] = (levels[-1][0], arm), after
    wide = stated(arm)
    of_final = wide.limited if arm is final else stated(final).limited
    lacking = undetermined(final, identifiability(final))
    reduction = shrinkage(before, after, noise.sd, of_shrinkage, noise.dof) if changed else ()
    if not all(n.confirmed for n in verdict.named):
        reduction = tuple(replace(s, claimed=False) for s in reduction)
    return Gap(
        dataset=dataset,
        baseline=effects,
        seed=seed,
        magnitude=size,
        where=where(first, last, promoted, noise.sd),
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
        without=tuple(map(str, parts)),
        amplitudes=amplitudes(final, of_final, verdict.named) if verdict.named else (),
        refit=final.model.effects,
        still_without=tuple(map(str, still_without(parts, members))),
        robust=robust,
        prior_width=prior_width,
        undecided=undecided(last),
        arm=arm,
        calibrated=first.fitted,
        covariance=wide.limited,
        rigid=rigid,
        undetermined=lacking,
    )


def _confirmed(found: Explained, robust: bool, width: float, without: Sequence[Part]) -> Estimate:
    """The refit with those of the named effects that the validation data confirm."""
    d = found.last.decision
    members = [m for m in d.members if m.effect not in d.unclaimed]
    if len(members) == len(d.members):
        return found.final
    return refit(found.last.fitted, found.last.candidates, members, robust, width, without)


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
