"""Names found in one half of a real session: found in the other half too, and do they improve it.

Each session is split by pose at random. One half is diagnosed alone (`gap` without validation rows). Every
name that it gives with a probability above `SURE` is looked for among the names of the other half, and the
model with these names, fitted to the first half, predicts the other.

``python -m analysis.real_names --real ../shared/data/real --out runs/real_names.md``
"""

from __future__ import annotations

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from analysis.real_halves import splits
from analysis.real_sessions import BOUND_TO_ITS_SESSION
from bayescal.dataset import Dataset, read_dataset
from bayescal.effects import MODELS
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, calibrated
from bayescal.gap.explain import explain
from bayescal.gap.search.refit import model_name
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import validation_errors

SURE = 0.95


@dataclass(frozen=True)
class Found:
    """A diagnosis of one half, and its RMS error, m, of the other half before and after the refit."""

    kind: str
    names: tuple[str, ...]  # with a probability above SURE, as `--model` takes them
    every: frozenset[str]  # named effects at any probability, without settings
    before: float
    after: float

    @property
    def effects(self) -> frozenset[str]:
        """Effects of `names`, without settings."""
        return frozenset(map(plain, self.names))


def with_roles(dataset: Dataset, own: np.ndarray, other: np.ndarray, as_role: str) -> Scene:
    """A scene that fits `own` rows, with the others as `as_role`."""
    m = dataset.measurements
    role = np.full(len(m.role), "skip", dtype=object)
    role[own], role[other] = "calibrate", as_role
    return Scene(replace(dataset, measurements=replace(m, role=role.astype(str))))


def diagnosed(dataset: Dataset, own: np.ndarray, other: np.ndarray) -> Found:
    """Diagnose one half alone; fit it with what was named, and predict the other."""
    alone, both = with_roles(dataset, own, other, "skip"), with_roles(dataset, own, other, "validate")
    circumstances = alone.circumstances(alone.rows("calibrate"))
    effects = tuple(e for e in ("geometry", "compliance") if not MODELS[e].missing(circumstances))
    found = explain(alone, effects)
    probability = found.verdict.probability
    members = found.last.decision.members
    known = found.last.candidates
    sure = tuple(model_name(m, known) for m in members if probability[m.effect] > SURE)
    usable = tuple(n for n in sure if plain(n) not in BOUND_TO_ITS_SESSION)
    before = error(calibrated(both, effects))
    after = error(calibrated(both, (*effects, *usable))) if usable else before
    every = frozenset(m.effect for m in members)
    return Found(found.verdict.kind, sure, every, before, after)


def error(fitted: Estimate) -> float:
    """Root mean square residual of the validation rows, m, without gross ones."""
    held = validation_errors(fitted)
    return float(np.sqrt(np.mean(held.residual[~held.gross] ** 2)))


def lines(folder: Path, count: int) -> Iterator[str]:
    """Lines of the table for a session."""
    dataset = read_dataset(folder)
    random = (s for s in splits(dataset) if s.kind == "random")
    for k, split in enumerate(islice(random, count), start=1):
        one, other = split.halves
        try:
            halves = diagnosed(dataset, one, other), diagnosed(dataset, other, one)
        except BayescalError as refused:
            yield f"| {folder.name} | {k} | refused: {refused.what} | | | |"
            continue
        for own, rest in (halves, halves[::-1]):
            names = ", ".join(own.names) or "-"
            again = f"{len(own.effects & rest.every)} of {len(own.effects)}" if own.names else "-"
            gain = f"{1e6 * own.before:.0f} | {1e6 * own.after:.0f}"
            yield f"| {folder.name} | {k} | {own.kind}: {names} | {again} | {gain} |"


def main(argv: Sequence[str] | None = None) -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--splits", type=int, default=2)
    args = parser.parse_args(argv)
    table = [
        "| session | split | verdict and names | found in the other half | other half, before (µm) | after |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for folder in sorted(p for p in args.real.iterdir() if p.is_dir()):
        for line in lines(folder, args.splits):
            print(line, flush=True)
            table.append(line)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text("\n".join(table) + "\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
