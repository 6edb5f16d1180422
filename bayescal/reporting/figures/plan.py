"""`plan.png`: the contacts in three views with the arm and its reach, by target, and U over their number."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayescal.arm.motion import NominalArm
from bayescal.arm.shapes import Shape
from bayescal.model.scene import Scene
from bayescal.planning.result import DISTANCES, GAP, REPEAT, VALIDATE, Plan
from bayescal.reporting.body import View, arm_drawing, fill, of_units, outlines, posed, typical
from bayescal.reporting.figures import scales
from bayescal.reporting.figures.figures import Content, picture
from bayescal.reporting.figures.sheet import LANE, Entry, Panel, Row, rows_panel
from bayescal.reporting.plan_sheets import COVERAGE_FACTOR, PURPOSES, by_target, count, headline, noun, title
from bayescal.reporting.style import ACCENT, FAINT, GREY, INK, MARKED, SERIES
from bayescal.reporting.text import MM, UM

VIEWS = (("from above", 0, 1), ("from the front", 1, 2), ("from the side", 0, 2))
"""Views with the axes of F0 that they show."""
MARKERS = {DISTANCES: "o", GAP: "s", REPEAT: "P", VALIDATE: "^"}
"""Purposes by marker: they are distinguished without colours."""
FILLS = {DISTANCES: (ACCENT, ""), GAP: (SERIES[3], "//////"), REPEAT: (GREY, "....."), VALIDATE: (FAINT, "")}
"""Colour and hatching of the bars."""
EDGE = {"edgecolor": "white", "lw": 0.4}
ORDER = "viridis"
"""Colours by order of probing: lightness increases, also in grey and for colour-blind readers."""
POSES = 4000
"""Random readings whose TCP positions outline the reach."""
AHEAD = 0.8
"""Cosine of the cone about the contacts in which the reach is shown."""
TANGENTS = 120
"""Of the outline of a solid."""
SOLID = "#eceff1"
"""Fill of solids."""
TARGETS = 14
"""Bars at most."""
WIDE, HEIGHT = 210.0, 44.0
"""Width of the figure, and height of the axes of U, mm."""
REACH: dict[str, Any] = {"color": FAINT, "lw": 0.9, "ls": "--"}
VOLUME: dict[str, Any] = {"color": MARKED, "lw": 1.0, "ls": ":"}
PLANNED: dict[str, Any] = {"color": ACCENT, "marker": "o", "lw": 1.2, "ms": 4}
RANDOM: dict[str, Any] = {"color": SERIES[1], "marker": "s", "lw": 1.2, "ls": "--", "ms": 4}
HERE: dict[str, Any] = {"marker": "o", "ls": "", "ms": 9, "mew": 1.2, "color": INK, "markerfacecolor": "none"}


def plan_picture(plan: Plan) -> bytes:
    """The figure as PNG."""
    return picture(plan_content(plan), WIDE)


def plan_content(plan: Plan) -> Content:
    """Above: three views of the contacts. Below: contacts by target, and U over the number of contacts."""
    lines = [f"{plan.session.name}: {title(plan)}", *list(headline(plan))[:1]]
    return lines, [_views(plan), [_targets(plan), _curve(plan)]]


def _views(plan: Plan) -> list[Panel]:
    """Three views of the contacts with the arm at one of them, solids, and the volume of interest."""
    from matplotlib import colormaps

    scene, session = Scene(plan.session), plan.session
    middle = typical(session.measurements.readings)
    body = arm_drawing(scene) | {"artefacts": []}  # solids stand for them
    angles = of_units(body, session.robot.shown(scene.q[middle]))
    points = MM * scene.points
    arm = np.vstack([posed(body, angles)[0], points[middle]])
    reach, unit = _reach(plan), np.eye(3)
    ahead = _ahead(reach, arm[0], points)
    shapes = [shape for s in plan.pool.setup.scene.solids if not s.carries for shape in s.shapes]
    volume = plan.pool.setup.volume
    purposes = [p for p in MARKERS if p in plan.purpose]
    mark: dict[str, Any] = {"ls": "", "ms": 3.5, "color": GREY}
    ends = ((0.0, "first probed"), (1.0, "last probed"))
    keys = (
        [Entry(PURPOSES[p], {"marker": MARKERS[p], **mark}) for p in purposes],
        [Entry("reach", REACH), *([Entry("volume of interest", VOLUME)] if volume is not None else [])],
        [Entry(words, {"marker": "o", **mark, "color": colormaps[ORDER](part)}) for part, words in ends],
    )

    def view(name: str, i: int, j: int, key: Sequence[Entry]) -> Panel:
        flat, bodies = [i, j], outlines(body, angles, View(unit[i], unit[j], np.cross(unit[i], unit[j])))

        def draw(axes: Any) -> None:
            from matplotlib.patches import Polygon, Rectangle
            from scipy.spatial import ConvexHull

            corners = reach[ConvexHull(reach[:, flat]).vertices]
            axes.add_artist(Polygon(corners[:, flat], fill=False, zorder=0, **REACH))  # may be cut off
            axes.update_datalim(ahead[:, flat])
            fill(axes, bodies)
            for shape in shapes:
                outline = MM * outlined(shape, i, j)
                axes.fill(*outline.T, facecolor=SOLID, edgecolor=FAINT, lw=0.6, zorder=0)
            axes.plot(*arm[:, flat].T, color=GREY, lw=0.8, zorder=1)
            axes.plot(*arm[0, flat], marker="s", ms=5, color=GREY, zorder=1)
            if volume is not None:
                x, y = MM * (volume.centre - volume.size / 2)[flat]
                axes.add_patch(Rectangle((x, y), *(MM * volume.size[flat]), fill=False, **VOLUME))
            number = np.arange(len(points))
            for p in purposes:
                mine = np.array(plan.purpose) == p
                axes.scatter(
                    *points[mine][:, flat].T, c=number[mine], cmap=ORDER, vmin=0, vmax=len(points) - 1,
                    marker=MARKERS[p], s=9, lw=0.3, edgecolors=INK, zorder=3,
                )  # fmt: skip
            axes.set_aspect("equal", adjustable="datalim")
            scales.linear_both(axes, scales.width_of(axes))

        return Panel(draw, lambda inner: inner, name, f"{'xyz'[i]} (mm)", f"{'xyz'[j]} (mm)", key=key)

    return [view(*of, key) for of, key in zip(VIEWS, keys, strict=True)]


def outlined(shape: Shape, i: int, j: int) -> np.ndarray:
    """The outline (K, 2), m, of a convex shape seen along the third axis: where its tangents meet."""
    angle = np.linspace(0, 2 * np.pi, TANGENTS, endpoint=False)
    across = np.zeros((TANGENTS, 3))
    across[:, i], across[:, j] = np.cos(angle), np.sin(angle)
    high = np.array([-shape.lowest(-way) for way in across])
    both = np.stack([across[:, [i, j]], np.roll(across[:, [i, j]], -1, axis=0)], axis=1)
    return np.linalg.solve(both, np.stack([high, np.roll(high, -1)], axis=1)[..., None])[..., 0]


def _reach(plan: Plan) -> np.ndarray:
    """Points within reach (M, 3), mm: TCP positions of the first tool at random readings."""
    robot, tools = plan.session.robot, plan.session.tools
    nominal = NominalArm(robot, tools[plan.session.measurements.tool[0]].centre)
    low, high = robot.limits_within(np.pi).T
    anywhere = nominal.readings_of(np.random.default_rng(0).uniform(low, high, (POSES, robot.n)))
    return MM * nominal.ball(nominal.frames(anywhere))


def _ahead(reach: np.ndarray, base: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The points within reach (M, 3) that are seen from the base where the contacts are, not behind it."""
    way, mean = reach - base, points.mean(axis=0) - base
    return reach[way @ mean > AHEAD * np.linalg.norm(way, axis=1) * np.linalg.norm(mean)]


