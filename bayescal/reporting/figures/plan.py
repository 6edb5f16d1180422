"""`plan.png`: the contacts in three views with the arm and its reach, by target, and u over their number."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.arm.motion import NominalArm
from bayescal.arm.shapes import Shape
from bayescal.model.scene import Scene
from bayescal.planning.result import DISTANCES, GAP, REPEAT, VALIDATE, Plan
from bayescal.reporting.body import Outline, View, arm_drawing, fill, of_units, outlines, typical
from bayescal.reporting.plan_sheets import COVERAGE_FACTOR, PURPOSES, by_target, count, headline, noun, title
from bayescal.reporting.style import ACCENT, FAINT, GREY, INK, MARKED, TINTS, figure, tidy
from bayescal.reporting.text import MM, UM

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VIEWS = (("from above", 0, 1), ("from the front", 1, 2), ("from the side", 0, 2))
"""Views with the axes of F0 that they show."""
MARKERS = {DISTANCES: "o", GAP: "s", REPEAT: "P", VALIDATE: "^"}
"""Purposes by marker: they are distinguished without colours."""
FILLS = {DISTANCES: (ACCENT, ""), GAP: (TINTS[1], "////"), REPEAT: (GREY, "...."), VALIDATE: (FAINT, "")}
"""Colour and hatching of the bars."""
ORDER = "viridis"
"""Colours by order of probing: lightness increases, also in grey and for colour-blind readers."""
POSES = 4000
"""Random readings whose TCP positions outline the reach."""
AHEAD = 0.8
"""Cosine of the cone about the contacts in which the reach is shown."""
MARGIN = 1.05
"""Width of a view over what it shows."""
TICKS = (1.0, 1.4, 2.0, 3.0, 4.0, 5.0, 7.0)
"""Labelled values of a decade."""
TANGENTS = 120
"""Of the outline of a solid."""
SOLID = "#eceff1"
"""Fill of solids."""
TARGETS = 14
"""Bars at most."""


def draw_plan(plan: Plan) -> Figure:
    """Above: three views of the contacts. Below: contacts by target, and u over the number of contacts."""
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import MaxNLocator

    lines = [f"{plan.session.name}: {title(plan)}", *list(headline(plan))[:1]]
    out = figure(13, 9.2, lines)
    parts: Any = out.subfigures(2, 1, height_ratios=(1.25, 1))
    views = parts[0].subplots(1, len(VIEWS))
    points, arm, reach, bodies = _points(plan)
    seen = np.vstack([points, arm, _ahead(reach, arm[0], points)])
    shapes = [shape for s in plan.pool.setup.scene.solids if not s.carries for shape in s.shapes]
    low, high = seen.min(axis=0), seen.max(axis=0)
    for (_, *flat), some in zip(VIEWS, bodies, strict=True):
        corners = np.vstack([*(o.polygon for o in some), *(MM * outlined(s, *flat) for s in shapes)])
        low[flat] = np.minimum(low[flat], corners.min(axis=0))
        high[flat] = np.maximum(high[flat], corners.max(axis=0))
    middle, half = (low + high) / 2, MARGIN * float(np.max(high - low)) / 2
    for axes, (name, i, j), some in zip(views, VIEWS, bodies, strict=True):
        flat = [i, j]
        fill(axes, some)
        shown = _view(plan, axes, points[:, flat], arm[:, flat], reach[:, flat])
        for shape in shapes:
            axes.fill(*(MM * outlined(shape, i, j).T), facecolor=SOLID, edgecolor=FAINT, lw=0.8, zorder=0)
        if (volume := plan.pool.setup.volume) is not None:
            x, y = MM * (volume.centre - volume.size / 2)[flat]
            dotted: dict[str, Any] = {"fill": False, "edgecolor": MARKED, "lw": 1.2, "ls": ":"}
            axes.add_patch(Rectangle((x, y), *(MM * volume.size[flat]), **dotted))
        axes.set_xlim(middle[i] - half, middle[i] + half)
        axes.set_ylim(middle[j] - half, middle[j] + half)
        axes.set_aspect("equal")
        axes.set_title(name, loc="left")
        axes.set_xlabel(f"{'xyz'[i]} (mm)")
        axes.set_ylabel(f"{'xyz'[j]} (mm)")
        tidy(axes)
    _legend(plan, views[0], parts[0])
    whole = MaxNLocator(integer=True)
    bar = parts[0].colorbar(shown, ax=list(views), shrink=0.75, pad=0.01, aspect=30, ticks=whole)
    bar.set_label("order of probing", fontsize=10, color=INK)
    bar.ax.tick_params(labelsize=9, colors=INK)
    bar.outline.set_visible(False)
    for axes, drawn in zip(parts[1].subplots(1, 2), (_targets, _curve), strict=True):
        drawn(plan, axes)
        tidy(axes)
    return out


def outlined(shape: Shape, i: int, j: int) -> np.ndarray:
    """The outline (K, 2), m, of a convex shape seen along the third axis: where its tangents meet."""
    angle = np.linspace(0, 2 * np.pi, TANGENTS, endpoint=False)
    across = np.zeros((TANGENTS, 3))
    across[:, i], across[:, j] = np.cos(angle), np.sin(angle)
    high = np.array([-shape.lowest(-way) for way in across])
    both = np.stack([across[:, [i, j]], np.roll(across[:, [i, j]], -1, axis=0)], axis=1)
    return np.linalg.solve(both, np.stack([high, np.roll(high, -1)], axis=1)[..., None])[..., 0]


def _points(plan: Plan) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[list[Outline]]]:
    """TCP positions (N, 3), the arm at a contact (K, 3), points within reach (M, 3), bodies by view; mm."""
    scene, robot = Scene(plan.session), plan.session.robot
    readings = plan.session.measurements.readings
    tool = plan.session.tools[plan.session.measurements.tool[0]]
    nominal = NominalArm(robot, tool.centre)
    middle = typical(readings)
    frames = nominal.frames(readings[middle : middle + 1])
    arm = np.vstack([frames[0, :, :3, 3], nominal.ball(frames)])
    low, high = robot.limits_within(np.pi).T
    anywhere = nominal.readings_of(np.random.default_rng(0).uniform(low, high, (POSES, robot.n)))
    body, unit = arm_drawing(scene) | {"artefacts": []}, np.eye(3)  # solids stand for them
    angles = of_units(body, robot.shown(scene.q[middle]))
    views = (View(unit[i], unit[j], np.cross(unit[i], unit[j])) for _, i, j in VIEWS)
    bodies = [outlines(body, angles, view) for view in views]
    return MM * scene.points, MM * arm, MM * nominal.ball(nominal.frames(anywhere)), bodies


def _ahead(reach: np.ndarray, base: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The points within reach (M, 3) that are seen from the base where the contacts are, not behind it."""
    way, mean = reach - base, points.mean(axis=0) - base
    return reach[way @ mean > AHEAD * np.linalg.norm(way, axis=1) * np.linalg.norm(mean)]


