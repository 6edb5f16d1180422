"""The arm as a drawing: the sites to mark, the bodies of a record and its contacts, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from bayescal.effects.location import Site
from bayescal.reporting.figures.residuals import marked_sites as figure_sites
from bayescal.reporting.page import svg
from bayescal.reporting.page.section import Run
from bayescal.reporting.shared.body import Outline, View, joints_of, of_units, outlines, posed, typical

ELEVATION = np.radians(18.0)
VIEWS = np.radians(np.arange(0, 180, 15))
"""Directions of view that are tried: the one with the widest arm is drawn."""
WIDTH, HEIGHT = 380.0, 330.0
"""Largest size; a drawing is no larger than what it shows."""
MARGIN = 12.0
LABELS = 74.0
"""Width at the right that labels take."""
LINE, TOP, BOTTOM = 15.0, 12.0, 6.0
"""Least distance of two labels, and of the first and the last from the edges."""
DRAWN = ("joint", "link", "base", "tool", "probe")
"""Kinds of sites that a drawing without contacts can mark."""


def marked_sites(run: Run) -> tuple[Site, ...]:
    """Sites of the errors that are significant; none where nothing is."""
    return tuple(map(Site.read, figure_sites(run.record))) if run.kind == "gap" else ()


def numbers(sites: Sequence[Site], kind: str) -> list[int]:
    """Numbers, from 1, of the sites of a kind: joint or link."""
    return [s.number for s in sites if s.kind == kind]


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
    view = _view(content)
    flat = view.seen(content)
    shown = [o for o in outlines(arm, angles, view) if contacts or o.kind != "artefact"]
    count = len(arm["joints"]) + len(sites)
    sheet = _Sheet.of(np.vstack([flat, *(o.polygon for o in shown)]), count)
    line = sheet.to_svg(flat[: len(chain)])
    joints, links = numbers(sites, "joint"), numbers(sites, "link")
    kinds = {s.kind for s in sites}
    tip = bool(kinds & {"tool", "probe"})

    def marked(o: Outline) -> bool:
        if o.kind == "tool":
            return tip
        return o.kind == "arm" and (o.joint in links or (o.joint == 0 and "base" in kinds))

    parts = [
        svg.line(
            sheet.to_svg(o.polygon),
            f"{o.kind} shade{min(int(3 * o.shade), 2)}" + " marked" * marked(o),
            "polygon",
        )
        for o in shown
    ]
    parts.append(svg.line(line, "arm axis"))
    if contacts:
        residual = np.array(rows["residual_um"], float)
        edge = float(np.nanquantile(np.abs(residual), 0.97)) if np.any(np.isfinite(residual)) else 1.0
        shade = np.clip(np.nan_to_num(np.abs(residual) / (edge or 1.0)), 0, 1)
        for (x, y), s in zip(sheet.to_svg(flat[len(chain) :]), shade, strict=True):
            style = f"contact level{int(4 * min(s, 0.999))}"
            parts.append(f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{1.4 + 1.8 * s:.1f}"/>')
    if not any(o.joint == 0 for o in shown):  # a base without a length has no capsule
        style = "base marked" if "base" in kinds else "base"
        x, y = line[0] - [16, 3]
        parts.append(f'<rect class="{style}" x="{x:.1f}" y="{y:.1f}" width="32" height="9"/>')
    labels = [(f"J{k}", line[k], k in joints) for k in range(1, len(arm["joints"]) + 1)]
    for k, (_, (x, y), hit) in enumerate(labels, start=1):
        style, r = ("joint marked", 8) if hit else ("joint", 4.5)
        parts.append(
            f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{r}"><title>joint {k}</title></circle>'
        )
    parts.append(f'<circle class="tip" cx="{line[-1, 0]:.1f}" cy="{line[-1, 1]:.1f}" r="3"/>')
    labels += [(f"link {k}", line[k : k + 2].mean(axis=0), True) for k in links]
    labels += [(s.text, line[-1], True) for s in sites if s.kind in ("tool", "probe")]
    labels += [("base", line[0], True)] if "base" in kinds else []
    parts += _labels(labels, sheet)
    named = ", ".join(s.text for s in sites)
    words = f"The arm {arm['robot']} in a typical pose" + (f"; marked: {named}" if named else "")
    return svg.drawing(sheet.width, sheet.height, parts, words)


def _view(points: np.ndarray) -> View:
    """The view from the side where points (N, 3) are widest."""
    views = [View.of(azimuth, ELEVATION) for azimuth in VIEWS]
    return max(views, key=lambda v: float(np.ptp(points @ v.right)))


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
        scale = float(np.min(np.array([WIDTH - LABELS, HEIGHT]) / size))
        width, height = scale * size + 2 * MARGIN
        more = max(TOP + LINE * (labels - 1) + BOTTOM - height, 0.0)
        return cls(width + LABELS, height + more, scale, np.array([low[0], high[1] + 0.5 * more / scale]))

    def to_svg(self, seen: np.ndarray) -> np.ndarray:
        """Points (..., 2) of a view in the SVG."""
        return MARGIN + self.scale * (seen - self.corner) * [1.0, -1.0]


def _labels(labels: Sequence[tuple[str, np.ndarray, bool]], sheet: _Sheet) -> list[str]:
    """Labels in a column at the right, in the order of height, with lines to what they name."""
    order = sorted(labels, key=lambda item: float(item[1][1]))
    apart = LINE * np.arange(len(order))
    wanted = np.maximum([point[1] for _, point, _ in order], TOP)
    heights = np.maximum.accumulate(wanted - apart) + apart  # below the label before
    heights = np.minimum(heights, sheet.height - BOTTOM - apart[::-1])  # with room for those that follow
    out = []
    x = sheet.width - LABELS + 4
    for (words, point, hit), y in zip(order, heights, strict=True):
        out.append(svg.line(np.array([[point[0] + 9, point[1]], [x - 12, y], [x - 3, y]]), "leader"))
        out.append(svg.text(x, y + 4, words, "name marked" if hit else "name", "start"))
    return out
