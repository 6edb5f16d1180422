"""A baseline and all effects that it lacks: fit, candidates, search, decision.

Locations of the named effects, as shares of the excess variance of the baseline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayescal.assess.findings import differing, noise_ratios
from bayescal.assess.shared_causes import SharedCause, completed, judged_complete
from bayescal.effects import EFFECTS, Circumstances, Parameter
from bayescal.effects.gravity import masses
from bayescal.effects.selection import plain as plain_name
from bayescal.errors import attempted
from bayescal.estimate import Estimate, calibrated, families
from bayescal.estimate.families import with_compliances
from bayescal.estimate.scatter import Scatter, scattered
from bayescal.estimate.widths import Width, with_widths
from bayescal.gap.linear.evidence import shared_variance, worth
from bayescal.gap.linear.problem import Problem, Slopes, of_certificate
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.outcome.where import Scale, places, places_named
from bayescal.gap.result import Place
from bayescal.gap.search.beam import COMPLIANCE, Member, Search
from bayescal.gap.search.candidates import Candidates, candidates, wide
from bayescal.gap.search.cells import cells
from bayescal.gap.search.makers import arguments
from bayescal.gap.search.refit import Screening, refit, screened, screening, screening_states
from bayescal.gap.search.unknown import CellFit, Pool, filled, with_set
from bayescal.gap.search.verdict import Decision, decide
from bayescal.gap.settings import LINEAR, SEARCH, VERDICT
from bayescal.model import ORIENTATION
from bayescal.model.model import main_group
from bayescal.model.options import USUAL, FitOptions
from bayescal.model.scene import Scene

LOOSE = 10.0
"""Factor on priors of errors of what measures the arm, while widths of its own are told (assumed)."""


@dataclass(frozen=True)
class Examined:
    """A baseline and all hypotheses that were evaluated with it."""

    fitted: Estimate  # with flat faces: their form is a hypothesis among others
    circumstances: Circumstances
    candidates: Candidates
    slopes: Slopes
    problem: Problem
    pool: Pool
    search: Search
    decision: Decision
    causes: tuple[SharedCause, ...] = ()  # of rows that the baseline rejects and that are used all the same
    options: FitOptions = USUAL  # of the fit, with the prior widths that the data told
    widths: tuple[Width, ...] = ()
    formed: Estimate | None = None  # the same with the form of uneven faces, where there are any
    scatter: Scatter | None = None  # errors that every image has anew, and that no effect explains

    @property
    def complete(self) -> Estimate:
        """The baseline as `fit` states it, with which refits are compared."""
        return self.fitted if self.formed is None else self.formed


def examine(scene: Scene, effects: tuple[str, ...], options: FitOptions, further: bool = False) -> Examined:
    """Fit a baseline at the deflected pose of the arm, and evaluate all effects that it lacks.

    Errors that every image has anew are scatter only where no effect explains what the images share, and no
    unmodelled one explains it with more evidence.

    Parameters
    ----------
    scene : Scene
    effects : tuple of str
        The baseline.
    options : FitOptions
    further : bool
        An effect was named before.
    """

    def fitted(some: Scene) -> tuple[Estimate, FitOptions, tuple[Width, ...]]:
        return _with_widths(some, effects, options)

    _, base, scatter = scattered(scene, fitted, prior_only=True)
    examined = _of_baseline(base, further)
    if scatter is None or not scatter.beyond:
        return examined
    decision = examined.decision
    less = decision.kind == "unknown" and decision.weighed[0].log_evidence < scatter.nats
    if decision.kind != "null" and not less:
        return examined
    _, base, scatter = scattered(scene, fitted)
    weighed = _of_baseline(base, further)
    # errors of another form than those of readings leave what looks like an effect
    return replace(weighed if less or weighed.decision.kind == "null" else examined, scatter=scatter)


def _of_baseline(base: tuple[Estimate, FitOptions, tuple[Width, ...]], further: bool) -> Examined:
    """Evaluate all effects that a baseline lacks, as `fit` states it."""
    plain, options, widths = base
    whole = completed(plain, options.robust)
    fitted, causes, formed = whole.fitted, whole.causes, None
    if fitted.model.effects != plain.model.effects:  # the search has no form of its own
        formed = fitted
        fitted, causes = judged_complete(plain) if options.robust else (plain, ())
    result = _examined(fitted, causes, options, further)
    if causes and result.decision.kind == "null":  # a few true outliers that share a cause by chance
        other = _examined(plain, (), options, further)
        result = result if other.decision.kind == "null" else other
    return replace(result, options=options, widths=widths, formed=formed)


def _with_widths(
    scene: Scene, effects: tuple[str, ...], options: FitOptions
) -> tuple[Estimate, FitOptions, tuple[Width, ...]]:
    """The baseline under the priors that the data tell.

    An error of what measures the arm may look like lengths of the arm beyond their priors: where there may be
    one, widths are those of a model that has it.
    """
    c = scene.circumstances(scene.rows("calibrate"))
    beside = [name for name, e in EFFECTS.items() if e.beside_arm and not e.missing(c)]
    if not beside:
        return with_widths(calibrated(scene, effects, options), scene, effects, options)
    wide = (*effects, *(f"{name} x{LOOSE:g}" for name in beside if name not in map(plain_name, effects)))
    _, options, widths = with_widths(calibrated(scene, wide, options), scene, wide, options)
    return calibrated(scene, effects, options), options, widths


def _examined(
    fitted: Estimate, causes: tuple[SharedCause, ...], options: FitOptions, further: bool
) -> Examined:
    """Evaluate all effects that a fitted baseline lacks, where `causes` are of rows that are no outliers."""
    settled = fitted.model.scene
    effects = fitted.model.effects
    c = with_compliances(settled.circumstances(settled.rows("calibrate")), fitted)
    nuisance = tuple(masses(c)) if COMPLIANCE in effects else ()
    candidate_effects = candidates(c, effects, options.without)
    baseline = Baseline(fitted, c, candidate_effects, nuisance, options.robust, further, causes)
    result = baseline.weighed(fitted)
    members = result.decision.members
    if members and ORIENTATION in fitted.weights.scale:
        # where it fails, the names are refused later, with the reason
        final = attempted(
            "", partial(refit, fitted, result.candidates, members, options, flat=True), fitted, []
        )
        if not _alike(fitted, final):
            result = baseline.weighed(final)
    return result


@dataclass(frozen=True)
class Baseline:
    """A fitted baseline, and what the evaluation of further effects takes from it."""

    fitted: Estimate
    circumstances: Circumstances
    candidates: Candidates
    nuisance: tuple[Parameter, ...]  # errors of masses, which every hypothesis may use
    robust: bool
    further: bool
    causes: tuple[SharedCause, ...]

    def weighed(self, noise: Estimate) -> Examined:
        """Evaluate all effects that the fit lacks; `noise` has the noise ratio of orientations to lengths."""
        fitted = self.fitted
        scale = dict(fitted.weights.scale)
        if ORIENTATION in scale:
            scale[ORIENTATION] = scale[main_group(fitted.model)] * _looseness(noise)
        slopes = Slopes.of(
            replace(fitted, weights=replace(fitted.weights, scale=scale)),
            [p for p in self.candidates.pool if of_certificate(p)],
        )
        if self.causes:
            rows = np.concatenate([cause.rows for cause in self.causes])
            slopes = replace(slopes, sharing=np.isin(slopes.rows, rows))
        slopes = replace(slopes, stop=families.stops_of(fitted.model.scene, slopes.rows))
        assert slopes.stop is not None
        poses = slopes.stop[slopes.contact[: len(slopes.sigma)]]

        def worth_by(variance: float) -> np.ndarray:
            return worth(variance, slopes.contact, len(slopes.sigma), slopes.gradient, poses)

        def searched(variance: float, ratio: np.ndarray | None = None) -> Examined:
            whitened = slopes if ratio is None else slopes.with_noise(ratio)
            return self._searched(replace(whitened, worth=worth_by(variance) if variance else None))

        bare = fit_state(slopes.problem(fitted.z, (), self.nuisance), (), (), robust=self.robust)
        variance = shared_variance(bare, slopes.gradient, poses)
        variance = 0.0 if np.mean(worth_by(variance)) > LINEAR.independent else variance
        result = searched(variance)
        # what an effect explains is no shared error: from above, as many effects explain any error of poses
        for _ in range(LINEAR.shared_rounds if variance else 0):
            before, variance = variance, shared_variance(_leading(result), slopes.gradient, poses)
            if variance > before - LINEAR.settled:
                break
            result = searched(variance)
        targets = [f"{b.group} {b.target}" for b in fitted.model.blocks for _ in b.rows]
        # what an effect explains is no noise; what noise explains is no effect
        for state in (_leading(result), result.search.hypotheses[frozenset()].state):
            noises = _noises(state, targets)
            if noises is None:
                continue
            other = searched(variance, noises.ratio)
            if other.decision.total - noises.cost > result.decision.total:
                notes = (*other.decision.footnotes, noises.words)
                result = replace(other, decision=replace(other.decision, footnotes=notes))
                break
        return replace(result, causes=self.causes)

    def _searched(self, slopes: Slopes) -> Examined:
        """Evaluate all effects that the fit lacks, with its derivatives."""
        c, modelled = self.circumstances, set(map(plain_name, self.fitted.model.effects))
        scans = [e for e in EFFECTS.values() if e.name not in modelled and wide(e, c)]
        screenings = dict[str, Screening]()
        if scans:
            p = slopes.problem(self.fitted.z, self.candidates.pool, self.nuisance)
            states = screening_states(p, np.empty(0, int), np.empty(0), self.robust)
            screenings = {e.name: screening(e, slopes, states, c) for e in scans}
            del p, states  # with the columns of the first problem
        result = self._with_scans(slopes, screenings)
        more = _screened_again(result, screenings, slopes)
        return self._with_scans(slopes, screenings | more) if more else result

    def _with_scans(self, slopes: Slopes, screenings: Mapping[str, Screening]) -> Examined:
        """Evaluate all effects, those of wide scans at some of their settings."""
        fitted, c = self.fitted, self.circumstances
        candidate_effects = screened(self.candidates, screenings, c)
        p = slopes.problem(fitted.z, candidate_effects.pool, self.nuisance)
        poses = np.unique(c.q[p.rows], axis=0, return_inverse=True)[1].ravel()
        pool = filled(partial(cells, c), slopes, poses, p)
        search = Search(p, candidate_effects, self.robust, self.further)
        search.run()
        decision = decide(search, pool, arguments(c))
        return Examined(fitted, c, candidate_effects, slopes, p, pool, search, decision)


def _screened_again(e: Examined, screenings: Mapping[str, Screening], slopes: Slopes) -> dict[str, Screening]:
    """Screenings of the wide scans of which untried settings explain more beside the leading hypothesis.

    Over noise only, a scan finds settings that stand for other effects, and a small shift not beside them.
    """
    best, out = e.decision.weighed[0], dict[str, Screening]()
    cell = smooth_cell(e)
    for name, before in screenings.items():
        others = [m for m in best.hypothesis.members if m.effect != name]
        if not (others or cell) or name not in e.search.candidates.variants:
            continue
        state = e.search.hypothesis(others, (None, best.hypothesis.state.weight)).state
        if cell:
            state = with_set(state, e.pool, cell.best, cell.scale, state.weight)
        more = screening(EFFECTS[name], slopes, [state], e.circumstances, SEARCH.screened_again)
        tried = e.search.additions(state, [m.effect for m in others])[name].gain
        if more.nats > tried + SEARCH.further_gain:
            out[name] = before.joined(more)
    return out


def smooth_cell(e: Examined) -> CellFit | None:
    """The generic cell beside the names of the leading hypothesis, if any, and if it is no random error."""
    cell = e.decision.weighed[0].cell
    return cell if cell is not None and e.pool.cells[cell.cell].clusters is None else None


@dataclass(frozen=True)
class Noises:
    """A noise of each target in place of one for all."""

    ratio: np.ndarray  # (contacts,) over one noise for all
    cost: float  # nats that the choice of the ratios gains at no evidence
    words: str


def _noises(state: State, target: Sequence[str]) -> Noises | None:
    """The noise of each target, where what a hypothesis leaves shows that they differ.

    Parameters
    ----------
    state : State
    target : sequence of str, length contacts
    """
    p = state.problem
    names, label = np.unique(target, return_inverse=True)
    weight = state.weight[: p.count]
    count = np.bincount(label[p.contact], weight, len(names))
    chi2 = np.bincount(label[p.contact], weight * state.residual[: p.count] ** 2, len(names))
    scaled = chi2 * (np.sum(count) / max(float(np.sum(chi2)), 1e-300))
    used = count > 0
    nats = differing(count[used], scaled[used])
    if nats <= LINEAR.uneven:
        return None
    ratio = np.ones(len(names))
    ratio[used] = noise_ratios(count[used], scaled[used])
    gained = 0.5 * float(np.sum(scaled * (1.0 - ratio**-2.0)))
    most = int(np.argmax(ratio))
    name, size = names[most].partition(" ")[2], f"{ratio[most]:.2g} times the mean"
    words = f"noise differs between targets ({name}: {size}): each is weighed by its own"
    return Noises(ratio[label], gained - nats, words)


def _leading(examined: Examined) -> State:
    """The state of the most probable hypothesis, with its unmodelled effect: what they leave is error."""
    state, cell = examined.decision.weighed[0].hypothesis.state, smooth_cell(examined)
    return with_set(state, examined.pool, cell.best, cell.scale, state.weight) if cell else state


def _looseness(fitted: Estimate) -> float:
    """Noise scale of the orientations over that of the lengths."""
    return fitted.weights.scale[ORIENTATION] / fitted.weights.scale[main_group(fitted.model)]


def _alike(a: Estimate, b: Estimate) -> bool:
    """Whether the noise ratio is equal in both: an error of orientations only first looks like noise."""
    return bool(abs(np.log(_looseness(a) / _looseness(b))) < np.log(VERDICT.alike))


def where(first: Examined, last: Examined, promoted: bool, noise: float) -> tuple[Place, ...]:
    """Locations of compliance where that was missing, then all others; shares of the same excess."""
    out: tuple[Place, ...] = ()
    null = first.search.hypotheses[frozenset()].state
    chosen = last.decision.hypothesis
    excess = _excess(null, chosen.state, noise)
    if promoted:
        every = max(first.candidates.variants[COMPLIANCE], key=lambda v: len(v.columns))
        compliant = first.search.hypothesis([Member(every, 1.0, 0.0)])
        scale = Scale(first.circumstances, excess, first.fitted.model.size, first.slopes)
        out = places_named(compliant, first.candidates.pool, scale)
    scale = Scale(last.circumstances, excess, last.fitted.model.size, last.slopes)
    return (*out, *places(chosen, last.pool, last.candidates.pool, scale))


def _excess(null: State, chosen: State, noise: float) -> float:
    """Excess variance of the lengths of a contact under the baseline, m2.

    Over the noise or, where that is less certain, over the residual variance of the chosen hypothesis.
    """
    p = null.problem
    keep = chosen.weight[: p.lengths] > 0
    before, after = (float(np.mean(p.metres(s.residual)[keep] ** 2)) for s in (null, chosen))
    expected = noise**2 * (1.0 - null.effective_dof / max(float(np.sum(chosen.weight[: p.count] > 0)), 1.0))
    return max(before - min(expected, after), 0.0)
