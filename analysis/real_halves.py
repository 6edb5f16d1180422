"""Halves of one session: do they agree within their stated uncertainty, and does one predict the other.

Each session of a real arm is split by pose: at random, in time, and in the workspace. Of each split: the
chi-square per degree of freedom of the difference of the arm's parameters, and the share of the other half's
residuals that the 95 % intervals hold; both by the plain covariance and by the stated one
(`bayescal.estimate.discrepancy`). Random halves share the discrepancy: its shared part is left out.

``python -m analysis.real_halves --real ../shared/data/real --out docs/real_halves.md``
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from analysis.pages import published
from analysis.pages import table as markdown
from analysis.records import TOP, Record, completed, real_arguments, real_folders
from bayescal.arm import chain as reference
from bayescal.assess.agreement import difference_covariance, known_directions, shared_masses
from bayescal.dataset import Dataset, read_dataset
from bayescal.effects import BASELINE, MODELS
from bayescal.estimate import Estimate, calibrated, root
from bayescal.estimate.discrepancy import Stated, stated
from bayescal.estimate.families import Family, families, poses
from bayescal.estimate.unexplained import unexplained
from bayescal.estimate.widths import with_widths
from bayescal.model import USUAL, FitOptions
from bayescal.model.model import noise_groups
from bayescal.model.scene import Scene
from bayescal.predict.crossvalidation import inside95
from bayescal.predict.validation import validate

RUNS = TOP / "runs" / "real-halves"
MARKS = ("<!-- halves: begin -->", "<!-- halves: end -->")
RANDOM, DRAWS = 4, 800
KINDS = ("random", "time", "workspace")


@dataclass(frozen=True)
class Split:
    """Two halves of the fitted measurements."""

    kind: str  # of KINDS
    halves: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Half:
    """A fitted half, and the share of the other half within 95 %, by the plain and the stated covariance."""

    plain: Estimate
    stated: Stated
    inside: tuple[float, float]


@dataclass(frozen=True)
class Figures:
    """Of one split: by the plain and by the stated covariance."""

    kind: str
    chi2: tuple[float, float]  # per degree of freedom
    inside: tuple[float, float]


def splits(dataset: Dataset) -> Iterator[Split]:
    """Splits of the calibrate rows; rows of one pose stay together."""
    scene = Scene(dataset)
    rows = scene.rows("calibrate")
    pose = poses(dataset.measurements, rows)
    count = int(pose.max()) + 1
    first = np.array([np.flatnonzero(pose == k)[0] for k in range(count)])
    c = scene.circumstances(rows)
    at = reference.points(c.chain, c.q, c.tool_centres[c.tool])[rows[first]]
    orders = [("random", np.random.default_rng(k).permutation(count)) for k in range(RANDOM)]
    orders.append(("time", np.argsort(first, kind="stable")))
    for value in (*at.T, np.hypot(at[:, 0], at[:, 1])):
        orders.append(("workspace", np.argsort(value, kind="stable")))
    for kind, order in orders:
        one = np.isin(pose, order[: count // 2])
        yield Split(kind, (rows[one], rows[~one]))


def with_roles(dataset: Dataset, own: np.ndarray, other: np.ndarray, as_role: str) -> Scene:
    """A scene that fits `own` rows, with the others as `as_role`."""
    m = dataset.measurements
    role = np.full(len(m.role), "skip", dtype=object)
    role[own], role[other] = "calibrate", as_role
    return Scene(replace(dataset, measurements=replace(m, role=role.astype(str))))


def half(
    dataset: Dataset, own: np.ndarray, other: np.ndarray, functions: Sequence[Family],
    options: FitOptions = USUAL,
) -> Half:  # fmt: skip
    """Fit some rows and predict others."""
    scene = with_roles(dataset, own, other, "validate")
    fitted = calibrated(scene, modelled(scene), options)
    found, left = stated(fitted, functions), unexplained(fitted)
    plain = share_inside(fitted, left.excess)
    wide = share_inside(found.wide, found.remaining(left).excess, found.white)
    return Half(fitted, found, (plain, wide))


def modelled(scene: Scene) -> tuple[str, ...]:
    """The baseline, as far as a session has what it needs."""
    circumstances = scene.circumstances(scene.rows("calibrate"))
    return tuple(e for e in BASELINE if not MODELS[e].missing(circumstances))


def share_inside(e: Estimate, excess: float, white: float = 1.0) -> float:
    """Share of the validation residuals within the 95 % intervals of an estimate's normal posterior."""
    rng = np.random.default_rng(0)
    z = e.z + rng.standard_normal((DRAWS, len(e.z))) @ root(e.covariance).T
    scales = np.array([e.weights.scale[group] for group in noise_groups(e.model)])
    kappa = np.tile(scales * np.sqrt(white), (DRAWS, 1))
    checked = validate(e, z, kappa, excess)
    held = [inside95(p.residuals, p.predicted).ravel() for p in (*checked.planes, *checked.points)]
    return float(np.mean(np.concatenate(held)))


