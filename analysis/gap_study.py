"""The study of `bayescal gap`: worlds of another making, diagnosed blind and held against their truth.

Run from the top of the project: ``python -m analysis.gap_study --worlds 200 --seed 7 --workers 2``.
"""

from __future__ import annotations

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from analysis import gap_score as score
from bayescal.dataset import Dataset, read_dataset
from bayescal.errors import BayescalError
from bayescal.gap.diagnose import diagnose
from bayescal.simulate import Options, simulate

TOP = Path(__file__).parents[1]
RUNS = TOP / "runs" / "gap-study"
BEGIN, END = "<!-- gap-study: begin -->", "<!-- gap-study: end -->"
OWN = {
    "noise as stated": {},
    "stated noise 0.75 x the truth": {"stated": 0.75},
    "stated noise 1.33 x the truth": {"stated": 4 / 3},
    "3 % outliers": {"outliers": 0.03},
    "masses +-15 %": {"masses": 0.15},
    "masses +-15 %, 2 kg on half the contacts": {"masses": 0.15, "payload": 2.0},
}
"""Sessions of our own in which nothing is hidden, and what is wrong with what they state."""
FEW = {"placements": 1, "later": 30}
"""They are asked for false names alone: few contacts to validate."""
World = tuple[Path, str, int | None]  # folder of worlds, name, the seed to make it from


def make(folder: Path, seed: int, name: str) -> None:
    """Make a world, unless it has been made already."""
    from bayescal.world import build as world
    from bayescal.world import write

    if not (folder / "truth" / f"{name}.json").exists():
        texts, truth = world.build(seed, int(name))
        write.folder(folder, name, texts, truth)


def diagnosed(task: World) -> score.Record:
    """Diagnose a world as its files stand, and only then open its truth; a crash is a record too."""
    folder, name, seed = task
    if seed is not None:
        make(folder, seed, name)
    baseline = (folder / name / "baseline.txt").read_text(encoding="utf-8").split()[-1].split(",")
    start = time.process_time()
    try:
        gap = diagnose(read_dataset(folder / name), tuple(baseline))
    except Exception as error:
        return {"world": name, "crash": repr(error)}
    seconds = time.process_time() - start
    truth = json.loads((folder / "truth" / f"{name}.json").read_text(encoding="utf-8"))
    return score.record(gap, truth, seconds)


def wrongly_stated(dataset: Dataset, seed: int, stated: float = 1.0, masses: float = 0.0) -> Dataset:
    """A session that states another noise, and whose robot file has other masses, than are true."""
    rng = np.random.default_rng([seed, 15])
    robot, noise = dataset.robot, dataset.noise
    if masses and robot.masses is not None:
        robot = replace(robot, masses=robot.masses * (1 + rng.uniform(-masses, masses, robot.n)))
    if stated != 1.0 and noise.contact is not None:
        noise = replace(noise, contact=stated * noise.contact)
    return replace(dataset, robot=robot, noise=noise)


def own(seed: int) -> list[score.Record]:
    """Diagnose one seed's sessions of our own, in which nothing is hidden, case by case."""
    out: list[score.Record] = []
    simulated: dict[tuple[tuple[str, float], ...], Dataset] = {}
    for case, said in OWN.items():
        wrong = {key: value for key, value in said.items() if key in ("stated", "masses")}
        given = {key: value for key, value in said.items() if key not in wrong}
        key = tuple(given.items())
        if key not in simulated:
            try:
                simulated[key] = simulate(Options(name="own", seed=seed, **FEW, **given)).dataset  # type: ignore[arg-type]
            except BayescalError:  # an arm that cannot reach what it should probe is no session
                return []
        gap = diagnose(wrongly_stated(simulated[key], seed, **wrong))
        named = [n.effect for n in gap.verdict.named]
        out.append({"case": case, "seed": seed, "verdict": gap.verdict.kind, "named": named})
    return out


def on_workers(work: Callable[[Any], Any], tasks: Sequence[Any], workers: int, what: str) -> Iterator[Any]:
    """Results in the order of the tasks, whatever the number of workers, with a count on the way."""

    def counted(results: Iterator[Any]) -> Iterator[Any]:
        for k, result in enumerate(results, start=1):
            print(f"\r{what}: {k} of {len(tasks)}", end="", file=sys.stderr, flush=True)
            yield result
        print(file=sys.stderr)

    if workers == 1 or len(tasks) < 2:
        yield from counted(map(work, tasks))
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from counted(pool.map(work, tasks))


def main(arguments: Sequence[str] | None = None) -> None:
    """Make or take worlds, diagnose them, and print and write what came of it."""
    parser = argparse.ArgumentParser(prog="python -m analysis.gap_study", description=__doc__)
    parser.add_argument("--worlds", type=int, default=200, help="worlds, at most those in --folder")
    parser.add_argument("--seed", type=int, default=7, help="one seed, one set of worlds and own sessions")
    parser.add_argument("--folder", type=Path, help="worlds that exist already, with truth/ among them")
    parser.add_argument("--own", type=int, default=40, help="sessions of our own a case, nothing hidden")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--out", type=Path, help="page to write, or whose tables to bring up to date")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder for worlds and records")
    parser.add_argument("--again", action="store_true", help="figures of the records in --runs")
    given = parser.parse_args(arguments)
    given.runs.mkdir(parents=True, exist_ok=True)
    raw = given.runs / "records.json"
    if not given.again:
        raw.write_text(json.dumps(_run(given), indent=1) + "\n", encoding="utf-8")
    records = json.loads(raw.read_text(encoding="utf-8"))
    found: dict[str, Any] = {"source": records["source"]}
    parts = [f"Worlds: {records['source']}."]
    if records["worlds"]:
        found["worlds"] = score.figures(records["worlds"])
        parts.append(score.table(found["worlds"]))
    if records["own"]:
        found["own"] = score.own_figures(records["own"])
        parts.append(score.own_table(found["own"]))
    (given.runs / "gap_study.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    text = "\n\n".join(parts)
    print(text)
    if given.out is not None:
        page(given.out, text)


def _run(given: argparse.Namespace) -> dict[str, Any]:
    if given.folder is None:
        folder, source = given.runs / f"worlds-{given.seed}", f"seed {given.seed} of `bayescal.world`"
        tasks: list[World] = [(folder, f"{k:03d}", given.seed) for k in range(given.worlds)]
    else:
        folder, source = given.folder, f"the folder `{given.folder.name}`"
        names = sorted(p.stem for p in (folder / "truth").glob("*.json") if (folder / p.stem).is_dir())
        tasks = [(folder, name, None) for name in names[: given.worlds]]
    worlds = list(on_workers(diagnosed, tasks, given.workers, "worlds"))
    seeds = [10_000 * given.seed + k for k in range(given.own)]
    sessions = [r for found in on_workers(own, seeds, given.workers, "own seeds") for r in found]
    return {"source": source, "worlds": worlds, "own": sessions}


def page(path: Path, text: str) -> None:
    """Renew the tables of a page between its marks; a page without is made of them alone."""
    old = path.read_text(encoding="utf-8") if path.exists() else f"{BEGIN}\n{END}\n"
    before, rest = old.split(BEGIN, 1)
    _, after = rest.split(END, 1)
    path.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8", newline="\n")


if __name__ == "__main__":  # worker processes import this module too
    main()
