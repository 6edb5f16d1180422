"""Names found in one half of a real session: found in the other half too, and do they improve it.

Each session is split by pose at random. One half is diagnosed alone (`gap` without validation data). The
model that it names, fitted to this half, predicts the other half; so does that model without each of its
names in turn. The residuals of the other half are compared with the 95 % intervals of the model with all
names. Halves of the workspace, by the radius of the point, show intervals where nothing was fitted.

``python -m analysis.real_names --real ../shared/data/real --out docs/real_names.md``
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analysis.knock_out import usual
from analysis.pages import published
from analysis.pages import table as markdown
from analysis.real_halves import share_inside, splits, with_roles
from analysis.records import TOP, Record, completed, real_arguments, real_folders
from bayescal.dataset import Dataset, read_dataset
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.estimate.discrepancy import stated
from bayescal.estimate.unexplained import unexplained
from bayescal.gap.concluded import doubted
from bayescal.gap.diagnose import explain
from bayescal.gap.search.refit import refit
from bayescal.predict.crossvalidation import validation_errors
from bayescal.predict.errors import ValidationErrors, kept

RUNS = TOP / "runs" / "real-names"
MARKS = ("<!-- names: begin -->", "<!-- names: end -->")
KINDS = ("random", "workspace")
SURE = 0.95
"""Probability above which a name is expected to hold in the other half."""


class Task(NamedTuple):
    """One half of a session."""

    folder: Path
    split: int  # from 0; of the workspace the last
    half: int  # 0 or 1
    kind: str = KINDS[0]

    @property
    def key(self) -> str:
        """Of its record."""
        kind = "" if self.kind == KINDS[0] else f" | {self.kind}"
        return f"{self.folder.name} | {self.split} | {self.half}{kind}"


def made(task: Task) -> Record:
    """The record of a half."""
    start = time.process_time()
    dataset = read_dataset(task.folder)
    halves = [s for s in splits(dataset) if s.kind == task.kind][task.split].halves
    own, other = halves[task.half], halves[1 - task.half]
    try:
        found = diagnosed(dataset, own, other)
    except BayescalError as refused:
        found = {"verdict": f"refused: {refused.what}", "names": []}
    of = {"session": task.folder.name, "split": task.split, "half": task.half, "kind": task.kind}
    return of | found | {"seconds": round(time.process_time() - start, 1)}


def diagnosed(dataset: Dataset, own: np.ndarray, other: np.ndarray) -> Record:
    """Diagnose one half alone; its refit, and the refit without each name, predict the other half."""
    alone, both = with_roles(dataset, own, other, "skip"), with_roles(dataset, own, other, "validate")
    found = explain(alone, usual(alone.dataset))
    last, verdict = found.last, found.verdict
    members = last.decision.members
    sets = [(), members, *(tuple(m for m in members if m is not one) for one in members)]
    bare = replace(last.fitted, model=replace(last.fitted.model, scene=both))
    fits = [refit(bare, last.candidates, own_set, last.options) for own_set in sets]
    errors = [validation_errors(fitted) for fitted in fits]
    fair = kept(*errors)
    before, after, *without = [1e6 * rms(h, fair) for h in errors]
    names = [
        {"name": n.model, "effect": n.effect, "probability": n.probability, "without_um": size}
        for n, size in zip(verdict.named[-len(members) :] if members else (), without, strict=True)
    ]
    inside = [intervals(fits[0]), intervals(doubted(fits[1], fits[0], verdict))]
    return {
        "verdict": verdict.kind, "before_um": before, "after_um": after, "inside": inside, "names": names,
        "prior_widths": dict(last.options.widths),
    }  # fmt: skip


def intervals(fitted: Estimate) -> float:
    """Share of the validation residuals within the 95 % intervals of a fit with its stated uncertainty."""
    wide = stated(fitted)
    return share_inside(wide.wide, wide.remaining(unexplained(fitted)).excess, wide.white)


def rms(held: ValidationErrors, fair: np.ndarray) -> float:
    """Root mean square residual, m, of the residuals (R,) that are used."""
    return float(np.sqrt(np.mean(held.residual[fair] ** 2)))


def table(records: Sequence[Record]) -> str:
    """The page's tables: every half with its names, their counts, and the intervals of the other half."""
    return "\n\n".join((counts(records), covered(records), halves(records)))


