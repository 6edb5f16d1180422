"""False names in sessions of our own simulator: nothing is hidden, but noise, masses or rows are not as told.

Run from the top of the project: ``python -m analysis.own_sessions --workers 2 --page docs/blind.md``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.blind.assessed import FLAGGED
from analysis.blind.rates import proportion
from analysis.blind.rows import of
from analysis.pages import published, table
from analysis.records import on_workers
from bayescal.dataset import Dataset
from bayescal.errors import BayescalError
from bayescal.gap.diagnose import diagnose
from bayescal.simulation import Options, simulate

RUNS = Path(__file__).parents[1] / "runs" / "own-sessions"
MARKS = "<!-- own-sessions: begin -->", "<!-- own-sessions: end -->"
CASES: dict[str, dict[str, float]] = {
    "noise as stated": {},
    "stated noise 0.75 x the truth": {"stated": 0.75},
    "stated noise 1.33 x the truth": {"stated": 4 / 3},
    "3 % outliers": {"outliers": 0.03},
    "masses +-15 %": {"masses": 0.15},
    "masses +-15 %, 2 kg on half the contacts": {"masses": 0.15, "payload": 2.0},
}
"""What is wrong with what a session states; `stated` and `masses` change its files, the rest the session."""
FEW: dict[str, Any] = {"placements": 1, "later": 30}
"""They are asked for false names alone: few contacts to validate."""
SEEDS = 10_000
"""Seeds that belong to one seed of the command."""


def wrongly_stated(dataset: Dataset, seed: int, stated: float = 1.0, masses: float = 0.0) -> Dataset:
    """A session that states another noise, and whose robot file has other masses, than are true."""
    rng = np.random.default_rng([seed, 15])
    robot, noise = dataset.robot, dataset.noise
    if masses and robot.masses is not None:
        robot = replace(robot, masses=robot.masses * (1 + rng.uniform(-masses, masses, robot.n)))
    if stated != 1.0 and noise.contact is not None:
        noise = replace(noise, contact=stated * noise.contact)
    return replace(dataset, robot=robot, noise=noise)


def diagnosed(seed: int) -> list[dict[str, Any]]:
    """One seed's sessions, case by case; none where the arm cannot reach what it should probe."""
    out = []
    simulated: dict[tuple[tuple[str, float], ...], Dataset] = {}
    for case, said in CASES.items():
        wrong = {key: value for key, value in said.items() if key in ("stated", "masses")}
        key = tuple((name, value) for name, value in said.items() if name not in wrong)
        if key not in simulated:
            try:
                simulated[key] = simulate(Options(name="own", seed=seed, **FEW, **dict(key))).dataset  # type: ignore[arg-type]
            except BayescalError:
                return []
        verdict = diagnose(wrongly_stated(simulated[key], seed, **wrong)).verdict
        named = [n.effect for n in verdict.named]
        out.append({"case": case, "seed": seed, "verdict": verdict.kind, "named": named})
    return out


def figures(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """False names and flags by case."""
    out = {}
    for case in dict.fromkeys(r["case"] for r in records):
        own = [r for r in records if r["case"] == case]
        out[case] = {
            "named": proportion(sum(bool(r["named"]) for r in own), len(own)),
            "flagged": sum(r["verdict"] in FLAGGED for r in own),
            "names": {str(r["seed"]): r["named"] for r in own if r["named"]},
        }
    return out


def markdown(found: dict[str, Any]) -> str:
    """The figures as a table."""
    lines = []
    for case, c in found.items():
        names = "; ".join(f"{seed}: {' + '.join(names)}" for seed, names in c["names"].items())
        lines.append((case, of(c["named"]), names, c["flagged"], "at most 5 %"))
    return table(["noise only", "a false name (Wilson 95 %)", "which, by seed", "flagged", "required"], lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate, diagnose, print the table, and renew it in a page."""
    parser = argparse.ArgumentParser(prog="python -m analysis.own_sessions", description=__doc__)
    parser.add_argument("--seeds", type=int, default=40, help="sessions a case")
    parser.add_argument("--seed", type=int, default=11, help="one seed, one set of sessions")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--page", type=Path, help="page whose table to renew")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder for the records")
    given = parser.parse_args(arguments)
    seeds = [SEEDS * given.seed + k for k in range(given.seeds)]
    records = [r for found in on_workers(diagnosed, seeds, given.workers, "seeds") for r in found]
    given.runs.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"seed": given.seed, "sessions": records}, indent=1)
    (given.runs / "records.json").write_text(text + "\n", encoding="utf-8")
    published(markdown(figures(records)), given.page, MARKS)


if __name__ == "__main__":  # worker processes import this module too
    main()
