"""Cholesky factors of small matrices, by LAPACK itself: SciPy prepares a call for longer than it takes."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs


def factored(matrix: np.ndarray) -> np.ndarray:
    """Lower factor L (D, D) of a positive definite matrix (D, D); what is above its diagonal is not used.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite, or not finite.
    """
    factor, failed = dpotrf(matrix, lower=1, clean=0)
    if failed or not np.isfinite(np.diag(factor)).all():
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return factor


def solved(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution x of L L' x = right, of shape (D,) or (D, K) as `right`, with the factor L of `factored`."""
    return _finite(dpotrs(factor, right, lower=1)[0])


def halved(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution x of L x = right, (D, K), with the factor L of `factored`."""
    return _finite(dtrtrs(factor, right, lower=1)[0])


def _finite(found: np.ndarray) -> np.ndarray:
    if not np.isfinite(found).all():
        raise ValueError("the right-hand side is not finite")
    return found
