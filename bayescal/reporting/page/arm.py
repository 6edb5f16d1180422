"""The arm as a drawing: a pose from the axes of a record, the sites to mark, a projection as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from bayescal.effects.location import Site
from bayescal.reporting.page import svg
from bayescal.reporting.page.run import Run

SIGNIFICANT = 0.01
"""Largest family-wise p-value of a location that is marked."""
ELEVATION = np.radians(18.0)
VIEWS = np.radians(np.arange(0, 180, 15))
"""Directions of view that are tried: the one with the widest arm is drawn."""
WIDTH, HEIGHT = 360.0, 300.0
LABELS = 74.0
"""Width at the right that labels take."""
LINE = 15.0
"""Least distance of two labels."""


def pose(arm: Mapping[str, Any], angles: np.ndarray) -> np.ndarray:
    """Base, joints and flange at link angles.

    Parameters
    ----------
    arm : mapping
        ``arm`` of a record: `links_mm` and `axes` at angles of zero.
    angles : np.ndarray, shape (n,), rad

    Returns
    -------
    np.ndarray, shape (n + 2, 3), mm
        In F0. Each joint rotates what follows it about its axis (product of exponentials; Lynch and Park,
        Modern Robotics, 2017, 4.1).
    """
    links, axes = np.array(arm["links_mm"]), np.array(arm["axes"])
    turn, shift, out = np.eye(3), np.zeros(3), [links[0]]
    for at, (x, y, z), angle in zip(links[1:-1], axes, angles, strict=True):
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        own = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        out.append(turn @ at + shift)
        shift = turn @ (at - own @ at) + shift
        turn = turn @ own
    return np.array([*out, turn @ links[-1] + shift])


def typical(rows: Mapping[str, Any]) -> int:
    """The row whose pose is nearest to the median of all."""
    angles = np.array(rows["angle_deg"], float)
    scale = np.maximum(np.std(angles, axis=0), 1e-6)
    return int(np.argmin(np.sum(((angles - np.median(angles, axis=0)) / scale) ** 2, axis=1)))


def marked_sites(run: Run) -> tuple[Site, ...]:
    """Sites of the errors that are significant; none where nothing is."""
    record = run.record
    if run.kind != "gap" or record["verdict"] == "null":
        return ()
    sites = [a["site"] for a in record["amplitudes"] if a["significant"]]
    sites += [record["marked"]] if record.get("marked") and not sites else []
    if record["verdict"] == "named+unexplained":
        clear = (w for w in record["where"] if not w["explained_by"] and _small(w["family_p_value"]))
        sites += [w["site"] for w in clear][:1]
    return tuple(Site.read(site) for site in dict.fromkeys(sites))


def _small(p: float | None) -> bool:
    return p is not None and p < SIGNIFICANT


def numbers(sites: Sequence[Site], kind: str) -> list[int]:
    """Numbers, from 1, of the sites of a kind: joint or link."""
    return [s.number for s in sites if s.kind == kind]


def draw_arm(run: Run, *, contacts: bool = False) -> Markup | None:
    """The arm in a typical pose with the significant sites marked; with its contacts where asked.

    None for a record without an arm.
    """
    arm = run.record.get("arm")
    if not arm or not run.record.get("rows", {}).get("id"):
        return None
    rows = run.rows
    sites = marked_sites(run)
    row = typical(rows)
    points = np.array(rows["point_mm"], float)
    chain = np.vstack([pose(arm, np.radians(rows["angle_deg"][row])), points[row]])
    every = np.vstack([chain, [[*chain[0, :2], 0.0]], *([points] if contacts else [])])
    flat = _projected(every)
    line = flat[: len(chain)]
    parts = []
    if contacts:
        residual = np.array([np.nan if r is None else r for r in rows["residual_um"]], float)
        edge = float(np.nanquantile(np.abs(residual), 0.97)) if np.any(np.isfinite(residual)) else 1.0
        shade = np.clip(np.nan_to_num(np.abs(residual) / (edge or 1.0)), 0, 1)
        for (x, y), s in zip(flat[len(chain) + 1 :], shade, strict=True):
            style = f"contact level{int(4 * min(s, 0.999))}"
            parts.append(f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{1.4 + 1.8 * s:.1f}"/>')
    parts.append(svg.line(line, "arm"))
    joints, links = numbers(sites, "joint"), numbers(sites, "link")
    for k in links:
        parts.append(svg.line(line[k : k + 2], "arm marked"))
    kinds = {s.kind for s in sites}
    if kinds & {"tool", "probe"}:
        parts.append(svg.line(line[-2:], "arm marked"))
    foot, style = line[0], "base marked" if "base" in kinds else "base"
    parts.append(
        f'<rect class="{style}" x="{foot[0] - 16:.1f}" y="{foot[1] - 3:.1f}" width="32" height="9"/>'
    )
    names = [(str(name), line[k], k in joints) for k, name in enumerate(arm["joints"], start=1)]
    for k, (_, (x, y), hit) in enumerate(names, start=1):
        style, r = ("joint marked", 8) if hit else ("joint", 4.5)
        parts.append(
            f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="{r}"><title>joint {k}</title></circle>'
        )
    parts.append(f'<circle class="tip" cx="{line[-1, 0]:.1f}" cy="{line[-1, 1]:.1f}" r="3"/>')
    labels = [(f"J{k}", at, hit) for k, (_, at, hit) in enumerate(names, start=1)]
    labels += [(f"link {k}", line[k : k + 2].mean(axis=0), True) for k in links]
    labels += [(s.text, line[-1], True) for s in sites if s.kind in ("tool", "probe")]
    labels += [("base", foot, True)] if "base" in kinds else []
    parts += _labels(labels)
    told = ", ".join(s.text for s in sites)
    words = f"The arm {escape(arm['robot'])} in a typical pose" + (f"; marked: {told}" if told else "")
    return svg.drawing(WIDTH, HEIGHT, parts, words)


def _projected(points: np.ndarray) -> np.ndarray:
    """Points (N, 3) as coordinates (N, 2) of an SVG, from the side where they are widest."""
    centred = points - 0.5 * (points.min(axis=0) + points.max(axis=0))
    best = max(VIEWS, key=lambda a: float(np.ptp(centred[:, :2] @ [-np.sin(a), np.cos(a)])))
    across = np.array([-np.sin(best), np.cos(best), 0.0])
    toward = np.array([np.cos(best) * np.cos(ELEVATION), np.sin(best) * np.cos(ELEVATION), np.sin(ELEVATION)])
    up = np.cross(toward, across)
    flat = np.stack([centred @ across, -(centred @ up)], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    room = np.array([WIDTH - LABELS - 30, HEIGHT - 30])
    scale = float(np.min(room / np.maximum(high - low, 1e-9)))
    middle = np.array([(WIDTH - LABELS) / 2, HEIGHT / 2])
    return (flat - 0.5 * (low + high)) * scale + middle


def _labels(labels: Sequence[tuple[str, np.ndarray, bool]]) -> list[str]:
    """Labels in a column at the right, in the order of height, with lines to what they name."""
    order = sorted(labels, key=lambda item: float(item[1][1]))
    heights: list[float] = []
    for _, at, _ in order:
        heights.append(max(float(at[1]), heights[-1] + LINE if heights else 12.0))
    over = heights[-1] - (HEIGHT - 6) if heights else 0.0
    for k in range(len(heights) - 1, -1, -1):
        top = HEIGHT - 6 if k == len(heights) - 1 else heights[k + 1] - LINE
        heights[k] = min(heights[k], top) if over > 0 else heights[k]
    out = []
    x = WIDTH - LABELS + 4
    for (words, at, hit), y in zip(order, heights, strict=True):
        out.append(svg.line(np.array([[at[0] + 9, at[1]], [x - 12, y], [x - 3, y]]), "leader"))
        out.append(svg.text(x, y + 4, words, "name marked" if hit else "name", "start"))
    return out
