"""Names found in one half of a real session: found in the other half too, and do they improve it.

Each session is split by pose at random. One half is diagnosed alone (`gap` without validation data). The
model that it names, fitted to this half, predicts the other half; so does that model without each of its
names in turn.

``python -m analysis.real_names --real ../shared/data/real --out docs/real_names.md``
"""

from __future__ import annotations

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analysis.knock_out import usual
from analysis.knock_out_page import update
from analysis.real_halves import splits
from analysis.records import Record, completed, stored
from bayescal.dataset import Dataset, read_dataset
from bayescal.errors import BayescalError
from bayescal.gap.diagnose import explain
from bayescal.gap.search.refit import refit
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.errors import ValidationErrors, kept

RUNS = Path(__file__).parents[1] / "runs" / "real-names"
MARKS = ("<!-- names: begin -->", "<!-- names: end -->")
SURE = 0.95
"""Probability above which a name is expected to hold in the other half."""


class Task(NamedTuple):
    """One random half of a session."""

    folder: Path
    split: int  # from 0
    half: int  # 0 or 1

    @property
    def key(self) -> str:
        """Of its record."""
        return f"{self.folder.name} | {self.split} | {self.half}"


def made(task: Task) -> Record:
    """The record of a half."""
    start = time.process_time()
    dataset = read_dataset(task.folder)
    random = (s for s in splits(dataset) if s.kind == "random")
    halves = next(islice(random, task.split, None)).halves
    own, other = halves[task.half], halves[1 - task.half]
    try:
        found = diagnosed(dataset, own, other)
    except BayescalError as refused:
        found = {"verdict": f"refused: {refused.what}", "names": []}
    seconds = round(time.process_time() - start, 1)
    return (
        {"session": task.folder.name, "split": task.split, "half": task.half} | found | {"seconds": seconds}
    )


def with_roles(dataset: Dataset, own: np.ndarray, other: np.ndarray, as_role: str) -> Scene:
    """A scene that fits `own` rows, with the others as `as_role`."""
    m = dataset.measurements
    role = np.full(len(m.role), "skip", dtype=object)
    role[own], role[other] = "calibrate", as_role
    return Scene(replace(dataset, measurements=replace(m, role=role.astype(str))))


def diagnosed(dataset: Dataset, own: np.ndarray, other: np.ndarray) -> Record:
    """Diagnose one half alone; its refit, and the refit without each name, predict the other half."""
    alone, both = with_roles(dataset, own, other, "skip"), with_roles(dataset, own, other, "validate")
    found = explain(alone, usual(alone.dataset))
    last, verdict = found.last, found.verdict
    members = last.decision.members
    sets = [(), members, *(tuple(m for m in members if m is not one) for one in members)]
    bare = replace(last.fitted, model=replace(last.fitted.model, scene=both))
    errors = [validation_errors(refit(bare, last.candidates, own_set)) for own_set in sets]
    fair = kept(*errors)
    before, after, *without = [1e6 * rms(h, fair) for h in errors]
    names = [
        {"name": n.model, "effect": n.effect, "probability": n.probability, "without_um": size}
        for n, size in zip(verdict.named[-len(members) :] if members else (), without, strict=True)
    ]
    return {"verdict": verdict.kind, "before_um": before, "after_um": after, "names": names}


def rms(held: ValidationErrors, fair: np.ndarray) -> float:
    """Root mean square residual, m, of the residuals (R,) that are used."""
    return float(np.sqrt(np.mean(held.residual[fair] ** 2)))


def table(records: Sequence[Record]) -> str:
    """The page's tables: every half with its names, and their counts."""
    return "\n".join([*counts(records), "", *halves(records)])


def counts(records: Sequence[Record]) -> Iterator[str]:
    """How many names improve the other half, and are found there."""
    yield "| names | number | the other half improves | their effect is named there too |"
    yield "| --- | --- | --- | --- |"
    for what, above in (("probability above 0.95", True), ("all others", False)):
        own = sure(records, above)
        better = sum(improves(r, n) for r, n in own)
        again = sum(bool(found_again(r, n, records)) for r, n in own)
        yield f"| {what} | {len(own)} | {share(better, len(own))} | {share(again, len(own))} |"


def halves(records: Sequence[Record]) -> Iterator[str]:
    """One line of every half, and one of each of its names."""
    yield "| session, split | verdict, names | P | other half without (µm) | with | in the other half |"
    yield "| --- | --- | --- | --- | --- | --- |"
    for r in records:
        label = f"{r['session']} {r['split'] + 1}{'ab'[r['half']]}"
        if not r["names"]:
            yield f"| {label} | {r['verdict']} | | | | |"
            continue
        whole = f"| {r['before_um']:.1f} | {r['after_um']:.1f} | |"
        yield f"| {label} | {r['verdict']}, all names | {whole}"
        for n in r["names"]:
            found = ", ".join(found_again(r, n, records)) or "no"
            sizes = f"{n['without_um']:.1f} | {r['after_um']:.1f}"
            yield f"| | {n['name']} | {n['probability']:.2f} | {sizes} | {found} |"


def improves(r: Record, name: Record) -> bool:
    """Whether the other half's RMS error is smaller with a name than without it."""
    return bool(r["after_um"] < name["without_um"])


def sure(records: Sequence[Record], above: bool = True) -> list[tuple[Record, Record]]:
    """Halves and their names with a probability above `SURE`, or those not above it."""
    return [(r, n) for r in records for n in r["names"] if (n["probability"] > SURE) is above]


def found_again(r: Record, name: Record, records: Sequence[Record]) -> list[str]:
    """Names of the same effect in the other half of the split, with their settings."""
    others = (q for q in records if (q["session"], q["split"]) == (r["session"], r["split"]) and q is not r)
    same = [n["name"] for q in others for n in q["names"] if n["effect"] == name["effect"]]
    return [text.split()[0] for text in same]


def share(count: int, of: int) -> str:
    """A count with its share."""
    return f"{count} ({count / of:.2f})" if of else "-"


def found_in(
    real: Path, count: int, runs: Path = RUNS, workers: int = 1, sessions: Sequence[str] = ()
) -> list[Record]:
    """Records of all halves of `count` random splits of every session; those of `runs` are kept."""
    folders = sorted(p.parent for p in real.glob("*/dataset.yaml"))
    folders = [f for f in folders if not sessions or f.name in sessions]
    tasks = [Task(f, split, half) for f in folders for split in range(count) for half in (0, 1)]
    path = runs / "records.json"
    return completed(stored(path), path, {t.key: t for t in tasks}, made, workers, "halves")


def main(arguments: Sequence[str] | None = None) -> None:
    """Diagnose the halves that are missing, and write the page of all."""
    parser = argparse.ArgumentParser(prog="python -m analysis.real_names", description=__doc__)
    parser.add_argument("--real", type=Path, required=True, help="folder of sessions")
    parser.add_argument("--splits", type=int, default=1, help="random splits of each session, at most 4")
    parser.add_argument("--sessions", nargs="*", default=(), help="names of sessions; default: all")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, help="page to write, or whose tables to bring up to date")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of the records; those there are kept")
    given = parser.parse_args(arguments)
    text = table(found_in(given.real, given.splits, given.runs, given.workers, given.sessions))
    print(text)
    if given.out is not None:
        update(given.out, text, MARKS)


if __name__ == "__main__":  # worker processes import this module too
    main()
