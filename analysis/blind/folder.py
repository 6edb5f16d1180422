"""Layout of the folder of a blind check, and how its files are written and read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayescal.errors import BayescalError
from bayescal.storage.files import write_together

WORLDS, ANSWERS = "worlds", "answers"
TRUTH, SEALED = "truth.json", "answers.json"
PLAN = ".making/plan.json"
"""The plan; it exists from the first session until the seal."""
SEAL, BASELINE = "seal.txt", "baseline.txt"
DATASET = ("dataset.yaml", "robot.yaml", "measurements.csv")
FILES = (*DATASET, BASELINE)
"""Files of a session, without its seal."""
TABLE = "motion.csv"
LOG = ("dataset.yaml", TABLE)
"""Files of a joint log."""
PAIR = ("before", "after")
"""Folders of two sessions of one arm, each a dataset."""


def name_of(number: int) -> str:
    """Name of a session."""
    return f"{number:03d}"


def names(folder: Path, what: str = WORLDS) -> list[str]:
    """Names of the sessions, or of those that have an answer, in order."""
    found = (p.stem for p in (folder / what).glob("*") if p.stem.isdigit())
    return sorted(found, key=int)


def texts(folder: Path, name: str) -> dict[str, str]:
    """The files of a session or of a joint log by name, without its seal."""
    own = folder / WORLDS / name
    if (own / TABLE).exists():
        return {file: read(own / file) for file in LOG}
    if (own / PAIR[0]).exists():
        return {f"{part}/{file}": read(own / part / file) for part in PAIR for file in DATASET}
    return {file: read(own / file) for file in FILES if file != BASELINE or (own / file).exists()}


def of_contacts(folder: Path) -> bool:
    """Whether a folder holds sessions of contacts, which have a baseline."""
    return any((folder / WORLDS).glob(f"*/{BASELINE}"))


def answer_path(folder: Path, name: str) -> Path:
    """Path of the answer to a session."""
    return folder / ANSWERS / f"{name}.json"


def read(path: Path) -> str:
    """The text of a file.

    Raises
    ------
    BayescalError
        Where it cannot be read.
    """
    try:
        return path.read_bytes().decode()
    except OSError as error:
        raise BayescalError(error.strerror or "cannot be read", str(path)) from None
    except UnicodeDecodeError:
        raise BayescalError("is not a text file", str(path)) from None


def parsed(text: str, path: Path) -> dict[str, Any]:
    """The contents of a JSON text.

    Raises
    ------
    BayescalError
        Where it is no JSON object.
    """
    try:
        found = json.loads(text)
    except ValueError as error:
        raise BayescalError(f"invalid JSON: {error}", str(path)) from None
    if not isinstance(found, dict):
        raise BayescalError("not a JSON object", str(path))
    return found


def record(path: Path) -> dict[str, Any]:
    """The contents of a JSON file; see `read` and `parsed`."""
    return parsed(read(path), path)


def write(path: Path, content: str | Mapping[str, Any]) -> None:
    """Write a text, or a record as JSON, atomically; a missing folder is created.

    Raises
    ------
    BayescalError
        Where it cannot be written.
    """
    text = content if isinstance(content, str) else json.dumps(content, allow_nan=False, indent=1) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BayescalError(error.strerror or "cannot be written", str(path)) from None
    write_together({path: text})
