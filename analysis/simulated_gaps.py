"""The sim-to-real gap of diagnosed sessions, replayed in MuJoCo: as the diagnosis reports it, and closed.

Each run folder of `bayescal gap` is exported to MJCF (with a replay script where a plain file cannot hold the
arm) and verified. Runs without a named effect are left out: their arm is the baseline.

    python -m analysis.simulated_gaps runs/*-gap [--truth ../shared/data/worlds-dev-2/truth]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import bayescal as bc
from bayescal.errors import BayescalError

KINDS = ("planes", "points", "distances")


@dataclass(frozen=True)
class Replayed:
    """One run: RMS errors, µm, in the simulator before and after, and after by the run."""

    name: str
    effects: tuple[str, ...]
    readings: str
    before: dict[str, float]
    after: dict[str, float]
    reported: dict[str, float]
    count: dict[str, int]
    refused: str = ""  # why there are none


def replayed(run: Path) -> Replayed | None:
    """Export and verify a run; None without a named effect."""
    record = json.loads((run / "gap.json").read_text(encoding="utf-8"))
    effects = tuple(name for name in record["effects"] if name != "unknown")
    if not effects:
        return None
    found, readings, why = None, "", ""
    for readings in ("plain", "script"):
        try:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "arm.xml"
                bc.export(run, "mjcf", readings=readings, force=True).save(path)
                found = bc.verify(run, path).record
            break
        except BayescalError as error:
            why = str(error)
    if found is None or not found["measured"]:
        return Replayed(run.name, effects, readings, {}, {}, {}, {}, why or "no validation measurements")
    of = {k: found["measured"][k] for k in KINDS if k in found["measured"]}
    return Replayed(
        run.name, effects, readings,
        {k: v["before_rms_um"] for k, v in of.items()},
        {k: v["after_rms_um"] for k, v in of.items()},
        {k: v["predicted_after_rms_um"] for k, v in of.items() if v["predicted_after_rms_um"] is not None},
        {k: v["count"] for k, v in of.items()},
    )  # fmt: skip


def lines(found: Sequence[Replayed], floors: dict[str, float]) -> Iterator[str]:
    """A table of the runs, then the ratios and the pooled share of the distance gap that is closed."""
    for r in found:
        cells = [
            f"{k} {r.before[k]:.1f} -> {r.after[k]:.1f} (run: {r.reported.get(k, np.nan):.1f})"
            for k in r.after
        ]
        yield f"{r.name}  {', '.join(r.effects)}  {r.readings}: {r.refused or '; '.join(cells)}"
    for kind in KINDS:
        ratio = np.array([r.after[kind] / r.reported[kind] for r in found if kind in r.reported])
        if len(ratio):
            near, most = np.mean(np.abs(ratio - 1.0) < 0.05), ratio[np.argmax(np.abs(ratio - 1.0))]
            yield f"{kind}: {len(ratio)} runs, {100 * near:.0f} % within 5 % of the run, farthest {most:.3f}"
    own = [r for r in found if "distances" in r.after and r.name in floors]
    if own:
        weight = np.array([r.count["distances"] for r in own], float)
        before, after = (
            np.average([getattr(r, w)["distances"] ** 2 for r in own], weights=weight)
            for w in ("before", "after")
        )
        floor = np.average([floors[r.name] ** 2 for r in own], weights=weight)
        closed = (before - after) / (before - floor)
        rms = " -> ".join(f"{v**0.5:.1f}" for v in (before, after))
        yield f"distances pooled: {rms} µm, true model {floor**0.5:.1f}: gap closed {closed:.2f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Replay runs and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path, help="run folders of bayescal gap")
    parser.add_argument("--truth", type=Path, help="ground truths by the names of the runs")
    given = parser.parse_args(arguments)
    found = [r for run in given.runs if (r := replayed(run)) is not None]
    floors = {}
    if given.truth:
        for r in found:
            truth = json.loads((given.truth / f"{r.name}.json").read_text(encoding="utf-8"))
            floors[r.name] = truth["distance_rms_um"]["fit_without_effect"]
    print("\n".join(lines(found, floors)))


if __name__ == "__main__":
    main()
