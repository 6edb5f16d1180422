"""A mixed session, faces and balls and a tracker in one graph, against each part of it alone.

Run with OPENBLAS_NUM_THREADS=1, as make does: ``python -m analysis.benchmarks.mixed``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from bayescal.dataset import Dataset, Target, read_dataset
from bayescal.dataset.write import taken
from bayescal.estimate import calibrated, linearise, solve, unit_weights
from bayescal.model import ARM, Model, build
from bayescal.model.scene import Scene

TOP = Path(__file__).parents[2]
EFFECTS = ("geometry", "compliance")
POINT = 10e-6  # m, noise of a tracker's coordinate
FRAME = np.array([2.0, 0.3, 0.5])  # m, where the tracker stands
KINDS = {"planes": "plane", "spheres": "sphere", "tracker": "instrument"}


def mixed(dataset: Dataset, seed: int = 0) -> Dataset:
    """A cube session whose balls are fitted too, and whose fitted contacts a tracker saw as well.

    The tracker reads where the calibrated arm has the ball, with noise.
    """
    found = calibrated(Scene(dataset), EFFECTS)
    model, rows = found.model, found.model.scene.rows("calibrate")
    p = model.motion(rows).points(model.deviations(found.z[model.slices[ARM]])).T
    seen = p - FRAME + POINT * np.random.default_rng(seed).standard_normal(p.shape)
    old, kinds = dataset.measurements, np.array([t.kind for t in dataset.targets])
    balls = np.flatnonzero(kinds[old.target] == "sphere")
    fitted = np.concatenate([rows, balls])
    both = taken(old, np.concatenate([fitted, rows]))
    count, size = len(fitted), len(rows)
    both = replace(
        both,
        ids=tuple(f"r{k}" for k in range(count + size)),
        role=np.full(count + size, "calibrate"),
        target=np.concatenate([old.target[fitted], np.full(size, len(dataset.targets))]),
        xyz=np.concatenate([np.full((count, 3), np.nan), seen]),
        repeat=None,
    )
    tracker = Target("tracker", "instrument", {"xyz": FRAME, "rpy": np.zeros(3)})
    noise = replace(dataset.noise, point=POINT)
    return replace(dataset, targets=(*dataset.targets, tracker), noise=noise, measurements=both)


def part(dataset: Dataset, kind: str) -> Dataset:
    """The rows of a session on targets of one kind."""
    rows = dataset.measurements
    kinds = np.array([t.kind for t in dataset.targets])[rows.target]
    return replace(dataset, measurements=taken(rows, np.flatnonzero(kinds == kind)))


def _solving(model: Model) -> tuple[Callable[[], object], Callable[[], object], int]:
    """A linearisation, a solution that starts at the nominal values, and its number of iterations."""
    start = np.zeros(model.size)
    weights = unit_weights(model, start)
    iterations = solve(model, weights, start)[2]
    return lambda: linearise(model, start, weights), lambda: solve(model, weights, start), iterations


def _least(functions: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Processor time, s, of a call of each: the least of `rounds` turns, turn and turn about.

    Not the clock's: a session three times as long would meet the machine's other users more often.
    """
    out = dict.fromkeys(functions, float("inf"))
    for _ in range(rounds):
        for name, function in functions.items():
            start = time.process_time()
            function()
            out[name] = min(out[name], time.process_time() - start)
    return out


def measure(folder: Path, rounds: int = 30) -> Mapping[str, Mapping[str, float]]:
    """Of each part and of "mixed": residuals, seconds of a linearisation and a solution, its iterations."""
    whole = mixed(read_dataset(folder))
    models = {name: build(Scene(part(whole, kind)), EFFECTS) for name, kind in KINDS.items()}
    models["mixed"] = build(Scene(whole), EFFECTS)
    made = {name: _solving(model) for name, model in models.items()}
    lines = _least({name: line for name, (line, _, _) in made.items()}, rounds)
    solved = _least({name: one for name, (_, one, _) in made.items()}, rounds)
    return {
        name: {
            "residuals": float(sum(b.residuals for b in model.blocks)),
            "linearise_s": lines[name],
            "solve_s": solved[name],
            "iterations": float(made[name][2]),
        }
        for name, model in models.items()
    }


def over_parts(measured: Mapping[str, Mapping[str, float]], key: str) -> float:
    """What the mixed session takes over the sum of what its parts take."""
    return measured["mixed"][key] / sum(measured[name][key] for name in KINDS)


def main() -> None:
    """Measure and print."""
    measured = measure(TOP / "data" / "lrmate200ic-cube")
    table = Table("session", "residuals", "linearise, ms", "solve, ms", "iterations", title="one core")
    for name, m in measured.items():
        cells = (f"{1e3 * m['linearise_s']:.2f}", f"{1e3 * m['solve_s']:.1f}", f"{m['iterations']:.0f}")
        table.add_row(name, f"{m['residuals']:.0f}", *cells)
    ratios = (f"{over_parts(measured, key):.2f}" for key in ("linearise_s", "solve_s"))
    table.add_row("mixed / parts", "", *ratios, "")
    Console().print(table)


if __name__ == "__main__":
    main()
