"""Runs the study: sessions one by one or on worker processes, then figures, pictures, the page."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from analysis.records import arguments_of
from analysis.study import figures, page, pictures, session
from bayescal.simulation import Options

RAW = "sessions.json"
Task = tuple[Options, bool]


def tasks(sessions: int, seed: int, with_emcee: int) -> list[Task]:
    """Sessions to simulate, the first few with emcee; sessions of different study seeds never coincide."""
    return [(Options(name="study", seed=10_000 * seed + k), k < with_emcee) for k in range(sessions)]


def _one(task: Task) -> session.Record:
    return session.run(*task)


def records(todo: Sequence[Task], workers: int) -> Iterator[session.Record]:
    """What became of each session, in order, whatever the number of workers."""
    if workers == 1:
        yield from map(_one, todo)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(_one, todo)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study and write what it shows."""
    parser = arguments_of("study", __doc__, "one seed, one study")
    parser.add_argument("--sessions", type=int, default=60, help="sessions to simulate")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--emcee", type=int, default=4, help="sessions that emcee samples too")
    parser.add_argument("--again", action="store_true", help="figures and pictures of the sessions in --out")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    raw = given.out / RAW
    if given.again:
        done = json.loads(raw.read_text(encoding="utf-8"))
    else:
        done = _run(given)
        raw.write_text(json.dumps(done) + "\n", encoding="utf-8")
    found = figures.of(done)
    (given.out / "study.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    pictures.draw(done, found, given.out)
    print(page.table(found))
    if given.page is not None:
        page.update(given.page, found, given.out)


def _run(given: argparse.Namespace) -> list[dict[str, Any]]:
    done = []
    for record in records(tasks(given.sessions, given.seed, given.emcee), given.workers):
        done.append(record)
        said = record.get("refused", "")
        print(
            f"\r{len(done)} of {given.sessions} {said}", end="\n" if said else "", file=sys.stderr, flush=True
        )
    print(file=sys.stderr)
    return done
