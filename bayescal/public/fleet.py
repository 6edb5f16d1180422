"""A fleet: many sessions, each fitted and diagnosed on worker processes, and their arms beside each other."""

import csv
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from os import PathLike
from pathlib import Path
from typing import Any

from bayescal import __version__
from bayescal.errors import BayescalError, listed, reason
from bayescal.fleets.compare import Member, models_of, read_likelihood
from bayescal.public.arms import names
from bayescal.public.fleet_results import CSV, FleetResult, robot_text
from bayescal.public.functions import MODEL, diagnose, fit, read_dataset
from bayescal.reporting import fleet as reporting
from bayescal.storage.files import json_text, write_together
from bayescal.storage.folders import LIST, check_unchanged
from bayescal.storage.locks import alone
from bayescal.storage.reading import Json, decoded, read_record
from bayescal.storage.stopping import Progress, keeping, silent
from bayescal.storage.workers import Lost, results

STATE, STATE_SCHEMA = "session.json", "bayescal-fleet-session/1"
BELOW = "sessions"
"""Folder of the sessions below that of the fleet."""
COMMANDS = ("fit", "gap")
AGAIN = "completed sessions are kept; the same command continues"


@dataclass(frozen=True)
class Task:
    """A session to be fitted and diagnosed: its dataset, its folder below that of the fleet, the options."""

    dataset: Path
    folder: Path
    options: Json
    allow_xacro: bool = False

    def inputs(self, digest: str) -> Json:
        """What the results depend on; `digest` is the SHA-256 of the dataset."""
        return {"sha256": digest, **self.options}

    def state(self) -> dict[str, Any]:
        """Inputs of each command that is complete, of the last that was begun, and of a failed one."""
        nothing: dict[str, Any] = {"schema": STATE_SCHEMA, "done": {}, "begun": None, "failed": None}
        with suppress(BayescalError):
            return nothing | read_record(self.folder / STATE, STATE_SCHEMA, "")
        return nothing

    def stamp(self, command: str) -> str:
        """SHA-256 of the list of files of a run folder, "" where there is none."""
        listed = self.folder / command / LIST
        return sha256(listed.read_bytes()).hexdigest() if listed.is_file() else ""

    def there(self, state: Json, command: str, inputs: Json) -> bool:
        """Whether the run folder of a command is there, and of these inputs."""
        run, noted = self.folder / command, state["done"].get(command) == inputs
        begun = state["begun"] or {}
        if (begun.get("command"), begun.get("inputs")) == (command, inputs):
            # its process may have been killed between the run folder and the note
            noted = noted or self.stamp(command) not in ("", begun["before"])
        if not noted or not (run / f"{command}.json").is_file():
            return False
        try:
            check_unchanged(run, (f"{command}.json", "arm.json"))
        except BayescalError:
            return False
        return True

    def failure(self, state: Json, inputs: Json) -> str:
        """Why this version failed with these inputs, "" if it did not."""
        failed = state["failed"] or {}
        return str(failed["error"]) if failed.get("inputs") == {**inputs, "version": __version__} else ""


def kept(task: Task) -> str | None:
    """The error ("" of none) of a session that was completed with the same inputs; None of another."""
    state = task.state()
    if not state["done"] and not state["failed"]:
        return None
    try:
        inputs = task.inputs(_read(task).sha256)
    except BayescalError:
        return None
    if error := task.failure(state, inputs):
        return error
    noted = all(state["done"].get(c) == inputs and task.there(state, c, inputs) for c in COMMANDS)
    return "" if noted else None


def _read(task: Task) -> Any:
    return read_dataset(task.dataset, task.allow_xacro)


def computed(task: Task) -> str:
    """Fit and diagnose a session, on a worker; the error is returned, "" of none.

    A run folder that is there and of the same inputs is kept. Each is written atomically, and noted in the
    state of the session before and behind.
    """

    def note(state: Json) -> None:
        write_together({task.folder / STATE: json_text(state)})

    try:
        dataset = _read(task)
        inputs, state = task.inputs(dataset.sha256), task.state()
        task.folder.mkdir(parents=True, exist_ok=True)
        runs: dict[str, Any] = {"fit": partial(fit, samples=0), "gap": diagnose}
        for command, run in runs.items():
            with alone(task.folder / command):  # which removes the lock of a process that was killed
                there = task.there(state, command, inputs)
            if not there:
                begun = {"command": command, "inputs": inputs, "before": task.stamp(command)}
                note(state | {"begun": begun})
                try:
                    result = run(dataset, **task.options)
                except Exception as error:
                    failed = {"inputs": {**inputs, "version": __version__}, "error": _line(error)}
                    note(state | {"failed": failed})
                    return str(failed["error"])
                result.save(task.folder / command, False)
            if state["done"].get(command) != inputs:
                state |= {"done": state["done"] | {command: inputs}, "begun": None, "failed": None}
                note(state)
    except Exception as error:  # what one session does must not stop the others
        return _line(error)
    return ""


