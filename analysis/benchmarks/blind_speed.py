"""Whether two workers answer blind worlds nearly twice as fast as one: ``blind run``, whole commands.

Run from the top of the project: ``python -m analysis.benchmarks.blind_speed --worlds 100``. It takes
minutes, and is no part of ``make bench``; the ratio goes into the same file.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from analysis.benchmarks.clock import seconds

TOP = Path(__file__).parents[2]
NAME = "blind_two_workers_vs_one"
SEED = 2026
WORKERS = (1, 2)
ROUNDS = 4


def measure(worlds: int, rounds: int = ROUNDS, seed: int = SEED) -> dict[int, float]:
    """Seconds of whole runs by number of workers, start of their processes included.

    The worlds are shared out to rounds, in each of which all numbers of workers have their turn on the same
    worlds: a slow spell of the machine falls on all alike.

    Raises
    ------
    RuntimeError
        Where the answers are not the same.
    """
    took = dict.fromkeys(WORKERS, 0.0)
    with tempfile.TemporaryDirectory() as top:
        made = Path(top) / "made"
        _blind("make", "--worlds", worlds, "--seed", seed, "--workers", max(WORKERS), "--out", made)
        every = sorted((made / "worlds").iterdir())
        for k in range(rounds):
            seals = set()
            for workers in WORKERS[:: (-1) ** k]:
                folder = Path(top) / f"round-{k}-by-{workers}"
                for world in every[k::rounds]:
                    shutil.copytree(world, folder / "worlds" / world.name)
                took[workers] += seconds(lambda f=folder, w=workers: _blind("run", f, "--workers", w))
                seals.add((folder / "answers.json").read_text(encoding="utf-8"))
            if len(seals) > 1:
                msg = "the answers depend on the number of workers"
                raise RuntimeError(msg)
    return took


def _blind(*words: object) -> None:
    subprocess.run(
        [sys.executable, "-m", "bayescal.cli", "blind", *map(str, words)],
        check=True,
        stdout=subprocess.DEVNULL,
    )


def main() -> None:
    """Measure, print, and add the ratio to the other ones."""
    parser = argparse.ArgumentParser(prog="python -m analysis.benchmarks.blind_speed", description=__doc__)
    parser.add_argument("--worlds", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--out", type=Path, default=TOP / "bench.json")
    given = parser.parse_args()
    took = measure(given.worlds, given.rounds)
    one, two = (took[workers] for workers in WORKERS)
    said = f"{given.worlds} worlds, {one:.1f} s by one worker, {two:.1f} by two"
    print(f"{NAME}  {one / two:.2f}  {said}")
    record = json.loads(given.out.read_text(encoding="utf-8")) if given.out.exists() else {}
    record.setdefault("schema", "bayescal-bench/1")
    record.setdefault("ratios", {})[NAME] = one / two
    record.setdefault("raw", {})[NAME] = said
    given.out.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
