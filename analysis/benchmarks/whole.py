"""How long whole commands take, start of the process and reading of files included."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

FIT = ("fit", "--samples", "5000")
GAP = ("gap",)


def second_run(dataset: Path, command: tuple[str, ...] = FIT) -> float | None:
    """Duration of the second of two runs, s (the first may compile), or None where the command fails."""
    name, *options = command
    took = 0.0
    for _ in range(2):
        with tempfile.TemporaryDirectory() as folder:
            out = ["--out", str(Path(folder) / "run")]
            start = time.perf_counter()
            line = [sys.executable, "-m", "bayescal.cli", name, str(dataset), *options, *out]
            done = subprocess.run(line, capture_output=True)
            took = time.perf_counter() - start
        if done.returncode:
            return None
    return took