def _line(error: Exception) -> str:
    """An error in one line."""
    return str(error) if isinstance(error, BayescalError) else f"{type(error).__name__}: {reason(error)}"


def fleet(
    sessions: Sequence[str | PathLike[str]], out: str | PathLike[str] = "runs/fleet",
    model: Sequence[str] | str = MODEL, *, arm: str = "", workers: int | None = None, dask: str | None = None,
    without: Sequence[str] | str = (), seed: int = 0, robust: bool = True, prior_width: float = 1.0,
    allow_xacro: bool = False, progress: Progress = silent, say: Callable[[str], None] = lambda text: None,
) -> FleetResult:  # fmt: skip
    """Fit and diagnose many sessions, compare their arms, and learn the prior of a further arm.

    A session that cannot be fitted does not stop the others. A second call with the same folder computes what
    is missing, and what has another dataset (SHA-256) or other options.

    Parameters
    ----------
    sessions : sequence of path
        Dataset folders, or folders of them.
    out : path
        Folder of the fleet: fleet.json, fleet.html, fleet.csv, the robot file with the learnt prior, and
        below ``sessions`` the run folders of each session. Workers of a cluster must see it and the datasets.
    model, without, seed, robust, prior_width, allow_xacro
        As of `fit`.
    arm : str
        Which sessions are of one arm: a regular expression for the name of the folder (its first group, or
        all of it), or the path of a CSV file with the columns session and arm. By default, sessions with one
        serial number of the arm; without it, with one name of the dataset.
    workers : int, optional
        Processes on this machine; default: one for each processor.
    dask : str, optional
        Address of a Dask scheduler, ``tcp://host:port``, whose workers are used instead.
    progress, say : callable
        As of `fit`.

    Returns
    -------
    FleetResult
        Prints as a summary; `arms`, `sessions`, `effects` and `prior` are tables.

    Raises
    ------
    BayescalError
        For no session, two of one name, a folder with other files, or a cluster that cannot be reached.
    """
    folder, options = Path(out), {
        "model": list(names(model) or MODEL), "without": list(names(without)), "seed": seed, "robust": robust,
        "prior_width": prior_width,
    }  # fmt: skip
    named = _named(sessions)
    arm_of = _arms(arm, list(named))
    if workers is not None and workers < 1:
        raise BayescalError("no worker", "--workers", "give a number above 0")
    _check(folder)
    with alone(folder), keeping(lambda: AGAIN):
        tasks = {
            name: Task(path.resolve(), (folder / BELOW / name).resolve(), options, allow_xacro)
            for name, path in named.items()
        }
        errors = {name: error for name, task in tasks.items() if (error := kept(task)) is not None}
        before, todo = len(errors), [name for name in tasks if name not in errors]
        if before:
            say(f"{before} of {len(tasks)} sessions are kept from an earlier run in {folder}")
        done = dict.fromkeys(errors, "kept")
        count = min(workers or os.cpu_count() or 1, max(len(todo), 1))
        with closing(results(computed, (tasks[name] for name in todo), count, dask)) as finished:
            for k, (index, result) in enumerate(finished, start=1):
                error = result.words if isinstance(result, Lost) else result
                errors[todo[index]], done[todo[index]] = error, "fitted"
                if error:
                    say(f"{todo[index]}: {error}")
                progress(f"{before + k} of {len(tasks)}", (before + k) / len(tasks))
        if not any(task.folder.exists() for task in tasks.values()):
            raise BayescalError("no session could be read", "SESSIONS", "correct what is said of each")
        progress("compare", 1.0)
        return _written(_entries(tasks, errors, done, arm_of), options, folder)


def _named(sessions: Sequence[str | PathLike[str]]) -> dict[str, Path]:
    """Dataset folders by name; a folder of datasets stands for those in it."""
    paths: list[Path] = []
    for path in map(Path, sessions):
        inside = sorted(p.parent for p in path.glob("*/dataset.yaml"))
        paths += [path] if (path / "dataset.yaml").exists() or not inside else inside
    if not any((path / "dataset.yaml").exists() for path in paths):
        where = str(paths[0]) if paths else "SESSIONS"
        raise BayescalError("no session", where, "give dataset folders, or folders of them")
    out: dict[str, Path] = {}
    alike = [p.resolve().name for p in paths]
    for path in paths:
        resolved = path.resolve()
        name = resolved.name if alike.count(resolved.name) == 1 else f"{resolved.parent.name}-{resolved.name}"
        if name in out:
            raise BayescalError(f"two sessions are called {name}", str(path), "rename one of the folders")
        out[name] = path
    return out


