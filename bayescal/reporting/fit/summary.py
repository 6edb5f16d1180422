"""The terminal's summary of a fit: verdict, predicted error, next step; then tables; then details."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from bayescal.assess.acceptance import FAIL, PASS, PLANNED, SHARED, Acceptance, Tolerance
from bayescal.assess.iso9283 import iso9283
from bayescal.assess.shared_causes import SharedCause
from bayescal.calibration import Fit
from bayescal.estimate.discrepancy import MASSES
from bayescal.fitted import gate
from bayescal.fitted.gate import STEPS, Use
from bayescal.predict import DistanceErrors, Validation, inside95
from bayescal.reporting.fit.agreement import iso9283_table
from bayescal.reporting.fit.tables import distance_table, level_table, parameter_table, tolerance_table
from bayescal.reporting.shared.origin import filed_lines
from bayescal.reporting.shared.text import MDEG, MM, UM, facts, percent, um, um2

MOST_REASONS = 4
"""Failed tests that are told; fit.json has all."""
SAME_ROWS = 0.5
"""Share of a cause's rows from which on another cause has told of them."""
MOST_ROWS = 6
"""Rejected measurements named without --verbose."""
MOST_FAMILIES = 3
"""Families of the discrepancy that are named."""
STYLES = {PASS: "bold green", FAIL: "bold red"}

Facts = Iterable[tuple[str, str, str]]


def fit_summary(fit: Fit, verbose: bool = False) -> RenderableType:
    """Verdict, prediction, validation and parameters; with `verbose` all distances, targets, directions."""
    v = fit.final.validation
    title = Text.assemble((fit.dataset.name, "bold"), f"  {fit.dataset.robot.name}")
    use = gate.of_fit(fit)
    parts: list[RenderableType] = [title, facts([*_verdict(fit.acceptance, use), *_predicted(fit)])]
    parts.append(facts([*_tolerance(fit.tolerance), *_next(fit, use), *_findings(fit)]))
    if v.planes or v.distances or v.points or v.turns:
        parts += ["", level_table(fit.levels)]
    if v.distances:
        parts += ["", distance_table(v, fit.levels[0].validation, verbose)]
    if verbose:
        parts += ["", iso9283_table(iso9283(fit.basis))]
    if fit.tolerance is not None and fit.tolerance.distances and verbose:
        parts += ["", tolerance_table(fit.tolerance)]
    if fit.final.estimate.model.parameters:
        parts += ["", parameter_table(fit, verbose)]
    parts += ["", facts(_details(fit, verbose))]
    return Group(*parts)


def _verdict(tests: Acceptance, use: Use) -> Facts:
    good = tests.usable and use.allowed
    style = "bold red" if not tests.explains else "bold green" if good else "bold yellow"
    yield "verdict", tests.verdict, style
    failed = [c.words for c in sorted(tests.failed, key=lambda c: (c.test != PLANNED, c.p_value))
              if c.test != SHARED]  # fmt: skip
    causes: list[SharedCause] = []
    for cause in tests.causes:  # further ones where they are not the same rows again
        if not any(np.mean(np.isin(cause.rows, other.rows)) > SAME_ROWS for other in causes):
            causes.append(cause)
    for words in [*(c.words for c in causes), *failed][:MOST_REASONS]:
        yield "", words, "red"


def _predicted(fit: Fit) -> Facts:
    """The distance error to expect, its interval, and the maximum errors of validation measurements."""
    lead, space = fit.forecast.lead, fit.forecast.workspace
    rests = "" if fit.acceptance.determined else ", from priors: not determined by these measurements"
    if fit.acceptance.unmade:
        yield "", "not valid, because contacts were not made:", "red"
    yield "distance error", _expected(lead) + (rests if lead is space else ""), "bold"
    yield "", _over(lead), "dim"
    if fit.forecast.checked:
        yield "probed volume", _expected(space) + rests, ""
        yield "", _over(space), "dim"
    for k, words in enumerate(_measured(fit.levels[0].validation, fit.final.validation)):
        yield "" if k else "validation", words, "" if k else "bold"


def _expected(d: DistanceErrors) -> str:
    low, high = d.interval
    expanded = f"U = {um2(d.expanded)} µm, k = {d.k:.2f}"
    return f"predicted {um2(d.u)} µm RMS (95 %: {um2(low)} to {um2(high)}); {expanded}"


def _over(d: DistanceErrors) -> str:
    return f"{d.count} distances, {MM * d.shortest:.0f} to {MM * d.longest:.0f} mm, between {d.over}"


def _measured(nominal: Validation, v: Validation) -> list[str]:
    """Errors of validation measurements, nominal and calibrated, of each kind."""

    def change(what: str, before: np.ndarray, after: np.ndarray) -> str:
        (was, most_was), (now, most) = ((np.sqrt(np.mean(e**2)), np.max(np.abs(e))) for e in (before, after))
        return f"{what} error {um(was)} -> {um(now)} µm RMS, maximum {um(most_was)} -> {um(most)}"

    out = []
    if v.distances:
        before, after = (np.array([d.error for d in part.distances]) for part in (nominal, v))
        within = sum(bool(inside95(d.error, d.predicted)) for d in v.distances)
        out.append(f"{change('distance', before, after)}; {within} of {len(v.distances)} within 95 %")
    if v.points:
        pairs = [[np.linalg.norm(p.residuals, axis=0) for p in part.points] for part in (nominal, v)]
        out.append(change("point", *map(np.concatenate, pairs)))
    if v.planes:
        pairs = [[p.residuals for p in part.planes] for part in (nominal, v)]
        out.append(change("contact", *map(np.concatenate, pairs)))
    if v.turns:
        angle = MDEG * np.concatenate([np.linalg.norm(t.residuals, axis=0) for t in v.turns])
        out.append(f"orientation error maximum {angle.max():.2g} mdeg, mean {angle.mean():.2g} mdeg")
    return out or ["none: no measurements with role validate"]


