"""Halves of a joint log, by motions: whether what `fit` says of each agrees within its u.

Every second motion of a log is one half, and has its own noise. The difference of both estimates is compared
with the covariance that their information and the common prior let expect, in all directions that both halves
determine. By chance chi-square over its degrees of freedom scatters by (2 / dof)^1/2: .23 of 39.

Run from the top of the project: ``python -m analysis.log_halves FOLDER... [--truth FOLDER/truth]``.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayescal.errors import BayescalError
from bayescal.logs import Log, read_log
from bayescal.logs.types import CALIBRATE
from bayescal.motion.calibrate import nominal_values
from bayescal.motion.estimate import estimate_of
from bayescal.motion.terms import nominal

DETERMINED = 3.0
"""Information of both halves over that of the prior, from which on a direction is compared."""


@dataclass(frozen=True)
class Half:
    """What one half says: estimates (K,), information of the data and of the prior, by the prior's sd."""

    names: tuple[str, ...]
    values: np.ndarray
    data: np.ndarray
    prior: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Of the estimates about the truth."""
        return np.linalg.inv(self.data + self.prior)


def fitted(log: Log, first: int) -> Half:
    """Fit every second motion of a log, from the `first` on."""
    motions = tuple(replace(m, role=CALIBRATE) for m in log.motions[first::2])
    estimate = estimate_of(replace(log, motions=motions))
    fit = estimate.fit()
    start = nominal_values(nominal(log, estimate.rms))
    terms = fit.normal.terms
    sd = np.array([t.sd for t in terms])
    values = np.array([fit.values[t.name] + start.get(t.name, 0.0) for t in terms])
    data = fit.normal.gram / np.outer(sd, sd)
    return Half(tuple(t.name for t in terms), values, data, np.diag(1.0 / sd**2))


def compared(one: Half, other: Half) -> tuple[float, int, dict[str, list[float]]]:
    """Chi-square of the difference, degrees of freedom, squares over variances by kinds of parameters."""
    scale = np.sqrt(1.0 / np.diag(one.prior))
    a, b = (h.data * np.outer(scale, scale) for h in (one, other))
    p, q = (h.prior * np.outer(scale, scale) for h in (one, other))
    c, d = np.linalg.inv(a + p), np.linalg.inv(b + q)
    shift = c @ a - d @ b
    covariance = shift @ shift.T + c @ a @ c + d @ b @ d
    difference = (one.values - other.values) / scale
    both = a @ np.linalg.solve(a + b + 1e-9 * np.eye(len(a)), b)
    size, vectors = np.linalg.eigh(0.5 * (both + both.T))
    v = vectors[:, size > DETERMINED]
    along = v.T @ difference
    chi2 = float(along @ np.linalg.solve(v.T @ covariance @ v, along))
    squares: dict[str, list[float]] = defaultdict(list)
    for k, name in enumerate(one.names):
        if c[k, k] < 0.25 and d[k, k] < 0.25:
            kind = name.partition(" of ")[0] if " of " in name else name.rstrip("0123456789 ")
            squares[kind].append(float(difference[k] ** 2 / covariance[k, k]))
    return chi2, v.shape[1], squares


def main() -> None:
    """Print chi-square over degrees of freedom of each log, and by kinds of parameters."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--truth", type=Path)
    asked = parser.parse_args()
    by_kind: dict[str, list[float]] = defaultdict(list)
    by_parameter: dict[str, list[float]] = defaultdict(list)
    for folder in asked.folders:
        kind, words = "", ""
        if asked.truth is not None:
            truth = json.loads((asked.truth / f"{folder.name}.json").read_text(encoding="utf-8"))
            kind, words = truth["kind"], " ".join([*truth["effects"], truth.get("outside") or ""])
        try:
            log = read_log(folder)
            chi2, dof, squares = compared(fitted(log, 0), fitted(log, 1))
        except BayescalError as error:
            print(f"{folder.name}: {error}")
            continue
        by_kind[kind].append(chi2 / dof)
        if kind in ("", "null"):
            for name, some in squares.items():
                by_parameter[name] += some
        print(f"{folder.name}  chi2/dof {chi2 / dof:5.2f} of {dof:2d}  {kind} {words}", flush=True)
    for kind, ratios in by_kind.items():
        text = f"mean {np.mean(ratios):.2f}, median {np.median(ratios):.2f}"
        print(f"{kind or 'all'}: {text}, {np.min(ratios):.2f} to {np.max(ratios):.2f}")
    for name, some in sorted(by_parameter.items()):
        print(f"  {name:14s} {np.mean(some):5.2f} of {len(some)}")


if __name__ == "__main__":
    main()
