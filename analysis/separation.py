"""`python -m analysis.separation`: what contacts chosen for the gap show, beside random ones.

All is linear at the nominal LR Mate on its cube, with the stated noise: the answer of a diagnosis is the
explanation with the larger evidence, averaged over prior scales as in `bayescal gap`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayescal.gap.linear.evidence import SCALE_PRIOR, SCALES, log_sum
from bayescal.gap.result import Pair, Suspect
from bayescal.model.options import parts_of
from bayescal.planning.candidates import COUNT, candidates
from bayescal.planning.contrasts import Contrasts, contrasts
from bayescal.planning.pool import Pool
from bayescal.planning.projection import Projection, nominal
from bayescal.planning.separate import choose, detectable
from bayescal.planning.setup import read_setup

SETUP = Path(__file__).parents[1] / "data" / "lrmate200ic-cube"
MODEL = ("geometry", "compliance")
FIRST, FURTHER, WHOLE = 200, 40, 200
"""Contacts of a first session, further ones, and of a session that is planned as a whole."""
RIGHT = 0.75
"""Share of correct answers after the first session, which sets the amplitudes of the effects."""
DRAWS = 4000


def right(
    information: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    scale: float,
    rng: np.random.Generator,
    fixed: bool = False,
) -> float:
    """Share of correct answers where the columns a or b are true, with equal probability.

    Parameters
    ----------
    information : np.ndarray, shape (K, K)
        G of `Projection`: the projected scores of columns with amplitudes x are G x + noise ~ N(0, G).
    a, b : np.ndarray of int
        Columns of both explanations.
    scale : float
        Standard deviation of the true amplitudes, in units of their priors.
    fixed : bool
        All amplitudes have this size, with random signs; else they are normally distributed, so that some are
        too small for any measurement.
    """
    shares = []
    for true, other in ((a, b), (b, a)):
        at = np.concatenate([true, other])
        g = information[np.ix_(at, at)]
        root = np.linalg.cholesky(g + 1e-9 * np.trace(g) * np.eye(len(at)))
        x = scale * rng.standard_normal((DRAWS, len(true)))
        x = scale * np.sign(x) if fixed else x
        score = x @ g[: len(true)] + rng.standard_normal((DRAWS, len(at))) @ root.T
        own, rival = (
            evidence(score[:, k], g[np.ix_(k, k)]) for k in np.split(np.arange(len(at)), [len(true)])
        )
        shares.append(np.mean(own > rival))
    return float(np.mean(shares))


def evidence(score: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Log Bayes factors (draws,) of columns over noise only, averaged over their prior scales."""
    each = []
    for scale, weight in zip(SCALES, SCALE_PRIOR, strict=True):
        total = np.eye(len(information)) / scale**2 + information
        volume = np.linalg.slogdet(total * scale**2)[1]
        each.append(weight + 0.5 * (np.einsum("ni,ij,nj->n", score, np.linalg.inv(total), score) - volume))
    return log_sum(np.array(each), axis=0)


def separated(pool: Pool, joint: int, rng: np.random.Generator, fixed: bool) -> dict[str, float]:
    """Shares of correct answers for the compliance of a joint against bending of its link; see `right`."""
    words = f"compliance at joint {joint}"
    parts = parts_of((words,), MODEL)
    pair = Pair((Suspect(words),), (Suspect(f"bending at link {joint}"),))
    c = contrasts(pool, nominal(pool.session, MODEL, parts), [pair], parts)
    a, b = (c.vocabulary.side(side)[0] for side in (pair.a, pair.b))
    bare = unloaded(pool)
    first = rng.choice(bare, FIRST, replace=False)

    def share(contacts: Sequence[int] | np.ndarray, scale: float) -> float:
        information = Projection(c.columns, np.concatenate([first, contacts]).astype(int)).information
        return right(information, a, b, scale, np.random.default_rng(0), fixed)

    low, high = 1e-4, 10.0
    for _ in range(20):
        scale = float(np.sqrt(low * high))
        low, high = (scale, high) if share([], scale) < RIGHT else (low, scale)
    every = np.setdiff1d(np.arange(c.columns.count), first)
    return {
        "amplitude": scale,
        "first": share([], scale),
        "chosen": share(choose(c, FURTHER, rng, first), scale),
        "random": share(rng.choice(np.setdiff1d(bare, first), FURTHER, replace=False), scale),
        "random, with payload": share(rng.choice(every, FURTHER, replace=False), scale),
    }


def amplitudes(pool: Pool, rng: np.random.Generator) -> dict[str, float]:
    """Smallest detectable amplitudes of a plan, in units of those of random selections.

    The geometric mean over effects, of the geometric mean over the sites of each; effects that no contact
    shows (the radius of the ball, by faces alone) are left out.
    """
    c = contrasts(pool, nominal(pool.session, MODEL))
    chosen = Projection(c.columns, choose(c, WHOLE, rng))
    out = {}
    for name, among in {"random": unloaded(pool), "random, with payload": np.arange(c.columns.count)}.items():
        selections = [Projection(c.columns, rng.choice(among, WHOLE, replace=False)) for _ in range(5)]
        out[name] = _ratio(c, chosen, selections)
    return out


def _ratio(c: Contrasts, chosen: Projection, random: Sequence[Projection]) -> float:
    effects: dict[str, list[float]] = {}
    for d in detectable(c.vocabulary, chosen, random):
        if np.isfinite(d.smallest) and d.smallest < 20.0 * d.plausible:
            effects.setdefault(d.effect, []).append(np.log(d.smallest / d.smallest_random))
    return float(np.exp(np.mean([np.mean(own) for own in effects.values()])))


def unloaded(pool: Pool) -> np.ndarray:
    """Candidates without additional payload."""
    load = pool.session.measurements.payload
    return np.arange(len(pool.candidates)) if load is None else np.flatnonzero(load[pool.candidates] == 0)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--candidates", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    pool = candidates(replace(read_setup(SETUP), payloads=(2.0,)), asked.candidates, asked.seed)
    for joint in (2, 3):
        for fixed, words in ((True, "of one size"), (False, "normally distributed")):
            found = separated(pool, joint, np.random.default_rng(asked.seed), fixed)
            print(f"compliance of J{joint} against bending, amplitudes {words}, correct answers:")
            print("\n".join(f"  {name:<22}{value:.3f}" for name, value in found.items()))
    print(f"smallest detectable amplitude of {WHOLE} chosen contacts, relative to {WHOLE} others:")
    for name, value in amplitudes(pool, np.random.default_rng(asked.seed)).items():
        print(f"  {name:<22}{value:.3f}")


if __name__ == "__main__":
    main()
