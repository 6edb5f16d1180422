"""Simulated test sessions, and their ground truth sealed in one file."""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from analysis.blind import seal
from analysis.blind.folder import PLAN, SEAL, TRUTH, WORLDS, name_of, parsed, read, record, write
from bayescal.errors import BayescalError
from bayescal.storage.folders import check_free, whole
from bayescal.storage.workers import Lost, results

SEEDS = 2**48
"""Number of possible seeds."""
NO_PINOCCHIO = BayescalError("simulating test sessions needs Pinocchio", "", "pip install 'bayescal[blind]'")
CONTACTS, MOTIONS, IMAGES, CHANGES = "contacts", "motions", "images", "changes"
GENERATORS = {CONTACTS: 4, MOTIONS: 1, IMAGES: 1, CHANGES: 2}
"""Version of the simulator of each kind for new sessions; a seed gives the same sessions within one."""
Notify = Callable[[str, float], None]


@dataclass(frozen=True)
class Plan:
    """The seed, the number of sessions, and the salt that protects the hash of the ground truth.

    A plan or ground truth that states no generator is of the first.
    """

    seed: int
    worlds: int
    salt: str
    generator: int = 1
    reserved: bool = False
    kind: str = CONTACTS


@dataclass(frozen=True)
class Asked:
    """What a caller asks for; None: whatever the folder has, else the default."""

    worlds: int
    seed: int | None
    generator: int | None
    reserved: bool
    kind: str = CONTACTS


@dataclass(frozen=True)
class Drawn:
    """A session as a worker simulates it."""

    seed: int
    number: int
    generator: int
    reserved: bool
    kind: str = CONTACTS


def make(
    folder: Path,
    worlds: int = 200,
    seed: int | None = None,
    workers: int = 1,
    dask: str | None = None,
    notify: Notify = lambda words, fraction: None,
    generator: int | None = None,
    reserved: bool = False,
    kind: str = CONTACTS,
) -> str:
    """Simulate the test sessions that are missing, and seal their ground truth.

    Parameters
    ----------
    folder : Path
        A new or empty folder, or one with an interrupted simulation.
    worlds : int
        Number of test sessions.
    seed : int, optional
        The same seed gives the same sessions; by default random, and recorded in the ground truth only.
    workers, dask
        See `workers.results`.
    notify : callable
        Called with the progress as text and as a fraction.
    generator : int, optional
        Version of the simulator, 1 to 4; by default that of an interrupted simulation, else the latest.
    reserved : bool
        Also draw the reserved causes not in the list of known effects, on which no constant may be chosen;
        of joint logs the reserved forms and causes. Sessions of a camera, and pairs of sessions, have none.
    kind : str
        Of `GENERATORS`: sessions of contacts, joint logs, sessions of a camera, or pairs of sessions.

    Returns
    -------
    str
        SHA-256 of the sealed ground truth.

    Raises
    ------
    BayescalError
        If the folder contains other files, or sessions of another seed or number, or Pinocchio is missing.
    """
    if worlds < 1 or (seed is not None and seed < 0):
        raise BayescalError("the number of sessions must be positive and the seed not negative")
    if kind not in GENERATORS:
        raise BayescalError(f"there is no kind {kind}", "--kind", f"use one of {', '.join(GENERATORS)}")
    if kind in (IMAGES, CHANGES) and reserved:
        raise BayescalError(f"sessions of kind {kind} have no reserved causes", "--reserved", "leave it out")
    latest = GENERATORS[kind]
    if generator not in (None, *range(1, latest + 1)):
        raise BayescalError(f"there is no generator {generator}", "", f"use one from 1 to {latest}")
    asked = Asked(worlds, seed, generator, reserved, kind)
    if (folder / TRUTH).is_file() and not (folder / PLAN).exists():
        return _made(folder, asked)
    if dask is None and kind != MOTIONS and find_spec("pinocchio") is None:
        raise NO_PINOCCHIO
    plan = _plan(folder, asked)
    todo = [k for k in range(plan.worlds) if not _record_path(folder, k).exists()]
    done = plan.worlds - len(todo)
    notify(f"{done} of {plan.worlds}", done / plan.worlds)
    with closing(results(built, (_drawn(plan, k) for k in todo), workers, dask)) as found:
        for index, result in found:
            if isinstance(result, Lost):
                raise BayescalError(f"could not be simulated: {result.words}", f"world {todo[index]}")
            _keep(folder, todo[index], *result)
            done += 1
            notify(f"{done} of {plan.worlds}", done / plan.worlds)
    return _seal(folder, plan)


