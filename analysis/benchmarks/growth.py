"""Time and peak memory of `fit` and `gap` over the number of contacts, and the exponents of their growth.

Every command is a process of its own, start and imports included, on a session of `large.session`.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from analysis.benchmarks.large import session
from bayescal.dataset import write_dataset

CONTACTS = (100, 1000, 10_000, 100_000)
COMMANDS: Mapping[str, tuple[tuple[str, ...], int]] = {
    "fit": (("fit", "--samples", "5000"), 10_000),
    "fit, Gaussian": (("fit", "--samples", "0"), 100_000),
    "gap": (("gap",), 10_000),
}
"""Commands, and the largest session on which each is measured."""
LEAST = 1000
"""Contacts from which on the exponent is fitted: below, imports and figures take most of the time."""


@dataclass(frozen=True)
class Cost:
    """What one process took."""

    command: str
    contacts: int
    seconds: float  # by the clock
    cpu_s: float  # of all its processes: less dependent on what else the machine does
    peak_mb: float  # resident memory of its largest process
    done: bool


def run(command: str, options: Sequence[str], dataset: Path, contacts: int) -> Cost:
    """The cost of a command on a dataset."""
    with tempfile.TemporaryDirectory() as folder:
        line = [sys.executable, "-m", "bayescal.cli", *options, str(dataset), "--out", f"{folder}/run"]
        watch = [sys.executable, "-m", __name__, *line]
        start = time.perf_counter()
        done = subprocess.run(watch, capture_output=True, text=True)
        took = time.perf_counter() - start
    code, cpu, peak = done.stdout.split()
    return Cost(command, contacts, took, float(cpu), float(peak), code == "0")


def measure(
    contacts: Sequence[int] = CONTACTS, commands: Mapping[str, tuple[tuple[str, ...], int]] = COMMANDS
) -> list[Cost]:
    """Costs of all commands on sessions of all sizes, the smallest first."""
    out = []
    for count in contacts:
        with tempfile.TemporaryDirectory() as folder:
            dataset = Path(folder) / "session"
            write_dataset(session(count), dataset)
            out += [
                run(name, options, dataset, count)
                for name, (options, most) in commands.items()
                if count <= most
            ]
    return out


def exponents(costs: Sequence[Cost], least: int = LEAST) -> dict[str, float]:
    """Slope of log CPU time over log contacts of every command with two sizes from `least` on."""
    out = {}
    for name in dict.fromkeys(c.command for c in costs):
        own = [c for c in costs if c.command == name and c.contacts >= least and c.done]
        if len(own) > 1:
            x, y = np.log([[c.contacts, c.cpu_s] for c in own]).T
            out[name] = float(np.polyfit(x, y, 1)[0])
    return out


def record(costs: Sequence[Cost]) -> dict[str, object]:
    """``growth`` of bench.json."""
    return {"runs": [asdict(c) for c in costs], "exponents": exponents(costs)}


def main() -> None:
    """Run the command given as arguments; print its exit code, CPU time, s, and peak memory, MB."""
    code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    unit = 1e-6 if sys.platform == "darwin" else 1e-3  # of ru_maxrss
    sys.stdout.write(f"{code} {used.ru_utime + used.ru_stime} {unit * used.ru_maxrss}\n")


if __name__ == "__main__":
    main()