def _arms(arm: str, sessions: Sequence[str]) -> Callable[[Json], str | None]:
    """The arm of a session, by a table, a regular expression, or what its dataset states."""
    if not arm:
        return lambda entry: entry["serial"] or entry["name"]
    if arm.lower().endswith(".csv"):
        rows = list(csv.DictReader(decoded(Path(arm))[0].splitlines()))
        if not rows or not {"session", "arm"} <= rows[0].keys():
            raise BayescalError(
                "no columns session and arm", arm, "write a table with the header session,arm"
            )
        by_name = {row["session"]: row["arm"] for row in rows}
        lacks, where, remedy = "no arm of", arm, "add a row for each session"
    else:
        try:
            pattern = re.compile(arm)
        except re.error as error:
            what = f"no regular expression: {error}"
            raise BayescalError(what, "--arm", "for example 'arm-(\\d+)'") from None
        matches = {name: match for name in sessions if (match := pattern.search(name))}
        by_name = {name: (pattern.groups and match[1]) or match[0] for name, match in matches.items()}
        lacks, where = f"`{arm}` is not in the name of", "--arm"
        remedy = "give a regular expression that all names contain"
    if lacking := [name for name in sessions if not by_name.get(name)]:
        raise BayescalError(f"{lacks} {listed(lacking)}", where, remedy)
    return lambda entry: by_name[entry["session"]]


def _check(folder: Path) -> None:
    """Refuse a folder with anything in it that neither is of a fleet nor of one that was interrupted."""
    if _is_own(folder / reporting.FLEET, reporting.SCHEMA):
        return
    inside = _visible(folder)
    if any(p.name != BELOW for p in inside) or any(
        _visible(p) and not _is_own(p / STATE, STATE_SCHEMA) for entry in inside for p in _visible(entry)
    ):
        what = "the folder contains files that are not of a fleet"
        raise BayescalError(what, str(folder), "give another --out")


def _visible(path: Path) -> list[Path]:
    """What a folder contains without what is hidden, such as locks; a file stands for itself."""
    if not path.is_dir():
        return [path] if path.exists() else []
    return [p for p in path.iterdir() if not p.name.startswith(".")]


def _is_own(path: Path, schema: str) -> bool:
    """Whether a file is a record of a schema."""
    with suppress(BayescalError):
        read_record(path, schema, "")
        return True
    return False


def _entries(
    tasks: Mapping[str, Task], errors: Mapping[str, str], done: Mapping[str, str],
    arm_of: Callable[[Json], str | None],
) -> list[Json]:  # fmt: skip
    """The sessions with what their run folders state, in the order of time within an arm."""
    out: list[Json] = []
    seen: dict[str, str] = {}
    for name, task in tasks.items():
        error = errors[name]
        status = "failed" if error else done[name]
        entry = reporting.session_entry(name, task.dataset, f"{BELOW}/{name}", status, error)
        state = task.state()
        failed = {k: v for k, v in ((state["failed"] or {}).get("inputs") or {}).items() if k != "version"}
        # of a session that failed, what is of the same inputs
        commands = [c for c, inputs in state["done"].items() if not error or inputs == failed]
        if "fit" in commands:
            entry = reporting.with_fit(entry, task.folder / "fit")
            entry["arm"] = arm_of(entry)
            first = seen.setdefault(entry["sha256"], name)
            if first != name:
                what = f"the same measurements as session {first}: not counted"
                entry = {**entry, "status": "failed", "error": what, "arm": None}
        if "gap" in commands:
            entry = reporting.with_gap(entry, task.folder / "gap")
        out.append(entry)
    dated = all(e["date"] for e in out if e["arm"])
    return sorted(out, key=lambda e: str(e["date"])) if dated else out


def _written(entries: list[Json], options: Json, folder: Path) -> FleetResult:
    """Compare the arms, and write the files of the fleet together."""
    models = models_of(list(_members(entries, folder, options["model"])))
    learnt = [k for k, m in enumerate(models) if m.learnt is not None]
    robots = {
        k: "fleet-robot.yaml" if len(learnt) == 1 else f"fleet-robot-{number}.yaml"
        for number, k in enumerate(learnt, start=1)
    }
    record = reporting.fleet_record(entries, models, options, robots)
    texts: dict[Path, str | bytes] = {}
    for k in learnt:
        copy = folder / BELOW / models[k].members[0].session / "fit" / "dataset"
        texts[folder / robots[k]] = robot_text(models[k], read_dataset(copy).robot)
    result = FleetResult(record, folder)
    texts |= {folder / CSV: result.csv, folder / "fleet.html": reporting.fleet_page(record)}
    write_together({**texts, folder / reporting.FLEET: json_text(record)})
    return result


def _members(entries: Sequence[Json], folder: Path, model: Sequence[str]) -> Iterator[Member]:
    for e in entries:
        if e["arm"] is not None:
            run = folder / e["folder"] / ("gap" if e["gap"] else "fit")
            yield Member(e["session"], e["arm"], e["robot"], read_likelihood(run, model))
