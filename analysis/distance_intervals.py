"""Coverage of the interval of the excess variance removed from distances that share spheres.

Run from the top of the project: ``python -m analysis.distance_intervals``. Spheres have an error of 20 µm per
coordinate; a second model keeps a share of each error and adds its own error. The interval should contain the
share of the excess variance that the second model removes in 95 of 100 cases. For comparison: the same
distances resampled as if they were independent.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.gap.outcome.magnitude import of_blocks, of_distances
from bayescal.predict.errors import CentreDistances

ERROR, NOISE = 20e-6, 2.5e-6
"""Standard deviations of a coordinate of a centre, m: what the first model leaves out, and the noise."""
LAYOUTS = ((1, 3), (1, 4), (1, 5), (1, 8), (4, 3), (5, 3))
"""Placements and spheres in each; distances are within a placement."""
MODELS = ((0.5, 0.0), (0.3, 0.5), (0.0, 0.3), (0.8, 0.2))
"""Share of an error that the second model keeps, and its own error over the first one's."""


def session(
    rng: np.random.Generator, placements: int, spheres: int, kept: float, own: float
) -> tuple[CentreDistances, CentreDistances]:
    """Distances of one simulated session by the two models."""
    first, second = np.triu_indices(spheres, 1)
    pairs = [(p * spheres + first, p * spheres + second) for p in range(placements)]
    first, second = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    count = placements * spheres
    place = rng.standard_normal((count, 3))
    along = place[first] - place[second]
    along /= np.linalg.norm(along, axis=1)[:, None]
    missing, other = ERROR * rng.standard_normal((2, count, 3))
    noise = NOISE * rng.standard_normal((count, 3))
    names = tuple((f"{a}", f"{b}") for a, b in zip(first, second, strict=True))
    none = np.zeros((len(names), 1))

    def distances(centre: np.ndarray) -> CentreDistances:
        error = np.sum(along * (centre[first] - centre[second]), axis=1)
        d = CentreDistances(names, error, none, none, none, along)
        return replace(d, by_noise=NOISE * d.by_centres)

    return distances(missing + noise), distances(kept * missing + own * other + noise)


def coverage(
    placements: int, spheres: int, kept: float, own: float, sessions: int, seed: int = 0
) -> tuple[float, float]:
    """Shares of sessions whose interval holds the truth: as it is, and as if distances were independent."""
    rng = np.random.default_rng(seed)
    truth, inside = 1.0 - kept**2 - own**2, []
    for _ in range(sessions):
        before, after = session(rng, placements, spheres, kept, own)
        floor = after.predicted_sd() ** 2
        squares = np.stack([before.error**2, after.error**2, floor, np.zeros(len(floor))])
        alone = np.arange(len(floor))
        ends = [
            of_distances(before, after, float("inf"), rng).removed_interval95,
            of_blocks(
                "distances", len(floor), squares, alone, (0.0, 0.0), float("inf"), rng
            ).removed_interval95,
        ]
        if np.all(np.isfinite(ends)):
            inside.append([low <= truth <= high for low, high in ends])
    ours, independent = np.mean(inside, axis=0)
    return float(ours), float(independent)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m analysis.distance_intervals", description=__doc__)
    parser.add_argument("--sessions", type=int, default=400, help="simulated sessions of each case")
    given = parser.parse_args(arguments)
    print("placements  spheres  kept  own   coverage  as if independent")
    for placements, spheres in LAYOUTS:
        for kept, own in MODELS:
            ours, independent = coverage(placements, spheres, kept, own, given.sessions)
            print(
                f"{placements:10d}{spheres:9d}{kept:6.1f}{own:5.1f}{ours:11.3f}{independent:19.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