def chi2_per_dof(a: Half, b: Half, shared: bool) -> tuple[float, float]:
    """Of the difference of the arm's parameters, by the plain and the stated covariances.

    `shared`: the halves have the same discrepancy, so that only the difference of its effects counts, as it
    always does of errors of the masses.
    """
    k = len(a.plain.model.parameters)
    one, other = (h.plain.covariance[:k, :k] for h in (a, b))
    directions, spread = known_directions(one, other), difference_covariance(one, other)
    along = directions.T @ (b.plain.z[:k] - a.plain.z[:k])
    extra = shared_masses((a.stated, b.stated), [np.arange(k), np.arange(k)])
    for h in (a, b):
        bias = sum(
            size * h.stated.slopes[name][:k] @ h.stated.slopes[name][:k].T
            for name, size in h.stated.variances.items()
        )
        extra += (h.stated.covariance - h.plain.covariance)[:k, :k] - (bias if shared else 0.0)
    if shared:
        for name, by in a.stated.slopes.items():
            apart = by[:k] - b.stated.slopes[name][:k]
            size = 0.5 * (a.stated.variances[name] + b.stated.variances[name])
            extra += size * apart @ apart.T

    def square(covariance: np.ndarray) -> float:
        return float(along @ np.linalg.solve(directions.T @ covariance @ directions, along)) / len(along)

    return square(spread), square(spread + extra)


def figures(dataset: Dataset) -> list[Figures]:
    """All splits of a session."""
    scene, out = Scene(dataset), []
    functions, effects = families(scene.circumstances(scene.rows("calibrate"))), modelled(scene)
    # parameters of halves are comparable if they have the same prior widths: those of the whole
    options = with_widths(calibrated(scene, effects), scene, effects, USUAL)[1]
    for split in splits(dataset):
        one, other = split.halves
        a, b = (half(dataset, *rows, functions, options) for rows in ((one, other), (other, one)))
        inside = (0.5 * (a.inside[0] + b.inside[0]), 0.5 * (a.inside[1] + b.inside[1]))
        out.append(Figures(split.kind, chi2_per_dof(a, b, split.kind == "random"), inside))
    return out


def made(folder: Path) -> Record:
    """The record of a session."""
    return {"session": folder.name, "splits": [asdict(f) for f in figures(read_dataset(folder))]}


def found_in(real: Path, runs: Path = RUNS, workers: int = 1, sessions: Sequence[str] = ()) -> list[Record]:
    """Records of the sessions of a folder (default: all); those of `runs` are kept."""
    folders = {folder.name: folder for folder in real_folders(real, sessions)}
    return completed(runs / "records.json", folders, made, workers, "sessions")


def table(records: Sequence[Record]) -> str:
    """The page's table, as Markdown."""
    chi2, inside = ("chi2 / dof, plain", "stated (least to largest)"), ("within 95 %, plain", "stated")
    return markdown(("session", "halves", *chi2, *inside), (row(r, kind) for r in records for kind in KINDS))


def row(r: Record, kind: str) -> list[str]:
    """The cells of a line of the table."""
    own = [f for f in r["splits"] if f["kind"] == kind]
    plain, wide = (np.array([f["chi2"][k] for f in own]) for k in (0, 1))
    inside = [f"{100 * np.mean([f['inside'][k] for f in own]):.0f} %" for k in (0, 1)]
    stated = f"{np.mean(wide):.2f} ({np.min(wide):.2f} to {np.max(wide):.2f})"
    return [r["session"], kind, f"{np.mean(plain):.2f}", stated, *inside]


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the records that are missing, and write the table of all."""
    given = real_arguments("real_halves", __doc__).parse_args(arguments)
    published(
        table(found_in(given.real, given.runs, given.workers, given.sessions)), given.out, MARKS, new=True
    )


if __name__ == "__main__":  # worker processes import this module too
    main()
