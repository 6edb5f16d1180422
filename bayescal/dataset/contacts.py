"""Residuals of contacts at nominal geometry, and how far a target must move to explain them.

The estimate is robust: it distinguishes an impossible row from an uncertain position of the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.arm.transforms import rigid_alignment, rpy_matrix
from bayescal.dataset.target_kinds import KINDS, Seen, angle_sd, place_sd
from bayescal.dataset.types import Target

ARM_ERROR = 0.01
"""m: what an arm may nominally be wrong by; a smaller misfit weighs in full."""

HOLD = 0.025
"""m: misfit of one contact that pulls as strongly as a target's prior holds."""

Residual = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Contacts:
    """The M rows of one target: ball centres p (M, 3), m, and what its kind is made of."""

    target: Target
    p: np.ndarray
    seen: Seen


def residual(contacts: Contacts, p: np.ndarray | None = None) -> Residual:
    """Residuals (M, k), m, and their gradients by p (M, k, 3), at `p` or at the contacts' own."""
    p = contacts.p if p is None else p
    kind = KINDS[contacts.target.kind].build(contacts.target, contacts.seen)
    r, slopes, _ = kind.linearise(np.zeros(len(kind.sd)), p.T)
    return r.T, np.moveaxis(slopes, -1, 0)


def settled(contacts: Contacts, passes: int = 12) -> np.ndarray:
    """Residuals' lengths (M,), m, once the target has moved rigidly to where most contacts want it.

    Gauss-Newton on a displacement and rotation of the target, held by its prior (three times its
    uncertainty of place, one and a half times that of direction), with Cauchy weights whose scale
    follows the median: most rows move the target, a few wild ones do not.
    """
    p = contacts.p
    u, angle = place_sd(contacts.target), angle_sd(contacts.target)
    pivot = np.median(p, axis=0)
    arm = p - pivot
    hold = np.repeat([1 / (3 * u + 0.001), 1 / (1.5 * angle + 0.001)], 3) ** 2
    move = np.zeros(6)
    for _ in range(passes):
        r, g = residual(contacts, _moved(p, pivot, move))
        size = np.linalg.norm(r, axis=1)
        weight = _cauchy(size, 2 * float(np.median(size))) / HOLD**2
        jacobian = -np.concatenate([g, np.cross(arm[:, None, :], g)], axis=2)
        normal = np.einsum("mki,mkj,m->ij", jacobian, jacobian, weight) + np.diag(hold)
        gradient = np.einsum("mki,mk,m->i", jacobian, r, weight) + hold * move
        move = move - np.linalg.solve(normal, gradient)
    return np.linalg.norm(residual(contacts, _moved(p, pivot, move))[0], axis=1)


def _moved(p: np.ndarray, pivot: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Points as a target moved by `move` sees them: the inverse motion."""
    return (p - move[:3] - pivot) @ rpy_matrix(move[3:]) + pivot


def _cauchy(size: np.ndarray, scale: float) -> np.ndarray:
    return 1 / (1 + (size / max(ARM_ERROR, scale)) ** 2)


def scatter(p: np.ndarray, seen: np.ndarray, near: float, passes: int = 30) -> np.ndarray:
    """Distances (M,), m, of points p from an instrument's readings after the best rigid fit.

    Refitted with Cauchy weights until all lie within `near` (m), or `passes` times.
    """
    away = np.zeros(len(p))
    for _ in range(passes):
        weight = _cauchy(away, float(np.median(away)))
        placed = rigid_alignment(p, seen, weight)
        away = np.linalg.norm(p - seen @ placed[:3, :3].T - placed[:3, 3], axis=1)
        if away.max() <= near:
            break
    return away