def _view(plan: Plan, axes: Any, points: np.ndarray, arm: np.ndarray, reach: np.ndarray) -> Any:
    from scipy.spatial import ConvexHull

    corners = reach[ConvexHull(reach).vertices]
    axes.fill(*corners.T, facecolor="none", edgecolor=FAINT, lw=1.2, ls="--", zorder=0)
    axes.plot(*arm.T, color=GREY, lw=1.0, solid_capstyle="round", solid_joinstyle="round", zorder=1)
    axes.scatter(*arm[0], s=70, color=GREY, marker="s", zorder=1)
    number = np.arange(1, len(points) + 1)
    shown = None
    for purpose, marker in MARKERS.items():
        if (mine := np.array(plan.purpose) == purpose).any():
            shown = axes.scatter(
                *points[mine].T, c=number[mine], cmap=ORDER, vmin=1, vmax=len(points), marker=marker,
                s=26, lw=0.4, edgecolors=INK, zorder=3,
            )  # fmt: skip
    return shown


def _legend(plan: Plan, axes: Any, part: Any) -> None:
    """The legend of all views, below them."""
    for purpose, marker in MARKERS.items():
        if purpose in plan.purpose:
            axes.scatter([], [], marker=marker, color=GREY, s=26, label=PURPOSES[purpose])
    axes.plot([], [], color=FAINT, lw=1.2, ls="--", label="reach")
    if plan.pool.setup.volume is not None:
        axes.plot([], [], color=MARKED, lw=1.2, ls=":", label="volume of interest")
    handles, labels = axes.get_legend_handles_labels()
    part.legend(handles, labels, frameon=False, loc="outside lower center", ncols=len(labels), fontsize=9.5)


