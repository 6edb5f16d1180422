"""Sections of several pages: arm and contacts in 3-D, residuals, budget, inputs; data of the script."""

from typing import Any

import numpy as np
from markupsafe import Markup

from bayescal.effects.vocabulary import unit_label
from bayescal.reporting import page
from bayescal.reporting.body import joints_of, marks_of, typical
from bayescal.reporting.page import svg
from bayescal.reporting.page.svg import draw_arm, marked_sites
from bayescal.reporting.sheet import Bar, Column, Sheet, as_is
from bayescal.reporting.text import MISSING, length, share, two_digits
from bayescal.storage.reading import Json

LARGEST, MOST = 12, 200
"""Rows that the table of residuals shows unfolded, and at most."""
ROLES = {"validate": "validation"}
DRAWN = ("id", "target", "role", "time_s", "point_mm", "direction", "residual_um", "rejected")
"""Quantities of the rows that interactive figures use as they are."""
CLIP = 0.985
"""Quantile of the absolute residuals that a drawing covers."""


def noise(run: page.Run) -> float | None:
    """Noise of a contact, or of the length of a point's error vector, µm."""
    record = run.record
    value = record["noise"]["estimated_um"] if run.kind == "fit" else record["lengths"]["noise_um"]
    return None if value is None else float(value)


def signed(run: page.Run) -> bool:
    """Whether residuals have a sign: those of contacts do, lengths of error vectors do not."""
    return any((r or 0.0) < 0 for r in run.rows["residual_um"])


def interactive(run: page.Run) -> dict[str, Any] | None:
    """What the page's script draws; None for a record without rows."""
    if not run.drawable:
        return None
    rows = run.rows
    points = np.array(rows["point_mm"], float)
    away = np.median(points[:, :2], axis=0) - run.record["arm"]["links_mm"][0][:2]
    angle = float(np.arctan2(away[1], away[0])) - np.radians(65.0)  # the arm from the side
    return {
        "rows": {key: rows[key] for key in DRAWN} | {"joint": np.round(joints_of(run.record), 2).tolist()},
        "arm": run.record["arm"],
        "typical": typical(joints_of(run.record)),
        "eye": {"x": 1.15 * np.cos(angle), "y": 1.15 * np.sin(angle), "z": 0.5},
        "marks": marks_of(marked_sites(run)),
        "noise_um": noise(run),
        "signed": signed(run),
        "residual_label": "residual (µm)" if signed(run) else "length of the error vector (µm)",
    }


def scene(run: page.Run) -> page.Section | None:
    """The arm in 3-D with its contacts."""
    context = {"drawing": draw_arm(run, contacts=True)}
    return page.Section("arm", "Arm and measurements", "scene.html.j2", context) if run.drawable else None


def residuals(run: page.Run, *tables: page.Block | None) -> page.Section | None:
    """Residuals over time and over the angle of each joint, and tables by group."""
    if not run.drawable:
        return page.blocks("residuals", "Residuals", *tables)
    parts = [_drawings(run), page.Text(_legend(run), "quiet"), *page.not_empty(tables), _largest(run)]
    title = "Residuals before the refit" if run.refitted else "Residuals"
    return page.Section("residuals", title, "residuals.html.j2", {"blocks": parts})


def _legend(run: page.Run) -> str:
    band = noise(run)
    grey = f" Grey band: twice the noise of {length(band)} µm." if band is not None else ""
    return f"Blue: fitted measurements; orange: validation measurements; triangles: off scale.{grey}"


def _drawings(run: page.Run) -> page.Figures:
    rows = run.rows
    r = np.array(rows["residual_um"], float)
    keep = np.isfinite(r) & ~np.array(rows["rejected"], bool)
    check = np.array(rows["role"]) == "validate"
    level = noise(run)
    band = None if level is None else 2.0 * level
    edge = float(np.quantile(np.abs(r[keep]), CLIP)) if np.any(keep) else 1.0
    edge = 1.15 * max(edge, 2.2 * (level or 0.0), 1e-3)
    ends = (-edge if signed(run) else 0.0, edge)
    y_label = "residual (µm)" if signed(run) else "length of error (µm)"
    angles = joints_of(run.record)
    units = run.record["arm"].get("units", ["deg"] * angles.shape[1])
    coordinates = [("row", np.arange(len(r)) + 1.0)]
    if rows["time_s"] is not None:
        coordinates = [("time (min)", np.array(rows["time_s"], float) / 60.0)]
    coordinates += [
        (f"J{k} ({unit})", column)
        for k, (unit, column) in enumerate(zip(units, angles.T, strict=True), start=1)
    ]

    def drawn(label: str, x: np.ndarray) -> tuple[str, Markup]:
        kinds = (("dot", keep & ~check), ("check", keep & check))
        groups = [(style, x[some], r[some]) for style, some in kinds]
        return "", svg.scatter(groups, (label, y_label), band, f"Residuals over {label}", ends)

    return page.Figures(tuple(drawn(label, x) for label, x in coordinates))


