"""How long a diagnosis computes after all imports, and whether its cost stays linear in contacts."""

from __future__ import annotations

from pathlib import Path

from analysis.benchmarks.clock import seconds
from bayescal.dataset import Dataset, read_dataset
from bayescal.gap.diagnose import diagnose
from bayescal.simulation import Options, simulate

MANY = 5000
ROUNDS = 3


def measure(folder: Path, many: int = MANY, rounds: int = ROUNDS) -> dict[str, float]:
    """Seconds of computing, contacts, and those of a simulated session of `many` contacts.

    The fastest of several rounds, after one that compiles.
    """
    few = read_dataset(folder)
    compute = _fastest(few, rounds)
    long = simulate(Options(seed=1, contacts=many, placements=2)).dataset
    longer = _fastest(long, max(1, rounds - 1))
    a, b = (int(sum(d.measurements.role == "calibrate")) for d in (few, long))
    return {
        "compute_s": compute,
        "contacts": a,
        "many_s": longer,
        "many_contacts": b,
        "ratio_a_contact": (longer / b) / (compute / a),
    }


def _fastest(dataset: Dataset, rounds: int) -> float:
    seconds(lambda: diagnose(dataset))
    return min(seconds(lambda: diagnose(dataset)) for _ in range(rounds))