def _drawn(plan: Plan, number: int) -> Drawn:
    return Drawn(plan.seed, number, plan.generator, plan.reserved, plan.kind)


def built(task: Drawn) -> tuple[dict[str, str], dict[str, Any]]:
    """Files of a test session by name and its ground truth, from seed and number, on a worker."""
    if task.kind == MOTIONS:
        from analysis.world.motion.build import make as motion

        made = motion(task.seed, task.number, held_out=task.reserved)
        return made.texts, made.truth
    try:  # imported here: the process that distributes the work does not need Pinocchio
        from analysis.world import camera, changes
        from analysis.world.build import build
    except ImportError:
        raise NO_PINOCCHIO from None
    from analysis.world.write import plain

    if task.kind == IMAGES:
        texts, truth = camera.build(task.seed, task.number)
    elif task.kind == CHANGES:
        texts, truth = changes.build(task.seed, task.number, generator=task.generator)
    else:
        texts, truth = build(task.seed, task.number, generator=task.generator, reserved=task.reserved)
    return texts, plain(truth)


def _made(folder: Path, asked: Asked) -> str:
    """The seal of a complete set of test sessions, if it is the requested one."""
    text = read(folder / TRUTH)
    sealed = seal.check_truth(folder, text)
    _tidy(folder)
    truth = parsed(text, folder / TRUTH)
    version = {key: truth[key] for key in ("generator", "reserved", "kind") if key in truth}
    _check_same(folder, Plan(truth["seed"], len(truth["worlds"]), truth["salt"], **version), asked)
    return sealed


def _plan(folder: Path, asked: Asked) -> Plan:
    """The plan of an interrupted simulation, or a new one."""
    path = folder / PLAN
    if not path.exists():
        check_free(folder, TRUTH)
        seed = secrets.randbelow(SEEDS) if asked.seed is None else asked.seed
        version = asked.generator or GENERATORS[asked.kind]
        salt = secrets.token_hex(32)
        plan = Plan(seed, asked.worlds, salt, version, asked.reserved, asked.kind)
        with whole(folder, PLAN) as stage:
            write(stage / PLAN, vars(plan))
        return plan
    plan = Plan(**record(path))
    _check_same(folder, plan, asked)
    return plan


def _check_same(folder: Path, plan: Plan, asked: Asked) -> None:
    differs = {
        f"{plan.worlds} sessions": asked.worlds != plan.worlds,
        "another seed": asked.seed not in (None, plan.seed),
        f"generator {plan.generator}": asked.generator not in (None, plan.generator),
        f"{'' if plan.reserved else 'no '}reserved causes": asked.reserved != plan.reserved,
        f"kind {plan.kind}": asked.kind != plan.kind,
    }
    if any(differs.values()):
        words = " and ".join(what for what, so in differs.items() if so)
        raise BayescalError(
            f"was started with {words}", str(folder), "use the same options, or another --out"
        )


def _record_path(folder: Path, number: int) -> Path:
    """Path of the ground truth of a session until all are simulated."""
    return (folder / PLAN).with_name(f"{name_of(number)}.json")


def _keep(folder: Path, number: int, texts: dict[str, str], truth: dict[str, Any]) -> None:
    with whole(folder / WORLDS / name_of(number), next(iter(texts))) as stage:
        for file, text in texts.items():
            write(stage / file, text)
    write(_record_path(folder, number), {"session": seal.of_world(texts), "truth": truth})


def _seal(folder: Path, plan: Plan) -> str:
    """Write all ground truths to one file and its hash to every session; repeatable."""
    made = {name_of(k): record(_record_path(folder, k)) for k in range(plan.worlds)}
    truth = {
        "schema": seal.TRUTHS,
        "seed": plan.seed,
        "salt": plan.salt,
        "generator": plan.generator,
        "reserved": plan.reserved,
        **({} if plan.kind == CONTACTS else {"kind": plan.kind}),
        "sessions": {name: own["session"] for name, own in made.items()},
        "worlds": {name: own["truth"] for name, own in made.items()},
    }
    text = json.dumps(truth, allow_nan=False, indent=1) + "\n"
    write(folder / TRUTH, text)
    sealed = seal.of_text(text)
    for name in made:
        write(folder / WORLDS / name / SEAL, sealed + "\n")
    (folder / PLAN).unlink()
    _tidy(folder)
    return sealed


def _tidy(folder: Path) -> None:
    """Remove temporary files, also those of an interrupted run."""
    for left in ((folder / PLAN).parent, *(folder / WORLDS).glob(".*")):
        shutil.rmtree(left, ignore_errors=True)
