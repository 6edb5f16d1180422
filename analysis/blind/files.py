"""The score folder: results and records in score.json, misses in misses.csv, figures."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from analysis.blind.assessed import Record
from bayescal.storage.folders import whole

SCORE, MISSES = "score.json", "misses.csv"
HEADINGS = (
    "world",
    "kind",
    "truth",
    "acts_at",
    "lambda",
    "verdict",
    "named",
    "leaders",
    "left_at",
    "reason",
    "detail",
)


def write_score(
    records: Sequence[Record],
    found: Mapping[str, Any],
    about: Mapping[str, Any],
    folder: Path,
    pictures: bool = True,
    headings: Sequence[str] = HEADINGS,
) -> tuple[str, ...]:
    """Write the score atomically.

    Parameters
    ----------
    records : sequence of dict
        As `score.records` returns them.
    found : Mapping
        As `score.figures` returns it.
    about : Mapping
        Hashes and versions; written with the results.
    folder : Path
        Output folder; an earlier score in it is replaced.
    pictures : bool
        Also draw the figures.
    headings : sequence of str
        Fields of a miss.

    Returns
    -------
    tuple of str
        Names of the files.
    """
    text = json.dumps({"about": dict(about), **found, "records": list(records)}, allow_nan=False, indent=1)
    names = [SCORE, MISSES]
    with whole(folder, SCORE) as stage:
        (stage / SCORE).write_text(text + "\n", encoding="utf-8")
        with (stage / MISSES).open("w", encoding="utf-8", newline="") as stream:
            lines = csv.DictWriter(stream, headings, lineterminator="\n")
            lines.writeheader()
            lines.writerows(found["misses"])
        if pictures:
            from analysis.blind.pictures import PICTURES

            for name, draw in PICTURES.items():
                draw(records, found).savefig(stage / name)
                names.append(name)
    return tuple(names)
