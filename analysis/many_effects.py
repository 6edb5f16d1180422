"""Arms in which many effects are a little wrong at once, as in a real one: which names are true, and where.

``python -m analysis.many_effects --out RUNS --sessions 24`` simulates sessions by `analysis.world`, each with
six to ten effects of the arm, diagnoses them and prints what of the names is there. Sessions and records that
are in RUNS are kept.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from analysis.outside import SURE, Record, Task, diagnosed
from analysis.records import on_workers
from analysis.world import build, frames, joints
from analysis.world.mix import NAMED, Maker, formed
from analysis.world.write import plain
from bayescal.storage.files import json_text

SEED = 31337
OF_ARM: tuple[Maker, ...] = tuple(
    m
    for m in NAMED
    if m.__module__ in (joints.__name__, frames.__name__)
    and m not in (joints.compliance, frames.step, frames.payload)
)
"""Effects that an arm has at all times; compliance is in the baseline."""
FEWEST, MOST = 6, 10
VISIBLE = 30.0
"""Detectability lambda from which on an effect alone is wanted to be named."""


class Name(NamedTuple):
    """A name of a diagnosis with a probability of `SURE` or more."""

    effect: str
    there: bool
    at_site: bool  # and at one of its sites, where it has one


def made(number: int, out: Path, seed: int = SEED) -> Record:
    """Write a session to `out`, and return its ground truth."""
    rng = np.random.default_rng([seed, 7, number])
    drawn = rng.choice(len(OF_ARM), rng.integers(FEWEST, MOST + 1), replace=False)
    session = build.make(seed, number, given=formed(seed, number, [OF_ARM[k] for k in drawn]))
    out.mkdir(parents=True, exist_ok=True)
    for name, text in session.texts.items():
        (out / name).write_text(text, encoding="utf-8")
    return session.truth


def names(truth: Mapping[str, Any], record: Mapping[str, Any]) -> Iterator[Name]:
    """Compare the sure names of a record with the truth."""
    sites: dict[str, set[str]] = {}
    for place in truth["where"]:
        sites.setdefault(place["effect"], set()).update((place["site"], *place.get("also", ())))
    said = {n["effect"]: set(n["sites"]) for n in record["named"]}
    for effect, probability in record["probability"].items():
        if effect not in ("null", "unknown") and probability >= SURE:
            mine = said.get(effect, set())
            yield Name(effect, effect in sites, bool(mine & sites.get(effect, set())) or not mine)


def answered(asked: tuple[int, Path]) -> tuple[Record, Record]:
    """The truth and the record of a session; what is there is kept."""
    number, out = asked
    folder, truth = out / f"{number:03d}", out / "truth" / f"{number:03d}.json"
    if not truth.exists():
        text = json_text(plain(made(number, folder)))
        truth.parent.mkdir(parents=True, exist_ok=True)
        truth.write_text(text, encoding="utf-8")
    record = out / "records" / f"{number:03d}.json"
    diagnosed(Task(folder, record, ""))
    return json.loads(truth.read_text(encoding="utf-8")), json.loads(record.read_text(encoding="utf-8"))


def card(pairs: Sequence[tuple[Record, Record]]) -> Iterator[str]:
    """Lines: how many names are true, and how many of the visible effects are named."""
    every = [n for truth, record in pairs for n in names(truth, record)]
    there, at_site = sum(n.there for n in every), sum(n.there and n.at_site for n in every)
    yield f"{len(pairs)} sessions with {FEWEST} to {MOST} effects each"
    yield f"names with P from {SURE:g}: {len(every)}, there: {there}, and at their site: {at_site}"
    for low, high in ((0.0, VISIBLE), (VISIBLE, np.inf)):
        seen = [(e, r) for t, r in pairs for e, v in t["lambda"]["each"].items() if low <= v < high]
        found = sum(r["probability"].get(e, 0.0) >= SURE for e, r in seen)
        yield f"effects with lambda from {low:g} to {high:g}: {len(seen)}, with P from {SURE:g}: {found}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Make, diagnose and print the card."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sessions", type=int, default=24)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args(arguments)
    tasks = [(k, asked.out) for k in range(asked.sessions)]
    pairs = list(on_workers(answered, tasks, asked.workers, "sessions"))
    print("\n".join(card(pairs)))


if __name__ == "__main__":
    main()
