"""Runs the checks: sessions design by design, kept one by one; then tests, page and table."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from analysis.calibration_checks import figures, page, session
from analysis.calibration_checks.designs import DESIGNS, Design
from analysis.records import arguments_of

RAW = "sessions.jsonl"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the checks and write what they show."""
    parser = arguments_of("calibration_checks", __doc__, "of the first session; the others follow it")
    parser.add_argument("--sessions", type=int, default=40, help="sessions of each design")
    parser.add_argument("--designs", nargs="+", choices=[d.name for d in DESIGNS], help="default: all")
    parser.add_argument("--again", action="store_true", help="only page and table, of the sessions in --out")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    raw = given.out / RAW
    if not given.again:
        chosen = [d for d in DESIGNS if not given.designs or d.name in given.designs]
        add(raw, chosen, range(given.seed, given.seed + given.sessions))
    done = read(raw)
    found = {d.name: figures.of([r for r in done if r["design"] == d.name]) for d in DESIGNS}
    found = {name: own for name, own in found.items() if own}
    print(page.text(found))
    if given.page is not None:
        page.update(given.page, found)


def read(raw: Path) -> list[session.Record]:
    """The sessions of a file, one a line."""
    return [json.loads(line) for line in raw.read_text(encoding="utf-8").splitlines()] if raw.exists() else []


def add(raw: Path, designs: Sequence[Design], seeds: Sequence[int]) -> None:
    """Run the sessions that the file does not have yet, and append each; seed after seed of all designs."""
    have = {(r["design"], r["seed"]) for r in read(raw)}
    todo = [(d, s) for s in seeds for d in designs if (d.name, s) not in have]
    for k, (design, seed) in enumerate(todo, start=1):
        record = session.run(design, seed)
        with raw.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
        print(f"{k} of {len(todo)}: {design.name}, seed {seed}", record.get("refused", ""), file=sys.stderr)
