"""Amplitudes of a set of changes, and their covariance with what is not known beside it.

The set of most evidence and the variances of most evidence are single points, and a covariance at them is too
small. First order in each: the variance of one family of model errors has a grid of values, weighted by their
evidence; other sets that have the same change count by their probability; and the change of a spring is in
proportion to the torque, which the stated masses give.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.changes.joint import Joint
from bayescal.changes.linear import LEAST, PER_MOMENT, Evidence
from bayescal.changes.search import FREE, Member, Search, Weighed, selectors
from bayescal.effects import Parameter
from bayescal.effects.gravity import masses

VALUES = 9
"""Of the variance of a family, from none to that of its unit amplitudes, in equal ratios and equally probable
before the measurements (assumed)."""
COUNTED = 1e-4
"""Share of the probability of a change from which on a set that has it counts (convention)."""


def posterior(e: Evidence, members: Sequence[Member]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (K, k) of a set of changes, and mean (k,) and covariance (k, k) of their amplitudes."""
    by, mean, covariance = _given(e, members, [FREE] * len(members))
    return by, mean, covariance + _by_errors(e, by, mean, covariance)


def _given(
    e: Evidence, members: Sequence[Member], scales: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `posterior`, by factors on the priors of the members, at the variances of most evidence."""
    by = selectors(e, members)
    counts = [len(e.joint.items[m.item].parameters) for m in members]
    a = by.T @ e.information @ by + np.diag(np.repeat(np.array(scales, float) ** -2, counts))
    scale = 1.0 / np.sqrt(np.diag(a))
    covariance = np.linalg.inv(a * np.outer(scale, scale)) * np.outer(scale, scale)
    return by, covariance @ (by.T @ e.score), covariance


def _by_errors(e: Evidence, by: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """What the unknown variances of model errors add to the covariance (k, k) of a set."""
    out = np.zeros_like(covariance)
    for f in e.errors:
        across = by.T @ f.across
        slopes = covariance @ across
        values, vectors = np.linalg.eigh(f.information - across.T @ slopes)
        score, slopes = vectors.T @ (f.score - across.T @ mean), slopes @ vectors
        step = (np.geomspace(LEAST, max(1.0, f.variance), VALUES) - f.variance)[:, None]
        odds = np.maximum(1.0 + step * values, np.finfo(float).tiny)
        share = step / odds  # of each direction in the covariance of the amplitudes of the errors
        gain = 0.5 * np.sum(score**2 * share - np.log(odds), axis=1)
        weight = np.exp(gain - np.max(gain))
        weight /= np.sum(weight)
        shifts = (share * score) @ slopes.T
        out += (slopes * np.maximum(weight @ share, 0.0)) @ slopes.T + (shifts.T * weight) @ shifts
    return out


def set_with(found: Search, m: Member) -> Weighed:
    """The most probable set that has a member."""
    return next(w for w in found.weighed if m in w.members)


def by_sets(found: Search, m: Member) -> np.ndarray:
    """What the other sets that have a member add to the variances (k,) of its parameters."""
    e, count = found.evidence, len(found.evidence.joint.items[m.item].parameters)

    def moments(w: Weighed) -> tuple[np.ndarray, np.ndarray]:
        scales = [FREE if other == m else s for other, s in zip(w.members, w.scales, strict=True)]
        _, mean, covariance = _given(e, w.members, scales)
        first = sum(len(e.joint.items[k.item].parameters) for k in w.members[: w.members.index(m)])
        return mean[first : first + count], np.diag(covariance)[first : first + count]

    least = COUNTED * found.probability[m]
    every = [w for w in found.weighed if m in w.members and w.probability >= least]
    means, variances = map(np.array, zip(*map(moments, every or [set_with(found, m)]), strict=True))
    weight = np.array([w.probability for w in every] or [1.0])
    added = (variances - variances[0]) + (means - means[0]) ** 2
    return np.maximum(weight @ added / np.sum(weight), 0.0)


def by_masses(joint: Joint, p: Parameter) -> float:
    """Relative standard uncertainty of the change of a spring by the stated masses; 0 of others."""
    if p.driver.kind != "torque" or not p.unit.endswith(PER_MOMENT):
        return 0.0
    c, (term, *_) = joint.circumstances, p.terms
    torque = np.asarray(term.driver)[c.fitted]
    torque = torque - np.mean(torque)
    shares = [
        error.sd * float(torque @ np.asarray(t.driver)[c.fitted]) / float(torque @ torque)
        for error in masses(replace(c, compliances={p.name: 1.0}))
        for t in error.terms
        if (t.frame, t.axis) == (term.frame, term.axis)
    ]
    return float(np.linalg.norm(shares))
