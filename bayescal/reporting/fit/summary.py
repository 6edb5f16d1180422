"""The terminal's summary of a fit: verdict, predicted error, next step; then tables; then details."""

from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType

from bayescal.assess.acceptance import PLANNED, SHARED, Acceptance
from bayescal.assess.agreement import Agreement
from bayescal.assess.conformance import FAIL, PASS, Tolerance
from bayescal.assess.shared_causes import SharedCause
from bayescal.calibration import Fit
from bayescal.estimate.discrepancy import MASSES
from bayescal.estimate.unexplained import AGAIN
from bayescal.fitted import gate
from bayescal.fitted.gate import STEPS, Use
from bayescal.predict.crossvalidation import inside95
from bayescal.predict.forecast import DistanceErrors
from bayescal.predict.validation import Errors, Validation
from bayescal.reporting import fit as sheets
from bayescal.reporting import text
from bayescal.reporting.origin import filed_lines, hand_eye_lines, images_lines
from bayescal.reporting.sheet import Sheet, below, headed, screen, terminal
from bayescal.storage.reading import Json

MOST_REASONS = 4
"""Failed tests that are told; fit.json has all."""
SAME_ROWS = 0.5
"""Share of a cause's rows from which on another cause has told of them."""
MOST_ROWS = 6
"""Rejected measurements named without --verbose."""
MOST_FAMILIES = 3
"""Families of the discrepancy that are named."""
STYLES = {PASS: "bold green", FAIL: "bold red"}


def fit_summary(
    fit: Fit, record: Json, verbose: bool = False, compared: Agreement | None = None
) -> RenderableType:
    """Verdict, prediction, validation and parameters; with `verbose` all distances, targets, directions.

    Tables are of the record of the fit; `compared` is what the sessions of a joint fit say each by itself.
    """
    v, checked = fit.final.validation, record["validation"]["distances"]
    title = headed(fit.dataset.name, fit.dataset.robot.name)
    use = gate.of_fit(fit)
    result = [*_verdict(fit.acceptance, use), *_predicted(fit)]
    result += [*images_lines(record), *hand_eye_lines(record)]
    steps = [*_tolerance(fit.tolerance), *_next(fit, use), *_findings(fit)]
    validated = v.planes or v.distances or v.points or v.turns
    parameters = sheets.parameter_table(record["parameters"], record["identifiability"], verbose)
    decided = record["acceptance"]["distances"] if verbose and record["acceptance"] else ()
    tables = (
        *below(sheets.validation_table(fit.levels) if validated else None),
        *below(sheets.distance_table(checked, verbose)),
        *(("", *_iso9283(record["iso9283"])) if verbose else ()),
        *below(Sheet(sheets.TOLERANCE, decided)),
        *below(parameters if fit.final.estimate.model.parameters else None),
    )
    agreement = below(sheets.agreement_summary(compared) if compared else None)
    return screen(title, result, steps, *tables, "", _details(fit, record, verbose), *agreement)


def _iso9283(record: Json) -> Iterator[RenderableType]:
    """The figures of ISO 9283, and what differs from the procedure of the standard."""
    if record["figures"]:
        headings = ("ISO 9283 (validation measurements)", "number", "mean (µm)", "u", "max (µm)", "u")
        yield terminal(Sheet(sheets.ISO9283, record["figures"]), *headings)
        yield text.facts(text.under("differs", record["differs_from_norm"], "dim"))


def _verdict(tests: Acceptance, use: Use) -> text.Facts:
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
    for doubt in () if tests.failed else tests.doubts[:MOST_REASONS]:
        yield "", doubt.words, "yellow"


def _predicted(fit: Fit) -> text.Facts:
    """The distance error to expect, its interval, and the maximum errors of validation measurements."""
    lead, space = fit.forecast.lead, fit.forecast.workspace
    from_priors = "" if fit.acceptance.determined else ", from priors: not determined by these measurements"
    if fit.acceptance.unmade:
        yield "", "not valid, because contacts were not made:", "red"
    yield "distance error", _expected(lead) + (from_priors if lead is space else ""), "bold"
    yield "", _over(lead), "dim"
    if fit.forecast.checked:
        yield "probed volume", _expected(space) + from_priors, ""
        yield "", _over(space), "dim"
    for k, words in enumerate(_measured(fit.levels[0].validation, fit.final.validation)):
        yield "" if k else "validation", words, "" if k else "bold"


def _expected(d: DistanceErrors) -> str:
    low, high = d.interval
    expanded = f"U = {text.um2(d.expanded)} µm, k = {d.k:.2f}"
    return f"predicted {text.um2(d.u)} µm RMS (95 %: {text.um2(low)} to {text.um2(high)}); {expanded}"


def _over(d: DistanceErrors) -> str:
    ends = f"{text.MM * d.shortest:.0f} to {text.MM * d.longest:.0f} mm"
    return f"{d.count} distances, {ends}, between {d.over}"


