"""Causes that are not in the list of known effects: how often the diagnosis gives them a false name.

``python -m analysis.outside SET --out RUNS [--held-out]`` diagnoses the sessions of a set (`SET/NNN` with
`baseline.txt`, `SET/truth/NNN.json`) and prints a card. With `--held-out` the list lacks the effect of each
session of one effect. `python -m analysis.made_up` makes a set of other causes.
"""

from __future__ import annotations

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from bayescal.dataset import read_dataset
from bayescal.effects import EFFECTS
from bayescal.gap.diagnose import diagnose
from bayescal.reporting.gap.record import gap_record
from bayescal.storage.files import json_text

RANGES = ((0.0, 10.0), (10.0, 30.0), (30.0, 100.0), (100.0, float("inf")))
"""Of the detectability lambda."""
SURE = 0.9
"""Probability from which on a false name counts."""
ALWAYS = ("compliance", "plane-form")
"""Effects that fits have in any case: compliance, and the form of faces that are uneven."""
KINDS = ("null", "single", "pair", "outside")
Record = dict[str, Any]


class Task(NamedTuple):
    """A session, where its record is kept, and the effect that the list lacks, if any."""

    folder: Path
    out: Path
    without: str


class Answer(NamedTuple):
    """A session's truth, and what the diagnosis said."""

    kind: str  # of KINDS; "outside" also where the list lacks the effect
    detectability: float
    right: bool
    partly: bool  # right, or only true names, or a class of at most four with a true one
    false: int  # names of `SURE` or more that are not true


def diagnosed(task: Task) -> None:
    """Diagnose a session and keep its record; one that is there is kept."""
    if task.out.exists():
        return
    model = (task.folder / "baseline.txt").read_text(encoding="utf-8").strip().split(",")
    listed = {name: EFFECTS[name] for name in EFFECTS}
    EFFECTS._effects.pop(task.without, None)
    try:
        record = gap_record(diagnose(read_dataset(task.folder), tuple(model)))
    finally:
        EFFECTS._effects.clear()
        EFFECTS._effects.update(listed)  # in the same order
    task.out.parent.mkdir(parents=True, exist_ok=True)
    task.out.write_text(json_text(record), encoding="utf-8")


def answer(truth: Record, record: Record, held_out: bool) -> Answer:
    """Compare a record with the truth."""
    kind = "outside" if held_out else truth["kind"]
    true = set(truth["effects"]) if kind in ("single", "pair") else set()
    baseline, verdict = set(record["baseline"]), record["verdict"]
    names = {n for n in record["effects"] if n != "unknown"} - baseline
    members = (record.get("class") or {}).get("members", {})
    flagged = verdict in ("unknown", "named+unexplained") or (verdict == "class" and "other" in members)
    right = {"null": verdict == "null", "outside": flagged}.get(kind, verdict == "named" and names == true)
    classed = verdict == "class" and len(members) <= 4 and bool(true & set(members))
    sure = {n for n, p in record["probability"].items() if p >= SURE} - {"null", "unknown"} - baseline
    partly = right or classed or (verdict.startswith("named") and bool(names) and names <= true)
    return Answer(kind, truth["lambda"]["value"], right, partly, len(sure - true))


def card(answers: Iterable[Answer]) -> Iterator[str]:
    """Lines of a table by kind and detectability."""
    answers = list(answers)
    yield f"{'kind':8} {'lambda':>10} {'sessions':>8} {'right':>6} {'partly':>6} {'false names':>11}"
    for kind in KINDS:
        for low, high in RANGES:
            mine = [a for a in answers if a.kind == kind and low <= a.detectability < high]
            if mine:
                right, partly = (
                    sum(x) / len(mine) for x in zip(*((a.right, a.partly) for a in mine), strict=True)
                )
                false = sum(a.false for a in mine)
                yield f"{kind:8} {low:4.0f}-{high:<5g} {len(mine):8d} {right:6.2f} {partly:6.2f} {false:11d}"


def tasks(folder: Path, out: Path, held_out: bool) -> Iterator[Task]:
    """Sessions of a set."""
    for path in sorted((folder / "truth").glob("*.json")):
        truth = json.loads(path.read_text(encoding="utf-8"))
        alone = truth["kind"] == "single" and truth["effects"][0] not in ALWAYS
        if alone or not held_out:
            without = truth["effects"][0] if held_out else ""
            yield Task(folder / path.stem, out / path.stem / "gap.json", without)


def main(arguments: Sequence[str] | None = None) -> None:
    """Diagnose and print the card."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args(arguments)
    every = list(tasks(asked.set, asked.out, asked.held_out))
    with ProcessPoolExecutor(asked.workers) as pool:
        list(pool.map(diagnosed, every))
    truths = (json.loads((asked.set / "truth" / f"{t.folder.name}.json").read_text()) for t in every)
    found = (json.loads(t.out.read_text()) for t in every)
    print("\n".join(card(answer(*pair, asked.held_out) for pair in zip(truths, found, strict=True))))


if __name__ == "__main__":
    main()
