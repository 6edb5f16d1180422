"""Write a simulated session: a dataset folder with its truth.json, atomically."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any, Protocol

from bayescal.dataset import Dataset
from bayescal.dataset.write import write_files
from bayescal.folders import whole

TRUTH = "truth.json"


class Simulated(Protocol):
    """A simulated session and its ground truth."""

    @property
    def dataset(self) -> Dataset:
        """The session."""

    @property
    def truth(self) -> dict[str, Any]:
        """The content of truth.json."""


def write(simulation: Simulated, folder: Path) -> None:
    """Write dataset.yaml, measurements.csv, truth.json, and robot.yaml where the robot is not built in.

    Raises
    ------
    BayescalError
        If the folder contains files other than a simulated session, or cannot be written.
    """
    with whole(folder, TRUTH) as stage:
        write_files(simulation.dataset, stage)
        text = json.dumps(simulation.truth, indent=1) + "\n"
        (stage / TRUTH).write_text(text, encoding="utf-8", newline="")


def summary(simulation: Simulated) -> str:
    """A few lines: contacts per target and the maximum error of the nominal arm."""
    dataset, truth = simulation.dataset, simulation.truth
    rows = dataset.measurements
    names = [dataset.targets[i].name for i in rows.target]
    counts = Counter(zip(names, rows.role, strict=True))
    lines = [f"{dataset.name}: {dataset.robot.name}, {', '.join(truth['effects']) or 'nominal'}"]
    for target in dataset.targets:
        if target.kind != "sphere":
            fitted, held = counts[target.name, "calibrate"], counts[target.name, "validate"]
            lines.append(f"  {target.name}: {fitted} contacts to calibrate, {held} to validate")
    balls = [t.name for t in dataset.targets if t.kind == "sphere"]
    if balls:
        each = [counts[name, "calibrate"] + counts[name, "validate"] for name in balls]
        number = f"{min(each)}" if min(each) == max(each) else f"{min(each)} to {max(each)}"
        lines.append(f"  {len(balls)} spheres ({balls[0]} to {balls[-1]}): {number} contacts each")
    if truth["distances"]:
        largest = truth["worst_distance_um"]["nominal"]
        lines.append(
            f"  maximum error of the nominal arm: {largest:.0f} µm over {len(truth['distances'])} distances"
        )
    return "\n".join(lines)
