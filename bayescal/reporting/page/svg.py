"""Small drawings as SVG text that scales with the page: scatter plots, intervals, a matrix, the arm.

All text is escaped; colours are those of the page's style sheet (classes), so that they print and read in
grey. Sizes are in user units, about a pixel at 360 pixels width.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from bayescal.effects.location import Site
from bayescal.reporting.body import View, is_marked, joints_of, marks_of, of_units, outlines, posed, typical
from bayescal.reporting.figures.residuals import marked_sites as figure_sites
from bayescal.reporting.page import Run

WIDTH, HEIGHT = 360, 210
LEFT, RIGHT, TOP, BOTTOM = 44, 8, 8, 36
TICKS = 5
CHARACTER = 6.4
"""Width of a character, about."""


Dots = tuple[str, np.ndarray, np.ndarray]
"""Points of a scatter plot: their class, x and y."""


def drawing(width: float, height: float, parts: Sequence[str], label: str) -> Markup:
    """An SVG with its text alternative."""
    head = f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(label)}">'
    return Markup(head + "".join(parts) + "</svg>")


def text(x: float, y: float, words: str, style: str = "", anchor: str = "middle") -> str:
    """A line of text at a point."""
    kind = f' class="{style}"' if style else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{kind}>{escape(words)}</text>'


def line(points: np.ndarray, style: str, shape: str = "polyline") -> str:
    """A polyline through points (N, 2), or another shape of points."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<{shape} class="{style}" points="{path}"/>'


def ticks(low: float, high: float) -> np.ndarray:
    """Round values within an interval, at most about `TICKS`; zero has no sign."""
    if not high > low:
        return np.array([low])
    raw = (high - low) / TICKS
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(m for m in (1, 2, 5, 10) if m * power >= raw * 0.999)
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    return np.arange(first, last + 1) * step + 0.0  # -0.0 + 0.0 = 0.0


