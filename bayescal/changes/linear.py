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

from bayescal.changes.joint import Item, Joint, changes, listed
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


Key = tuple[str, str, str, int]
"""Name, site and driver of a parameter, and its number among those that have the same."""


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


@dataclass(frozen=True)
class _Beside:
    """What explains residuals beside the unknowns of a joint fit: errors that the model lacks, changes."""

    families: tuple[str, ...]  # of errors, then of changes; "" of a change without a variance
    errors: tuple[Parameter, ...]
    names: tuple[str, ...]  # of the errors; "" of smooth functions
    changes: tuple[Parameter, ...]  # of items that are no unknowns of the joint fit

    @classmethod
    def of(cls, joint: Joint, free: Sequence[Item]) -> "_Beside":
        """All errors, and changes of some items."""
        c = joint.circumstances
        # an error that the model lacks is none at the joint fit, not the prior's mean
        listed_errors = [
            (effect.name, p.name, replace(p, mean=None, positive=False))
            for effect, parameters in listed(replace(c, sessions=()), joint.estimate.model.effects)
            for p in parameters
        ]
        errors = [*listed_errors, *((f.name, "", p) for f in families(c) for p in f.parameters)]
        # smooth changes have no variance: few sessions have one, and their columns are most of all
        changed = [
            (f"change: {i.effect}" if i.kind == "effect" else "", within(p, s))
            for s in joint.sessions[1:]
            for i in free
            for p in i.parameters
        ]
        labels = (*(label for label, _, _ in errors), *(label for label, _ in changed))
        names, parameters = tuple(name for _, name, _ in errors), tuple(p for _, _, p in errors)
        return cls(labels, parameters, names, tuple(p for _, p in changed))


@dataclass(frozen=True)
class _Equations:
    """Normal equations (N, N) and their gradient (N,): unknowns of the joint fit, errors, changes.

    Priors are in them, but of changes, whose prior belongs to a hypothesis, and of errors.
    """

    information: np.ndarray
    slope: np.ndarray
    noise: Covariance
    variances: dict[str, float]  # of families
    session: np.ndarray  # (R,) of each residual
    shared: np.ndarray  # numbers of the unknowns that no change moves
    errors: np.ndarray
    changed: np.ndarray
    origin: np.ndarray  # of each change, at the joint fit


def _equations(joint: Joint, beside: _Beside, fixed: int) -> _Equations:
    """The equations about a joint fit; the last `fixed` parameters of its arm are changes."""
    estimate, m = joint.estimate, joint.dataset.measurements
    at_stop = displacements(joint.circumstances.robot.n)
    j, g, e, rows = linearised_with(estimate, [*beside.errors, *beside.changes, *at_stop])
    g, by_stop = g[:, : -len(at_stop)], g[:, -len(at_stop) :]
    session = np.argmax([s.rows[rows] for s in joint.sessions], axis=0)
    of_group, group = np.unique(np.stack([session, m.target[rows]]), axis=1, return_inverse=True)
    d, count = j.shape[1], len(beside.errors)
    certified = slice(sum(b.residuals for b in estimate.model.blocks), None)
    held = estimate.linear.jacobian[certified]
    prior = held.T @ held + np.eye(d)  # of certificates and priors, and the gradient of both
    pull = held.T @ estimate.linear.residual[certified] + estimate.z
    labels = np.array(beside.families, dtype=object)
    used = labels != ""
    stops = Stops.of(m, rows, session, by_stop)
    noise, variances = _variances(
        j, g[:, used], e, group.ravel(), of_group[0], prior, pull, labels[used], stops
    )
    x = np.column_stack([j, g])
    weighted = noise.weighted(x)
    full = weighted.T @ x
    full = 0.5 * (full + full.T)
    full[:d, :d] += prior
    slope = weighted.T @ e
    slope[:d] += pull
    arm = estimate.model.slices[ARM].stop
    of_arm = np.arange(arm - fixed, arm)
    full[of_arm, of_arm] -= 1.0
    slope[of_arm] -= estimate.z[of_arm]
    return _Equations(
        full, slope, noise, variances, session,
        shared=np.setdiff1d(np.arange(d), of_arm),
        errors=np.arange(d, d + count),
        changed=np.concatenate([of_arm, np.arange(d + count, len(slope))]),
        origin=np.concatenate([estimate.z[of_arm], np.zeros(len(beside.changes))]),
    )  # fmt: skip


