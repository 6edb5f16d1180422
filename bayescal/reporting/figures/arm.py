"""The nominal arm at a row of the session, with the contacts and their errors, in an oblique view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.reporting.figures.residuals import Errors, of_fit, of_gap
from bayescal.reporting.figures.sheet import Entry, Panel
from bayescal.reporting.figures.where import significant
from bayescal.reporting.shared.body import View, fill, joints_of, of_units, outlines, posed, typical
from bayescal.reporting.shared.style import ACCENT, GREY, INK, MARKED, SERIES
from bayescal.storage.reading import Json

if TYPE_CHECKING:
    from bayescal.effects.location import Site

VIEW = View.of(np.radians(-62.0), np.radians(18.0))
"""Direction of view: an oblique view without perspective."""
AXIS = 60.0
"""Half the length of the line that marks the axis of a joint, mm."""
LARGE = 0.97
"""Quantile of the absolute errors that has the largest sign."""
SMALLEST, LARGEST = 1.0, 16.0
"""Areas of signs, pt^2."""
FLOOR = 9.0
"""Room below the arm for the scale and the directions of F0, mm."""
SIGNS = (("+", "^", SERIES[1], lambda error: error >= 0), ("−", "v", SERIES[0], lambda error: error < 0))
LENGTHS = (("", "o", SERIES[1], np.isfinite),)
"""Text, marker and colour of signs, and the errors that have them."""
ROUND = {"solid_capstyle": "round", "solid_joinstyle": "round"}
WIDE: dict[str, Any] = {"color": INK, "lw": 2.5, "alpha": 0.8, **ROUND}


def arm_panel(record: Json) -> Panel:
    """The arm with contacts: signs up and down for positive and negative errors, their area for the size.

    Of a fit the residuals of the fitted model; of a diagnosis those of the baseline, before the refit.
    """
    diagnosis = record["schema"] == "bayescal-gap/1"
    e = of_gap(record, "before") if diagnosis else of_fit(record)
    edge = max(float(np.quantile(np.abs(e.value), LARGE)), 1e-3) if len(e.value) else 1.0
    marked = marked_sites(record) if diagnosis else []
    what = f"{_um(edge)} µm or more"
    sign = {"ls": "", "ms": LARGEST**0.5}
    signs = SIGNS if e.signed else LENGTHS
    key = [Entry(f"{text}{what}", {"marker": marker, "color": c, **sign}) for text, marker, c, _ in signs]
    if marked:
        key.append(Entry(", ".join(marked), {"color": MARKED, "lw": 3.5}))

    def draw(axes: Any) -> None:
        sites: list[Site] = []
        if marked:
            from bayescal.effects.location import Site  # slow to import, and seldom needed

            sites = [Site.read(name) for name in marked]
        _draw(axes, record, e, edge, sites)

    title = f"Nominal arm, contacts with their residuals{' before the refit' if record.get('named') else ''}"
    return Panel(draw, lambda inner: 0.85 * inner + FLOOR, title, key=key)


def marked_sites(record: Json) -> list[str]:
    """Sites that drawings of a diagnosis mark: of the errors that are significant; none where nothing is."""
    if record["verdict"] == "null":
        return []
    sites = [a["site"] for a in record["amplitudes"] if a["significant"]]
    sites = sites or [site for site in [record.get("marked")] if site]
    if record["verdict"] == "named+unexplained":
        sites += [w["site"] for w in record["where"] if not w["explained_by"] and significant(w)][:1]
    return list(dict.fromkeys(sites))


def _draw(axes: Any, record: Json, e: Errors, edge: float, sites: Sequence[Site]) -> None:
    points, readings = np.array(record["rows"]["point_mm"], float), joints_of(record)
    row = e.row[typical(readings[e.row])] if len(e.row) else 0
    angles = of_units(record["arm"], readings[row])
    line_of, turned = posed(record["arm"], angles)
    strokes = np.stack([line_of[1:-1] - AXIS * turned, line_of[1:-1] + AXIS * turned], axis=1)
    drawn, flat = VIEW.seen(np.vstack([line_of, points[row]])), VIEW.seen(points[e.row])
    bodies = outlines(record["arm"], angles, VIEW)
    fill(axes, bodies)
    axes.plot(*drawn.T, zorder=2, **(WIDE | ({"lw": 0.8} if bodies else {})))
    axes.plot(*drawn[0], marker="s", ms=7, color=GREY, zorder=2)
    for k, stroke in enumerate(VIEW.seen(strokes), start=1):
        mine = any(site.kind == "joint" and site.number == k for site in sites)
        colour, thick = (MARKED, 4.5) if mine else (ACCENT, 2.2)
        axes.plot(*stroke.T, color=colour, lw=thick, zorder=3 + mine)
    for site in sites:
        _mark(axes, site, drawn, flat, e.target, alone=len(sites) == 1)
    area = SMALLEST + (LARGEST - SMALLEST) * np.minimum(np.abs(e.value) / edge, 1.0)
    for _, marker, colour, chosen in SIGNS if e.signed else LENGTHS:
        which = chosen(e.value)
        image = len(flat) > MANY
        size = area[which]
        axes.scatter(*flat[which].T, s=size, marker=marker, color=colour, lw=0, zorder=5, rasterized=image)
    _frame(axes, np.vstack([drawn, flat, VIEW.seen(strokes).reshape(-1, 2), *(o.polygon for o in bodies)]))


MANY = 1500
"""Contacts from which on their signs are an image in an SVG."""


def _mark(
    axes: Any, site: Site, drawn: np.ndarray, flat: np.ndarray, targets: np.ndarray, alone: bool
) -> None:
    """Mark a site: a link, the base, the stylus, contacts of a target; all contacts for others `alone`."""
    if site.kind == "link":
        axes.plot(*drawn[site.number : site.number + 2].T, color=MARKED, lw=4.5, zorder=3)
    elif site.kind == "base":
        axes.plot(*drawn[0], marker="s", ms=10, color=MARKED, zorder=3)
    elif site.kind in ("tool", "probe"):
        axes.plot(*drawn[-2:].T, color=MARKED, lw=4.5, zorder=3)
    elif site.kind != "joint" and (alone or np.any(targets == str(site))):
        mine = flat[targets == str(site)] if np.any(targets == str(site)) else flat
        axes.scatter(*mine.T, s=30, facecolors="none", edgecolors=MARKED, lw=0.6, zorder=6)


def _frame(axes: Any, content: np.ndarray) -> None:
    """Limits with equal scales, and below the content a scale in mm and the directions of F0."""
    figure: Any = axes.figure
    box = axes.get_window_extent()
    wide, tall = box.width / figure.dpi * 25.4, box.height / figure.dpi * 25.4
    low, high = content.min(axis=0), content.max(axis=0)
    size = np.maximum(high - low, 1e-6)
    per_mm = 1.06 * max(size[0] / wide, size[1] / (tall - FLOOR))  # of the scene, per mm of the figure
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - 0.5 * per_mm * wide, middle[0] + 0.5 * per_mm * wide)
    bottom = middle[1] - 0.5 * per_mm * (tall - FLOOR) - per_mm * FLOOR
    axes.set_ylim(bottom, bottom + per_mm * tall)
    axes.axis("off")
    length = _round(per_mm * 0.25 * wide)
    start = middle[0] - 0.5 * per_mm * wide
    axes.plot([start, start + length], [bottom + 1.0 * per_mm] * 2, color=INK, lw=1.2, solid_capstyle="butt")
    axes.text(start, bottom + 1.8 * per_mm, f"{length:g} mm", color=INK, va="bottom", ha="left")
    corner = np.array([middle[0] + 0.5 * per_mm * wide - 9.0 * per_mm, bottom + 1.5 * per_mm])
    for name, way in zip("xyz", VIEW.seen(np.eye(3)), strict=True):
        tip = corner + 4.5 * per_mm * way
        axes.plot(*np.array([corner, tip]).T, color=GREY, lw=1.0)
        to = corner + (4.5 * way + 1.6 * way / max(float(np.hypot(*way)), 0.2)) * per_mm
        axes.text(*to, name, color=INK, ha="center", va="center")


def _round(value: float) -> float:
    """The next smaller length of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(s for s in (5.0, 2.0, 1.0) if s * power <= value) * power)


def _um(value: float) -> str:
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"
