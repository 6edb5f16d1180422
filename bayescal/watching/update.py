"""The estimate after a further contact, what the contact says of itself, and the uncertainty so far.

The model of all rows is solved again from the estimate before, by Gauss-Newton steps and the noise scale that
follows: at a thousand contacts 15 ms. Only the new row's kinematics and gravity moments are computed; the
moments of the others are those of the last complete fit, as are the widths of the priors and the outliers.

A contact is judged by what all others predict of it. With whitened residuals r of the contact and their
leverage H in the estimate that includes it, the residuals before it are (I - H)^-1 r, with the covariance
(I - H)^-1 (Cook and Weisberg, Residuals and Influence in Regression, 1982, 2.2); exact for a linear model.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import partial
from math import inf, nan

import numpy as np

from bayescal.arm.statics import Stance
from bayescal.dataset import Dataset
from bayescal.effects import parameters_of, possible
from bayescal.effects.selection import plain
from bayescal.estimate import STATED_WORTH, Estimate, estimate, unit_weights
from bayescal.estimate.solver import Evaluations, factored, linearise, rescaled_weights, solved
from bayescal.model import ARM, FitOptions, Model
from bayescal.model.equilibrium import by_name, standing
from bayescal.model.model import length_blocks, with_parameters
from bayescal.model.options import kept
from bayescal.model.parts import continued
from bayescal.model.scene import Scene
from bayescal.predict.errors import slopes
from bayescal.predict.forecast import workspace
from bayescal.statistics import f_sf

ODD = 1e-5
"""Probability of so large a residual by chance, below which a contact is odd: one false alarm in a
hundred sessions of 1,000 contacts."""
STEPS = 12
"""Most Gauss-Newton steps of an update; beyond, the complete solver is used."""
SETTLED, SAME_NOISE = 1e-7, 1e-5
"""Step, in posterior standard deviations, and relative change of a noise scale, at which an update ends."""


@dataclass(frozen=True)
class Contact:
    """A row that was measured, and what the rows before it say of it.

    Attributes
    ----------
    row : int
        Of the session.
    id, target, role : str
    residual : float
        Difference from the prediction: signed for one residual, else its length; m, of a camera on the board.
    u : float
        Standard uncertainty of the prediction with the noise of the contact, m; nan if nothing is predicted.
    p_value : float
        Probability of so large a difference by chance; nan if nothing is predicted.
    U : float
        Expanded uncertainty of a distance in the probed workspace after the contact, m; nan before a fit.
    """

    row: int
    id: str
    target: str
    role: str
    residual: float = nan
    u: float = nan
    p_value: float = nan
    U: float = nan

    @property
    def odd(self) -> bool:
        """Whether the contact is not to be explained by chance; it is set aside."""
        return self.p_value < ODD


def refined(model: Model, start: np.ndarray, left_out: Collection[int], of: Estimate) -> Estimate:
    """The estimate of a model from a start near its solution, by Gauss-Newton steps.

    Parameters
    ----------
    model : Model
    start : np.ndarray, shape (D,)
    left_out : collection of int
        Rows of the session that do not count.
    of : Estimate
        With the noise scales to start from.
    """
    z, rows = start, np.array(sorted(left_out), int)
    weights = unit_weights(model, z)
    scale = {group: of.weights.scale.get(group, 1.0) for group in weights.scale}
    row = {b.name: (~np.isin(b.rows, rows)).astype(float) for b in model.blocks}
    weights, evaluations = replace(weights, row=row, scale=scale), Evaluations(model)
    for steps in range(1, STEPS + 1):
        linear = linearise(model, z, weights, evaluations)
        information = linear.jacobian.T @ linear.jacobian + np.eye(model.size)
        covariance = solved(factored(information), np.eye(model.size))
        step = -covariance @ (linear.jacobian.T @ linear.residual + z)
        size = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance)), initial=0.0))
        rescaled, dof = rescaled_weights(model, weights, linear, covariance)
        change = max(abs(np.log(rescaled.scale[g] / weights.scale[g])) for g in weights.scale)
        if size < SETTLED and change < SAME_NOISE:
            return Estimate(model, z, covariance, weights, linear, steps, rows, dof)
        z, weights = z + step, rescaled
    return estimate(model, True, z, rows)


def begun(complete: Estimate, asked: tuple[str, ...], options: FitOptions) -> Estimate:
    """The estimate to continue from: that of a complete fit, without what only all rows together tell."""
    model = _model(complete.model, complete.model.scene, asked, options)
    return refined(model, _start(model, complete), complete.rejected.tolist(), complete)


def followed(
    before: Estimate, dataset: Dataset, asked: tuple[str, ...], options: FitOptions, left_out: Collection[int]
) -> Estimate:
    """The estimate of a session with further rows.

    Parameters
    ----------
    before : Estimate
        Of its first rows.
    dataset : Dataset
    asked : tuple of str
        Effects of the model, without those that a complete fit added.
    options : FitOptions
    left_out : collection of int
        Rows that do not count.
    """
    scene = continued(before.model.scene, dataset, partial(_stance, before))
    model = _model(before.model, scene, asked, options)
    return refined(model, _start(model, before), left_out, before)


def _model(before: Model, scene: Scene, asked: tuple[str, ...], options: FitOptions) -> Model:
    """The model of a scene with the parameters and priors of another, and those that only further rows have.

    The form of a face that a complete fit found uneven, and a part that it found rigid, are among the first.
    """
    earlier = {p.name: p for p in before.parameters}
    added = {*map(plain, before.effects)} - {*map(plain, asked)}
    present = kept(parameters_of(before.effects, scene.circumstances()), options.without)
    parameters = [
        replace(earlier[p.name], terms=p.terms) if p.name in earlier else options.wider(p)
        for p in present
        if p.name in earlier or p.effect not in added
    ]
    return with_parameters(scene, before.effects, tuple(parameters))


def _start(model: Model, of: Estimate) -> np.ndarray:
    values = dict(zip(of.model.names, of.z.tolist(), strict=True))
    return np.array([values.get(name, 0.0) for name in model.names])


def _stance(fitted: Estimate, later: Scene) -> Stance:
    """Where the fitted arm stands in further rows."""
    effects, c = fitted.model.effects, later.circumstances(np.arange(len(later.q)))
    named = {p.name: p for p in parameters_of(possible(effects, c), c, lenient=True)}
    terms = ((p, named[p.name].terms if p.name in named else ()) for p in fitted.model.parameters)
    model = Model(later, effects, tuple(replace(p, terms=t) for p, t in terms), (), ())
    stance = standing(model, by_name(model, fitted.arm, fitted.model)).stance
    assert stance is not None
    return stance


def judged(fitted: Estimate, row: int, wider: float = 1.0) -> tuple[float, float, float]:
    """What all other rows say of a fitted one.

    Parameters
    ----------
    fitted : Estimate
    row : int
        Of the session.
    wider : float
        Factor on the standard uncertainty of what the model predicts: by its error in the last complete fit.

    Returns
    -------
    residual, u : float
        The difference from the prediction and its standard uncertainty, m; see `Contact`. Orientations that
        an instrument reads are not judged.
    p_value : float
    """
    block = next((b for b in length_blocks(fitted.model) if row in b.rows), None)
    if block is None or row in fitted.rejected:
        return nan, nan, nan
    mine = np.flatnonzero(np.tile(block.rows, block.kind.rows) == row)
    index, whiten = fitted.linear.of_block[block.name].start + mine, fitted.weights.whitening(block)[mine]
    r, by = fitted.linear.residual[index], fitted.linear.jacobian[index]
    redundancy, axes = np.linalg.eigh(np.eye(len(index)) - by @ fitted.covariance @ by.T)
    redundancy = np.maximum(redundancy, np.finfo(float).eps)
    across = axes.T @ r
    ahead, variance = across / redundancy, 1.0 + wider**2 * (1.0 - redundancy) / redundancy
    # of all others: the noise, estimated from their residuals and the worth of the stated one
    dof = max(fitted.dof[block.group] + STATED_WORTH - len(index), 1.0)
    others = max(fitted.dof[block.group] + STATED_WORTH - float(np.sum(across * ahead)), 0.1)
    p = float(f_sf(np.sum(ahead**2 / variance) / len(index) * dof / others, len(index), dof))
    residual, sd = axes @ ahead / whiten, np.sqrt(axes**2 @ variance) / whiten
    if len(index) == 1:
        return float(residual[0]), float(sd[0]), p
    return float(np.linalg.norm(residual)), float(np.sqrt(np.mean(sd**2))), p


def distance_u(fitted: Estimate) -> float:
    """Standard uncertainty, m, of a distance in the probed workspace, by the noise and the priors alone."""
    model, space = fitted.model, workspace(fitted)
    if not model.parameters or not len(space.pairs):
        return inf
    arm = model.slices[ARM]
    by = slopes(model, space.motion, space.values, space.pairs)
    return float(np.sqrt(np.mean(np.sum(by @ fitted.covariance[arm, arm] * by, axis=1))))
