"""Steps added to sessions of real arms: is the row within the interval that a diagnosis states.

From a row on, the base of the arm is displaced by a vector: points that an instrument reads move by it, and
where the readings alone say where the ball is, the arm must reach the same place from a displaced base. Three
rows and four sizes for each session; the sizes are multiples of the RMS residual of the calibrated arm. The
noncentrality lambda is the square sum of what the calibrated arm cannot absorb, over the residual variance.

``python -m analysis.real_steps --real ../shared/data/real --out docs/real_steps.md``
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analysis.knock_out import usual
from analysis.pages import published
from analysis.pages import table as markdown
from analysis.records import Record, completed, real_arguments, real_folders
from bayescal.arm.inverse import descend, to_frames
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import Dataset, read_dataset
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.estimate.unexplained import unexplained
from bayescal.gap.diagnose import explain
from bayescal.gap.examine import where
from bayescal.gap.outcome.magnitude import noise_floor
from bayescal.model.model import build
from bayescal.model.scene import Scene

MARKS = ("<!-- steps: begin -->", "<!-- steps: end -->")
SHARES, SIZES = (0.25, 0.5, 0.75), (1.0, 2.0, 4.0, 8.0)
"""Of the fitted rows, that are before the step; shifts in RMS residuals of the calibrated arm."""
RANGES = (10.0, 30.0, 100.0)
"""Of lambda, for which the table counts apart."""
BESIDE = 0.25
"""Share of the rows of a target that are before a step, and after it, at least."""


class Task(NamedTuple):
    """A session with a step."""

    folder: Path
    share: float
    size: float

    @property
    def key(self) -> str:
        """Of its record."""
        return f"{self.folder.name} | {self.share:g} | {self.size:g}"


def shifted(dataset: Dataset, row: int, by: np.ndarray) -> Dataset:
    """A session whose base is displaced by a vector `by` (3,), m in F0, from a row (from 0) on."""
    m = dataset.measurements
    after = np.arange(len(m.readings)) >= row
    seen = np.zeros(len(after), bool) if m.xyz is None else np.isfinite(m.xyz).all(axis=1)
    readings, xyz = m.readings.copy(), None if m.xyz is None else m.xyz.copy()
    for number, t in enumerate(dataset.targets):
        own = after & seen & (m.target == number)
        if xyz is not None and own.any():
            xyz[own] += by @ rpy_matrix(np.asarray(t.values["rpy"]))
    for number, tool in enumerate(dataset.tools):
        own = np.flatnonzero(after & ~seen & (m.tool == number))
        arm = NominalArm(dataset.robot, np.asarray(tool.centre))
        poses = arm.tool_poses(arm.frames(readings[own]))
        poses[:, :3, 3] -= by
        free = np.full(dataset.robot.n, np.inf)
        angles, reached = descend(to_frames(arm, poses), arm.angles_of(readings[own]), -free, free)
        assert reached.all()
        readings[own] = arm.readings_of(angles)
    return replace(dataset, measurements=replace(m, readings=readings, xyz=xyz))


def seen_at(dataset: Dataset, rows: np.ndarray, share: float) -> int:
    """The fitted row nearest to a share of them with `BESIDE` of the rows of its target before it and after.

    A session that goes from one target of unknown position to the next does not show a step between them.
    """
    target = dataset.measurements.target[rows]
    before = np.array([np.mean(np.flatnonzero(target == t) < k) for k, t in enumerate(target)])
    able = np.flatnonzero((before >= BESIDE) & (before <= 1.0 - BESIDE))
    return int(rows[able[np.argmin(np.abs(able - share * len(rows)))]])


def direction(dataset: Dataset, row: int, share: float) -> np.ndarray:
    """Unit vector (3,) of a step at a row: across the plane that is measured there, or else at random."""
    values = dataset.targets[dataset.measurements.target[row]].values
    along = np.asarray(values.get("normal", np.random.default_rng(int(100 * share)).standard_normal(3)))
    return along / np.linalg.norm(along)


def made(task: Task) -> Record:
    """The record of a session with a step."""
    start = time.process_time()
    dataset = read_dataset(task.folder)
    effects, rows = usual(dataset), Scene(dataset).rows("calibrate")
    row = seen_at(dataset, rows, task.share)
    plain = calibrated(Scene(dataset), effects)
    size = task.size * unexplained(plain).fitted
    stepped = shifted(dataset, row, size * direction(dataset, row, task.share))
    try:
        found = events(stepped, effects)
    except BayescalError as refused:
        found = {"verdict": f"refused: {refused.what}", "events": []}
    around = [int(np.sum((rows > low) & (rows <= high))) for _, (low, high) in found["events"]]
    return {
        "session": task.folder.name, "share": task.share, "size": task.size, "row": row, "um": 1e6 * size,
        "lambda": detectability(plain, stepped), **found, "widths": around,
        "seconds": round(time.process_time() - start, 1),
    }  # fmt: skip


def detectability(plain: Estimate, stepped: Dataset) -> float:
    """Noncentrality of a step: what the calibrated arm cannot absorb of it, over the residuals' scale."""
    after = estimate(build(Scene(stepped), plain.model.effects), start=plain.z, left_out=plain.rejected)
    total = 0.0
    for one, other in zip(plain.model.blocks, after.model.blocks, strict=True):
        change = after.residuals(other) - plain.residuals(one)
        total += float(np.sum((change.ravel() * plain.weights.whitening(one)) ** 2))
    return total


