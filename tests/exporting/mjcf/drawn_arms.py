"""Arms with drawn parameters, made once, and how far their files in MuJoCo are from the model."""

from functools import cache

import numpy as np

from analysis import simulators
from bayescal.verifying.simulator import File, Machine, modelled

drawn = cache(simulators.drawn)


def off(arm, poses, file=None):
    """Distances (C,), m, at poses of the session: of a new file, or of one that is given."""
    rows = np.unique(np.linspace(0, len(arm.dataset.measurements.ids) - 1, poses).astype(int))
    state = int(rows[-1])
    reached, points = Machine.of(arm, state, file or File.new(arm, state)).replayed(rows)
    return np.linalg.norm(points - modelled(arm, rows, reached, state), axis=1)
