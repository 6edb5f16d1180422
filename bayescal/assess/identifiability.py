"""Identifiability: which parameters and combinations the contacts determine, and which they do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.effects import UNITS, Parameter
from bayescal.effects.vocabulary import unit_label
from bayescal.estimate import Estimate

DETERMINED = 0.9  # contraction from which on the data count as having decided
PRIOR_ONLY = 0.1
WEAK = 1.0  # singular value below which a direction stays wider than 71 % of its prior
FORM = "plane-form"
SHOWN = 0.25  # loadings smaller than this are not named
LEAK = 0.1  # share of a combination that may be in weak directions for it to count as identifiable


@dataclass(frozen=True)
class Direction:
    """A combination of arm parameters that is not identifiable or weakly identifiable."""

    singular_value: float
    loadings: tuple[tuple[str, float], ...]  # largest first, in units of prior sds
    words: str
    vector: np.ndarray  # (P,) unit vector, of the parameters of `Identifiability.index`


@dataclass(frozen=True)
class Identifiability:
    """Of the arm's parameters, targets eliminated."""

    singular_values: np.ndarray  # (P,) of the whitened Jacobian, largest first
    weak: tuple[Direction, ...]
    determined: tuple[str, ...]
    partly: tuple[str, ...]
    prior_only: tuple[str, ...]
    index: np.ndarray  # (P,) of the arm's parameters in the model
    information: np.ndarray  # (P, P) of the rows, by z, without the prior
    parameters: tuple[Parameter, ...]  # (P,) of the index

    def direction(self, v: np.ndarray) -> Direction:
        """A unit vector (P,) among the weak directions, with its words."""
        return _direction(self.parameters, v, self.information, np.array([d.vector for d in self.weak]).T)


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
    parameters = [model.parameters[k] for k in arm]
    names = [p.name for p in parameters]
    weak = vectors[:, singular < WEAK]
    found = [_direction(parameters, v, information, weak) for v in simplified(weak).T] if weak.size else []
    contraction = 1.0 - np.diag(fitted.covariance)[arm]
    found.sort(key=lambda d: d.singular_value)
    return Identifiability(
        singular[::-1],
        tuple(found),
        tuple(n for n, c in zip(names, contraction, strict=True) if c >= DETERMINED),
        tuple(n for n, c in zip(names, contraction, strict=True) if PRIOR_ONLY <= c < DETERMINED),
        tuple(n for n, c in zip(names, contraction, strict=True) if c < PRIOR_ONLY),
        arm,
        information,
        tuple(parameters),
    )


def _direction(
    parameters: Sequence[Parameter], v: np.ndarray, information: np.ndarray, weak: np.ndarray
) -> Direction:
    """A direction (P,) among weak ones (P, K), with its words."""
    size = float(np.sqrt(max(v @ information @ v, 0.0)))
    order = np.argsort(-np.abs(v))
    v = v * np.sign(v[order[0]])
    loadings = tuple((parameters[k].name, float(v[k])) for k in order if abs(v[k]) > SHOWN)
    return Direction(size, loadings, _words(parameters, v, size, weak), v)


def _words(parameters: Sequence[Parameter], v: np.ndarray, size: float, weak: np.ndarray) -> str:
    """A weak direction as what the data leave open, in the units of files.

    Parameters
    ----------
    parameters : sequence of Parameter, (P,)
    v : np.ndarray, shape (P,)
        The direction, a unit vector, normalised by the prior standard deviations.
    size : float
        Its singular value.
    weak : np.ndarray, shape (P, K)
        Basis of all weak directions: what it holds is not identifiable in any other combination either.
    """
    state = "not" if size**2 / (1.0 + size**2) < PRIOR_ONLY else "weakly"
    shown = [int(k) for k in np.argsort(-np.abs(v)) if abs(v[k]) > SHOWN]
    units = [UNITS[p.unit] for p in parameters]
    if len(shown) == 1:
        return f"{parameters[shown[0]].name} is {state} identifiable"
    if len(shown) == 2:
        i, j = sorted(shown, key=lambda k: parameters[k].name)
        across = np.zeros(len(v))
        across[[i, j]] = np.array([v[j], -v[i]]) / np.hypot(v[i], v[j])
        if np.sum((weak.T @ across) ** 2) < LEAK:
            sd = [parameters[k].sd * units[k][1] for k in (i, j)]
            kept = _combination(parameters[i].name, parameters[j].name, -v[i] * sd[0] / (v[j] * sd[1]))
            if units[i][0] != units[j][0]:
                kept = kept.replace("*", f" {unit_label(units[i][0])}/{unit_label(units[j][0])} ")
            kept = kept.replace("*", " ")
            if state == "not":
                return f"only the combination {kept} is identifiable"
            both = f"{parameters[i].name} and {parameters[j].name}"
            return f"the combination {kept} is identifiable, {both} singly weakly"
    changes = [
        f"{parameters[k].name} by {v[k] * parameters[k].sd * units[k][1]:+.2g} {unit_label(units[k][0])}"
        for k in shown
    ]
    return f"a common change of {', '.join(changes[:-1])} and {changes[-1]} is {state} identifiable"


def _combination(first: str, second: str, factor: float) -> str:
    """``first + factor*second``; a factor that rounds to 1 is left out."""
    size = f"{abs(factor):.2g}"
    return f"{first} {'+' if factor > 0 else '-'} {'' if size == '1' else size + '*'}{second}"


def simplified(basis: np.ndarray, rounds: int = 60) -> np.ndarray:
    """Rotate an orthonormal basis (P, k) so that each vector loads on few parameters (Kaiser 1958)."""
    turn = np.eye(basis.shape[1])
    for _ in range(rounds):
        loading = basis @ turn
        square = loading**2
        u, _, vt = np.linalg.svd(basis.T @ (loading * (square - square.mean(axis=0))))
        turn = u @ vt
    return basis @ turn
