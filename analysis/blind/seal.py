"""Seals: the SHA-256 of ground truth, sessions, answers, and the sources that computed them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from analysis.blind.folder import PLAN, SEAL, SEALED, TRUTH, WORLDS, names, read
from bayescal.errors import BayescalError

TRUTHS, ANSWERED = "bayescal-blind-truth/1", "bayescal-blind-answers/1"
"""Schemas of the two sealed files."""
PACKAGES = ("bayescal", "factors", "analysis.world", "analysis.blind")
TIMED = "seconds"
"""The only key of an answer that its seal does not cover: it differs from run to run."""


def of_text(text: str) -> str:
    """SHA-256 of a text in UTF-8, 64 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def of_record(record: Any) -> str:
    """SHA-256 of a record, independent of the layout of its JSON."""
    return of_text(json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False))


def of_world(texts: Mapping[str, str]) -> str:
    """SHA-256 of the files of a test session, including the model of its diagnosis."""
    return of_record({name: of_text(texts[name]) for name in texts})


def of_answer(answer: Mapping[str, Any]) -> str:
    """SHA-256 of the content of an answer."""
    return of_record({key: value for key, value in answer.items() if key != TIMED})


@cache
def of_code() -> str:
    """SHA-256 of the installed sources: names and contents of all modules, and the built-in robots.

    Computed once per process, at its start.
    """
    found = {}
    for package in PACKAGES:
        spec = find_spec(package)
        assert spec is not None
        assert spec.origin is not None
        top = Path(spec.origin).parent
        for path in (*top.rglob("*.py"), *top.rglob("*.yaml")):
            name = f"{package}/{path.relative_to(top).as_posix()}"
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return of_record(found)


def truth_seal(folder: Path) -> str:
    """The seal of the ground truth as recorded with every session; the ground truth is not read.

    Raises
    ------
    BayescalError
        If there are no test sessions, the set is incomplete, or their seals differ.
    """
    if (folder / PLAN).exists():
        raise BayescalError(
            "its worlds are not all made", str(folder), "run `python -m analysis.blind make` again"
        )
    found = names(folder)
    if not found:
        raise BayescalError(
            "no blind worlds here", str(folder), "make some: python -m analysis.blind make --out FOLDER"
        )
    seals = {name: read(folder / WORLDS / name / SEAL).strip() for name in found}
    first = seals[found[0]]
    for name, seal in seals.items():
        if seal != first:
            where = str(folder / WORLDS / name / SEAL)
            raise BayescalError(f"seal {seal} differs from that of world {found[0]}, {first}", where)
    return first


def check_truth(folder: Path, text: str) -> str:
    """The seal of a ground truth that was read, if it is that of every session.

    Raises
    ------
    BayescalError
        If the seals differ.
    """
    seal, found = truth_seal(folder), of_text(text)
    if found != seal:
        raise BayescalError(
            f"not the truth that was sealed: SHA-256 {found}, sealed {seal}", str(folder / TRUTH)
        )
    return seal


def check_unsealed(folder: Path) -> None:
    """Raise an error for a folder whose answers are sealed.

    Raises
    ------
    BayescalError
        If the answers are sealed.
    """
    if (folder / SEALED).exists():
        raise BayescalError(
            "the answers are sealed already",
            str(folder),
            "`python -m analysis.blind score` opens the truth; to answer anew, make other worlds",
        )