def _targets(plan: Plan, axes: Any) -> None:
    """Contacts by target and purpose."""
    sheet = by_target(plan)
    rows = sheet.rows[:-1]
    hidden = rows[TARGETS - 1 :] if len(rows) > TARGETS else ()
    shown = rows[: len(rows) - len(hidden)][::-1]
    start = np.zeros(len(shown))
    for purpose in (p for p in PURPOSES if p in plan.purpose):
        column = 1 + sheet.headings.index(PURPOSES[purpose])
        width = np.array([int(row[column]) for row in shown])
        colour, hatch = FILLS[purpose]
        axes.barh(range(len(shown)), width, left=start, height=0.65, label=PURPOSES[purpose],
                  facecolor=colour, edgecolor="white", hatch=hatch, lw=0.6)  # fmt: skip
        start += width
    for k, total in enumerate(start):
        axes.annotate(f"{total:.0f}", (total, k), (4, 0), textcoords="offset points", va="center", color=INK)
    axes.set_yticks(range(len(shown)), [row[0] for row in shown])
    axes.set_ylim(len(shown) - max(len(shown), 4) - 0.6, len(shown) - 0.4)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_xlabel(noun(plan))
    more = f", {len(hidden)} targets not shown" if hidden else ""
    axes.set_title(f"{noun(plan)} by target{more}", loc="left")
    axes.legend(
        frameon=False, loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=len(FILLS), columnspacing=0.9,
        handletextpad=0.4, borderpad=0.0,
    )  # fmt: skip


def _curve(plan: Plan, axes: Any) -> None:
    """Expected U of the first goal over the number of contacts, beside random selections."""
    from matplotlib.ticker import LogLocator, NullLocator

    first = plan.expected[0] if plan.expected else None
    drawn = (
        (plan.curve, "o-", ACCENT, "optimised plan"),
        (plan.curve_random, "s--", TINTS[1], "random (median)"),
    )
    for points, style, colour, label in drawn:
        if points:
            x, u = np.array(points, float).T
            axes.plot(x, COVERAGE_FACTOR * UM * u, style, color=colour, lw=1.6, ms=6, label=label)
    if first is not None:
        here = count(plan)
        u, u_random = (COVERAGE_FACTOR * UM * value for value in (first.u, first.u_random))
        ring: dict[str, Any] = {"s": 150, "facecolors": "none", "edgecolors": INK, "lw": 1.6}
        axes.scatter(here, u, label="this plan", **ring)
        if not plan.curve_random and np.isfinite(u_random):
            axes.scatter(here, u_random, marker="s", color=TINTS[1], label="random")
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=TICKS))
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_locator(NullLocator())
    axes.set_xlabel(noun(plan))
    axes.set_ylabel("expected U (µm, k = 2)")
    axes.set_title(f"{first.over if first else 'distances'}, assuming the model is correct", loc="left")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, loc="best")