def _without_shared(q: _Equations) -> tuple[np.ndarray, np.ndarray]:
    """Information and score of changes, then of errors, with the shared unknowns integrated out."""
    wide, shared = np.concatenate([q.changed, q.errors]), q.shared
    right = np.column_stack([q.information[np.ix_(shared, wide)], q.slope[shared]])
    across = q.information[np.ix_(wide, shared)]
    solved = _inverse(q.information[np.ix_(shared, shared)]) @ right
    of_wide = q.information[np.ix_(wide, wide)] - across @ solved[:, :-1]
    of_wide = 0.5 * (of_wide + of_wide.T)
    score = across @ solved[:, -1] - q.slope[wide] + of_wide[:, : len(q.changed)] @ q.origin
    return of_wide, score


def _forms(joint: Joint, columns: Sequence[Column], amplitudes: dict[Key, float]) -> np.ndarray:
    """Standard deviations (K,) of what may differ between sessions in an error that all have."""
    form = np.zeros(len(columns))
    for k in range(1, len(joint.sessions)):
        later = [i for i, c in enumerate(columns) if c.session == k]
        for i, key in zip(later, _keys([columns[i].parameter for i in later]), strict=True):
            if joint.items[columns[i].item].name in joint.scattered:
                form[i] = 1.0
            elif not columns[i].parameter.unit.endswith(PER_MOMENT):
                form[i] = FORM * amplitudes.get(key, 0.0)
    return form


def _columns(joint: Joint, *of: Sequence[Item]) -> tuple[Column, ...]:
    """Columns of items, those of each kind in all sessions together."""
    number = {id(i): k for k, i in enumerate(joint.items)}
    return tuple(
        Column(number[id(i)], k, p)
        for items in of
        for k in range(1, len(joint.sessions))
        for i in items
        for p in i.parameters
    )


def evidence(joint: Joint) -> Evidence:
    """The evidence of all changes of a joint estimate."""
    estimate, model = joint.estimate, joint.estimate.model
    fixed = [i for i in joint.items if i.kind in ("arm", "setup")]
    free = [i for i in joint.items if i.kind not in ("arm", "setup")]
    beside, columns = _Beside.of(joint, free), _columns(joint, fixed, free)
    count, nuisance = len(changes(fixed, joint.sessions)), len(beside.errors)
    q = _equations(joint, beside, count)
    information, score = _without_shared(q)

    labels = beside.families[:nuisance]
    size = np.array([q.variances[label] for label in labels])
    full = q.information.copy()
    full[q.errors, q.errors] += 1.0 / size
    kept = np.setdiff1d(np.arange(len(q.slope)), q.changed)
    inner = _inverse(full[np.ix_(kept, kept)])
    follow = -inner @ full[np.ix_(kept, q.changed)]
    z = np.concatenate([estimate.z, np.zeros(nuisance)])[kept]
    start = z - inner @ q.slope[kept] - follow @ q.origin

    # of what is told, not its noise
    seen = np.sqrt(np.maximum(start**2 - np.diag(inner), 0.0))[len(estimate.z) - count :]
    form = _forms(joint, columns, dict(zip(_keys(beside.errors), seen.tolist(), strict=True)))
    by = np.diag(np.concatenate([form, np.sqrt(np.where(size > NONE, size, 0.0))]))
    information, score, _ = integrated(information, score, by[:, np.any(by, axis=0)])
    of_changes, every = slice(len(columns)), []
    for label in dict.fromkeys(labels):
        members = len(columns) + np.flatnonzero(np.array(labels) == label)
        inside = information[np.ix_(members, members)]
        every.append(Errors(information[of_changes, members], inside, score[members], q.variances[label]))

    centre = model.physical(np.zeros(model.size))
    names = (*model.names, *beside.names)
    sizes = np.append(model.physical(np.ones(model.size)) - centre, [p.sd for p in beside.errors])
    centres = np.append(centre, np.zeros(nuisance))
    scale = q.noise.kappa * scales_of(estimate)  # residuals are whitened by the scales of the joint fit
    return Evidence(
        joint, columns, information[of_changes, of_changes], score[of_changes], start, follow,
        tuple(names[k] for k in kept), sizes[kept], centres[kept],
        np.sqrt(np.bincount(q.session, scale**2) / np.bincount(q.session)), q.noise.share, q.variances,
        tuple(every),
    )  # fmt: skip


def _keys(parameters: Sequence[Parameter]) -> list[Key]:
    """What errors of all sessions and their changes have in common."""
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