def _measured(nominal: Validation, v: Validation) -> list[str]:
    """Errors of validation measurements, nominal and calibrated, of each kind."""

    def change(what: str, before: Errors, after: Errors) -> str:
        change = f"{what} error {text.um(before.rms)} -> {text.um(after.rms)} µm RMS"
        return f"{change}, maximum {text.um(before.maximum)} -> {text.um(after.maximum)}"

    out = []
    if v.distances:
        within = sum(bool(inside95(d.error, d.predicted)) for d in v.distances)
        words = change("distance", nominal.distance_errors, v.distance_errors)
        out.append(f"{words}; {within} of {len(v.distances)} within 95 %")
    if v.points:
        out.append(change("point", nominal.point_lengths, v.point_lengths))
    if v.planes:
        out.append(change("contact", nominal.contacts, v.contacts))
    if v.turns:
        angles = v.turn_angles
        maximum, mean = (text.two_digits(text.MDEG * angle) for angle in (angles.maximum, angles.mean))
        out.append(f"orientation error maximum {maximum} mdeg, mean {mean} mdeg")
    return out or ["none: no measurements with role validate"]


def _tolerance(decided: Tolerance | None) -> text.Facts:
    if decided is None:
        return
    style = STYLES.get(decided.decision, "bold yellow")
    words = f"{text.MM * decided.tolerance:g} mm: {decided.decision}; {decided.why} (ISO 14253-1)"
    yield "tolerance", words, style
    yield "", f"probability {text.percent(decided.probability)} for a distance in the probed volume", ""


def _next(fit: Fit, use: Use) -> text.Facts:
    failed = {check.words for check in fit.acceptance.failed}
    reasons = [reason for reason in use.against if reason not in failed]
    if use.against:
        reasons.append("robot.yaml says so; export, compensate and certificates need --force")
    yield from text.under("not to be used", reasons, "red")
    gap = f"bayescal gap {' '.join(str(d.folder) for d in (fit.dataset.sessions or (fit.dataset,)))}"
    gap += text.model_options(fit.final.effects, fit.options.omitted)
    yield "next", gap if use.next == "gap" else STEPS[use.next], "bold"
    if use.next == "use":
        yield "", f"{gap}  (effects that validation does not show)", ""


def _findings(fit: Fit) -> text.Facts:
    failed = {check.test for check in fit.acceptance.failed}
    for finding in fit.findings:
        if finding.code not in failed:
            yield finding.severity, finding.text, "" if finding.severity == "note" else "yellow"


def _details(fit: Fit, record: Json, verbose: bool) -> text.Facts:
    level, estimate = fit.final, fit.final.estimate
    model, scatter = estimate.model, level.unexplained
    count = sum(len(b.rows) for b in model.states)
    targets = f"{len(model.states)} target{'s' if len(model.states) > 1 else ''}"
    beside = [p.site.kind for p in model.parameters if not p.site.of_arm]
    parameters = f"{len(model.parameters) - len(beside)} parameters of the arm"
    parameters += f" and {len(beside)} of {text.listed(list(dict.fromkeys(beside)))}" if beside else ""
    parameters += f" from {count} measurements on {targets}"
    yield "fitted", f"{', '.join(level.effects)}: {parameters}", ""
    repeats = ""
    if scatter.repeats is not None:
        dof = f"{scatter.repeats_dof} d.o.f."
        repeats = f", {AGAIN[scatter.group]} {text.UM * scatter.repeats:.1f} µm ({dof})"
    what = "residual s.d." if scatter.group == "contact" else "single-point residual s.d."
    if any(b.group == scatter.group and b.kind.rows > 1 for b in model.states):
        what += " per coordinate"
    fitted, stated = (f"{text.UM * sd:.1f} µm" for sd in (scatter.fitted, scatter.stated))
    yield "noise", f"{what} {fitted}, stated {stated}{repeats}", ""
    yield from _discrepancy(fit)
    if len(estimate.rejected):
        ids = [fit.dataset.measurements.ids[row] for row in estimate.rejected]
        shown = ids if verbose else ids[:MOST_ROWS]
        more = ", ..." if len(shown) < len(ids) else ""
        rows = f"{len(ids)} row{'s' if len(ids) > 1 else ''}"
        yield "rejected", f"{rows} as outliers: {', '.join(shown)}{more}", ""
    if verbose:
        yield from _identifiable(fit)
    yield "posterior", _sampler(fit), ""
    yield from filed_lines(record)


def _discrepancy(fit: Fit) -> text.Facts:
    """How much of the stated uncertainty is from stated masses, and from model discrepancy by family."""
    shares, what = dict(fit.stated.parameter_shares), "of the variance of a distance in the probed volume"
    if of_masses := shares.pop(MASSES, 0.0):
        yield "u from masses", f"{text.percent(fit.forecast.masses_share)} {what}", ""
        yield "", f"{text.percent(of_masses)} of that of a parameter, in the mean", ""
    if shares:
        largest = [*shares.items()][:MOST_FAMILIES]
        named = ", ".join(f"{name} {text.percent(share)}" for name, share in largest)
        share = text.percent(fit.forecast.discrepancy_share)
        yield "discrepancy", f"{share} {what}", ""
        yield "", f"{text.percent(sum(shares.values()))} of that of a parameter, in the mean ({named})", ""


def _identifiable(fit: Fit) -> text.Facts:
    of = fit.identifiability
    for heading, names in (("identifiable", of.determined), ("weakly", of.partly), ("not", of.prior_only)):
        if names:
            yield heading, ", ".join(names), "yellow" if heading == "not" else ""
    yield from text.under("weak directions", (direction.words for direction in of.weak), "yellow")


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
