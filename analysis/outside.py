"""Causes that are not in the list of known effects: how often the diagnosis gives them a false name.

``python -m analysis.outside SET --out RUNS [--held-out]`` diagnoses the sessions, or joint logs, of a set
(`SET/NNN`, sessions with `baseline.txt`, and `SET/truth/NNN.json`; or the folder of a blind check whose truth
is open) and prints a card. With `--held-out` the list lacks the effect of each session of one effect.
`python -m analysis.made_up` makes a set of other causes.
"""

from __future__ import annotations

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import argparse
import json
from collections.abc import Iterable, Iterator, Mapping, MutableMapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from bayescal.dataset import read_dataset
from bayescal.effects import EFFECTS
from bayescal.gap.diagnose import diagnose
from bayescal.logs import is_log, read_log
from bayescal.motion import effects as of_motions
from bayescal.motion.diagnose import diagnose as diagnose_log
from bayescal.reporting.gap.record import gap_record
from bayescal.reporting.motion.record import motion_record
from bayescal.storage.files import json_text

RANGES = ((0.0, 10.0), (10.0, 30.0), (30.0, 100.0), (100.0, float("inf")))
"""Of the detectability lambda."""
SURE = 0.9
"""Probability from which on a false name counts."""
ALWAYS = ("compliance", "plane-form")
"""Effects that fits have in any case: compliance, and the form of faces that are uneven."""
SHARES = ("right", "partly", "located")
"""Of an `Answer`, those of which the card has the share."""
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
    located: bool | None  # whether the first location is one of the truth; None where that has none
    partly: bool  # right, or only true names, or a class of at most four with a true one
    false: int  # names of `SURE` or more that are not true


def diagnosed(task: Task) -> None:
    """Diagnose a session and keep its record; one that is there is kept."""
    if task.out.exists():
        return
    every: MutableMapping[str, Any] = of_motions.EFFECTS if is_log(task.folder) else EFFECTS._effects
    listed = dict(every)
    every.pop(task.without, None)
    try:
        record = recorded(task.folder)
    finally:
        every.clear()
        every.update(listed)  # in the same order
    task.out.parent.mkdir(parents=True, exist_ok=True)
    task.out.write_text(json_text(record), encoding="utf-8")


def recorded(folder: Path) -> Record:
    """The record of a session, or of a joint log."""
    if is_log(folder):
        return motion_record(diagnose_log(read_log(folder)))
    model = (folder / "baseline.txt").read_text(encoding="utf-8").strip().split(",")
    return gap_record(diagnose(read_dataset(folder), tuple(model)))


def answer(truth: Record, record: Record, held_out: bool) -> Answer:
    """Compare a record with the truth."""
    kind = "outside" if held_out else truth["kind"]
    true = set(truth["effects"]) if kind in ("single", "pair") else set()
    # the baseline of a log has what some effects are errors of, under the same names
    baseline, verdict = set(record["baseline"]) - set(of_motions.EFFECTS), record["verdict"]
    names = {n for n in record["effects"] if n != "unknown"} - baseline
    members = (record.get("class") or {}).get("members", {})
    flagged = verdict in ("unknown", "named+unexplained") or (verdict == "class" and "other" in members)
    right = {"null": verdict == "null", "outside": flagged}.get(kind, verdict == "named" and names == true)
    classed = verdict == "class" and len(members) <= 4 and bool(true & set(members))
    sure = {n for n, p in record["probability"].items() if p >= SURE} - {"null", "unknown"} - baseline
    partly = right or classed or (verdict.startswith("named") and bool(names) and names <= true)
    there = {site for w in truth.get("where", ()) for site in (w["site"], *w.get("also", ()))}
    first = record["where"][0]["site"] if record.get("where") else ""
    # "cube" and "cube." stand for all that begins so: "cube.+x"
    located = any(f"{first}.".startswith(f"{site.rstrip('.')}.") for site in there) if there else None
    return Answer(kind, truth["lambda"]["value"], right, located, partly, len(sure - true))


def card(answers: Iterable[Answer]) -> Iterator[str]:
    """Lines of a table by kind and detectability."""
    answers = list(answers)
    yield f"{'kind':8} {'lambda':>10} sessions  right partly located false names"
    for kind in KINDS:
        for low, high in RANGES:
            mine = [a for a in answers if a.kind == kind and low <= a.detectability < high]
            if mine:
                right, partly, located = (_share(getattr(a, x) for a in mine) for x in SHARES)
                of = f"{kind:8} {low:4.0f}-{high:<5g} {len(mine):8d} {right:>6} {partly:>6} {located:>7}"
                yield f"{of} {sum(a.false for a in mine):11d}"


def _share(hits: Iterable[bool | None]) -> str:
    known = [hit for hit in hits if hit is not None]
    return f"{sum(known) / len(known):.2f}" if known else "-"


def truths(folder: Path) -> dict[Path, Record]:
    """The ground truth of each session of a set."""
    opened = folder / "truth.json"
    if opened.exists():
        worlds = json.loads(opened.read_text(encoding="utf-8"))["worlds"]
        return {folder / "worlds" / number: truth for number, truth in worlds.items()}
    files = sorted((folder / "truth").glob("*.json"))
    return {folder / path.stem: json.loads(path.read_text(encoding="utf-8")) for path in files}


def tasks(every: Mapping[Path, Record], out: Path, held_out: bool) -> dict[Task, Record]:
    """Sessions of a set that are diagnosed, with their ground truth."""
    found = {}
    for path, truth in every.items():
        alone = truth["kind"] == "single" and truth["effects"][0] not in ALWAYS
        if alone or not held_out:
            without = truth["effects"][0] if held_out else ""
            found[Task(path, out / path.name / "gap.json", without)] = truth
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Diagnose and print the card."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args(arguments)
    every = tasks(truths(asked.set), asked.out, asked.held_out)
    with ProcessPoolExecutor(asked.workers) as pool:
        list(pool.map(diagnosed, every))
    found = (answer(truth, json.loads(t.out.read_text()), asked.held_out) for t, truth in every.items())
    print("\n".join(card(found)))


if __name__ == "__main__":
    main()
