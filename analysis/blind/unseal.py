"""Read the ground truth, after a check that the answers are sealed and no file has changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from analysis.blind import seal
from analysis.blind.folder import (
    ANSWERS,
    SEALED,
    TRUTH,
    WORLDS,
    answer_path,
    names,
    parsed,
    read,
    record,
    texts,
)
from analysis.blind.make import CONTACTS
from bayescal.errors import BayescalError

Records = dict[str, dict[str, Any]]
AFTER = "was changed after the answers were sealed"


def opened(folder: Path) -> tuple[Records, Records, dict[str, Any]]:
    """Ground truth and answers of a blind folder by session, and their origin.

    Returns
    -------
    truths, answers : dict of str to dict
    about : dict
        ``seed``, ``generator``, ``reserved``, ``kind``, ``worlds``, ``truth_sha256``, ``answers_sha256``,
        ``code_sha256``, ``software`` and ``same_code``, whether the answers were computed with the sources
        that are installed now.

    Raises
    ------
    BayescalError
        If the answers are not sealed, or ground truth, a session or an answer was changed since.
    """
    truth_sha256 = seal.truth_seal(folder)
    if not (folder / SEALED).is_file():
        raise BayescalError(
            "its answers are not sealed", str(folder), f"run `python -m analysis.blind run {folder}`"
        )
    text = read(folder / SEALED)
    sealed = parsed(text, folder / SEALED)
    try:
        answers = _answers(folder, sealed["answers"])
        if sealed["truth_sha256"] != truth_sha256:
            words = f"answers a truth of SHA-256 {sealed['truth_sha256']}, worlds have {truth_sha256}"
            raise BayescalError(words, str(folder / SEALED))
        truth = _truth(folder)
        _check_worlds(folder, truth, answers)
        about = {key: sealed[key] for key in ("truth_sha256", "code_sha256", "software")}
    except KeyError as key:
        raise BayescalError(
            f"lacks {key}", str(folder / SEALED), "its seal is not one of `blind run`"
        ) from None
    about |= {
        "seed": truth["seed"],
        "generator": truth.get("generator", 1),
        "reserved": truth.get("reserved", False),
        "kind": truth.get("kind", CONTACTS),
        "worlds": len(answers),
        "answers_sha256": seal.of_text(text),
        "same_code": sealed["code_sha256"] == seal.of_code(),
    }
    return truth["worlds"], answers, about


def _answers(folder: Path, sealed: dict[str, str]) -> Records:
    """Answers, after a check of their seals."""
    strangers = set(names(folder, ANSWERS)) - set(sealed)
    if strangers:
        where = str(answer_path(folder, min(strangers)))
        raise BayescalError("an answer that was not sealed", where)
    out = {}
    for name, expected in sealed.items():
        path = answer_path(folder, name)
        if not path.is_file():
            raise BayescalError("an answer that was sealed is missing", str(path))
        out[name] = record(path)
        found = seal.of_answer(out[name])
        if found != expected:
            raise BayescalError(f"{AFTER}: SHA-256 {found}, sealed {expected}", str(path))
    return out


def _truth(folder: Path) -> dict[str, Any]:
    text = read(folder / TRUTH)
    seal.check_truth(folder, text)
    return parsed(text, folder / TRUTH)


def _check_worlds(folder: Path, truth: dict[str, Any], answers: Records) -> None:
    """Raise an error for sessions that were changed after their simulation or after their answer."""
    for name, made in truth["sessions"].items():
        where = str(folder / WORLDS / name)
        if name not in answers:
            raise BayescalError("has no answer", where)
        asked, now = answers[name]["dataset_sha256"], seal.of_world(texts(folder, name))
        for what, found in (("was changed before it was answered", asked), ("was changed since", now)):
            if found != made:
                raise BayescalError(f"{what}: SHA-256 {found}, made as {made}", where)
