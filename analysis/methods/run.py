"""Runs every method on simulated sessions of four sorts, and on real ones, and renews the page."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from analysis.methods import page, session
from analysis.pages import published
from analysis.records import arguments_of
from bayescal.dataset import Dataset, read_dataset
from bayescal.errors import BayescalError
from bayescal.methods import compare
from bayescal.reporting.comparison import comparison_record
from bayescal.simulation import Options

RAW = "methods.json"
NOISE, SHAPE, OUTLIERS, TRACKER = 5e-6, 20e-6, 0.03, 20e-6  # m, m, fraction, m
Record = dict[str, Any]

SORTS: dict[str, Callable[[Options, int], Dataset]] = {
    "500 contacts": lambda layout, arm: session.touched(replace(layout, contacts=500), arm, NOISE),
    "100 contacts": lambda layout, arm: session.touched(layout, arm, NOISE),
    "100, cube off by 20 µm": lambda layout, arm: session.touched(layout, arm, NOISE, shape_error=SHAPE),
    "100, 3 % outliers": lambda layout, arm: session.touched(layout, arm, NOISE, outliers=OUTLIERS),
    "tracker": lambda layout, arm: session.tracked(replace(layout, seed=arm), TRACKER),
}
"""Sessions by what is particular about them: of a layout and the seed of an arm."""


def simulated(layouts: int, arms: int, seed: int) -> Iterator[Record]:
    """Records of compared sessions: `arms` arms before each of `layouts` layouts, of every sort."""
    for k in range(layouts):
        layout = Options(seed=100 * seed + k, contacts=100, later=40, repeats=0, placements=2)
        for sort, made in SORTS.items():
            for j in range(arms if sort != "tracker" else 1):
                arm = 10_000 * seed + 100 * k + j
                try:
                    yield _record(made(layout, arm), sort)
                except BayescalError as error:
                    yield {"sort": sort, "seed": arm, "refused": str(error)}


def real(folder: Path) -> Iterator[Record]:
    """Records of the sessions in a folder."""
    for each in sorted(p for p in folder.iterdir() if (p / "dataset.yaml").is_file()):
        yield _record(read_dataset(each), each.name)


def _record(dataset: Dataset, sort: str) -> Record:
    return {"sort": sort, **comparison_record(compare(dataset))}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study and write what it shows."""
    parser = arguments_of("methods", __doc__, "one seed, one study")
    parser.add_argument("--layouts", type=int, default=3, help="layouts of cube and spheres")
    parser.add_argument("--arms", type=int, default=4, help="arms before each")
    parser.add_argument("--real", type=Path, help="folder of real sessions")
    given = parser.parse_args(arguments)
    done: list[Record] = []
    sources = [simulated(given.layouts, given.arms, given.seed), *([real(given.real)] if given.real else [])]
    for source in sources:
        for record in source:
            done.append(record)
            print(f"\r{len(done)} {record['sort']:30s}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / RAW).write_text(json.dumps(done) + "\n", encoding="utf-8")
    published(page.tables(done), given.page, (page.BEGIN, page.END))
