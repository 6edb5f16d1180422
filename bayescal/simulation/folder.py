"""Write a simulated session: a dataset folder with its truth.json, atomically."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from bayescal.dataset.write import write_files
from bayescal.folders import whole
from bayescal.simulation import Simulation

TRUTH = "truth.json"


def write(simulation: Simulation, folder: Path) -> None:
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


def summary(simulation: Simulation) -> str:
    """A few lines: contacts per target and the maximum error of the nominal arm."""
    dataset, truth = simulation.dataset, simulation.truth
    rows = dataset.measurements
    names = [dataset.targets[i].name for i in rows.target]
    counts = Counter(zip(names, rows.role, strict=True))
    lines = [f"{dataset.name}: {dataset.robot.name}, {', '.join(truth['effects']) or 'nominal'}"]
    for target in dataset.targets:
        if target.kind == "plane":
            fitted, held = counts[target.name, "calibrate"], counts[target.name, "validate"]
            lines.append(f"  {target.name}: {fitted} contacts to calibrate, {held} to validate")
    balls = [t.name for t in dataset.targets if t.kind == "sphere"]
    if balls:
        each = counts[balls[0], "validate"]
        lines.append(f"  {len(balls)} spheres ({balls[0]} to {balls[-1]}): {each} contacts each")
    if truth["distances"]:
        largest = truth["worst_distance_um"]["nominal"]
        lines.append(
            f"  maximum error of the nominal arm: {largest:.0f} µm over {len(truth['distances'])} distances"
        )
    return "\n".join(lines)
