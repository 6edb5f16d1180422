"""Agreement of sessions: estimates of the arm from each session alone, and their differences.

Two estimates of the same arm under the same prior are not independent: both are shrunk towards the prior
mean. Normalised by the prior standard deviations, with covariances C_A and C_B, and A = 1 - C_A, B = 1 - C_B,
the difference of the estimates has the covariance A + B - AB - BA over data and true values (Gaussian,
linear). This is C_A + C_B for identifiable directions, and zero for directions that are not identifiable.
What stated covariances have more than C_A and C_B (`estimate.discrepancy`) is added. Of errors of masses that
both sessions share, the difference of their effects on the estimates is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import MODELS
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate, calibrated
from bayescal.estimate.discrepancy import Stated, stated
from bayescal.model.options import USUAL, FitOptions
from bayescal.model.scene import Scene
from bayescal.statistics import chi2_sf

KNOWN = 1.0
"""Information, relative to the prior's, that both sessions need in a direction for a comparison."""
DISAGREE = 1e-3
"""Probability of the observed difference by chance, below which two sessions disagree."""


@dataclass(frozen=True)
class Pair:
    """Comparison of two sessions."""

    sessions: tuple[str, str]
    apart: np.ndarray  # (P,) differences (second minus first) in their standard deviations
    chi2: float
    directions: int  # in which both sessions say more than the prior: degrees of freedom of chi2
    p_value: float  # that estimates of one arm differ so much

    @property
    def disagree(self) -> bool:
        """Whether the difference is significant."""
        return self.p_value < DISAGREE


@dataclass(frozen=True)
class Agreement:
    """The arm's shared parameters, estimated from every session alone and from all together; SI."""

    names: tuple[str, ...]  # (P,)
    units: tuple[str, ...]
    together: tuple[np.ndarray, np.ndarray]  # (P,) values and standard deviations
    alone: Mapping[str, tuple[np.ndarray, np.ndarray]]  # the same by session
    pairs: tuple[Pair, ...]
    refused: Mapping[str, str]  # why a session cannot be fitted alone

    @property
    def furthest(self) -> np.ndarray:
        """Largest difference of any two sessions, (P,), in its standard deviations."""
        return np.max([np.abs(p.apart) for p in self.pairs], axis=0, initial=0.0) * np.ones(len(self.names))


def agreement(together: Estimate, effects: tuple[str, ...], options: FitOptions = USUAL) -> Agreement:
    """Fit each session of a joint estimate alone, and compare their estimates of the arm.

    Parameters
    ----------
    together : Estimate
        Of sessions joined (`dataset.join`).
    effects : tuple of str
        The model; a session is fitted without those for which it lacks what they need.
    options : FitOptions
        As of the joint estimate; no part of an effect is left out.
    """
    fits: dict[str, Stated] = {}
    options = replace(options, without=())
    refused: dict[str, str] = {}
    for session in together.model.scene.dataset.sessions:
        try:
            fit = calibrated(Scene(session), _possible(session, effects), options)
            fits[session.name] = stated(fit)
        except BayescalError as error:
            refused[session.name] = error.what
    plain = [together, *(fit.plain for fit in fits.values())]
    arms = [{p.name for p in fit.model.parameters} for fit in plain]
    shared = [p for p in together.model.parameters if all(p.name in arm for arm in arms)]
    names = tuple(p.name for p in shared)
    return Agreement(
        names,
        tuple(p.unit for p in shared),
        _said(stated(together), names),
        {name: _said(fit, names) for name, fit in fits.items()},
        tuple(pair(pick, (fits[pick[0]], fits[pick[1]]), names) for pick in combinations(fits, 2)),
        refused,
    )


def pair(sessions: tuple[str, str], fits: tuple[Stated, Stated], names: tuple[str, ...]) -> Pair:
    """Compare two estimates of the same parameters."""
    picks = [_index(fit.plain, names) for fit in fits]
    z = [fit.plain.z[k] for fit, k in zip(fits, picks, strict=True)]
    c = [fit.plain.covariance[np.ix_(k, k)] for fit, k in zip(fits, picks, strict=True)]
    wider = [fit.covariance[np.ix_(k, k)] - solved for fit, k, solved in zip(fits, picks, c, strict=True)]
    difference, spread = z[1] - z[0], difference_covariance(*c) + sum(wider) + shared_masses(fits, picks)
    # where a session says next to nothing, a difference is one of rounding
    directions = known_directions(*c)
    along = directions.T @ difference
    square = float(along @ np.linalg.solve(directions.T @ spread @ directions, along)) if len(along) else 0.0
    size = np.sqrt(np.maximum(np.diag(spread), np.finfo(float).eps))
    p = float(chi2_sf(square, len(along))) if len(along) else 1.0
    return Pair(sessions, difference / size, square, len(along), p)


def shared_masses(fits: tuple[Stated, Stated], picks: Sequence[np.ndarray]) -> np.ndarray:
    """Change (P, P) of the covariance of a difference of P parameters by errors of masses that both share.

    `picks` are the places of the parameters among the unknowns of each. Shared errors cancel as far as they
    change the parameters of both alike.
    """
    slopes = [fit.inputs.slopes[k] for fit, k in zip(fits, picks, strict=True)]
    if not _same_masses(*fits):
        return np.zeros((len(slopes[0]), len(slopes[0])))
    separate = [by @ fit.inputs.mixing for fit, by in zip(fits, slopes, strict=True)]
    common = (slopes[1] - slopes[0]) @ fits[0].inputs.together(fits[1].inputs).mixing
    out: np.ndarray = common @ common.T - sum(by @ by.T for by in separate)
    return out


def _same_masses(one: Stated, other: Stated) -> bool:
    """Whether the masses of two sessions, stated for the same links and tools, have the same errors."""

    def loads(fit: Stated) -> list[tuple[float, ...]]:
        tools = fit.plain.model.scene.dataset.tools
        return [(t.mass, *(t.centre if t.centre_of_mass is None else t.centre_of_mass)) for t in tools]

    return one.inputs.names == other.inputs.names and loads(one) == loads(other)


def difference_covariance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Covariance (P, P) of the difference of two estimates with covariances (P, P), whitened by the prior."""
    a, b = np.eye(len(one)) - one, np.eye(len(other)) - other
    return a + b - a @ b - b @ a


def known_directions(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Orthonormal directions (P, K) of which both of two estimates know more than the prior does.

    Eigenvectors of the information that they share, that of the worse of the two: I_A (I_A + I_B)^-1 I_B.
    """
    a, b = (np.linalg.inv(c) - np.eye(len(c)) for c in (one, other))
    common = a @ np.linalg.pinv(a + b, hermitian=True) @ b
    values, vectors = np.linalg.eigh(0.5 * (common + common.T))
    return vectors[:, values > KNOWN]


def _possible(session: Dataset, effects: tuple[str, ...]) -> tuple[str, ...]:
    """The effects for which a session has what they need."""
    circumstances = Scene(session).circumstances()
    return tuple(e for e in effects if not MODELS[plain(e)].missing(circumstances))


def _index(fitted: Estimate, names: tuple[str, ...]) -> np.ndarray:
    index = {p.name: k for k, p in enumerate(fitted.model.parameters)}
    return np.array([index[name] for name in names], int)


def _said(fit: Stated, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard deviations (P,) of parameters, SI."""
    index, model = _index(fit.plain, names), fit.plain.model
    return model.physical(fit.plain.z)[index], fit.sd[index] * model.sd[index]
