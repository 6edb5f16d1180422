"""Evidence of columns integrated over the noise, compiled: a search needs it for thousands of sets.

Over L, the log of the noise's precision over the state's own: without the columns its density is
exp(dof L / 2 - chi2 exp(L) / 2), a gamma integral. With them, Gauss-Hermite quadrature is centred at its
mode and has the width there, about 1 / sqrt(dof / 2): correct to a thousandth of a nat for any number of
contacts.
"""

from __future__ import annotations

import math

import numpy as np

from bayescal.arm.compiled import compiled

TRIED, NEWTON = 8, 5
"""Number of noise levels among which the mode of the integral is searched, and of refinement steps."""
_jit = compiled(error_model="numpy")


@_jit
def gain(values, along, square, log_precision):
    """Log Bayes factor of columns at one log precision of the noise and one squared prior scale.

    `values` (k,) are the eigenvalues of their information, `along` (k,) their squared scores along its
    eigenvectors, both at log precision 0.
    """
    y = math.exp(log_precision)
    by = square * y
    total, product = 0.0, 1.0
    for j in range(len(values)):
        with_it = 1.0 + by * values[j]
        total += along[j] * by * y / with_it
        product *= with_it  # a logarithm of several factors is one logarithm
        if product > 1e100:
            total -= math.log(product)
            product = 1.0
    return 0.5 * (total - math.log(product))


@_jit
def _slopes(values, along, square, log_precision):
    """First and second derivative of `gain` by the log precision."""
    y = math.exp(log_precision)
    by = square * y
    first, second = 0.0, 0.0
    for j in range(len(values)):
        p = by * values[j]
        part = p / (1.0 + p)
        h = along[j] * by * y * (2.0 + p) / (1.0 + p) ** 2
        first += h - part
        second += h * (2.0 + p / (2.0 + p) - 2.0 * part) - part / (1.0 + p)
    return 0.5 * first, 0.5 * second


@_jit
def integrated(values, along, squares, dof, chi2, worth, nodes, log_weights):
    """Log of the integrals (B, S) over the log precision, of B sets of k columns at S squared prior scales.

    Parameters
    ----------
    values, along : np.ndarray, shape (B, k)
        Eigenvalues of the information of each set, and its squared scores along the eigenvectors.
    squares : np.ndarray, shape (S,)
        Squared factors on the prior standard deviations.
    dof, chi2 : float
        Degrees of freedom and chi-square of the noise without the columns.
    worth : float
        Part of `chi2` that no column explains: the stated noise.
    nodes, log_weights : np.ndarray, shape (U,)
        Of the Gauss-Hermite quadrature; of the weights the logarithms.
    """
    out = np.empty((len(values), len(squares)))
    own, density = np.empty(values.shape[1]), np.empty(len(nodes))
    least = min(worth, chi2)
    lowest = math.log(dof / chi2)
    for b in range(len(values)):
        # columns explain at most chi2 minus the share of the stated noise, which bounds the noise from below
        largest, explained = 1e-300, 0.0
        for value in values[b]:
            largest = max(largest, value)
        for j in range(len(own)):
            if values[b, j] > 1e-12 * largest:
                explained += along[b, j] / values[b, j]
        # what columns take from the model's prior is no part of chi2: without a limit the integral diverges
        share = min(1.0, (chi2 - least) / max(explained, 1e-300))
        for j in range(len(own)):
            own[j] = share * along[b, j]
        highest = math.log(dof / max(chi2 - min(explained, chi2 - least), least))
        for s in range(len(squares)):
            mode, most = lowest, -np.inf
            for i in range(TRIED):
                at = lowest + (highest - lowest) * i / (TRIED - 1)
                level = 0.5 * (dof * at - chi2 * math.exp(at)) + gain(values[b], own, squares[s], at)
                if level > most:
                    mode, most = at, level
            for _ in range(NEWTON):
                slope, bend = _slopes(values[b], own, squares[s], mode)
                noise = 0.5 * chi2 * math.exp(mode)
                step = (slope + 0.5 * dof - noise) / max(abs(bend - noise), 1e-3 * dof)
                mode += min(max(step, -0.5), 0.5)
            bend = 0.5 * chi2 * math.exp(mode) - _slopes(values[b], own, squares[s], mode)[1]
            width = math.sqrt(2.0 / max(bend, 1e-3 * dof))
            most = -np.inf
            for u in range(len(nodes)):
                at = mode + width * nodes[u]
                level = 0.5 * (dof * at - chi2 * math.exp(at)) + gain(values[b], own, squares[s], at)
                density[u] = level + nodes[u] ** 2 + log_weights[u]
                most = max(most, density[u])
            total = 0.0
            for u in range(len(nodes)):
                total += math.exp(density[u] - most)
            out[b, s] = most + math.log(total) + math.log(width)
    return out
