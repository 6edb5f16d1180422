"""The picture of the README: sphere distances of the example session under four model levels.

Run from the top of the project: ``python analysis/readme_picture.py``.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from bayescal.calibration import Fit, fit
from bayescal.dataset import read_dataset

ROOT = Path(__file__).resolve().parents[1]
LABELS = ("nominal", "joint\noffsets", "geometry", "geometry\n+ compliance")
COLOURS = ("#9aa5b1", "#8fb0c9", "#5b8db8", "#1b4f72")


def draw(result: Fit) -> Figure:
    """Errors in mm on the left, the calibrated ones with their predicted intervals in µm on the right."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9.5, 3.6), width_ratios=(1, 1.7), constrained_layout=True
    )
    rng = np.random.default_rng(0)
    for k, (level, colour) in enumerate(zip(result.levels, COLOURS, strict=True)):
        errors = np.array([abs(d.error) for d in level.validation.distances]) * 1e3
        left.scatter(k + rng.uniform(-0.13, 0.13, len(errors)), errors, s=22, color=colour, alpha=0.85)
        left.annotate(
            f"max. {errors.max():.3f}", (k, errors.max()), (0, 7), textcoords="offset points", ha="center",
            fontsize=8, color=colour,
        )  # fmt: skip
    left.set_yscale("log")
    left.set_ylim(3e-4, 4)
    left.set_xticks(range(4), LABELS)
    left.set_xlim(-0.5, 3.5)
    left.set_ylabel("|error of a sphere distance| (mm)")
    left.grid(axis="y", alpha=0.25)
    checks = result.final.validation.distances
    low, high = np.array([np.quantile(d.predicted, [0.025, 0.975]) for d in checks]).T * 1e6
    errors = np.array([d.error for d in checks]) * 1e6
    at = np.arange(len(checks))
    right.bar(at, high - low, bottom=low, width=0.62, color="#d6e4f0", label="95 % prediction interval")
    right.scatter(at, errors, s=26, color=COLOURS[3], zorder=3, label="measured")
    right.axhline(0.0, color="0.5", lw=0.8)
    names = ["-".join(name.split(".")[1].split("@")[0] for name in d.between) for d in checks]
    places = [d.between[0].split("@")[1] for d in checks]
    right.set_xticks(at, [f"{n}\n@{p}" for n, p in zip(names, places, strict=True)], fontsize=7)
    right.set_ylabel("error after calibration (µm)")
    right.legend(frameon=False, fontsize=8, ncols=2, loc="upper right")
    right.set_ylim(1.25 * low.min(), 1.45 * high.max())
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


if __name__ == "__main__":
    out = ROOT / "docs" / "pictures" / "distances.png"
    out.parent.mkdir(parents=True, exist_ok=True)
    draw(fit(read_dataset(ROOT / "data" / "lrmate200ic-cube"), samples=0)).savefig(out, dpi=110)
