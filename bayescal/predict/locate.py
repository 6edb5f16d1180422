"""Finding a target (and a tool used with no other) from its own rows, one posterior draw at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.kind import Kind

ITERATIONS = 6
TAIL = 4.0  # degrees of freedom of the Student t that weighs the rows
OUTLIER = 4.5  # noise standard deviations beyond which a row does not help to find its target


@dataclass(frozen=True)
class Found:
    """States of a target, (S, size), and shifts of its tool's centre, (S, 3) m (zeros where known)."""

    x: np.ndarray
    tool: np.ndarray


def find(
    kind: Kind,
    p: np.ndarray,
    inverse_sigma: np.ndarray,
    noise: np.ndarray | None = None,
    tool_slopes: np.ndarray | None = None,
    tool_sd: float = 0.0,
) -> Found:
    """Gauss-Newton for all draws at once.

    Parameters
    ----------
    kind : Kind
        Of C rows; its `sd` is the prior.
    p : np.ndarray, shape (S, 3, C)
        Ball centres by draw, m, tools nominal.
    inverse_sigma : np.ndarray, shape (rows, C) or (S, rows, C)
        1 / standard uncertainty of the residuals, 1/m; 0 leaves a row out.
    noise : np.ndarray, shape (S, rows, C), optional
        Simulated measurement error, m, taken off the residuals.
    tool_slopes : np.ndarray, shape (S, 3, 3, C), optional
        Change of p (axis 2) by the tool's three shifts (axis 1), where the tool too is unknown.
    tool_sd : float
        Prior standard deviation of those shifts, m.
    """
    free = kind.sd > 0
    x = np.zeros((len(p), len(kind.sd)))
    tool = np.zeros((len(p), 3))
    count = int(free.sum())
    prior = 1.0 / kind.sd[free]
    if tool_slopes is not None:
        prior = np.append(prior, np.full(3, 1.0 / tool_sd))
    if not len(prior):
        return Found(x, tool)
    for _ in range(ITERATIONS):
        at = p if tool_slopes is None else p + np.einsum("sj,sjkc->skc", tool, tool_slopes)
        r, u, dx = kind.linearise(x, at)
        r = (r if noise is None else r - noise) * inverse_sigma
        slopes = [dx[..., free]]
        if tool_slopes is not None:
            slopes.append(np.einsum("srkc,sjkc->srcj", u, tool_slopes))
        j = np.concatenate(slopes, axis=-1) * inverse_sigma[..., None]
        j = j.reshape(len(p), -1, j.shape[-1])
        now = np.concatenate([x[:, free], tool], axis=1)[:, : len(prior)]
        gradient = np.einsum("sri,sr->si", j, r.reshape(len(p), -1)) + prior**2 * now
        hessian = np.swapaxes(j, 1, 2) @ j + np.diag(prior**2)
        step = np.linalg.solve(hessian, gradient[..., None])[..., 0]
        x[:, free] -= step[:, :count]
        if tool_slopes is not None:
            tool -= step[:, count:]
    return Found(x, tool)


def robust_rows(
    kind: Kind,
    p: np.ndarray,
    sigma: np.ndarray,
    tool_slopes: np.ndarray | None = None,
    tool_sd: float = 0.0,
) -> np.ndarray:
    """Which rows help to find a target, (C,) of 0 and 1: those within `OUTLIER` of a Student t fit.

    p of shape (3, C), sigma (rows, C), tool_slopes (1, 3, 3, C) as for `find`. More than the stated
    scatter is allowed for by the median.
    """
    weight = np.ones(p.shape[-1])
    size = np.zeros_like(weight)
    for _ in range(8):
        found = find(kind, p[None], np.sqrt(weight) / sigma, None, tool_slopes, tool_sd)
        at = p[None]
        if tool_slopes is not None:
            at = at + np.einsum("sj,sjkc->skc", found.tool, tool_slopes)
        r = kind.residual(found.x, at)[0] / sigma
        size = np.sqrt(np.mean(r**2, axis=0))
        scale = max(float(np.median(size)) / 0.6745, 1.0)
        weight = (TAIL + 1) / (TAIL + (size / scale) ** 2)
    return (size <= OUTLIER * scale).astype(float)
