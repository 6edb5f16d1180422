"""Identifiability: what these contacts determine, and what only the priors hold, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.estimate import Estimate

DETERMINED = 0.9  # contraction from which on the data count as having decided
PRIOR_ONLY = 0.1
WEAK = 1.0  # singular value below which a direction stays wider than 71 % of its prior
FORM = "plane-form"
SHOWN = 0.25  # loadings smaller than this are not named


@dataclass(frozen=True)
class Direction:
    """A combination of arm parameters that the data leave to the prior."""

    singular_value: float
    loadings: tuple[tuple[str, float], ...]  # largest first, in units of prior sds
    words: str


@dataclass(frozen=True)
class Identifiability:
    """Of the arm's parameters, targets eliminated."""

    singular_values: np.ndarray  # (P,) of the whitened Jacobian, largest first
    weak: tuple[Direction, ...]
    determined: tuple[str, ...]
    partly: tuple[str, ...]
    prior_only: tuple[str, ...]


def identifiability(fitted: Estimate) -> Identifiability:
    """Singular values of the whitened Jacobian of the arm, its targets projected out.

    A direction of singular value s has 1 / (1 + s^2) of its prior variance left.
    """
    model = fitted.model
    # the form of a face is not the arm's: it is projected out with the targets
    arm = np.array([k for k, p in enumerate(model.parameters) if p.effect != FORM], int)
    j = fitted.linear.jacobian
    own, other = j[:, arm], np.delete(j, arm, axis=1)
    shared = other.T @ own
    prior = other.T @ other + np.eye(other.shape[1])
    information = own.T @ own - shared.T @ np.linalg.solve(prior, shared)
    eigenvalues, vectors = np.linalg.eigh(information)
    singular = np.sqrt(np.maximum(eigenvalues, 0.0))
    names = [model.parameters[k].name for k in arm]
    weak = singular < WEAK
    directions = _varimax(vectors[:, weak]) if np.any(weak) else np.zeros((len(names), 0))
    found = []
    for v in directions.T:
        size = float(np.sqrt(max(v @ information @ v, 0.0)))
        order = np.argsort(-np.abs(v))
        v = v * np.sign(v[order[0]])
        loadings = tuple((names[k], float(v[k])) for k in order if abs(v[k]) > SHOWN)
        found.append(Direction(size, loadings, _words(loadings)))
    contraction = 1.0 - np.diag(fitted.covariance)[arm]
    found.sort(key=lambda d: d.singular_value)
    return Identifiability(
        singular[::-1],
        tuple(found),
        tuple(n for n, c in zip(names, contraction, strict=True) if c >= DETERMINED),
        tuple(n for n, c in zip(names, contraction, strict=True) if PRIOR_ONLY <= c < DETERMINED),
        tuple(n for n, c in zip(names, contraction, strict=True) if c < PRIOR_ONLY),
    )


def _words(loadings: tuple[tuple[str, float], ...]) -> str:
    """What cannot be told: the weak direction is free, what is orthogonal to it is determined."""
    if len(loadings) == 1:
        return f"{loadings[0][0]} is not identifiable from these contacts"
    if len(loadings) == 2 and abs(abs(loadings[0][1]) - abs(loadings[1][1])) < 0.1:
        first, second = sorted(name for name, _ in loadings)
        kept = "sum" if loadings[0][1] * loadings[1][1] < 0 else "difference"
        return f"{first} and {second} only as their {kept}"
    parts = [f"{'+' if value > 0 else '-'} {abs(value):.2f} {name}" for name, value in loadings]
    return f"the combination {' '.join(parts).removeprefix('+ ')} (in prior sds) is not identifiable"


def _varimax(basis: np.ndarray, rounds: int = 60) -> np.ndarray:
    """Rotate an orthonormal basis (P, k) so that each vector loads on few parameters (Kaiser 1958)."""
    turn = np.eye(basis.shape[1])
    for _ in range(rounds):
        loading = basis @ turn
        square = loading**2
        u, _, vt = np.linalg.svd(basis.T @ (loading * (square - square.mean(axis=0))))
        turn = u @ vt
    return basis @ turn
