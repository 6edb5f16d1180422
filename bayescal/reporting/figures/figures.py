"""The figures of a fit and of a diagnosis: title, panels, and the files in a run folder.

A PNG has the same bytes for the same record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bayescal.errors import BayescalError
from bayescal.reporting.figures import estimates, residuals, where
from bayescal.reporting.figures.estimates import Draws
from bayescal.reporting.figures.sheet import WIDTH, Panel, into, sheet
from bayescal.reporting.style import drawing, png
from bayescal.reporting.text import model_label
from bayescal.storage.reading import Json

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIT, GAP, BUDGET = "bayescal-fit/1", "bayescal-gap/1", "bayescal-budget/1"
Content = tuple[Sequence[str], Sequence[Sequence[Panel]]]
"""Lines of the title, and panels by row."""


def _where(record: Json) -> Content:
    rows = [[where.places_panel(record), *([residuals.arm_panel(record)] if "rows" in record else [])]]
    curves = [where.curve_panel(curve) for curve in where.drawn_curves(record)]
    return record["words"], [*rows, *([curves] if curves else [])]


def _residuals_fit(record: Json) -> Content:
    _needs(record, "rows")
    e = residuals.of_fit(record)
    edge = residuals.edge_of(e)
    title = f"Residuals of the calibrated model: {residuals.rms_of(e)}"
    return [title], [residuals.beside(e, edge), [residuals.targets_panel(e, edge)]]


def _residuals_gap(record: Json) -> Content:
    before, after = (residuals.of_gap(record, when) for when in ("before", "after"))
    same = np.allclose(before.value, after.value)
    edge = residuals.edge_of(before, after)
    baseline = model_label(record["baseline"])
    named = " + ".join((baseline, *(n["effect"] for n in record["named"])))
    shown = [(before, baseline)] if same else [(before, baseline), (after, named)]
    rows = [residuals.beside(e, edge, f"{model}: {residuals.rms_of(e)}") for e, model in shown]
    if np.any(after.target != ""):
        rows.append([residuals.targets_panel(after, edge)])
    return ["Residuals of the fitted measurements" + ("" if same else ", before and after the refit")], rows


def _distances(record: Json) -> Content:
    first = estimates.distances_panel(record) if record["schema"] == FIT else None
    panels = [p for p in (first, estimates.reduction_panel(record)) if p is not None]
    _validated(record, bool(panels))
    return ["Validation: errors before and after"], [[p] for p in panels]


def _levels(record: Json) -> Content:
    _validated(record, estimates.levelled(record))
    return ["Validation error of the model levels"], [[estimates.levels_panel(record)]]


def _validated(record: Json, some: bool) -> None:
    _check(record, some, "there are no validation measurements", "add rows with role validate")


def _arm(record: Json) -> Content:
    _needs(record, "rows", "arm")
    return [str(record["arm"]["robot"])], [[residuals.arm_panel(record)]]


def _parameters(record: Json) -> Content:
    _fitted(record)
    return ["Parameters: estimate against prior"], [estimates.parameter_panels(record)]


def _fitted(record: Json) -> None:
    _check(record, bool(estimates.of_arm(record)), "no parameter of the arm was fitted", "fit one")


def posterior_content(record: Json, draws: Draws, names: Sequence[str] = ()) -> Content:
    """Title and panels of the posterior; without names of the parameters about which the data say least."""
    _fitted(record)
    title = "Posterior distributions" if names else "Posterior of the parameters with the weakest data"
    return [title], estimates.posterior_rows(record, draws, names)


CONTENT: dict[str, dict[str, Callable[[Json], Content]]] = {
    "levels": {FIT: _levels, GAP: _levels},
    "distances": {FIT: _distances, GAP: _distances},
    "residuals": {FIT: _residuals_fit, GAP: _residuals_gap},
    "parameters": {FIT: _parameters},
    "where": {GAP: _where},
    "which": {GAP: lambda r: (r["words"], [[where.effects_panel(r), where.sets_panel(r)]])},
    "arm": {FIT: _arm, GAP: _arm},
    "budget": {BUDGET: lambda r: ([f"Uncertainty budget: {r['measurand']}"], [[where.budget_panel(r)]])},
}
"""Figures by name, and by the schema of the record that they are of."""
KINDS = {FIT: "a calibration", GAP: "a diagnosis", BUDGET: "an uncertainty budget"}
FILES: dict[str, dict[str, str]] = {
    FIT: {f"fit-{name}.png": name for name in ("levels", "distances", "residuals", "parameters")},
    GAP: {f"gap-{name}.png": name for name in ("where", "which", "levels", "residuals")},
}
"""Files in a run folder by schema, and the figure that each holds; `fit-posterior.png` needs draws too."""


def content(name: str, record: Json) -> Content:
    """Title and panels of a figure of `CONTENT`."""
    schema = record.get("schema", "")
    if schema not in CONTENT[name]:
        of = " or ".join(KINDS[s] for s in CONTENT[name])
        what = f"the figure `{name}` is of {of}, not of {KINDS.get(schema, schema)}"
        raise BayescalError(what, "bc.plot", f"give {of}")
    return CONTENT[name][schema](record)


def draw(name: str, record: Json, wide: float = WIDTH, ax: Axes | None = None) -> Figure:
    """A figure of a record.

    Parameters
    ----------
    name : str
        A key of `CONTENT`.
    record : mapping
        Content of fit.json, gap.json or budget.json.
    wide : float
        Width, mm.
    ax : Axes, optional
        Draw the first panel into these axes instead.
    """
    return drawn(content(name, record), wide, ax)


def drawn(of: Content, wide: float = WIDTH, ax: Axes | None = None) -> Figure:
    """A figure of a title and panels."""
    title, rows = of
    with drawing():
        return sheet(title, rows, wide) if ax is None else into(ax, rows[0][0])


def _needs(record: Json, *keys: str) -> None:
    for key in keys:
        _check(record, key in record, f"the record has no `{key}`", "repeat the command with this version")


def _check(record: Json, there: bool, what: str, remedy: str) -> None:
    """Refuse a record in which something is not there."""
    if not there:
        raise BayescalError(what, str(record.get("dataset", {}).get("name", "")), remedy)


def figures_of(record: Json, draws: Draws | None = None) -> dict[str, bytes]:
    """File names of the figures of a fit or a diagnosis, and their content as PNG.

    With the draws of its parameters, by name, the posterior of a fit too. Those of which the record has
    nothing are left out: there may be no validation measurement, and no parameter.
    """
    every = {file: partial(content, name) for file, name in FILES[record["schema"]].items()}
    if draws:
        every["fit-posterior.png"] = partial(posterior_content, draws=draws)
    drawable: dict[str, Content] = {}
    for file, content_of in every.items():
        with suppress(BayescalError):
            drawable[file] = content_of(record)
    return {file: picture(of) for file, of in drawable.items()}


def picture(of: Content, wide: float = WIDTH) -> bytes:
    """A figure of a title and panels as PNG, `wide` mm wide."""
    with drawing():
        return png(sheet(*of, wide))
