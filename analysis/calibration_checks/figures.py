"""Tests of places that should be uniform: by quantity, jointly, and as coverage of intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.stats import binom, chi2, ks_1samp, uniform

from analysis.calibration_checks.session import Record

LEVELS = (0.5, 0.8, 0.95)
SIMULATED = 20_000
"""Uniform samples from which the distribution of the largest deviation is taken."""
LEAST_EXPECTED = 8
"""Places that each bin of a chi-square test should have."""
BINS = 5
"""Bins of the histogram of validation contacts."""
RESAMPLED = 2000
"""Bootstrap samples of sessions."""

Places = Sequence[Sequence[float]]
"""Of each session."""


def deviation(places: np.ndarray) -> np.ndarray:
    """Least pointwise probability of an empirical distribution function, (...), of places (..., N).

    At N points the number of places below is compared with its binomial distribution; the least two-sided
    tail probability is the statistic whose level gives simultaneous bands (Säilynoja, Bürkner, Vehtari 2022,
    Stat. Comput. 32, 32).
    """
    count = places.shape[-1]
    at = np.arange(1, count) / count
    below = np.sum(places[..., None, :] <= at[:, None], axis=-1)
    lower, upper = _tails(count)
    k = np.arange(count - 1)
    return np.min(np.minimum(1.0, 2.0 * np.minimum(lower[k, below], upper[k, below])), axis=-1)


@lru_cache(maxsize=32)
def _tails(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities of at most and of at least so many places below each point, (N - 1, N + 1)."""
    at, number = np.arange(1, count)[:, None] / count, np.arange(count + 1)
    return binom.cdf(number, count, at), binom.sf(number - 1, count, at)