def _largest(run: page.Run) -> Sheet:
    rows = {key: values for key, values in run.rows.items() if values is not None}
    items = [dict(zip(rows, row, strict=True)) for row in zip(*rows.values(), strict=True)]
    items.sort(key=lambda row: -1.0 if row["residual_um"] is None else abs(row["residual_um"]), reverse=True)

    def residual(row: Json) -> str | None:
        value = row["residual_um"]
        return None if value is None else f"{value:.1f}" + (", rejected" if row["rejected"] else "")

    columns = (
        Column("row", "id"),
        Column("target", "target", words=True),
        Column("role", lambda row: ROLES.get(row["role"], "fitted"), words=True),
        Column("residual (µm)", residual),
        *([Column("after the refit (µm)", "residual_after_um", "{:.1f}".format)] if run.refitted else []),
        Column("time (min)", lambda row: row.get("time_s"), lambda seconds: f"{seconds / 60:.1f}"),
        Column("direction of motion", lambda row: row.get("direction")),
    )
    more = f" ({MOST} of {len(items)})" if len(items) > MOST else ""
    return Sheet(columns, items[:MOST], f"Residuals, the largest first{more}", LARGEST)


MEASURANDS = (
    Column("measurand", "measurand"),
    Column("result, U = k u", "text", words=True),
    Column("u", lambda b: f"{two_digits(b['u'])} {unit_label(b['unit'])}"),
    Column("k", "k", "{:.2f}".format),
    Column("coverage", "coverage", lambda p: f"{100 * p:.2f} %"),
    Column("share of priors", "prior_share", share),
)


def budget(run: page.Run) -> page.Section | None:
    """The uncertainty budget, where there is one: all measurands, components of one of each kind."""
    if run.budget is None:
        return None
    each = run.budget["budgets"]
    every = Sheet(MEASURANDS, each, "Measurands; all components are in budget.json and budget.csv", 8)
    kinds = {one["kind"]: one for one in reversed(each)}  # the first of each kind
    tables = [_components(one) for one in each if kinds[one["kind"]] is one]
    return page.blocks("budget", "Uncertainty budget", every, *tables)


def _components(one: Json) -> Sheet:
    """Components of a budget, the largest first; contributions to a length are in µm."""
    total = sum(c["contribution"] ** 2 for c in one["components"]) or 1.0
    key, unit = ("contribution_um", "um") if one["U_um"] is not None else ("contribution", one["unit"])

    def part(c: Json) -> Bar:
        fraction = c["contribution"] ** 2 / total
        return Bar(fraction, share(fraction))

    def u(c: Json) -> str:
        number = MISSING if c["u"] is None else two_digits(c["u"])
        return f"{number} {unit_label(c['unit'] or '1')}".rstrip()

    def sensitivity(c: Json) -> str | None:
        if c["sensitivity"] is None:
            return None
        of, _, per = c["sensitivity_unit"].partition("/")
        unit = f"{unit_label(of)}/{unit_label(per)}".removesuffix("/") if per else ""
        return f"{two_digits(c['sensitivity'])} {unit}".rstrip()

    columns = (
        Column("component", "name"),
        Column("share of the variance", part, as_is),
        Column(f"contribution ({unit_label(unit)})", key, two_digits),
        Column("type", lambda c: c["type"] or None, words=True),
        Column("distribution", lambda c: c["distribution"] or None, words=True),
        Column("u", u),
        Column("sensitivity", sensitivity),
    )
    ranked = sorted(one["components"], key=lambda c: -abs(c["contribution"]))
    return Sheet(columns, ranked, f"Components of: {one['measurand']}", 10)


def figures(run: page.Run) -> page.Section | None:
    """Figures of the run folder, as pictures with text alternatives."""
    pictures = [page.picture(page.FIGURES[name], content) for name, content in run.figures.items()]
    return page.Section("figures", "Figures", "figures.html.j2", {"pictures": pictures}) if pictures else None


def inputs(run: page.Run) -> page.Section | None:
    """Dataset with its hash, options, seed, versions."""
    record = run.record
    dataset = record["dataset"]
    lines = [("dataset", str(dataset["name"])), ("SHA-256", str(dataset["sha256"] or MISSING))]
    lines += [
        (f"session {s['name']}", f"{s['rows']} measurements, SHA-256 {s['sha256'] or MISSING}")
        for s in dataset.get("sessions", ())
    ]
    model = record["model"] if run.kind == "fit" else record["baseline"]
    without = record.get("without") or ()
    lines += [
        ("robot", run.robot or MISSING),
        ("model", ", ".join(model) + (f" without {', '.join(without)}" if without else "")),
        ("seed", str(record["seed"])),
        ("versions", ", ".join(f"{name} {v}" for name, v in record["software"].items())),
    ]
    return page.blocks("inputs", "Inputs and versions", page.Facts(tuple(lines)))