@dataclass(frozen=True)
class _Axes:
    """Linear axes of a drawing: limits and labels of x and y, and the ticks of both."""

    x: tuple[float, float]
    y: tuple[float, float]
    labels: tuple[str, str]
    along: np.ndarray
    levels: np.ndarray

    @property
    def left(self) -> float:
        """Where x begins: there is room for the label of y and its ticks."""
        return max(LEFT, 20 + CHARACTER * max(len(f"{v:g}") for v in self.levels))

    def to_svg(self, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        """Points (..., 2) in user units."""
        (low, high), (bottom, top) = self.x, self.y
        across = self.left + (np.asarray(x) - low) / (high - low) * (WIDTH - self.left - RIGHT)
        down = TOP + (top - np.asarray(y)) / ((top - bottom) or 1.0) * (HEIGHT - TOP - BOTTOM)
        return np.stack(np.broadcast_arrays(across, down), axis=-1)

    def drawing(self, below: Sequence[str], data: Sequence[str], label: str, zero: str = "grid") -> Markup:
        """SVG of data on a grid; `below` is under the grid, `zero` the class of its line at zero."""
        low, bottom = self.x[0], self.y[0]
        grid = []
        for v in self.levels:
            y = float(self.to_svg(low, v)[1])
            ends = np.array([[self.left, y], [WIDTH - RIGHT, y]])
            grid.append(line(ends, zero if abs(v) < 1e-12 else "grid"))
            grid.append(text(self.left - 5, y + 4, f"{v:g}", anchor="end"))
        for v in self.along:
            grid.append(text(float(self.to_svg(v, bottom)[0]), HEIGHT - BOTTOM + 15, f"{v:g}"))
        x_label, y_label = self.labels
        across = text((self.left + WIDTH - RIGHT) / 2, HEIGHT - 5, x_label)
        middle = (TOP + HEIGHT - BOTTOM) / 2
        up = f'<g transform="translate(11 {middle:.1f}) rotate(-90)">{text(0, 0, y_label)}</g>'
        return drawing(WIDTH, HEIGHT, [*below, *grid, *data, across, up], label)


def scatter(
    dots: Sequence[Dots], labels: tuple[str, str], band: float | None, label: str, ends: tuple[float, float]
) -> Markup:
    """Residuals over a coordinate, with a band of +- `band` about zero; y between `ends`.

    Points beyond the ends are drawn at them, as triangles. `labels` are of x and y.
    """
    bottom, top = ends
    x = np.concatenate([across for _, across, _ in dots])
    low, high = (float(x.min()), float(x.max())) if len(x) else (0.0, 1.0)
    room = 0.03 * (high - low) or 1.0
    low, high = low - room, high + room
    axes = _Axes((low, high), ends, labels, ticks(low, high), ticks(bottom, top))
    below = []
    if band is not None:
        left, upper, lower = axes.left, *axes.to_svg(low, np.clip([band, -band], bottom, top))[:, 1]
        size = f'width="{WIDTH - left - RIGHT:.1f}" height="{lower - upper:.1f}"'
        below.append(f'<rect class="band" x="{left:.1f}" y="{upper:.1f}" {size}/>')
    data = []
    for style, across, up in dots:
        inside, points = (up >= bottom) & (up <= top), axes.to_svg(across, up)
        # one path of lines without length: their round ends are the dots
        path = "".join(f"M{px:.1f} {py:.1f}h0" for px, py in points[inside])
        data.append(f'<path class="{style}" d="{path}"/>')
        for px, above in zip(points[~inside, 0], up[~inside] > 0, strict=True):
            py, s = (TOP, 4) if above else (HEIGHT - BOTTOM, -4)
            path = f"M{px - 4:.1f} {py + s:.1f}L{px + 4:.1f} {py + s:.1f}L{px:.1f} {py - s:.1f}Z"
            data.append(f'<path class="beyond" d="{path}"/>')
    return axes.drawing(below, data, label, "zero")


def course(
    values: Sequence[np.ndarray], fitted: Sequence[np.ndarray], labels: tuple[str, str], label: str
) -> Markup:
    """Values over time with their expanded uncertainties (x, y and U, (N,) each), and a fitted course (x, y).

    `labels` are of x and y.
    """
    x, y, expanded = values
    ends = float(np.min(y - expanded)), float(np.max(y + expanded))
    first, last = float(np.min(fitted[0])), float(np.max(fitted[0]))
    room = 0.05 * (last - first) or 1.0
    axes = _Axes((first - room, last + room), ends, labels, ticks(first, last), ticks(*ends))
    data = [line(axes.to_svg(*fitted), "zero")]
    for px, py, size in zip(x, y, expanded, strict=True):
        data.append(line(axes.to_svg(np.array([px, px]), np.array([py - size, py + size])), "range"))
        cx, cy = axes.to_svg(px, py)
        data.append(f'<circle class="estimate" cx="{cx:.1f}" cy="{cy:.1f}" r="3"/>')
    return axes.drawing((), data, label)


def prior_posterior(prior: tuple[float, float], ends: tuple[float, float], estimate: float) -> Markup:
    """A small drawing: prior mean +- 2 standard deviations as a band, posterior 95 % interval and estimate.

    The scale is that of the prior, three standard deviations either side; what lies beyond is clipped there.
    """
    mean, sd = prior
    width, height = 150.0, 16.0

    def x(v: float) -> float:
        return float(np.clip((v - mean) / (3.0 * sd), -1, 1) * (width / 2 - 4) + width / 2)

    low, high = x(mean - 2 * sd), x(mean + 2 * sd)
    parts = [
        f'<rect class="band" x="{low:.1f}" y="2" width="{high - low:.1f}" height="12"/>',
        line(np.array([[width / 2, 1], [width / 2, 15]]), "grid"),
        line(np.array([[x(ends[0]), 8], [x(ends[1]), 8]]), "range"),
        f'<circle class="estimate" cx="{x(estimate):.1f}" cy="8" r="3"/>',
    ]
    words = f"estimate {(estimate - mean) / sd:+.2f} prior standard deviations from the prior mean"
    return drawing(width, height, parts, words)


def matrix(names: Sequence[str], values: np.ndarray, label: str) -> Markup:
    """Correlations as squares: their area is the absolute value, they are filled where positive."""
    cell = 13.0
    left = 8 + CHARACTER * max(map(len, names))
    size = cell * len(names)
    parts = []
    for i, name in enumerate(names):
        y = 4 + cell * i
        parts.append(text(left - 5, y + 10, name, anchor="end"))
        for j in range(i):
            r = float(values[i, j])
            half = 0.5 * (cell - 2) * float(np.sqrt(abs(r)))
            if half < 0.5:
                continue
            x0, y0 = left + cell * (j + 0.5) - half, y + 0.5 * cell - half
            kind = "positive" if r > 0 else "negative"
            title = f"<title>{escape(names[j])}, {escape(name)}: {r:+.2f}</title>"
            square = f'x="{x0:.1f}" y="{y0:.1f}" width="{2 * half:.1f}" height="{2 * half:.1f}"'
            parts.append(f'<rect class="{kind}" {square}>{title}</rect>')
    for k in range(len(names)):
        x = left + cell * k
        parts.append(line(np.array([[x, 4 + cell * k], [x, 4 + size]]), "grid"))
    return drawing(left + size + 4, size + 8, parts, label)


ELEVATION = np.radians(18.0)
VIEWS = np.radians(np.arange(0, 180, 15))
"""Directions of view that are tried: the one with the widest arm is drawn."""
ARM_WIDTH, ARM_HEIGHT = 380.0, 330.0
"""Largest size of a drawing of the arm; a drawing is no larger than what it shows."""
MARGIN = 12.0
LABELS = 74.0
"""Width at the right that labels take."""
APART, FIRST, LAST = 15.0, 12.0, 6.0
"""Least distance of two labels, and of the first and the last from the edges."""


def marked_sites(run: Run) -> tuple[Site, ...]:
    """Sites of the errors that are significant; none where nothing is."""
    return tuple(map(Site.read, figure_sites(run.record))) if run.kind == "gap" else ()


def draw_arm(run: Run, *, contacts: bool = False) -> Markup | None:
    """The arm in a typical pose with the significant sites marked; with its contacts where asked.

    None for a record without an arm.
    """
    if not run.drawable:
        return None
    arm, rows, sites = run.record["arm"], run.rows, marked_sites(run)
    every = joints_of(run.record)
    row = typical(every)
    points = np.array(rows["point_mm"], float)
    angles = of_units(arm, every[row])
    chain = np.vstack([posed(arm, angles)[0], points[row]])
    content = np.vstack([chain, points]) if contacts else chain
    views = (View.of(azimuth, ELEVATION) for azimuth in VIEWS)
    view = max(views, key=lambda v: float(np.ptp(content @ v.right)))  # from the side where it is widest
    flat = view.seen(content)
    shown = [o for o in outlines(arm, angles, view) if contacts or o.kind != "artefact"]
    count = len(arm["joints"]) + len(sites)
    sheet = _Sheet.of(np.vstack([flat, *(o.polygon for o in shown)]), count)
    axis = sheet.to_svg(flat[: len(chain)])
    marks = marks_of(sites)

    parts = []
    for o in shown:
        style = f"{o.kind} shade{min(int(3 * o.shade), 2)}" + " marked" * is_marked(o, marks)
        parts.append(line(sheet.to_svg(o.polygon), style, "polygon"))
    parts.append(line(axis, "arm axis"))
    if contacts:
        residual = np.array(rows["residual_um"], float)
        edge = float(np.nanquantile(np.abs(residual), 0.97)) if np.any(np.isfinite(residual)) else 1.0
        shade = np.clip(np.nan_to_num(np.abs(residual) / (edge or 1.0)), 0, 1)
        for (x, y), s in zip(sheet.to_svg(flat[len(chain) :]), shade, strict=True):
            style = f"contact level{int(4 * min(s, 0.999))}"
            parts.append(f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{1.4 + 1.8 * s:.1f}"/>')
    if not any(o.joint == 0 for o in shown):  # a base without a length has no capsule
        style = "base marked" if marks["base"] else "base"
        x, y = axis[0] - [16, 3]
        parts.append(f'<rect class="{style}" x="{x:.1f}" y="{y:.1f}" width="32" height="9"/>')
    labels = [(f"J{k}", axis[k], k in marks["joints"]) for k in range(1, len(arm["joints"]) + 1)]
    for k, (_, (x, y), hit) in enumerate(labels, start=1):
        style, r = ("joint marked", 8) if hit else ("joint", 4.5)
        parts.append(
            f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{r}"><title>joint {k}</title></circle>'
        )
    parts.append(f'<circle class="tip" cx="{axis[-1, 0]:.1f}" cy="{axis[-1, 1]:.1f}" r="3"/>')
    labels += [(f"link {k}", axis[k : k + 2].mean(axis=0), True) for k in marks["links"]]
    labels += [(s.text, axis[-1], True) for s in sites if s.kind in ("tool", "probe")]
    labels += [("base", axis[0], True)] if marks["base"] else []
    parts += _labels(labels, sheet)
    named = ", ".join(s.text for s in sites)
    words = f"The arm {arm['robot']} in a typical pose" + (f"; marked: {named}" if named else "")
    return drawing(sheet.width, sheet.height, parts, words)


@dataclass(frozen=True)
class _Sheet:
    """Coordinates of a view, mm, in an SVG that is as large as its content; labels stand at its right."""

    width: float
    height: float
    scale: float
    corner: np.ndarray  # mm, upper left

    @classmethod
    def of(cls, content: np.ndarray, labels: int) -> _Sheet:
        """The smallest that has the content (N, 2), mm, and so many labels."""
        low, high = content.min(axis=0), content.max(axis=0)
        size = np.maximum(high - low, 1e-9)
        scale = float(np.min(np.array([ARM_WIDTH - LABELS, ARM_HEIGHT]) / size))
        width, height = scale * size + 2 * MARGIN
        more = max(FIRST + APART * (labels - 1) + LAST - height, 0.0)
        return cls(width + LABELS, height + more, scale, np.array([low[0], high[1] + 0.5 * more / scale]))

    def to_svg(self, seen: np.ndarray) -> np.ndarray:
        """Points (..., 2) of a view in the SVG."""
        return MARGIN + self.scale * (seen - self.corner) * [1.0, -1.0]


def _labels(labels: Sequence[tuple[str, np.ndarray, bool]], sheet: _Sheet) -> list[str]:
    """Labels in a column at the right, in the order of height, with lines to what they name."""
    order = sorted(labels, key=lambda item: float(item[1][1]))
    apart = APART * np.arange(len(order))
    wanted = np.maximum([point[1] for _, point, _ in order], FIRST)
    heights = np.maximum.accumulate(wanted - apart) + apart  # below the label before
    heights = np.minimum(heights, sheet.height - LAST - apart[::-1])  # with room for those that follow
    out = []
    x = sheet.width - LABELS + 4
    for (words, point, hit), y in zip(order, heights, strict=True):
        out.append(line(np.array([[point[0] + 9, point[1]], [x - 12, y], [x - 3, y]]), "leader"))
        out.append(text(x, y + 4, words, "name marked" if hit else "name", "start"))
    return out
