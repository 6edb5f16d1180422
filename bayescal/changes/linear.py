"""The evidence of changes in closed form.

At the joint estimate, residuals are e + J d + G w + X x: d are the unknowns that all sessions share, w the
amplitudes of errors that the model lacks, in all sessions alike (effects of the list, smooth functions), x
the changes. The families of w have variances that maximise the evidence where every change is free, together
with a noise scale of each session (MacKay 1992, Neural Computation 4, 415). d and w are integrated out:

    log L(x) = s'x - x'Gx/2,    G = X'MX,  s = -X'M (e - X x0),  M = (K + [J G] P [J G]')^-1

with the covariance K of the residuals (noise, and what the measurements of a stop share) and that of the
prior, P. For x = B a, a ~ N(0, T) the evidence over no change is

    (s'B (T^-1 + B'GB)^-1 B's - log det(1 + T B'GB)) / 2.

A model error that is the same in both sessions is in w, so that it is no change, nor where the sessions are
measured at different poses.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from bayescal.changes.joint import Joint, changes, listed
from bayescal.changes.stops import Covariance, Stops, displacements
from bayescal.effects import Parameter
from bayescal.effects.common import within
from bayescal.errors import BayescalError
from bayescal.estimate import STATED_WORTH
from bayescal.estimate.families import families, linearised_with, scales_of
from bayescal.model import ARM

ITERATIONS, ENOUGH = 40, 1e-2
"""Largest number of updates of variances, and the change of a logarithm at which they end."""
NONE = 1e-12
"""In place of a variance that is none, so that its inverse is finite."""
PER_MOMENT = "(N m)"
"""End of the units of springs: they are linear, so that only others differ in their form."""
ALIKE = 20.0
"""Residuals that the mean of a session is worth in the noise scale of one of its targets (assumed)."""
FIRST, LEAST = 0.03, 1e-4
"""Variances of families at the start, and up to which they are none, over those of the unit amplitudes."""

FORM = 0.05
"""Standard deviation of what may differ between sessions in an error that all have, over its size: forms of
effects are approximate, and act differently where poses and ways differ (assumed)."""


@dataclass(frozen=True)
class Column:
    """One parameter of an item in one later session."""

    item: int
    session: int  # from 1
    parameter: Parameter


@dataclass(frozen=True)
class Errors:
    """A family of model errors beside the changes, at the variances that maximise the evidence."""

    across: np.ndarray  # (K, k) information of changes and amplitudes
    information: np.ndarray  # (k, k)
    score: np.ndarray  # (k,)
    variance: float


@dataclass(frozen=True)
class Evidence:
    """Information and score of all changes, with all else integrated out; changes in units of their prior.

    `follow` (D, K) is how the shared unknowns move with a change, and `start` (D,) where they are without.
    """

    joint: Joint
    columns: tuple[Column, ...]  # (K,)
    information: np.ndarray  # (K, K)
    score: np.ndarray  # (K,)
    shared: np.ndarray  # (D,) z of the shared unknowns without a change
    follow: np.ndarray  # (D, K)
    names: tuple[str, ...]  # (D,) of them: parameters of the arm, targets, then effects of the list
    sd: np.ndarray  # (D,) SI of a unit of each
    centre: np.ndarray  # (D,) SI
    noise: np.ndarray  # (S,) factors on the stated noise
    of_stops: np.ndarray  # (S,) RMS error that measurements of one stop share, over their noise
    variances: dict[str, float]  # of the families of model errors
    errors: tuple[Errors, ...]  # these families

    @cached_property
    def places(self) -> tuple[np.ndarray, ...]:
        """Columns (S - 1, k) of the parameters of each item, session after session."""
        of: list[list[int]] = [[] for _ in self.joint.items]
        for k, c in enumerate(self.columns):
            of[c.item].append(k)
        return tuple(np.array(columns, int).reshape(len(self.joint.sessions) - 1, -1) for columns in of)


def evidence(joint: Joint) -> Evidence:
    """The evidence of all changes of a joint estimate."""
    estimate, c, parts = joint.estimate, joint.circumstances, joint.sessions
    fixed = [i for i in joint.items if i.kind in ("arm", "setup")]
    free = [i for i in joint.items if i.kind not in ("arm", "setup")]
    model = estimate.model
    # an error that the model lacks is none at the joint fit, not the prior's mean
    of_effects = [
        (effect.name, replace(p, mean=None, positive=False))
        for effect, parameters in listed(replace(c, sessions=()), model.effects)
        for p in parameters
    ]
    smooth = [(f.name, p) for f in families(c) for p in f.parameters]
    # smooth changes have no variance: few sessions have one, and their columns are most of all
    more = [
        (f"change: {i.effect}" if i.kind == "effect" else "", within(p, s))
        for s in parts[1:]
        for i in free
        for p in i.parameters
    ]
    labels = [label for label, _ in (*of_effects, *smooth, *more)]
    errors_of = [p for _, p in (*of_effects, *smooth)]
    at_stop = displacements(c.robot.n)
    j, g, e, rows = linearised_with(estimate, [*errors_of, *(p for _, p in more), *at_stop])
    g, by_stop = g[:, : -len(at_stop)], g[:, -len(at_stop) :]
    nuisance = len(errors_of)
    session = np.argmax([s.rows[rows] for s in parts], axis=0)
    target = joint.dataset.measurements.target[rows]
    of_group, group = np.unique(np.stack([session, target]), axis=1, return_inverse=True)
    of_group, group = of_group[0], group.ravel()
    d, linear = j.shape[1], estimate.linear
    certified = slice(sum(b.residuals for b in model.blocks), None)
    held = linear.jacobian[certified]
    prior = held.T @ held + np.eye(d)  # of certificates and priors, and the gradient of both
    pull = held.T @ linear.residual[certified] + estimate.z
    arm = model.slices[ARM].stop
    count = len(changes(fixed, parts))
    fixed_changes = np.arange(arm - count, arm)
    label_of = np.array(labels, dtype=object)
    used = label_of != ""
    stops = Stops.of(joint.dataset.measurements, rows, session, by_stop)
    noise, variances = _variances(j, g[:, used], e, group, of_group, prior, pull, label_of[used], stops)
    x = np.column_stack([j, g])
    weighted = noise.weighted(x)
    full = weighted.T @ x
    full = 0.5 * (full + full.T)
    scale = noise.kappa * scales_of(estimate)  # residuals are whitened by the scales of the joint fit
    size = np.array([variances[label] for label in labels[:nuisance]])
    full[:d, :d] += prior
    slope = weighted.T @ e
    slope[:d] += pull
    # changes have no prior here: it belongs to a hypothesis
    full[fixed_changes, fixed_changes] -= 1.0
    slope[fixed_changes] -= estimate.z[fixed_changes]
    errors = np.arange(d, d + nuisance)
    changed = np.concatenate([fixed_changes, np.arange(d + nuisance, len(slope))])
    wide = np.concatenate([changed, errors])
    origin = np.concatenate([estimate.z[fixed_changes], np.zeros(len(slope) - d - nuisance)])
    shared = np.setdiff1d(np.arange(d), fixed_changes)
    right = np.column_stack([full[np.ix_(shared, wide)], slope[shared]])
    solved = _inverse(full[np.ix_(shared, shared)]) @ right
    beside = full[np.ix_(wide, wide)] - full[np.ix_(wide, shared)] @ solved[:, :-1]
    beside = 0.5 * (beside + beside.T)
    along = full[np.ix_(wide, shared)] @ solved[:, -1] - slope[wide] + beside[:, : len(changed)] @ origin
    full[errors, errors] += 1.0 / size
    kept = np.setdiff1d(np.arange(len(slope)), changed)
    inner = _inverse(full[np.ix_(kept, kept)])
    follow = -inner @ full[np.ix_(kept, changed)]
    number = {id(i): k for k, i in enumerate(joint.items)}
    columns = tuple(
        Column(number[id(i)], k, p)
        for items in (fixed, free)
        for k in range(1, len(parts))
        for i in items
        for p in i.parameters
    )
    z = np.concatenate([estimate.z, np.zeros(nuisance)])[kept]
    start = z - inner @ slope[kept] - follow @ origin
    centre = model.physical(np.zeros(model.size))
    sizes = np.append(model.physical(np.ones(model.size)) - centre, [p.sd for p in errors_of])
    centres = np.append(centre, np.zeros(nuisance))
    names = (*model.names, *(p.name for _, p in of_effects), *("" for _ in smooth))
    form = np.zeros(len(columns))
    seen = np.sqrt(np.maximum(start**2 - np.diag(inner), 0.0))[d - count :]  # of what is told, not its noise
    amplitude = dict(zip(_keys(errors_of), seen.tolist(), strict=True))
    for k in range(1, len(parts)):
        later = [i for i, c in enumerate(columns) if c.session == k]
        for i, key in zip(later, _keys([columns[i].parameter for i in later]), strict=True):
            if joint.items[columns[i].item].name in joint.scattered:
                form[i] = 1.0
            elif not columns[i].parameter.unit.endswith(PER_MOMENT):
                form[i] = FORM * amplitude.get(key, 0.0)
    by = np.diag(np.concatenate([form, np.sqrt(np.where(size > NONE, size, 0.0))]))
    beside, along, _ = integrated(beside, along, by[:, np.any(by, axis=0)])
    families_of, changes_of = np.array(labels[:nuisance]), slice(len(columns))
    every = []
    for label in dict.fromkeys(labels[:nuisance]):
        members = len(columns) + np.flatnonzero(families_of == label)
        inside = beside[np.ix_(members, members)]
        every.append(Errors(beside[changes_of, members], inside, along[members], variances[label]))
    return Evidence(
        joint, columns, beside[changes_of, changes_of], along[changes_of], start, follow,
        tuple(names[k] for k in kept), sizes[kept], centres[kept],
        np.sqrt(np.bincount(session, scale**2) / np.bincount(session)), noise.share, variances, tuple(every),
    )  # fmt: skip


def _keys(parameters: Sequence[Parameter]) -> list[tuple[str, str, str, int]]:
    """What errors of all sessions and their changes have in common: name, site, driver, and their number."""
    count: Counter[tuple[str, str, str]] = Counter()
    out = []
    for p in parameters:
        key = (p.name, str(p.site), str(p.driver))
        out.append((*key, count[key]))
        count[key] += 1
    return out


def integrated(
    information: np.ndarray, score: np.ndarray, by: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Information (K, K), score (K,) and log evidence with changes along columns `by` (K, k) integrated out.

    The columns have amplitudes of unit variance.
    """
    if not by.shape[1]:
        return information, score, 0.0
    across, along = information @ by, by.T @ score
    a = np.eye(by.shape[1]) + by.T @ across
    solved = np.linalg.solve(a, np.column_stack([across.T, along]))
    log_evidence = 0.5 * (float(along @ solved[:, -1]) - float(np.linalg.slogdet(a)[1]))
    return information - across @ solved[:, :-1], score - across @ solved[:, -1], log_evidence


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a positive definite matrix, scaled to a unit diagonal first."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    factor, fault = dpotrf(matrix * np.outer(scale, scale), lower=1)
    half, _ = dpotri(factor, lower=1)
    if fault:
        raise BayescalError("the sessions do not determine a joint fit", "", "fit each of them: bayescal fit")
    half = np.tril(half)
    out: np.ndarray = (half + np.tril(half, -1).T) * np.outer(scale, scale)
    return out