def _tolerance(decided: Tolerance | None) -> Facts:
    if decided is None:
        return
    style = STYLES.get(decided.decision, "bold yellow")
    yield (
        "tolerance",
        f"{MM * decided.tolerance:g} mm: {decided.decision}; {decided.why} (ISO 14253-1)",
        style,
    )
    yield "", f"probability {percent(decided.probability)} for a distance in the probed volume", ""


def _next(fit: Fit, use: Use) -> Facts:
    told = {check.words for check in fit.acceptance.failed}
    reasons = [reason for reason in use.against if reason not in told]
    if use.against:
        reasons.append("robot.yaml says so; export, compensate and certificates need --force")
    for k, reason in enumerate(reasons):
        yield "" if k else "not to be used", reason, "red"
    words = STEPS[use.next]
    if use.next == "gap":
        words = f"bayescal gap {' '.join(str(d.folder) for d in (fit.dataset.sessions or (fit.dataset,)))}"
    yield "next", words, "bold"


def _findings(fit: Fit) -> Facts:
    told = {check.test for check in fit.acceptance.failed}
    for finding in fit.findings:
        if finding.code not in told:
            yield finding.severity, finding.text, "" if finding.severity == "note" else "yellow"


def _details(fit: Fit, verbose: bool) -> Facts:
    level, found = fit.final, fit.final.estimate
    left = level.unexplained
    count = sum(len(b.rows) for b in found.model.states)
    targets = len(found.model.states)
    yield (
        "fitted",
        f"{', '.join(level.effects)}: {len(found.model.parameters)} arm parameters from {count} measurements "
        f"on {targets} target{'s' if targets > 1 else ''}",
        "",
    )
    repeats = ""
    if left.repeats is not None:
        repeats = f", repeated {left.group}s {UM * left.repeats:.1f} µm ({left.repeats_dof} d.o.f.)"
    what = "residual s.d." if left.group == "contact" else "single-point residual s.d."
    if any(b.group == left.group and b.kind.rows > 1 for b in found.model.states):
        what += " per coordinate"
    yield "noise", f"{what} {UM * left.fitted:.1f} µm, stated {UM * left.stated:.1f} µm{repeats}", ""
    yield from _discrepancy(fit)
    if len(found.rejected):
        ids = [fit.dataset.measurements.ids[row] for row in found.rejected]
        shown = ids if verbose else ids[:MOST_ROWS]
        more = ", ..." if len(shown) < len(ids) else ""
        yield (
            "rejected",
            f"{len(ids)} row{'s' if len(ids) > 1 else ''} as outliers: {', '.join(shown)}{more}",
            "",
        )
    if verbose:
        yield from _identifiable(fit)
    yield "posterior", _sampler(fit), ""
    yield from filed_lines(fit.dataset)


def _discrepancy(fit: Fit) -> Facts:
    """How much of the stated uncertainty is from stated masses, and from model discrepancy by family."""
    shares, what = dict(fit.stated.parameter_shares), "of the variance of a distance in the probed volume"
    if of_masses := shares.pop(MASSES, 0.0):
        yield "u from masses", f"{percent(fit.forecast.masses_share)} {what}", ""
        yield "", f"{percent(of_masses)} of that of a parameter, in the mean", ""
    if shares:
        named = ", ".join(f"{name} {percent(share)}" for name, share in [*shares.items()][:MOST_FAMILIES])
        share = percent(fit.forecast.discrepancy_share)
        yield "discrepancy", f"{share} {what}", ""
        yield "", f"{percent(sum(shares.values()))} of that of a parameter, in the mean ({named})", ""


def _identifiable(fit: Fit) -> Facts:
    known = fit.identifiability
    for heading, names, style in (
        ("identifiable", known.determined, ""),
        ("weakly", known.partly, ""),
        ("not", known.prior_only, "yellow"),
    ):
        if names:
            yield heading, ", ".join(names), style
    for k, direction in enumerate(known.weak):
        yield "" if k else "weak directions", direction.words, "yellow"


def _sampler(fit: Fit) -> str:
    draws = fit.draws
    if not draws.acceptance:
        return "Gaussian approximation (--samples 0)"
    state = "converged" if draws.converged else f"NOT CONVERGED: {draws.complaint}"
    moves = ", ".join(f"{name} {rate:.2f}" for name, rate in draws.acceptance.items())
    return (
        f"{state}: at least {draws.ess.min():.0f} effective draws of every parameter, "
        f"R-hat up to {np.nanmax(draws.rhat):.4f}, acceptance {moves}"
    )
