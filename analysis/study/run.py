"""Runs the study: sessions one by one or on worker processes, then figures, pictures, the page."""

from __future__ import annotations

import json
from collections.abc import Sequence

from analysis.records import arguments_of, on_workers
from analysis.study import figures, page, pictures, session
from bayescal.simulation import Options

RAW = "sessions.json"
Task = tuple[Options, bool]


def tasks(sessions: int, seed: int, with_emcee: int) -> list[Task]:
    """Sessions to simulate, the first few with emcee; sessions of different study seeds never coincide."""
    return [(Options(name="study", seed=10_000 * seed + k), k < with_emcee) for k in range(sessions)]


def _one(task: Task) -> session.Record:
    return session.run(*task)


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
        todo = tasks(given.sessions, given.seed, given.emcee)
        done = list(on_workers(_one, todo, given.workers, "sessions"))
        raw.write_text(json.dumps(done) + "\n", encoding="utf-8")
    found = figures.of(done)
    (given.out / "study.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    pictures.draw(done, found, given.out)
    print(page.table(found))
    if given.page is not None:
        page.update(given.page, found, given.out)
