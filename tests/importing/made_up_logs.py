"""Logs of simulated sessions in whatever units, as controllers and trackers write them."""

import csv
from pathlib import Path

import numpy as np

from bayescal.dataset import Dataset

PER = {"deg": 180 / np.pi, "rad": 1.0, "mrad": 1e3, "m": 1.0, "mm": 1e3, "um": 1e6}
PER |= {"in": 1 / 0.0254, "cm": 100.0}
"""How many of a unit one of SI is, written down apart from the code under test."""


def said(angle: str, length: str = "") -> str:
    """The map of a `table`, in these units."""
    points = f", x=X {length}, y=Y {length}, z=Z {length}" if length else ""
    return f"j*=A* {angle}, id=Point, role=role, time=t min{points}"


def table(
    dataset: Dataset,
    path: Path,
    angle: str = "deg",
    length: str = "",
    separator: str = ",",
    mark: str = ".",
    clock: np.ndarray | None = None,
) -> Path:
    """Joint readings, with points where a unit of `length` is given, under names of the log's own."""
    m = dataset.measurements
    header = ["Point", "role", "face", "t", *(f"A{j + 1}" for j in range(dataset.robot.n))]
    numbers = np.column_stack([(m.time if clock is None else clock) / 60, m.readings * PER[angle]])
    if length:
        header += ["X", "Y", "Z"]
        numbers = np.column_stack([numbers, m.xyz * PER[length]])
    with path.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, delimiter=separator)
        out.writerow(header)
        for i, values in enumerate(numbers.tolist()):
            face = dataset.targets[m.target[i]].name
            out.writerow([m.ids[i], m.role[i], face, *(repr(v).replace(".", mark) for v in values)])
    return path


def spatial_analyzer(dataset: Dataset, path: Path, order: np.ndarray, length: str = "mm") -> Path:
    """Points as SpatialAnalyzer exports them: comments, then collection, group, target, x, y, z."""
    m = dataset.measurements
    lines = ["// SA Version : made up", "// X Y Z", ""]
    for i in order:
        x, y, z = m.xyz[i] * PER[length]
        lines.append(f"A Main {m.ids[i]} {x:.7f} {y:.7f} {z:.7f}")
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def robodk(
    dataset: Dataset, path: Path, tools: np.ndarray, pose: bool = False, lost: tuple[int, ...] = ()
) -> Path:
    """A RoboDK table: joints, point (and angles), TCP (and angles), each line ending with a comma."""
    m = dataset.measurements
    turn = [0.1, 0.2, 0.3] if pose else []
    lines = []
    for i, q in enumerate(np.degrees(m.readings)):
        seen = np.zeros(3) if i in lost else 1e3 * m.xyz[i]
        lines.append("".join(f"{v:.6f}," for v in [*q, *seen, *turn, *(1e3 * tools[i]), *turn]))
    path.write_text("\n".join(lines), encoding="utf-8")
    return path
