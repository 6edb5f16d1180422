"""Answers: a diagnosis of each simulated session without its ground truth, and their seal."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from analysis.blind import seal
from analysis.blind.folder import (
    BASELINE,
    PAIR,
    SEALED,
    TABLE,
    answer_path,
    names,
    read,
    record,
    texts,
    write,
)
from analysis.blind.make import Notify
from bayescal.errors import BayescalError
from bayescal.storage.workers import Lost, results

LONG = ("curves", "residuals", "rows", "arm")
"""Keys of gap.json that hold data of figures and are not part of an answer."""


@dataclass(frozen=True)
class Answered:
    """All answers: their seal, their number, crashes, and answers that were computed again."""

    sha256: str
    worlds: int
    crashed: int
    again: int


@dataclass(frozen=True)
class Task:
    """A session as a worker receives it: its name and its files only."""

    name: str
    texts: dict[str, str]


def run(
    folder: Path, workers: int = 1, dask: str | None = None, notify: Notify = lambda words, fraction: None
) -> Answered:
    """Diagnose every session that has no answer yet, and seal the answers.

    A session that was answered with other sources, or whose files have changed since, is answered again.

    Parameters
    ----------
    folder : Path
        Test sessions of `make.make`. Their ground truth is not read and may be stored elsewhere.
    workers, dask
        See `workers.results`. The answers do not depend on them.
    notify : callable
        Called with the progress as text and as a fraction.

    Raises
    ------
    BayescalError
        If there are no test sessions, the set is incomplete, its answers are sealed, or a worker has other
        sources.
    """
    seal.check_unsealed(folder)
    truth = seal.truth_seal(folder)
    worlds = names(folder)
    given = {name: answer_path(folder, name).exists() for name in worlds}
    todo = [name for name in worlds if not (given[name] and _stands(folder, name))]
    done = len(worlds) - len(todo)
    notify(f"{done} of {len(worlds)}", done / len(worlds))
    for answer in _answers(folder, todo, workers, dask):
        write(answer_path(folder, answer["world"]), answer)
        done += 1
        notify(f"{done} of {len(worlds)}", done / len(worlds))
    answers = {name: record(answer_path(folder, name)) for name in worlds}
    write(folder / SEALED, _sealed(truth, answers))
    return Answered(
        seal.of_text(read(folder / SEALED)),
        len(worlds),
        sum("error" in answer for answer in answers.values()),
        sum(given[name] for name in todo),
    )


def known(folder: Path) -> Answered:
    """Answers that are sealed already."""
    found = [record(answer_path(folder, name)) for name in names(folder)]
    return Answered(seal.of_text(read(folder / SEALED)), len(found), sum("error" in a for a in found), 0)


def _stands(folder: Path, name: str) -> bool:
    """Whether an answer belongs to the present session files and the present sources."""
    answer = record(answer_path(folder, name))
    now = seal.of_world(texts(folder, name)), seal.of_code()
    return (answer.get("dataset_sha256"), answer.get("code_sha256")) == now


def _answers(folder: Path, todo: list[str], workers: int, dask: str | None) -> Iterator[dict[str, Any]]:
    """Answers in the order of completion."""
    own = seal.of_code()
    tasks = (Task(name, texts(folder, name)) for name in todo)
    with closing(results(answered, tasks, workers, dask)) as found:
        for index, answer in found:
            if isinstance(answer, Lost):
                about = _about(Task(todo[index], texts(folder, todo[index])))
                answer = about | {"error": answer.words}
            if answer["code_sha256"] != own:
                raise BayescalError(
                    "a worker has a different version of bayescal than this process",
                    dask or "",
                    "install the same version for all workers, and start again",
                )
            yield answer


def answered(task: Task) -> dict[str, Any]:
    """Diagnose one session in a folder that holds only its dataset; a crash is recorded as an answer."""
    start, about = time.process_time(), _about(task)
    with TemporaryDirectory(prefix="bayescal-blind-") as name:
        folder = Path(name)
        for file in (name for name in task.texts if name != BASELINE):
            write(folder / file, task.texts[file])
        try:
            found = _found(folder, task.texts)
        except Exception as error:
            text = error if isinstance(error, BayescalError) else f"{type(error).__name__}: {error}"
            words = " ".join(str(text).replace(f"{folder}/", "").split())
            return about | {"seconds": time.process_time() - start, "error": words}
    return about | {
        "seconds": time.process_time() - start,
        "gap": {key: value for key, value in found.pop("gap").items() if key not in LONG},
        **found,
    }


def _found(folder: Path, files: Mapping[str, str]) -> dict[str, Any]:
    """The diagnosis of a folder as ``gap``, and what else an answer holds."""
    if TABLE in files:
        return {"gap": _of_log(folder)}
    if BASELINE in files:
        return {"gap": _of_contacts(folder, files[BASELINE])}
    from analysis.blind import changes, images

    return (changes if (folder / PAIR[0]).exists() else images).answer(folder)


def _of_contacts(folder: Path, baseline: str) -> dict[str, Any]:
    """The diagnosis of a session of contacts, beyond the effects of a baseline."""
    # imported here: the process that distributes the work does not need it
    from bayescal.dataset import read_dataset
    from bayescal.gap.diagnose import diagnose
    from bayescal.reporting.gap.record import gap_record

    return gap_record(diagnose(read_dataset(folder), tuple(baseline.rsplit(maxsplit=1)[-1].split(","))))


def _of_log(folder: Path) -> dict[str, Any]:
    """The diagnosis of a joint log."""
    import bayescal

    return dict(bayescal.diagnose(folder).record)


def _about(task: Task) -> dict[str, Any]:
    return {"world": task.name, "dataset_sha256": seal.of_world(task.texts), "code_sha256": seal.of_code()}


def _sealed(truth: str, answers: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The contents of answers.json, without computing times."""
    from bayescal.reporting.origin import LIBRARIES, software

    return {
        "schema": seal.ANSWERED,
        "truth_sha256": truth,
        "code_sha256": seal.of_code(),
        "software": software(LIBRARIES),
        "answers": {name: seal.of_answer(answer) for name, answer in answers.items()},
    }