@lru_cache(maxsize=32)
def _deviations(count: int) -> np.ndarray:
    """Sorted statistics of uniform samples."""
    rng = np.random.default_rng(0)
    chunks = [deviation(rng.uniform(size=(500, count))) for _ in range(SIMULATED // 500)]
    return np.sort(np.concatenate(chunks))


def ecdf_p(places: np.ndarray) -> float:
    """Probability that uniform places (N,) deviate as much anywhere."""
    known = _deviations(len(places))
    return float((np.searchsorted(known, deviation(places), side="right") + 1) / (len(known) + 1))


def chi2_p(places: np.ndarray) -> float:
    """Probability of a histogram that is as uneven, of uniform places (N,)."""
    bins = max(len(places) // LEAST_EXPECTED, 2)
    counts = np.histogram(places, bins, (0.0, 1.0))[0]
    return float(chi2.sf(np.sum((counts - len(places) / bins) ** 2) * bins / len(places), bins - 1))


def holm(p: Iterable[float]) -> np.ndarray:
    """Probabilities corrected for their number (Holm 1979)."""
    p = np.asarray(list(p), float)
    order = np.argsort(p)
    out = np.empty(len(p))
    out[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)), 1.0)
    return out


def coverage(places: Places, level: float) -> dict[str, float]:
    """Share of central intervals of a level that contain the truth, and the range expected of it.

    Intervals of one session have errors in common. The range is that of the binomial law for as many
    independent intervals as give the variance that the sessions' shares have.
    """
    hits = [np.abs(np.asarray(p) - 0.5) <= level / 2 for p in places]
    share, total = np.array([np.mean(h) for h in hits]), sum(len(h) for h in hits)
    sessions = len(hits)
    variance = float(np.var(share, ddof=1)) / sessions if sessions > 1 else np.inf
    alone = level * (1.0 - level)
    independent = round(min(max(alone / max(variance, 1e-12), 1), total))
    low, high = binom.ppf((0.025, 0.975), independent, level) / independent
    return {
        "level": level,
        "covered": float(np.mean(np.concatenate(hits))),
        "low": float(low),
        "high": float(high),
        "count": total,
        "independent": independent,
    }


def tarp(records: Sequence[Record], draws: str) -> dict[str, Any]:
    """Expected coverage of regions about random points (Lemos et al. 2023, ICML, PMLR 202, 19256).

    The share of draws nearer to a random point than the truth is uniform if the joint posterior is right. The
    bands resample whole sessions; the test takes one point of each.
    """
    f = np.array([r["tarp"][draws] for r in records])
    rng = np.random.default_rng(0)
    pick = rng.integers(len(f), size=(RESAMPLED, len(f)))
    out = {}
    for level in LEVELS:
        below = np.mean(f <= level, axis=1)
        low, high = np.quantile(np.mean(below[pick], axis=1), (0.025, 0.975))
        out[str(level)] = [float(np.mean(below)), float(low), float(high)]
    return {"expected_coverage": out, "p_value": ecdf_p(f[:, 0])}


def quantities(records: Sequence[Record]) -> dict[str, np.ndarray]:
    """Places (N,) over the sessions, by quantity: parameters, noise scales, predicted distances."""
    shared = [n for n in records[0]["names"] if all(n in r["names"] for r in records)]
    out = {n: np.array([r["plain"][r["names"].index(n)] for r in records]) for n in shared}
    out |= {f"noise scale of {g}": np.array([r["noise"][g] for r in records]) for g in records[0]["noise"]}
    for key, word in (("distances", "certified distance"), ("workspace", "distance in the workspace")):
        own = np.array([r[key] for r in records])
        out |= {f"{word} {k + 1}": own[:, k] for k in range(own.shape[1])}
    return out


COVERED = {
    "parameters, posterior": lambda r: r["plain"],
    "parameters, stated": lambda r: r["stated"],
    "parameters, decorrelated": lambda r: uniform_of(r["independent"]),
    "noise scales": lambda r: list(r["noise"].values()),
    "certified distances": lambda r: r["distances"],
    "distances in the workspace, stated": lambda r: r["workspace_stated"],
    "validation contacts": lambda r: r["contacts"],
}
"""Places of a record by quantity."""


def uniform_of(scores: Sequence[float]) -> list[float]:
    """Standard normal scores as places."""
    from scipy.special import ndtr

    return ndtr(np.asarray(scores)).tolist()


def of(records: Sequence[Record]) -> dict[str, Any]:
    """All figures of the sessions of one design; empty without any."""
    done = [r for r in records if "refused" not in r]
    if not done:
        return {}
    places = quantities(done)
    p = {"ecdf": [ecdf_p(own) for own in places.values()], "chi2": [chi2_p(own) for own in places.values()]}
    by_quantity = {
        name: {"ecdf_p": e, "chi2_p": c} for name, e, c in zip(places, p["ecdf"], p["chi2"], strict=True)
    }
    least = list(places)[int(np.argmin(p["ecdf"]))]
    one = np.array([r["contacts"][r["seed"] % len(r["contacts"])] for r in done])
    every = np.concatenate([r["contacts"] for r in done])
    of_distances = np.array([r["workspace_sd_ratio"] for r in done if "workspace_sd_ratio" in r])
    ratio = np.array([r["sd_ratio"] for r in done if len(r["sd_ratio"]) == len(done[0]["sd_ratio"])])
    return {
        "sessions": len(done),
        "seeds": [min(r["seed"] for r in records), max(r["seed"] for r in records)],
        "refused": [r["seed"] for r in records if "refused" in r],
        "by_quantity": by_quantity,
        "least": least,
        "least_ecdf_p_holm": float(np.min(holm(p["ecdf"]))),
        "least_chi2_p_holm": float(np.min(holm(p["chi2"]))),
        "joint_p": {d: ecdf_p(np.array([r["ellipsoid"][d] for r in done])) for d in ("plain", "stated")},
        "tarp": {d: tarp(done, d) for d in ("plain", "stated")},
        "coverage": {
            name: [coverage([of_record(r) for r in done], level) for level in LEVELS]
            for name, of_record in COVERED.items()
        },
        "contacts": {
            "ks_p": float(ks_1samp(one, uniform.cdf).pvalue),
            "histogram": (np.histogram(every, BINS, (0.0, 1.0))[0] / len(every)).tolist(),
        },
        "stated_over_posterior_sd": [float(v) for v in np.quantile(ratio, (0.0, 0.5, 1.0))],
        "of_distances": [float(v) for v in np.quantile(of_distances, (0.5, 1.0))]
        if len(of_distances)
        else [],
        "with_discrepancy": sum(bool(r["families"]) for r in done),
        "with_unexplained_error": sum(r["excess_um"] > 0 for r in done),
        "contradicted": sum(not r["explains"] for r in done),
        "gross": [sum(r[k] for r in done) for k in ("gross", "gross_rejected", "good_rejected")],
    }
