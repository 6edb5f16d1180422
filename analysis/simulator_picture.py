"""The picture of docs/simulators.md: difference between simulator and machine, before and after.

python -m analysis.simulator_picture "label=runs/a-verify/verify.json" --out docs/pictures/simulator-gap.png
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from analysis.charts import figure, tidy
from bayescal.reporting.style import ACCENT, FAINT, INK, png

WORDS = {"planes": "contacts", "points": "points", "distances": "sphere distances"}


def bars(label: str, record: dict) -> list[tuple[str, float, float]]:
    """Name, RMS before and after, µm, of each kind of validation data of a verify.json."""
    found = record["measured"]
    kinds = [kind for kind in WORDS if kind in found]
    return [(f"{label}\n{WORDS[k]}", found[k]["before_rms_um"], found[k]["after_rms_um"]) for k in kinds]


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the bars of some records."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("records", nargs="+", help="label=verify.json")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    shown = []
    for entry in given.records:
        label, _, path = entry.partition("=")
        shown += bars(label, json.loads(Path(path).read_text(encoding="utf-8")))
    out = figure(9, 0.9 + 0.75 * len(shown), ["Validation data replayed in MuJoCo: simulator minus machine"])
    axes = out.subplots()
    for k, (_, before, after) in enumerate(shown[::-1]):
        for value, at, colour in ((before, k + 0.18, FAINT), (after, k - 0.18, ACCENT)):
            axes.barh(at, value, height=0.34, color=colour)
            axes.annotate(
                f"{value:.3g}", (value, at), (4, 0), textcoords="offset points", va="center", color=INK
            )
    axes.barh(0, 0, color=FAINT, label="before")
    axes.barh(0, 0, color=ACCENT, label="calibrated arm")
    axes.set_yticks(range(len(shown)), [name for name, *_ in shown[::-1]])
    axes.set_xscale("log")
    axes.set_xlim(1.0, 2.0 * max(before for _, before, _ in shown))
    axes.set_xlabel("RMS (µm)")
    axes.legend(frameon=False, loc="lower right")
    tidy(axes)
    given.out.write_bytes(png(out))


if __name__ == "__main__":
    main()