def _variances(
    j: np.ndarray, g: np.ndarray, e: np.ndarray, group: np.ndarray, session: np.ndarray, prior: np.ndarray,
    pull: np.ndarray, labels: np.ndarray, stops: Stops,
) -> tuple[Covariance, dict[str, float]]:  # fmt: skip
    """Covariance of the residuals, and variance of each family, that maximise the evidence.

    `group` (R,) is that of each residual, each with a noise scale, `session` the session of each group. The
    unknowns of the model keep their prior, as a quadratic form with the gradient `pull`.
    """
    d, names = j.shape[1], list(dict.fromkeys(labels))
    member = [np.flatnonzero(labels == name) + d for name in names]
    every = np.column_stack([j, g])
    kappa, size = np.ones(len(session)), np.full(len(names), FIRST)
    # errors of stops from above: enough families explain any error of a few stops
    noise = Covariance(stops, kappa[group], np.where(stops.shared(int(session.max()) + 1), 1.0, NONE))
    for _ in range(ITERATIONS):
        # families without a variance take no part
        active = [k for k in range(len(names)) if size[k] > LEAST]
        x = every[:, np.concatenate([np.arange(d), *(member[k] for k in active)]).astype(int)]
        weighted = noise.weighted(x)
        a, b = weighted.T @ x, weighted.T @ e
        a[:d, :d] += prior
        b[:d] += pull
        prior_variance = np.repeat(size[active], [len(member[k]) for k in active])
        a[np.arange(d, len(b)), np.arange(d, len(b))] += 1.0 / prior_variance
        covariance = _inverse(a)
        u, variance = -covariance @ b, np.diag(covariance)
        before, start = np.concatenate([np.log(kappa), np.log(size), np.log(noise.size.ravel())]), d
        for k in active:
            m = slice(start, start + len(member[k]))
            start = m.stop
            determined = max(len(member[k]) - float(np.sum(variance[m])) / size[k], 1e-9)
            size[k] = _updated(float(u[m] @ u[m]), determined)
        weighted_residual = noise.weighted((e + x @ u)[:, None])[:, 0]
        updated = _updated(*noise.sizes(weighted_residual, weighted, covariance))
        shared = np.where(noise.size > LEAST, updated, noise.size)
        scale = noise.kappa**2
        square = np.bincount(group, (scale * weighted_residual) ** 2, len(session))
        spent = scale * (noise.diagonal - np.sum((weighted @ covariance) * weighted, axis=1))
        dof = np.bincount(group, spent, len(session))
        for k in range(int(session.max()) + 1):
            of = session == k
            mean = (np.sum(square[of]) + STATED_WORTH) / (max(np.sum(dof[of]), 1.0) + STATED_WORTH)
            kappa[of] = np.sqrt((square[of] + ALIKE * mean) / (np.maximum(dof[of], 0.0) + ALIKE))
        shared = np.where(shared > LEAST, shared, NONE)
        noise = Covariance(stops, kappa[group], shared)
        after = np.concatenate([np.log(kappa), np.log(size), np.log(shared.ravel())])
        if np.max(np.abs(after - before)) < ENOUGH:
            break
    return noise, dict(zip(names, np.where(size > LEAST, size, NONE).tolist(), strict=True))


def _updated(square: Any, determined: Any) -> Any:
    """The update of MacKay of a variance; where nothing is known it tends to the smallest."""
    return np.maximum((square + 1e-3 * LEAST) / (determined + 1e-3), LEAST)
