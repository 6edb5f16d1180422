"""Flatness of the faces: a score test of each, and a fit with the form of those that are not flat."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.distributions import f_sf
from bayescal.effects import parameters_of
from bayescal.effects.plane_form import shapes
from bayescal.estimate import Estimate, estimate
from bayescal.model import Model, with_parameters
from bayescal.model.scene import Scene

FAMILY_P = 1e-4  # probability that any face of a session of flat faces is called uneven
ROUNDS = 12
FORM = "plane-form"


@dataclass(frozen=True)
class FaceCheck:
    """Form of a face, estimated from the residuals."""

    target: str
    form: float  # m, root mean square of the smooth part of the residuals
    p_value: float  # corrected for the number of faces
    uneven: bool  # significant, and larger than the stated noise of a contact


def check_faces(fitted: Estimate) -> tuple[FaceCheck, ...]:
    """Score test of a smooth form error of every fitted face, with all other parameters free.

    The columns of the shapes are projected orthogonally to the parameters of the fit, so that tilts, offsets
    and arm errors that look like a form error do not count.
    """
    model, out = fitted.model, []
    faces = model.scene.circumstances(model.scene.rows("calibrate")).faces
    for face in faces:
        block = model.block_of[face.name]
        at = fitted.linear.of_block[face.name]
        whiten = fitted.weights.whitening(block)
        columns = np.stack([values[block.rows] for _, _, values in shapes(face)], axis=1) * whiten[:, None]
        jacobian = fitted.linear.jacobian[at]
        shared = jacobian.T @ columns
        information = columns.T @ columns - shared.T @ fitted.covariance @ shared
        score = columns.T @ fitted.linear.residual[at]
        size, dof = len(score), fitted.dof[block.group]
        ridge = information + 1e-6 * np.trace(information) / size * np.eye(size)
        amplitude = np.linalg.solve(ridge, score)
        statistic = float(score @ amplitude) / size
        p = min(1.0, float(f_sf(statistic, size, max(dof, 1.0))) * len(faces))
        smooth = columns @ amplitude / np.where(whiten > 0, whiten, 1.0)
        form = float(np.sqrt(np.mean(smooth[whiten > 0] ** 2)))
        out.append(FaceCheck(face.name, form, p, p < FAMILY_P and form > float(np.median(block.sigma))))
    return tuple(out)


def with_form(scene: Scene, fitted: Estimate, names: tuple[str, ...], robust: bool = True) -> Estimate:
    """Refit with the form of the named faces as unknowns, with a prior scale estimated from the contacts.

    Each face's scale is a variance component, estimated by expectation-maximisation.
    """
    model = fitted.model
    form = {check.target: max(check.form, 1e-6) for check in check_faces(fitted) if check.target in names}
    out = fitted
    start = None
    for _ in range(ROUNDS):
        formed = _formed(scene, model, form)
        start = np.zeros(formed.size) if start is None else start
        out = estimate(formed, robust=robust, start=start)
        start = out.z
        before = dict(form)
        second = out.z**2 + np.diag(out.covariance)
        for name in form:
            own = [k for k, p in enumerate(formed.parameters) if p.name.startswith(f"{name} form ")]
            form[name] = max(before[name] * float(np.sqrt(np.mean(second[own]))), 1e-7)
        if all(abs(np.log(form[name] / before[name])) < 0.02 for name in form):
            break
    return out


def _formed(scene: Scene, model: Model, form: dict[str, float]) -> Model:
    circumstances = scene.circumstances(scene.rows("calibrate"))
    faces = tuple(replace(face, u_form=form[face.name]) for face in circumstances.faces if face.name in form)
    extra = parameters_of((FORM,), replace(circumstances, faces=faces, fitted_tools=()))
    effects = (*(e for e in model.effects if e != FORM), FORM)
    plain = tuple(p for p in model.parameters if p.effect != FORM)
    return with_parameters(scene, effects, (*plain, *extra))
