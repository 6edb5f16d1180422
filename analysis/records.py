"""Records of long studies: made on several processes and kept as they come; an interrupted study resumes."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

TOP = Path(__file__).parents[1]
Record = dict[str, Any]


def arguments_of(name: str, description: str | None, seed: str) -> argparse.ArgumentParser:
    """The options of every study: its seed, the folder of its records, and a page to bring up to date.

    Parameters
    ----------
    name : str
        Of the package in `analysis`, and of the folder in `runs`.
    description : str, optional
    seed : str
        What the seed is of.
    """
    parser = argparse.ArgumentParser(prog=f"python -m analysis.{name}", description=description)
    parser.add_argument("--seed", type=int, default=1, help=seed)
    parser.add_argument("--out", type=Path, default=TOP / "runs" / name, help="folder to write")
    parser.add_argument("--page", type=Path, help="page whose tables are brought up to date")
    return parser


def real_arguments(name: str, description: str | None, workers: int = 1) -> argparse.ArgumentParser:
    """The options of every study of real sessions; the folder of its records has its name."""
    parser = argparse.ArgumentParser(prog=f"python -m analysis.{name}", description=description)
    runs = TOP / "runs" / name.replace("_", "-")
    parser.add_argument("--real", type=Path, required=True, help="folder of sessions")
    parser.add_argument("--sessions", nargs="*", default=(), help="names of sessions; default: all")
    parser.add_argument("--workers", type=int, default=workers, help="processes")
    parser.add_argument("--out", type=Path, help="page to write, or whose tables to bring up to date")
    parser.add_argument("--runs", type=Path, default=runs, help="folder of the records; those there are kept")
    return parser


def real_folders(real: Path, sessions: Sequence[str] = ()) -> list[Path]:
    """Folders of real sessions of some names, by default of all."""
    every = sorted(p.parent for p in real.glob("*/dataset.yaml"))
    return [folder for folder in every if not sessions or folder.name in sessions]


def on_workers(work: Callable[[Any], Any], tasks: Sequence[Any], workers: int, what: str) -> Iterator[Any]:
    """Results in the order of the tasks, with a count on the way."""

    def counted(results: Iterator[Any]) -> Iterator[Any]:
        for k, found in enumerate(results, start=1):
            print(f"\r{what}: {k} of {len(tasks)}", end="", file=sys.stderr, flush=True)
            yield found
        print(file=sys.stderr)

    if workers == 1 or len(tasks) < 2:
        yield from counted(map(work, tasks))
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from counted(pool.map(work, tasks))


def stored(path: Path) -> dict[str, Record]:
    """The records of a file by their keys; none where there is no file yet."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def completed(
    path: Path, tasks: Mapping[str, Any], work: Callable[[Any], Record], workers: int, what: str
) -> list[Record]:
    """The records of tasks, by key, in a file; those that it lacks are made and written one by one."""
    records = stored(path)
    missing = {key: task for key, task in tasks.items() if key not in records}
    for key, found in zip(missing, on_workers(work, list(missing.values()), workers, what), strict=True):
        records[key] = found
        path.write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
    return [records[key] for key in tasks]
