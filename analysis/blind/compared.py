"""Benefit of a second round: correct answers before it, after chosen contacts, and after random ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from analysis.blind import seal
from analysis.blind.folder import SEALED, answer_path, record
from analysis.blind.rates import BANDS, ends, share
from analysis.blind.rounds import ARMS, ROUND
from analysis.blind.rows import of
from analysis.blind.score import CLEAR, records
from analysis.pages import table as markdown
from bayescal.errors import BayescalError
from bayescal.reporting.text import FigureTable

BEGIN, END = "<!-- rounds: begin -->", "<!-- rounds: end -->"
FIRST = "first round"
WEAK = (10.0, 30.0)
"""Band of lambda in which a first round often does not decide."""

Records = Mapping[str, dict[str, Any]]


def answers(folder: Path, first: Mapping[str, dict[str, Any]], arm: str) -> dict[str, dict[str, Any]]:
    """Answers after a round: those of an arm where a session was continued, else the first ones.

    Raises
    ------
    BayescalError
        If an answer of the round was changed since it was sealed.
    """
    own = folder / ROUND / arm
    sealed = record(own / SEALED)["answers"]
    out = dict(first)
    for name, expected in sealed.items():
        out[name] = record(answer_path(own, name))
        if seal.of_answer(out[name]) != expected:
            raise BayescalError("was changed after the answers were sealed", str(answer_path(own, name)))
    return out


def compared(folder: Path, truths: Records, first: Records) -> list[dict[str, Any]]:
    """Correct answers in bands of lambda of the first round: before the second, and after each of its arms.

    Parameters
    ----------
    folder : Path
        With a second round.
    truths, first
        As of `score.records`.
    """
    rounds = {FIRST: first} | {arm: answers(folder, first, arm) for arm in ARMS}
    judged = {label: {r["world"]: r for r in records(truths, own)} for label, own in rounds.items()}
    start = judged[FIRST].values()
    groups = [
        (
            f"one effect, lambda {_words(band)}",
            [r["world"] for r in start if r["kind"] == "single" and band[0] <= r["lambda"] < band[1]],
            ends(band),
        )
        for band in (*BANDS, WEAK)
    ]
    clear = [r["world"] for r in start if r["verdict"] == "ambiguous" and r["lambda"] > CLEAR]
    groups.append((f"ambiguous at first, lambda from {CLEAR:g}", clear, [CLEAR, None]))
    return [
        {
            "group": words,
            "lambda": band,
            "right": {
                label: share([own[w] for w in worlds], lambda r: r["right"]) for label, own in judged.items()
            },
        }
        for words, worlds, band in groups
    ]


def _words(band: tuple[float, float]) -> str:
    return f"from {band[0]:g}" if np.isinf(band[1]) else f"{band[0]:g} to {band[1]:g}"


def _cells(row: Mapping[str, Any]) -> list[str]:
    return [row["group"], *(of(share) for share in row["right"].values())]


HEADINGS = ("correct answers", FIRST, "60 chosen contacts", "60 random contacts")


def terminal(rows: list[dict[str, Any]]) -> Table:
    """The comparison on a screen."""
    out = FigureTable(*HEADINGS)
    for row in rows:
        out.add_row(*_cells(row))
    return out


def page(rows: list[dict[str, Any]]) -> str:
    """The comparison as Markdown."""
    return markdown(HEADINGS, map(_cells, rows))
