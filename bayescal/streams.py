"""Seeds of independent streams of random numbers, from the seed of a run."""

from __future__ import annotations

import numpy as np


def spawned(seed: int, count: int) -> tuple[int, ...]:
    """Seeds for `count` independent generators; the same seed gives the same result.

    Two generators with the same seed give the same numbers: draws of the posterior and of the noise added
    to them would be correlated (`numpy.random.SeedSequence.spawn`).
    """
    children = np.random.SeedSequence(seed).spawn(count)
    return tuple(int(child.generate_state(1, np.uint64)[0]) for child in children)
