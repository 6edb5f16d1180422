"""Errors of the rows over time, their distribution with the noise, and by target: a mark for each row.

The nominal arm at a row of the session, with the contacts and their errors, in an oblique view.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayescal.effects.location import Site
from bayescal.reporting.body import DRAWN, View, fill, joints_of, marks_of, of_units, outlines, posed, typical
from bayescal.reporting.figures import scales
from bayescal.reporting.figures.sheet import LANE, Entry, Panel, Row, first_of, rows_panel
from bayescal.reporting.style import ACCENT, GREY, HOLLOW, INK, MARKED, NOISE, SERIES
from bayescal.reporting.text import significant
from bayescal.statistics import chi2_isf, grouped, rms
from bayescal.storage.reading import Json

CLIP = 0.99
"""Quantile of the absolute errors that an axis covers; larger ones are marked at its edge."""
HEIGHT = 36.0
"""Of the axes over time, mm."""
MOST_TARGETS = 20
BINS = 45
MANY = 3000
"""Rows from which on their marks are an image in an SVG."""
KINDS: dict[str, Any] = {
    "fitted": {"color": SERIES[0], "marker": "o", "ms": 2.2, "mew": 0},
    "validation": {"markeredgecolor": SERIES[1], "marker": "D", "ms": 2.8, "mew": 0.7, **HOLLOW},
    "rejected": {"color": MARKED, "marker": "x", "ms": 3.5, "mew": 0.9},
}
"""Marks of the rows by what they are used for."""


@dataclass(frozen=True)
class Errors:
    """Errors of rows: a residual with its sign, of points the length of the error vector.

    Attributes
    ----------
    row : np.ndarray, shape (R,)
        Index among the rows of the record.
    x : np.ndarray, shape (R,)
        Time in min or number of the row.
    value : np.ndarray, shape (R,)
        µm.
    target, kind : np.ndarray, shape (R,)
        Names of the targets, keys of `KINDS`.
    components : int
        Coordinates of the vectors whose lengths these are; 1 of residuals with a sign.
    timed : bool
        Whether x is a time.
    noise : float
        Noise of a coordinate, µm; nan if unknown.
    """

    row: np.ndarray
    x: np.ndarray
    value: np.ndarray
    target: np.ndarray
    kind: np.ndarray
    components: int
    timed: bool
    noise: float

    @property
    def signed(self) -> bool:
        """Whether they are residuals with a sign."""
        return self.components == 1


def of_fit(record: Json) -> Errors:
    """Errors of a fit: fitted, validation and rejected measurements of the targets in the model."""
    rows = record["rows"]
    value = np.array(rows["residual_um"], float)
    kind = np.where(np.array(rows["role"]) == "validate", "validation", "fitted")
    kind = np.where(np.array(rows["rejected"], bool), "rejected", kind)
    # of planes and points together the lengths of points have no sign, and the others have
    components = 1 if np.any(value < 0) else record["noise"].get("components", 3)
    return _ordered(rows, value, np.array(rows["target"]), kind, components, record["noise"]["estimated_um"])


def of_gap(record: Json, when: str) -> Errors:
    """Errors of the fitted measurements of a diagnosis; `when` is "before" or "after" the refit."""
    entries, rows = record["residuals"], record.get("rows")
    components = grouped(zip(entries["id"], entries[f"{when}_um"], strict=True))
    most = max((len(r) for r in components.values()), default=1)
    value = {name: r[0] if most == 1 else np.sqrt(np.sum(np.square(r))) for name, r in components.items()}
    if rows is None:  # in the order of time, as `residuals`
        rows = {"id": list(value), "time_s": None, "target": [""] * len(value)}
    every = np.array([value.get(name, np.nan) for name in rows["id"]], float)
    flags = entries.get(f"excluded_{when}", [False] * len(entries["id"]))
    excluded = [name for name, flag in zip(entries["id"], flags, strict=True) if flag]
    kind = np.where(np.isin(rows["id"], excluded), "rejected", "fitted")
    return _ordered(rows, every, np.array(rows["target"]), kind, most, record["gap"]["noise_um"])


def _ordered(
    rows: Json, value: np.ndarray, target: np.ndarray, kind: np.ndarray, components: int, noise: float | None
) -> Errors:
    timed, x = rows["time_s"] is not None, np.arange(1.0, len(value) + 1)
    if timed:
        x = (np.array(rows["time_s"], float) - min(rows["time_s"])) / 60.0
    keep = np.flatnonzero(np.isfinite(value) & np.isfinite(x))
    level = np.nan if noise is None else noise
    return Errors(keep, x[keep], value[keep], target[keep], kind[keep], components, timed, level)


def edge_of(*series: Errors) -> float:
    """End of the axis of errors, µm, for all series."""
    every = np.abs(np.concatenate([e.value for e in series]))
    noise = max((e.noise for e in series if np.isfinite(e.noise)), default=0.0)
    return float(1.15 * max(np.quantile(every, CLIP) if len(every) else 0.0, 3.2 * noise)) or 1.0


def time_panel(e: Errors, edge: float, title: str, share: float) -> Panel:
    """Errors over time or row; the band is twice the noise."""
    kinds = [k for k in KINDS if np.any(e.kind == k)]
    key = [Entry(f"{k} measurements", {"ls": "", **KINDS[k]}) for k in kinds] if len(kinds) > 1 else []
    beyond = int(np.sum(np.abs(e.value) > edge))
    note = f"{beyond} measurements are off scale and marked at the edge" if beyond else ""

    def draw(axes: Any) -> None:
        _band(axes, e, across=False)
        for kind in kinds:
            mine = (e.kind == kind) & (np.abs(e.value) <= edge)
            axes.plot(e.x[mine], e.value[mine], ls="", rasterized=len(e.x) > MANY, **KINDS[kind])
        for side, marker in ((1, "^"), (-1, "v")):
            x = e.x[(np.abs(e.value) > edge) & (np.sign(e.value) == side)]
            axes.plot(x, np.full(len(x), side * 0.97 * edge), ls="", marker=marker, ms=4, color=MARKED)
        axes.set_ylim(-edge if e.signed else 0.0, edge)
        scales.linear_both(axes, HEIGHT)

    x = "time (min)" if e.timed else "row"
    return Panel(draw, HEIGHT, title, x, _label(e), note, key, share)


def beside(e: Errors, edge: float, title: str = "") -> list[Panel]:
    """Errors over time, and their distribution beside them."""
    return [time_panel(e, edge, title, 2.2), spread_panel(e, edge)]


def _label(e: Errors) -> str:
    return "residual (µm)" if e.signed else "error length (µm)"


def _band(axes: Any, e: Errors, across: bool) -> None:
    """Twice the noise; of lengths the 95 % quantile of the length of so many coordinates."""
    if np.isfinite(e.noise):
        ends = (-2 * e.noise, 2 * e.noise) if e.signed else (0.0, length95(e.components) * e.noise)
        (axes.axvspan if across else axes.axhspan)(*ends, color=NOISE, lw=0, zorder=0)


def length95(components: int) -> float:
    """95 % quantile of the length of a vector of standard normal coordinates."""
    return float(np.sqrt(chi2_isf(0.05, components)))


def spread_panel(e: Errors, edge: float) -> Panel:
    """Distribution of the errors, and of the noise alone."""
    each = "" if e.signed else " per coordinate"
    noise = Entry(f"noise, {e.noise:.1f} µm{each}", {"color": INK, "lw": 1.2})
    key = [noise] if np.isfinite(e.noise) else []

    def draw(axes: Any) -> None:
        low = -edge if e.signed else 0.0
        value = e.value[e.kind != "rejected"]
        bins = np.linspace(low, edge, BINS).tolist()
        axes.hist(value, bins, density=True, color=SERIES[0], alpha=0.5, histtype="stepfilled")
        if np.isfinite(e.noise) and e.noise > 0:
            fine = np.linspace(low, edge, 300)
            axes.plot(fine, noise_density(fine, e.noise, e.components), color=INK, lw=1.2)
        scales.without_y(axes)
        scales.linear_x(axes, low, edge)

    return Panel(draw, HEIGHT, "Distribution", _label(e), key=key)


def noise_density(x: np.ndarray, sd: float, components: int) -> np.ndarray:
    """Density of noise of standard deviation `sd`: normal, of lengths of two or three coordinates chi."""
    bell = np.exp(-0.5 * (x / sd) ** 2)
    if components == 1:
        return bell / (sd * np.sqrt(2 * np.pi))
    k = components
    return 2.0 ** (1.0 - 0.5 * k) / math.gamma(0.5 * k) * (x / sd) ** (k - 1) * bell / sd


def targets_panel(e: Errors, edge: float) -> Panel:
    """Errors by target, those with the largest RMS first."""
    used = e.kind != "rejected"
    errors = {str(t): e.value[used & (e.target == t)] for t in np.unique(e.target[used])}
    names = sorted(errors, key=lambda t: -rms(errors[t]))
    shown, note = first_of(names, MOST_TARGETS, "targets with smaller errors are not shown")
    rows = [Row(t, f"RMS {rms(errors[t]):.1f} µm, {len(errors[t])} measurements") for t in shown]

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        _band(axes, e, across=True)
        rng = np.random.default_rng(0)
        for name, middle in zip(shown, middles, strict=True):
            for kind, style in KINDS.items():
                mine = (e.target == name) & (e.kind == kind)
                y = middle + 0.25 * LANE * rng.uniform(-1, 1, int(mine.sum()))
                axes.plot(np.clip(e.value[mine], -edge, edge), y, ls="", rasterized=len(e.x) > MANY, **style)
        scales.linear_x(axes, -edge if e.signed else 0.0, edge)

    return rows_panel(rows, lanes, "By target, the largest RMS first", _label(e), note)


def rms_of(e: Errors) -> str:
    """RMS of the rows that are not rejected, as text."""
    value = e.value[e.kind != "rejected"]
    what = "" if e.signed else " error length"
    return f"RMS{what} {rms(value):.1f} µm" if len(value) else "no measurements"


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
        _draw(axes, record, e, edge, [Site.read(name) for name in marked])

    title = f"Nominal arm, contacts with their residuals{' before the refit' if record.get('named') else ''}"
    return Panel(draw, lambda inner: 0.85 * inner + FLOOR, title, key=key)


def marked_sites(record: Json) -> list[str]:
    """Sites that drawings of a diagnosis mark: of the errors that are significant; none where nothing is."""
    if record["verdict"] == "null":
        return []
    sites = [a["site"] for a in record["amplitudes"] if a["significant"]]
    sites = sites or [site for site in [record.get("marked")] if site]
    if record["verdict"] == "named+unexplained":
        others = (w for w in record["where"] if not w["explained_by"])
        sites += [w["site"] for w in others if significant(w["family_p_value"])][:1]
    return list(dict.fromkeys(sites))


def _draw(axes: Any, record: Json, e: Errors, edge: float, sites: Sequence[Site]) -> None:
    arm, points, readings = record["arm"], np.array(record["rows"]["point_mm"], float), joints_of(record)
    row = e.row[typical(readings[e.row])] if len(e.row) else 0
    angles, marks = of_units(arm, readings[row]), marks_of(sites)
    origins, turned = posed(arm, angles)
    strokes = VIEW.seen(np.stack([origins[1:-1] - AXIS * turned, origins[1:-1] + AXIS * turned], axis=1))
    drawn, flat = VIEW.seen(np.vstack([origins, points[row]])), VIEW.seen(points[e.row])
    bodies = outlines(arm, angles, VIEW)
    fill(axes, bodies, marks)
    axes.plot(*drawn.T, zorder=2, **(WIDE | ({"lw": 0.8} if bodies else {})))
    axes.plot(*drawn[0], marker="s", ms=7, color=MARKED if marks["base"] else GREY, zorder=2)
    for k, stroke in enumerate(strokes, start=1):
        colour, thick, order = (MARKED, 4.5, 4) if k in marks["joints"] else (ACCENT, 2.2, 3)
        axes.plot(*stroke.T, color=colour, lw=thick, zorder=order)
    for site in sites:
        mine = e.target == str(site)  # or of all contacts, where nothing else is marked
        if site.kind not in DRAWN and (np.any(mine) or len(sites) == 1):
            rings = flat[mine] if np.any(mine) else flat
            axes.scatter(*rings.T, s=30, facecolors="none", edgecolors=MARKED, lw=0.6, zorder=6)
    area = SMALLEST + (LARGEST - SMALLEST) * np.minimum(np.abs(e.value) / edge, 1.0)
    image = len(flat) > MANY_POSES
    for _, marker, colour, chosen in SIGNS if e.signed else LENGTHS:
        mine = chosen(e.value)
        style = {"marker": marker, "color": colour, "lw": 0, "zorder": 5, "rasterized": image}
        axes.scatter(*flat[mine].T, s=area[mine], **style)
    _frame(axes, np.vstack([drawn, flat, strokes.reshape(-1, 2), *(o.polygon for o in bodies)]))


MANY_POSES = 1500
"""Contacts from which on their signs are an image in an SVG."""


def _frame(axes: Any, content: np.ndarray) -> None:
    """Limits with equal scales, and below the content a scale in mm and the directions of F0."""
    wide, tall = scales.size_of(axes)
    low, high = content.min(axis=0), content.max(axis=0)
    size = np.maximum(high - low, 1e-6)
    per_mm = 1.06 * max(size[0] / wide, size[1] / (tall - FLOOR))  # of the scene, per mm of the figure
    corner = 0.5 * (low + high) - 0.5 * per_mm * np.array([wide, tall + FLOOR])
    axes.set_xlim(corner[0], corner[0] + per_mm * wide)
    axes.set_ylim(corner[1], corner[1] + per_mm * tall)
    axes.axis("off")

    def placed(x: float, y: float) -> np.ndarray:
        """A place of the figure, mm from its corner, in the scene."""
        return corner + per_mm * np.array([x, y])

    length = _round(per_mm * 0.25 * wide)
    ends = np.array([placed(0.0, 1.0), placed(length / per_mm, 1.0)])
    axes.plot(*ends.T, color=INK, lw=1.2, solid_capstyle="butt")
    axes.text(*placed(0.0, 1.8), f"{length:g} mm", color=INK, va="bottom", ha="left")
    for name, way in zip("xyz", VIEW.seen(np.eye(3)), strict=True):
        middle, beyond = placed(wide - 9.0, 1.5), 4.5 * way + 1.6 * way / max(float(np.hypot(*way)), 0.2)
        axes.plot(*np.array([middle, middle + 4.5 * per_mm * way]).T, color=GREY, lw=1.0)
        axes.text(*(middle + per_mm * beyond), name, color=INK, ha="center", va="center")


def _round(value: float) -> float:
    """The next smaller length of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(s for s in (5.0, 2.0, 1.0) if s * power <= value) * power)


def _um(value: float) -> str:
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"
