"""Tasks, entries and scores: each step keeps what is there, so that an interrupted run continues."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from analysis.contest import page
from analysis.contest.entry import record_of
from analysis.contest.ours import Answer, Given, opened
from analysis.contest.packages import tools
from analysis.contest.score import scored
from analysis.contest.tasks import written
from analysis.pages import published
from bayescal.errors import FAILURES, BayescalError, reason
from bayescal.storage.files import json_text

OUT = Path(__file__).parents[2] / "runs" / "contest"
HERE = Path(__file__).parents[2] / ".venv-"


def file_of(tool: str) -> str:
    """Name of an entry's file, without its ending."""
    return "".join(c if c.isalnum() else "-" for c in tool)


def spent() -> float:
    """CPU time of this process and of those that it has run, s."""
    return sum(os.times()[:4])


def entered(out: Path, run: Mapping[str, Callable[[Given], Answer]], tasks: str = "*") -> None:
    """Enter tools in all tasks; a tool that does not apply leaves a text with the reason."""
    for folder in sorted(
        (out / "tasks").glob(tasks), key=lambda f: (not f.name.startswith("simulated"), f.name)
    ):
        place = out / "entries" / folder.name
        place.mkdir(parents=True, exist_ok=True)
        missing = [
            t
            for t in run
            if not list(place.glob(f"{file_of(t)}.json")) + list(place.glob(f"{file_of(t)}.txt"))
        ]
        if not missing:
            continue
        given = opened(folder)
        for tool in missing:
            print(f"\r{folder.name}: {tool:30s}", end="", file=sys.stderr, flush=True)
            start = spent()
            try:
                found = run[tool](given)
            except FAILURES as error:
                why = error.what if isinstance(error, BayescalError) else reason(error)
                (place / f"{file_of(tool)}.txt").write_text(f"{tool}\n{why}\n", encoding="utf-8")
                continue
            seconds, ids = spent() - start, given.whole.measurements.ids
            record = record_of(tool, folder.name, ids, found.points, seconds, found.u, found.names)
            part = place / f".{file_of(tool)}"
            part.write_text(json_text(record), encoding="utf-8")
            part.rename(place / f"{file_of(tool)}.json")
    print(file=sys.stderr)


def declined(out: Path) -> Iterator[str]:
    """Reasons why tools have no entry, with the number of tasks of each."""
    found = Counter(path.read_text(encoding="utf-8") for path in (out / "entries").glob("*/*.txt"))
    for text, count in sorted(found.items()):
        tool, why = text.splitlines()
        yield f"{tool}, {count} task{'s' if count > 1 else ''}: {why}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Write tasks, enter our own and installed tools, score all entries."""
    parser = argparse.ArgumentParser(prog="python -m analysis.contest", description=__doc__)
    parser.add_argument("step", choices=("tasks", "enter", "score", "all"), nargs="?", default="all")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of tasks, answers and entries")
    parser.add_argument("--real", type=Path, help="folder of the real sessions")
    parser.add_argument("--seed", type=int, help="of other simulated sessions than the frozen ones")
    parser.add_argument("--environments", default=str(HERE), help="prefix of the packages' environments")
    parser.add_argument("--tasks", default="*", help="pattern of the names of tasks to enter")
    parser.add_argument("--only", nargs="*", help="names of tools to enter")
    parser.add_argument("--page", type=Path, help="page whose tables to renew")
    given = parser.parse_args(arguments)
    try:
        run(given)
    except BayescalError as error:
        sys.exit(str(error))


def run(given: argparse.Namespace) -> None:
    """The steps that are asked for."""
    said = list[str]()
    if given.step in ("tasks", "all"):
        said += written(given.out, given.real, given.seed)
    if not (given.out / "tasks").is_dir():
        raise BayescalError(
            "there are no tasks", str(given.out), "write them first: python -m analysis.contest tasks"
        )
    found, lacking = tools(given.environments)
    if given.step in ("enter", "all"):
        chosen = {k: v for k, v in found.items() if given.only is None or k in given.only}
        entered(given.out, chosen, given.tasks)
        said += lacking
    if given.step in ("score", "all"):
        records = scored(given.out)
        if not records:
            raise BayescalError("there are no entries", str(given.out / "entries"), "see docs/contest.md")
        said += declined(given.out)
        (given.out / "scores.json").write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
        (given.out / "index.html").write_text(page.standalone(records, said), encoding="utf-8")
        published(page.markdown(records, said), given.page, page.MARKS)
    else:
        print("\n".join(said))
