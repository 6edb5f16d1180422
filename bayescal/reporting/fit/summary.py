"""The terminal's summary of a fit: what a metrologist reads in ten seconds."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from bayescal.calibration import Fit
from bayescal.predict import Distances, PlaneCheck, PointCheck, TurnCheck, Validation, inside95, interval95
from bayescal.reporting.shared.text import MDEG, MM, UM, facts, model_label, plain_table, um

MOST_PAIRS = 15
MOST_DIRECTIONS = 6


def fit_summary(fit: Fit) -> RenderableType:
    """Headline, ladder of models, distances, parameters, sampler, warnings."""
    title = Text.assemble((fit.dataset.name, "bold"), f"  {fit.dataset.robot.name}")
    parts: list[RenderableType] = [title, facts(_headline(fit))]
    v = fit.final.validation
    if v.planes or v.distances or v.points or v.turns:
        parts += ["", _ladder(fit)]
    if v.distances:
        parts += ["", _distances(v, fit.ladder[0].validation)]
    parts += ["", facts([*_knowledge(fit), ("posterior", _sampler(fit), "")])]
    if fit.warnings:
        parts += ["", facts(("warning", warning, "yellow") for warning in fit.warnings)]
    return Group(*parts)


def _headline(fit: Fit) -> Iterable[tuple[str, str, str]]:
    rung, found = fit.final, fit.final.estimate
    left = rung.unexplained
    contacts = sum(len(b.rows) for b in found.model.states)
    yield "predicted error", _predicted(fit), "bold"
    if fit.forecast.checked:
        yield "", _expected(fit.forecast.workspace), ""
    yield (
        "fitted",
        f"{', '.join(rung.effects)}: {len(found.model.parameters)} arm parameters from {contacts} rows "
        f"on {len(found.model.states)} target{'s' if len(found.model.states) > 1 else ''}",
        "",
    )
    repeats = ""
    if left.repeats is not None:
        repeats = f", repeats {UM * left.repeats:.1f} um ({left.repeats_dof} degrees of freedom)"
    noise = f"fitted {UM * left.fitted:.1f} um, stated {UM * left.stated:.1f} um{repeats}"
    yield f"one {left.group}", noise, ""
    if len(found.rejected):
        ids = [fit.dataset.measurements.ids[row] for row in found.rejected]
        shown = ", ".join(ids[:8]) + (", ..." if len(ids) > 8 else "")
        yield "rejected", f"{len(ids)} rows as outliers: {shown}", ""


def _predicted(fit: Fit) -> str:
    """The distance error to expect, its interval, over which lengths, and what was measured of it."""
    lead, v = fit.forecast.lead, fit.final.validation
    words = _expected(lead)
    if lead.measured is None:
        return f"{words}; measured: none held out"
    words += f"; measured: {um(lead.measured)} um rms"
    if v.distances:
        inside = sum(bool(inside95(d.error, d.predicted)) for d in v.distances)
        words += f", worst {um(v.worst_distance)} um, {inside} of {len(v.distances)} inside"
    return words


def _expected(d: Distances) -> str:
    low, high = d.interval
    return (
        f"of a distance {um(d.rms)} um rms (95 %: {um(low)} to {um(high)}), "
        f"{d.count} of {MM * d.shortest:.0f} to {MM * d.longest:.0f} mm between {d.over}"
    )


def _ladder(fit: Fit) -> Table:
    v = fit.final.validation
    headings = ["planes rms"] * bool(v.planes)
    headings += ["distances rms", "worst", "predicted 95 %"] * bool(v.distances)
    headings += ["points mean"] * bool(v.points)
    headings += ["angles mean (mdeg)"] * bool(v.turns)
    table = plain_table("held out (um)", *headings, "inside")
    for rung in fit.ladder:
        v = rung.validation
        cells = []
        if v.planes:
            cells.append(um(np.sqrt(np.mean(np.concatenate([p.residuals for p in v.planes]) ** 2))))
        if v.distances:
            low, high = interval95(np.concatenate([d.predicted for d in v.distances]))
            cells.append(um(np.sqrt(np.mean([d.error**2 for d in v.distances]))))
            cells += [um(v.worst_distance), f"{UM * low:+.0f} .. {UM * high:+.0f}"]
        if v.points:
            cells.append(um(np.mean(np.concatenate([np.linalg.norm(p.residuals, axis=0) for p in v.points]))))
        if v.turns:
            angles = np.concatenate([np.linalg.norm(t.residuals, axis=0) for t in v.turns])
            cells.append(f"{MDEG * np.mean(angles):.2g}")
        table.add_row(model_label(rung.effects), *cells, _inside(v))
    return table


def _inside(v: Validation) -> str:
    """How many held-out values lie inside their predicted intervals, in per cent."""
    hits = [np.atleast_1d(inside95(d.error, d.predicted)) for d in v.distances]
    checks: list[PlaneCheck | PointCheck | TurnCheck] = [*v.planes, *v.points, *v.turns]
    hits += [inside95(check.residuals, check.predicted).ravel() for check in checks]
    return f"{100 * np.mean(np.concatenate(hits)):.0f} %" if hits else "-"


def _distances(v: Validation, nominal: Validation) -> Table:
    table = plain_table("distances (um)", "certified mm", "as drawn", "calibrated", "predicted 95 %", "")
    order = sorted(range(len(v.distances)), key=lambda k: -abs(v.distances[k].error))
    for k in sorted(order[:MOST_PAIRS]):
        d, n = v.distances[k], nominal.distances[k]
        low, high = interval95(d.predicted)
        table.add_row(
            " - ".join(d.between),
            f"{1e3 * d.certified:.3f}",
            f"{UM * n.error:+.0f}",
            f"{UM * d.error:+.1f}",
            f"{UM * low:+.1f} .. {UM * high:+.1f}",
            Text("inside", style="green")
            if inside95(d.error, d.predicted)
            else Text("outside", style="yellow"),
        )
    if len(order) > MOST_PAIRS:
        table.caption = f"the {MOST_PAIRS} largest of {len(order)}"
    return table


def _knowledge(fit: Fit) -> Iterable[tuple[str, str, str]]:
    known = fit.identifiability
    for heading, names, style in (
        ("data decide", known.determined, ""),
        ("data and prior", known.partly, ""),
        ("only the prior", known.prior_only, "yellow"),
    ):
        if names:
            yield heading, ", ".join(names), style
    for direction in known.weak[:MOST_DIRECTIONS]:
        yield "", direction.words, "yellow"
    if len(known.weak) > MOST_DIRECTIONS:
        yield "", f"and {len(known.weak) - MOST_DIRECTIONS} more weak directions: see fit.json", "yellow"


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