def covered(records: Sequence[Record]) -> str:
    """Shares of the residuals of the other halves within 95 % intervals, without names and with them."""
    rows = []
    for kind in KINDS:
        own = [r for r in records if kind_of(r) == kind and "inside" in r]
        for name in (*dict.fromkeys(r["session"] for r in own), "all"):
            inside = [r["inside"] for r in own if name in (r["session"], "all")]
            if inside:
                rows.append((kind, name, *(f"{100 * share:.0f} %" for share in np.mean(inside, axis=0))))
    return markdown(("halves", "session", "without names", "with all names"), rows)


def kind_of(r: Record) -> str:
    """Kind of the split of a record."""
    return str(r.get("kind", KINDS[0]))


def counts(records: Sequence[Record]) -> str:
    """How many names improve the other half, and are found there."""
    rows = []
    for what, above in (("probability above 0.95", True), ("all others", False)):
        own = sure(records, above)
        better = sum(improves(r, n) for r, n in own)
        again = sum(bool(found_again(r, n, records)) for r, n in own)
        rows.append((what, len(own), share(better, len(own)), share(again, len(own))))
    return markdown(("names", "number", "the other half improves", "their effect is named there too"), rows)


def halves(records: Sequence[Record]) -> str:
    """One line of every half, and one of each of its names."""
    rows: list[tuple[str, ...]] = []
    for r in records:
        split = r["split"] + 1 if kind_of(r) == KINDS[0] else kind_of(r) + " "
        label = f"{r['session']} {split}{'ab'[r['half']]}"
        if not r["names"]:
            rows.append((label, r["verdict"], *[""] * 4))
            continue
        after = f"{r['after_um']:.1f}"
        rows.append((label, f"{r['verdict']}, all names", "", f"{r['before_um']:.1f}", after, ""))
        for n in r["names"]:
            found = ", ".join(found_again(r, n, records)) or "no"
            rows.append(("", n["name"], f"{n['probability']:.2f}", f"{n['without_um']:.1f}", after, found))
    heads = ("session, split", "verdict, names", "P", "other half without (µm)", "with", "in the other half")
    return markdown(heads, rows)


def improves(r: Record, name: Record) -> bool:
    """Whether the other half's RMS error is smaller with a name than without it."""
    return bool(r["after_um"] < name["without_um"])


def sure(records: Sequence[Record], above: bool = True) -> list[tuple[Record, Record]]:
    """Random halves and their names with a probability above `SURE`, or those not above it."""
    random = (r for r in records if kind_of(r) == KINDS[0])
    return [(r, n) for r in random for n in r["names"] if (n["probability"] > SURE) is above]


def found_again(r: Record, name: Record, records: Sequence[Record]) -> list[str]:
    """Names of the same effect in the other half of the split, with their settings."""
    same_split = (q for q in records if all(q[key] == r[key] for key in ("session", "split")))
    others = (q for q in same_split if kind_of(q) == kind_of(r) and q is not r)
    same = [n["name"] for q in others for n in q["names"] if n["effect"] == name["effect"]]
    return [text.split()[0] for text in same]


def share(count: int, of: int) -> str:
    """A count with its share."""
    return f"{count} ({count / of:.2f})" if of else "-"


def found_in(
    real: Path, count: int, runs: Path = RUNS, workers: int = 1, sessions: Sequence[str] = (),
    workspace: bool = False,
) -> list[Record]:  # fmt: skip
    """Records of all halves of `count` random splits of every session; those of `runs` are kept.

    `workspace`: also of its halves by the radius of the point.
    """
    folders = real_folders(real, sessions)
    parts = [(KINDS[0], k) for k in range(count)] + [(KINDS[1], -1)] * workspace
    tasks = [Task(f, split, half, kind) for f in folders for kind, split in parts for half in (0, 1)]
    return completed(runs / "records.json", {t.key: t for t in tasks}, made, workers, "halves")


def main(arguments: Sequence[str] | None = None) -> None:
    """Diagnose the halves that are missing, and write the page of all."""
    parser = real_arguments("real_names", __doc__)
    parser.add_argument("--splits", type=int, default=1, help="random splits of each session, at most 4")
    parser.add_argument("--workspace", action="store_true", help="halves of the workspace too")
    given = parser.parse_args(arguments)
    found = found_in(given.real, given.splits, given.runs, given.workers, given.sessions, given.workspace)
    published(table(found), given.out, MARKS, new=True)


if __name__ == "__main__":  # worker processes import this module too
    main()
