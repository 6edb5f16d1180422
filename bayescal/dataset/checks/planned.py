"""Contacts that were never made: readings at which the nominal arm touches the nominal target exactly.

A plan has such readings; no measured contact has, because arm, targets and noise are off by micrometres at
least. Some contacts come near by chance. If an error at nominal geometry has the scale s, about the median of
its target, then abs(r) < t has the probability sqrt(2 / pi) t / s, and the k smallest of N errors are all
below t with the binomial probability of k or more. Contacts are taken for planned ones where this is below
`CHANCE` 2^-k. Only errors far below the noise are counted, so that repeats of a contact count as independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from bayescal.dataset.checks.misfit import away
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Dataset

CHANCE = 1e-3
"""Chance that a session of measured contacts has any that is taken for a planned one."""
SHARE = 0.02
"""Of the stated noise, below which errors are counted."""
NOISE = 1e-6
"""m: of a session that states none (assumed)."""
SLOPE = float(np.sqrt(2 / np.pi))


@dataclass(frozen=True)
class Planned:
    """Contacts that have the readings of a plan: rows, the chance of so many, and their largest error, m."""

    rows: np.ndarray
    chance: float
    error: float

    def words(self, dataset: Dataset, most: int = 4) -> str:
        """In words, with the first ids."""
        ids = [dataset.measurements.ids[k] for k in self.rows[:most]]
        more = ", ..." if len(self.rows) > most else ""
        error = f"{1e9 * self.error:.1g} nm" if self.error > 1e-10 else "less than 0.1 nm"
        contacts = "1 contact has" if len(self.rows) == 1 else f"{len(self.rows)} contacts have"
        return (
            f"{contacts} the readings of a plan ({', '.join(ids)}{more}): the nominal arm touches the "
            f"nominal target within {error}; such a contact was not made"
        )


def planned(dataset: Dataset) -> Planned | None:
    """The contacts of a session that were never made, or None.

    Parameters
    ----------
    dataset : Dataset
    """
    m = dataset.measurements
    r = np.full(len(m.ids), np.nan)
    scale, noise = np.ones(len(r)), np.ones(len(r))
    errors = away(dataset, m.readings) if len(r) else r
    for k, target in enumerate(dataset.targets):
        rows, kind = np.flatnonzero(m.target == k), KINDS[target.kind]
        if not len(rows) or not kind.placed or kind.reads:
            continue
        noise[rows] = getattr(dataset.noise, kind.noise) or NOISE
        r[rows] = errors[rows]
        scale[rows] = np.maximum(np.median(r[rows]), noise[rows])
    rows = np.flatnonzero(np.isfinite(r))
    near = np.where(rows.size and r[rows] < SHARE * noise[rows], r[rows] / scale[rows], np.inf)
    order = np.argsort(near, kind="stable")
    order = order[: int(np.sum(np.isfinite(near)))]
    if not len(order):
        return None
    count = np.arange(1, len(order) + 1)
    chance = bdtrc(count - 1, len(rows), np.minimum(SLOPE * near[order], 1.0))
    weighed = chance * 2.0 ** np.minimum(count, 1000)
    if np.min(weighed) >= CHANCE:
        return None
    k = int(np.flatnonzero(weighed == np.min(weighed))[-1])
    own = np.sort(rows[order[: k + 1]])
    return Planned(own, float(chance[k]), float(np.max(r[own])))
