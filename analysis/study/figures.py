"""The figures of the study: z-scores, coverage with bands, errors of the model levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.stats import binom, chi2, ks_1samp, norm

from analysis.study.session import LEVELS, Record

SCHEMA = "bayescal-study/1"
COVERAGE = 0.95
RESAMPLED = 4000  # bootstrap samples of sessions
PUBLISHED_MM = {"nominal": 1.321, "geometry + compliance": 0.274}
"""Largest distance error of the real arm, mm (Joubair and Bonev, Precision Engineering, 2015)."""
COVERED = {
    "parameters": "pit",
    "sphere distances": "distance_pit",
    "sphere diameters": "diameter_pit",
    "validation contacts": "contact_pit",
}


def of(records: Sequence[Record]) -> dict[str, Any]:
    """All figures of the sessions that could be simulated."""
    done = [r for r in records if "refused" not in r]
    return {
        "schema": SCHEMA,
        "sessions": len(done),
        "refused": [r["seed"] for r in records if "refused" in r],
        "contacts": int(np.median([r["contacts"] for r in done])),
        "identified": identified(done),
        "z_scores": z_scores(done),
        "coverage": {name: coverage([r[key] for r in done]) for name, key in COVERED.items()},
        "predicted_sd_um": {
            "distance": spread(np.concatenate([r["distance_sd_um"] for r in done])),
            "diameter": spread(np.concatenate([r["diameter_sd_um"] for r in done])),
        },
        "maximum_distance_mm": {level: spread(1e-3 * maximum(done, level)) for level in LEVELS},
        "published_maximum_distance_mm": PUBLISHED_MM,
        "noise_scale": spread(np.array([r["noise_scale"] for r in done])),
        "rejected_of_fitted": {level: sum(r["rejected"][level] for r in done) for level in LEVELS},
        "false_alarms": {
            "uneven_face": sum(r["uneven_faces"] > 0 for r in done),
            "unexplained_error": sum(r["unexplained_um"] > 0 for r in done),
        },
        "emcee": [r["emcee"] for r in done if "emcee" in r],
    }


def maximum(done: Sequence[Record], level: str) -> np.ndarray:
    """Largest absolute distance error of each session, µm."""
    return np.array([np.max(np.abs(r["distance_error_um"][level])) for r in done])


def spread(values: np.ndarray) -> dict[str, float]:
    """Median and range."""
    return {"median": float(np.median(values)), "least": float(np.min(values)), "most": float(np.max(values))}


def identified(done: Sequence[Record]) -> dict[str, float]:
    """Least contraction (1 - posterior variance / prior variance) over sessions, by quantity."""
    least = np.min([r["contraction"] for r in done], axis=0)
    return dict(zip(done[0]["names"], least.tolist(), strict=True))


def z_scores(done: Sequence[Record]) -> dict[str, Any]:
    """Estimate minus truth over the stated standard deviation, pooled and by quantity.

    The z-scores of one session are correlated, as its parameters are. So the bands of the pooled mean
    and standard deviation are bootstrapped over sessions, and the Kolmogorov-Smirnov test of the pool
    is of the scores made independent by the covariance's Cholesky factor.
    """
    z = np.array([r["z"] for r in done])
    free = np.array([r["independent_z"] for r in done])
    test = ks_1samp(free.ravel(), norm.cdf)
    each = {}
    for name, own in zip(done[0]["names"], z.T, strict=True):
        p = float(ks_1samp(own, norm.cdf).pvalue)
        each[name] = {"mean": float(own.mean()), "sd": float(own.std(ddof=1)), "ks_p_value": p}
    low, high = np.sqrt(chi2.ppf([0.025, 0.975], len(z) - 1) / (len(z) - 1)) if len(z) > 1 else (0.0, np.inf)
    return {
        "count": z.size,
        "mean": float(z.mean()),
        "mean_band95": band(z, np.mean),
        "sd": float(z.std()),
        "sd_band95": band(z, np.std),
        "independent": {
            "sd": float(free.std()),
            "ks_statistic": float(test.statistic),
            "ks_p_value": float(test.pvalue),
        },
        "by_quantity": each,
        "expected_sd_of_one95": [float(low), float(high)],
        "least_ks_p_value_times_quantities": min(
            1.0, len(each) * min(q["ks_p_value"] for q in each.values())
        ),
    }


def coverage(places: Sequence[Sequence[float]], level: float = COVERAGE) -> dict[str, Any]:
    """How often central intervals hold the truth, by sessions' shares of predictive draws below it.

    The binomial band is where the fraction would lie for as many independent trials; those of one
    session are not, so `band95`, about the fraction found, is bootstrapped over sessions.
    """
    hit = inside(places, level)
    count = hit.size
    low, high = binom.ppf([0.025, 0.975], count, level) / count
    return {
        "level": level,
        "count": count,
        "inside": float(hit.mean()),
        "band95": band(hit, np.mean),
        "binomial95_if_independent": [float(low), float(high)],
    }


def inside(places: Sequence[Sequence[float]], level: float) -> np.ndarray:
    """Which truths lie in the central interval of a level, (sessions, trials)."""
    return np.abs(np.array(places) - 0.5) <= level / 2


def band(values: np.ndarray, statistic: Callable[..., Any], seed: int = 0) -> list[float]:
    """95 % bootstrap interval of a statistic of values (sessions, ...), whole sessions resampled."""
    rng = np.random.default_rng(seed)
    some = [statistic(values[rng.integers(len(values), size=len(values))]) for _ in range(RESAMPLED)]
    return [float(v) for v in np.quantile(some, [0.025, 0.975])]
