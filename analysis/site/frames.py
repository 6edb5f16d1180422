"""The figure of the frames of an arm: joint axes, links and tool, at the nominal geometry."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.reporting.style import ACCENT, GREY, INK, MARKED
from bayescal.robots import load_robot

ROBOT = "fanuc-lrmate200ic"
READINGS = np.radians([[25.0, 20.0, -15.0, 30.0, -60.0, 0.0]])
TOOL = np.array([0.06, 0.0, 0.12])  # m, of the ball in the flange frame
SIZE = 0.08  # m, length of an axis in the figure
COLOURS = (MARKED, "#3a8f6b", ACCENT)  # of x, y, z
LIFT = np.array([-0.03, 0.0, 0.0])  # m, from an origin to its label


def picture() -> bytes:
    """The figure, PNG."""
    robot, _ = load_robot(ROBOT)
    poses = frames(chain_of(robot), link_angles(robot, READINGS))[0]
    ball = poses[-1, :3, :3] @ TOOL + poses[-1, :3, 3]
    way = np.vstack([poses[:, :3, 3], ball])
    figure = Figure(figsize=(7.2, 6.4))
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d", proj_type="ortho")
    axes.plot(*way.T, "-", color=GREY, lw=7, alpha=0.35, solid_capstyle="round")
    for pose in poses:
        for k, colour in enumerate(COLOURS):
            axes.plot(*np.array([pose[:3, 3], pose[:3, 3] + SIZE * pose[:3, k]]).T, color=colour, lw=2)
    axes.plot(*ball[:, None], "o", ms=9, color=INK)
    for text, at in labels(way).items():
        axes.text(*(np.array(at) + LIFT), text, color=INK, fontsize=11, ha="right", weight="bold")
    middle = (way.max(axis=0) + way.min(axis=0)) / 2
    half = np.max(np.ptp(way, axis=0)) / 2 + SIZE
    for k, name in enumerate("xyz"):
        axes.set(**{f"{name}lim": (middle[k] - half, middle[k] + half), f"{name}label": f"{name} of F0, m"})
    axes.set_yticks([-0.2, 0.0, 0.2, 0.4])
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=14, azim=-62)
    figure.subplots_adjust(0.0, 0.03, 0.95, 1.0)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()


def labels(way: np.ndarray) -> dict[str, tuple[float, ...]]:
    """Labels and their places: frames with one origin share a label."""
    names = ["F0", *(str(k) for k in range(1, len(way) - 2)), "flange", f"{len(way) - 2} (ball)"]
    shared: dict[tuple[float, ...], list[str]] = {}
    for name, at in zip(names, way, strict=True):
        shared.setdefault(tuple(np.round(at, 6).tolist()), []).append(name)
    return {", ".join(own): at for at, own in shared.items()}
