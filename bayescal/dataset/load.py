"""What is attached to the flange in each row: tool and payload."""

from __future__ import annotations

import numpy as np

from bayescal.dataset.types import Dataset


def load_mass(dataset: Dataset) -> np.ndarray:
    """Mass of the load on the flange, (N,), kg."""
    m = dataset.measurements
    mass = np.array([tool.mass for tool in dataset.tools], float)[m.tool]
    return mass if m.payload is None else mass + m.payload


def load_centre(dataset: Dataset) -> np.ndarray:
    """Centre of mass of the load in the flange frame, (N, 3), m; default: the ball's centre."""
    centres = [t.centre if t.centre_of_mass is None else t.centre_of_mass for t in dataset.tools]
    return np.array(centres)[dataset.measurements.tool]