def _targets(plan: Plan) -> Panel:
    """Contacts by target and purpose."""
    sheet = by_target(plan)
    every = sheet.rows[:-1]
    shown = every if len(every) <= TARGETS else every[: TARGETS - 1]
    used = {p: 1 + sheet.headings.index(words) for p, words in PURPOSES.items() if p in plan.purpose}
    styles = {p: {"facecolor": FILLS[p][0], "hatch": FILLS[p][1], **EDGE} for p in used}

    def lanes(axes: Any, middles: Sequence[float]) -> None:
        start = np.zeros(len(shown))
        for purpose, column in used.items():
            width = np.array([int(row[column]) for row in shown])
            axes.barh(middles, width, left=start, height=0.8 * LANE, zorder=2, **styles[purpose])
            start += width
        scales.linear_x(axes, 0, 1.05 * max(start, default=1.0))
        axes.xaxis.get_major_locator().set_params(integer=True)

    rows = [Row(row[0], row[1]) for row in shown]
    key = [Entry(PURPOSES[p], styles[p], patch=True) for p in used]
    more = len(every) - len(shown)
    note = f"{more} targets are not shown" if more else ""
    return rows_panel(rows, lanes, f"{noun(plan)} by target", noun(plan), note, key)


def _curve(plan: Plan) -> Panel:
    """Expected U of the first goal over the number of contacts, beside random selections."""
    first = plan.expected[0] if plan.expected else None
    curves = {"optimised plan": (plan.curve, PLANNED), "random (median)": (plan.curve_random, RANDOM)}
    if first is not None:
        here = count(plan)
        curves["this plan"] = ((here, first.u),), HERE
        if not plan.curve_random and np.isfinite(first.u_random):
            curves["random"] = ((here, first.u_random),), RANDOM
    drawn = {label: (points, style) for label, (points, style) in curves.items() if points}

    def draw(axes: Any) -> None:
        for points, style in drawn.values():
            x, u = np.array(points, float).T
            axes.plot(x, COVERAGE_FACTOR * UM * u, **style)
        scales.linear_both(axes, HEIGHT)

    words = f"{first.over if first else 'distances'}, assuming the model is correct"
    key = [Entry(label, style) for label, (_, style) in drawn.items()]
    return Panel(draw, HEIGHT, words, noun(plan), "expected U (µm, k = 2)", key=key)
