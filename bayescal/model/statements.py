"""Values that certificates state of two targets, one residual each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.dataset import Certificate
from factors.certificate import Relation, aligned, apart, between_faces, off_plane, square

STATED: dict[str, dict[Relation, tuple[tuple[str, str], ...]]] = {
    "parallel": {
        aligned: (("parallel 1", "rad"), ("parallel 2", "rad")),
        square: (("parallel", "rad"),),
        between_faces: (("distance", "m"),),
        off_plane: (("distance", "m"),),
        apart: (("distance", "m"),),
    },
    "perpendicular": {square: (("square", "rad"),), aligned: (("square 1", "rad"), ("square 2", "rad"))},
    "distance": {off_plane: (("distance", "m"),), apart: (("distance", "m"),)},
}
"""Values that a certificate of two targets states, one residual each, and their units, by relation."""


POINTS = "points"
"""Kind of the certificate of an artefact's coordinates, of which a fit uses those of the fitted targets."""


def u_of(entry: Certificate, stated: Sequence[tuple[str, str]]) -> np.ndarray:
    """Standard uncertainties, rad and m, of all values of a certificate."""
    return np.array([entry.u_angle if unit == "rad" else entry.u_distance for _, unit in stated], float)
