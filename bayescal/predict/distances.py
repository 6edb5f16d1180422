"""Errors of certified distances between located targets, and their predicted uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.dataset import Certificate
from bayescal.model.scene import Scene
from bayescal.predict.targets import LocatedTarget


@dataclass(frozen=True)
class CentreDistances:
    """D distances between located centres, m; `by_...` are factors of covariances."""

    names: tuple[tuple[str, str], ...]
    error: np.ndarray  # (D,) measured by the arm minus certified
    by_parameters: np.ndarray  # (D, F) by standard normals: posterior of the arm, priors of the targets
    by_noise: np.ndarray  # (D, M) by standard normals: noise of the rows that located the targets
    u: np.ndarray  # (D,) of the certificates
    along: np.ndarray  # (D, 3) unit vectors in F0, from the second centre to the first

    @property
    def by_centres(self) -> np.ndarray:
        """Slopes (D, 3 N) of the distances by errors of the N centres, three coordinates for each centre."""
        ends = [name for pair in self.names for name in pair]
        centres = list(dict.fromkeys(ends))
        out = np.zeros((len(self.names), len(centres), 3))
        for d, (first, second) in enumerate(self.names):
            out[d, centres.index(first)] += self.along[d]
            out[d, centres.index(second)] -= self.along[d]
        return out.reshape(len(self.names), 3 * len(centres))

    def predicted_sd(self, noise: float = 1.0) -> np.ndarray:
        """Predicted standard deviations (D,), m, with the noise of the fit multiplied by a factor."""
        square = np.sum(self.by_parameters**2, axis=1) + noise**2 * np.sum(self.by_noise**2, axis=1)
        return np.sqrt(square + self.u**2)


def certified_pairs(
    scene: Scene, located: Mapping[str, LocatedTarget]
) -> Iterator[tuple[Certificate, LocatedTarget, LocatedTarget]]:
    """Certificates of a distance between two located targets that have a centre, with both targets."""
    centres = {k: t for k, t in located.items() if scene.declared_of(k).centred}
    for c in scene.dataset.certificates:
        if c.kind == "distance" and all(name in centres for name in c.targets):
            a, b = (centres[name] for name in c.targets)
            yield c, a, b


def centre_distances(scene: Scene, located: Mapping[str, LocatedTarget], arm: np.ndarray) -> CentreDistances:
    """Errors of certified distances; `arm` (P, F): rows of the arm in a factor of the covariance."""
    pairs = list(certified_pairs(scene, located))
    used = list({id(t): t for _, *ends in pairs for t in ends}.values())
    rows = np.cumsum([0, *(len(t.noise) for t in used)])
    unknowns = np.cumsum([0, *(len(t.by_prior) for t in used)]) + arm.shape[1]
    number = {id(t): k for k, t in enumerate(used)}
    by_parameters = np.zeros((len(pairs), unknowns[-1] if used else arm.shape[1]))
    by_noise = np.zeros((len(pairs), rows[-1]))
    names, error, u, directions = [], [], [], [np.zeros((0, 3))]
    for i, (c, a, b) in enumerate(pairs):
        apart = a.centre - b.centre
        length = float(np.linalg.norm(apart))
        names.append((c.targets[0], c.targets[1]))
        error.append(length - (c.distance or 0.0))
        u.append(c.u_distance or 0.0)
        directions.append((apart / length)[None])
        for t, sign in ((a, 1.0), (b, -1.0)):
            k, by = number[id(t)], sign * (apart / length) @ t.to_state[:3]
            by_parameters[i, : arm.shape[1]] += by @ t.by_arm @ arm
            by_parameters[i, unknowns[k] : unknowns[k + 1]] = by @ t.by_prior
            by_noise[i, rows[k] : rows[k + 1]] = by @ t.by_noise
    along = np.concatenate(directions)
    return CentreDistances(tuple(names), np.array(error), by_parameters, by_noise, np.array(u), along)
