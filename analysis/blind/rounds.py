"""A second round: a diagnosis plans further contacts, the simulator probes them, it answers again.

A plan is made of the files of a session and of its own answer. The simulator, which opens the ground truth,
appends measurements to the files, and nothing else. Beside the chosen contacts as many random ones are
probed. Both arms of the comparison are folders of test sessions that `run` answers and seals like the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from analysis.blind import seal
from analysis.blind.folder import (
    FILES,
    SEAL,
    SEALED,
    TRUTH,
    WORLDS,
    answer_path,
    names,
    parsed,
    read,
    record,
    texts,
    write,
)
from analysis.blind.further import ERROR, Continued, Open, Rows, planned, probed
from analysis.blind.make import Notify
from analysis.blind.run import Answered, known, run
from bayescal.errors import BayescalError
from bayescal.storage.workers import Lost, results

ROUND = "round-2"
ARMS = ("chosen", "random")
"""Folders of the second round: contacts of the plan, and random ones without additional payload."""
LEFT_OUT = "left_out.json"
"""Sessions without a second round, and why."""
MEASURED = "measurements.csv"


def is_open(gap: Mapping[str, Any]) -> bool:
    """Whether a diagnosis asks for further contacts."""
    return gap["verdict"] not in ("null", "named") or bool(gap["undecided"])


def second_round(
    folder: Path, workers: int = 1, dask: str | None = None, notify: Notify = lambda words, fraction: None
) -> dict[str, Answered]:
    """Plan, probe and answer a second round of every session whose sealed answer leaves something open.

    An interrupted round continues.

    Parameters
    ----------
    folder : Path
        Test sessions with sealed answers, and their ground truth.
    workers, dask, notify
        As of `run.run`.

    Raises
    ------
    BayescalError
        If the answers are not sealed, the ground truth is not that of the sessions, no session leaves
        anything open, or Pinocchio is missing.
    """
    if not (folder / SEALED).is_file():
        raise BayescalError(
            "its answers are not sealed", str(folder), f"run `python -m analysis.blind run {folder}`"
        )
    plans = _plans(folder, workers, dask, notify)
    if all(ERROR in rows for rows in plans.values()):
        raise BayescalError("no answer leaves anything open", str(folder), "make more test sessions")
    _probe(folder, plans, workers, dask, notify)
    out = {}
    for arm in ARMS:
        own = folder / ROUND / arm

        def told(words: str, fraction: float, arm: str = arm) -> None:
            notify(f"{arm} {words}", fraction)

        out[arm] = known(own) if (own / SEALED).is_file() else run(own, workers, dask, told)
    return out


def _plans(folder: Path, workers: int, dask: str | None, notify: Notify) -> dict[str, dict[str, Rows]]:
    """Further contacts of every open session, by arm; kept in the folder."""
    gaps = {name: record(answer_path(folder, name)).get("gap") for name in names(folder)}
    kept = {n: folder / ROUND / "plans" / f"{n}.json" for n, gap in gaps.items() if gap and is_open(gap)}
    todo = [name for name, path in kept.items() if not path.exists()]
    tasks = (Open(name, texts(folder, name), gaps[name] or {}) for name in todo)
    with closing(results(planned, tasks, workers, dask)) as found:
        for done, (index, rows) in enumerate(found, start=1):
            if isinstance(rows, Lost):
                raise BayescalError(f"could not be planned: {rows.words}", f"world {todo[index]}")
            write(kept[todo[index]], rows)
            notify(f"plans {done} of {len(todo)}", done / len(todo))
    return {name: record(path) for name, path in kept.items()}


def _probe(
    folder: Path, plans: Mapping[str, Mapping[str, Any]], workers: int, dask: str | None, notify: Notify
) -> None:
    """Write the sessions of both arms, with the rows that the simulator measured at their end."""
    text = read(folder / TRUTH)
    sealed, truth = seal.check_truth(folder, text), parsed(text, folder / TRUTH)
    options: dict[str, Any] = {key: truth[key] for key in ("seed", "generator", "reserved") if key in truth}
    left_out = {name: rows[ERROR] for name, rows in plans.items() if ERROR in rows}
    todo = [
        name
        for name in plans
        if name not in left_out
        and not all((folder / ROUND / arm / WORLDS / name / SEAL).exists() for arm in ARMS)
    ]
    tasks = (Continued(n, options, dict(plans[n]), texts(folder, n)[MEASURED]) for n in todo)
    with closing(results(probed, tasks, workers, dask)) as found:
        for done, (index, measured) in enumerate(found, start=1):
            name = todo[index]
            if isinstance(measured, Lost):
                raise BayescalError(f"could not be probed: {measured.words}", f"world {name}")
            if ERROR in measured:
                left_out[name] = measured[ERROR]
            else:
                for arm in ARMS:
                    _keep(
                        folder / ROUND / arm / WORLDS / name,
                        texts(folder, name) | {MEASURED: measured[arm]},
                        sealed,
                    )
            notify(f"probed {done} of {len(todo)}", done / len(todo))
    write(folder / ROUND / LEFT_OUT, left_out)


def _keep(folder: Path, files: Mapping[str, str], sealed: str) -> None:
    """Write a session; its seal last, so that a session with a seal is complete."""
    for file in FILES:
        write(folder / file, files[file])
    write(folder / SEAL, sealed + "\n")
