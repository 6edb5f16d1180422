"""The figures of a fit and of a diagnosis: title, panels, and the file names in a run folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.reporting.figures import arm, distances, parameters, posterior, residuals, where
from bayescal.reporting.figures.palette import drawing
from bayescal.reporting.figures.sheet import WIDTH, Panel, into, sheet
from bayescal.reporting.shared.text import model_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Json = Mapping[str, Any]
FIT, GAP = "bayescal-fit/1", "bayescal-gap/1"
Content = tuple[Sequence[str], Sequence[Sequence[Panel]]]
"""Lines of the title, and panels by row."""
AGAIN = "repeat the command with this version"


def _levels(record: Json) -> Content:
    return ["Validation error of the model levels"], [[distances.levels_panel(dict(record))]]


def _where(record: Json) -> Content:
    own = dict(record)
    rows = [[where.places_panel(own), *([arm.arm_panel(own)] if "rows" in own else [])]]
    curves = where.curve_panels(own)
    return record["words"], [*rows, *([curves] if curves else [])]


def _which(record: Json) -> Content:
    return record["words"], [[where.effects_panel(dict(record)), where.sets_panel(dict(record))]]


def _residuals_fit(record: Json) -> Content:
    _needs(record, "rows")
    e = residuals.of_fit(dict(record))
    edge = residuals.edge_of(e)
    title = f"Residuals of the calibrated model: {residuals.rms_of(e)}"
    panels = [residuals.time_panel(e, edge, "", 2.2), residuals.spread_panel(e, edge)]
    return [title], [panels, [residuals.targets_panel(e, edge)]]


def _residuals_gap(record: Json) -> Content:
    before, after = (residuals.of_gap(dict(record), when) for when in ("before", "after"))
    same = np.allclose(before.value, after.value)
    edge = residuals.edge_of(before, after)
    baseline = model_label(record["baseline"])
    named = " + ".join((baseline, *(n["effect"] for n in record["named"])))
    shown = [(before, baseline)] if same else [(before, baseline), (after, named)]
    rows = [
        [
            residuals.time_panel(e, edge, f"{model}: {residuals.rms_of(e)}", 2.2),
            residuals.spread_panel(e, edge),
        ]
        for e, model in shown
    ]
    if np.any(after.target != ""):
        rows.append([residuals.targets_panel(after, edge)])
    return ["Residuals of the fitted measurements" + ("" if same else ", before and after the refit")], rows


def _distances(record: Json) -> Content:
    own = dict(record)
    first = distances.distances_panel(own) if record["schema"] == FIT else None
    panels = [p for p in (first, distances.reduction_panel(own)) if p is not None]
    if not has("distances", record):
        raise BayescalError(
            "there are no validation measurements",
            str(record["dataset"]["name"]),
            "add rows with role validate",
        )
    return ["Validation: errors before and after"], [[p] for p in panels]


def _parameters(record: Json) -> Content:
    return ["Parameters: estimate against prior"], [parameters.parameter_panels(dict(record))]


def _arm(record: Json) -> Content:
    _needs(record, "rows", "arm")
    return [str(record["arm"]["robot"])], [[arm.arm_panel(dict(record))]]


def _budget(record: Json) -> Content:
    return [f"Uncertainty budget: {record['measurand']}"], [[where.budget_panel(dict(record))]]


def posterior_content(record: Json, draws: posterior.Draws, names: Sequence[str] = ()) -> Content:
    """Title and panels of the posterior; without names of the parameters about which the data say least."""
    title = "Posterior distributions" if names else "Posterior of the parameters with the weakest data"
    return [title], posterior.posterior_rows(dict(record), draws, names)


CONTENT: dict[str, dict[str, Callable[[Json], Content]]] = {
    "levels": {FIT: _levels, GAP: _levels},
    "distances": {FIT: _distances, GAP: _distances},
    "residuals": {FIT: _residuals_fit, GAP: _residuals_gap},
    "parameters": {FIT: _parameters},
    "where": {GAP: _where},
    "which": {GAP: _which},
    "arm": {FIT: _arm, GAP: _arm},
    "budget": {"bayescal-budget/1": _budget},
}
"""Figures by name, and by the schema of the record that they are of."""
KINDS = {FIT: "a calibration", GAP: "a diagnosis", "bayescal-budget/1": "an uncertainty budget"}
FILES: dict[str, dict[str, str]] = {
    FIT: {f"fit-{name}.png": name for name in ("levels", "distances", "residuals", "parameters")},
    GAP: {f"gap-{name}.png": name for name in ("where", "which", "levels", "residuals")},
}
"""Files in a run folder by schema, and the figure that each holds; `fit-posterior.png` needs draws too."""


def has(name: str, record: Json) -> bool:
    """Whether a record holds what a figure is of: there may be no validation measurement."""
    own = dict(record)
    return name != "distances" or distances.measured(own)


def content(name: str, record: Json) -> Content:
    """Title and panels of a figure of `CONTENT`."""
    schema = record.get("schema", "")
    if schema not in CONTENT[name]:
        of = " or ".join(KINDS[s] for s in CONTENT[name])
        raise BayescalError(
            f"the figure `{name}` is of {of}, not of {KINDS.get(schema, schema)}", "bc.plot", f"give {of}"
        )
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
        if key not in record:
            raise BayescalError(
                f"the record has no `{key}`", str(record.get("dataset", {}).get("name", "")), AGAIN
            )