def events(dataset: Dataset, effects: tuple[str, ...]) -> Record:
    """The verdict of a diagnosis, and the sudden changes that it states: row and 95 % interval, from 0."""
    found = explain(Scene(dataset, oriented=True), effects)
    noise = noise_floor(found.final, found.after.main)
    named = [event for name in found.verdict.named for event in name.events]
    other = [place.event for place in where(found.first, found.last, found.promoted, noise.sd) if place.event]
    return {
        "verdict": found.verdict.kind,
        "names": [n.model for n in found.verdict.named],
        "events": [(event.row, list(event.interval95)) for event in (*named, *other)],
    }


def inside(r: Record) -> bool:
    """Whether the interval of a stated sudden change has the row of the step."""
    return any(low <= r["row"] <= high for _, (low, high) in r["events"])


def table(records: Sequence[Record]) -> str:
    """The page's table: a line a session, a column a range of lambda."""
    ranges = [(low, high) for low, high in itertools.pairwise((0.0, *RANGES, np.inf))]
    heads = [f"lambda below {high:g}" if not low else f"{low:g} to {high:g}" for low, high in ranges[:-1]]
    heads.append(f"above {RANGES[-1]:g}")
    rows = []
    for name in (*dict.fromkeys(r["session"] for r in records), ""):
        own = [r for r in records if name in ("", r["session"])]
        cells = [_share([r for r in own if low <= r["lambda"] < high]) for low, high in ranges]
        rows.append((name or "**all**", *cells, _width(own)))
    return markdown(("session", *heads, "rows within the interval, median"), rows)


def _share(records: Sequence[Record]) -> str:
    return f"{sum(map(inside, records))} of {len(records)}" if records else "-"


def _width(records: Sequence[Record]) -> str:
    """Median number of fitted rows of the intervals that have the row of the step."""
    found = [
        count for r in records for count, (_, (low, high)) in zip(r["widths"], r["events"], strict=True)
        if low <= r["row"] <= high
    ]  # fmt: skip
    return f"{np.median(found) + 1:g}" if found else "-"


def main(arguments: Sequence[str] | None = None) -> None:
    """Diagnose the sessions that are missing, and write the page's table."""
    given = real_arguments("real_steps", __doc__).parse_args(arguments)
    folders = real_folders(given.real, given.sessions)
    tasks = [Task(f, share, size) for f in folders for share in SHARES for size in SIZES]
    every = {t.key: t for t in tasks}
    found = completed(given.runs / "records.json", every, made, given.workers, "steps")
    published(table(found), given.out, MARKS, new=True)


if __name__ == "__main__":  # worker processes import this module too
    main()
