"""Unexplained residual: the part of a fit's residuals that exceeds the noise of a single contact.

An unmodelled error (form of a surface, backlash, a compliant base) does not average out: it is present in
every prediction. So if the residuals are significantly larger than the scatter of repeated contacts, the
excess is added to every prediction of a point.

Flatness of the faces: a score test of each, and a fit with the form of those that are not flat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from bayescal.effects import parameters_of
from bayescal.effects.probe import PLANE_FORM, shapes
from bayescal.effects.selection import plain
from bayescal.estimate import Estimate, estimate
from bayescal.estimate.families import poses
from bayescal.estimate.outliers import MEDIAN_WORTH, rejected
from bayescal.model import Block, with_parameters
from bayescal.model.scene import Scene
from bayescal.statistics import chi2_isf, chi2_sf, f_isf, f_sf, rms
from factors.camera import Camera

FEWEST_REPEATS = 5  # degrees of freedom that are sufficient to estimate the noise
FINEST = 1e-9  # m: a smaller scatter of repeats means that the resolution is coarser than the noise
P_VALUE = 1e-2
POSE = 6
"""Unknowns of the pose of an image."""
CONTACT, POINT, IMAGE = "contact", "point", "pixel"
GROUPS = (CONTACT, POINT, IMAGE)
"""Kinds of noise group; that of a session is the first of those that it has."""
AGAIN = {CONTACT: "repeated contacts", POINT: "repeated points", IMAGE: "corners within images"}
"""What tells the noise of a group."""
STATED_FACTOR = 1.4  # without repeats: the true noise may be larger than the stated noise by this factor


@dataclass(frozen=True)
class Unexplained:
    """Noise of one contact, residuals of the fit, and the excess of the residuals; all m, 1 sigma."""

    group: str  # noise group: contact or point
    stated: float
    repeats: float | None  # scatter of repeated contacts; None without enough of them
    repeats_dof: int
    fitted: float  # of the residuals without outliers
    excess: float  # root of the difference of squares if significant, else 0
    p_value: float  # that the noise of one contact alone explains the residuals
    dof: float = 1.0  # degrees of freedom of `fitted`

    @property
    def floor(self) -> float:
        """Best estimate of the noise of one contact, m."""
        return self.stated if self.repeats is None else self.repeats

    @property
    def excess_dof(self) -> float:
        """Effective degrees of freedom of `excess`, the root of a difference of variances (Satterthwaite)."""
        of_floor = 0.0 if self.repeats is None else self.floor**4 / self.repeats_dof
        difference = max(self.fitted**2 - self.floor**2, 0.0)
        return max(difference**2 / (self.fitted**4 / self.dof + of_floor), 1.0)

    @property
    def words(self) -> str:
        """The residuals and the noise that they are compared with."""
        of = "the stated noise" if self.repeats is None else f"the scatter of {AGAIN[self.group]}"
        return f"residuals of {1e6 * self.fitted:.1f} µm against {of}, {1e6 * self.floor:.1f} µm"

    def limit(self, chance: float) -> float:
        """Ratio of residuals to noise that noise alone exceeds with probability `chance`."""
        if self.repeats is None:
            return STATED_FACTOR * float(np.sqrt(chi2_isf(chance, self.dof) / self.dof))
        return float(np.sqrt(f_isf(chance, self.dof, self.repeats_dof)))


def repeat_scatter(scene: Scene, fitted: Estimate, group: str = CONTACT) -> tuple[float | None, int]:
    """Standard deviation of repeated contacts, or points, about their mean, m, and its degrees of freedom.

    From `calibrate` and `validate` rows of fitted targets, without outliers; of points a coordinate. None
    without enough repeats, or if most readings are identical because the encoder's resolution is coarser than
    the noise.
    """
    repeat = scene.dataset.measurements.repeat
    if repeat is None:
        return None, 0
    groups: dict[tuple[str, str, int], list[float]] = {}
    for name, block in fitted.model.block_of.items():
        target = scene.index[name]
        rows = scene.rows_of(target, scene.rows("calibrate", "validate"))
        rows = rows[repeat[rows] != ""]
        if not len(rows) or block.group.partition(" of ")[0] != group:
            continue
        for axis, values in enumerate(fitted.residuals(fitted.model.block(target, rows))):
            for row, r in zip(rows, values, strict=True):
                groups.setdefault((name, str(repeat[row]), axis), []).append(float(r))
    return scatter([np.asarray(values) for values in groups.values() if len(values) > 1])


def sharp_of(scene: Scene, b: Block) -> np.ndarray:
    """Residuals (R,) of a camera that are not of blurred images."""
    return np.tile(scene.blur[b.rows] == 1.0, b.kind.rows)


def sharp(fitted: Estimate, b: Block) -> np.ndarray:
    """Stated noise (R',) of the residuals of a block, m, without blurred images."""
    sigma = fitted.weights.sigma[b.name]
    return sigma[sharp_of(fitted.model.scene, b)] if b.group.startswith(IMAGE) else sigma


def stated_noise(fitted: Estimate, group: str) -> float:
    """Root mean square of the stated noise of a group's residuals, m, without blurred images.

    Of a kind of groups, it is that of all sessions that are fitted together.
    """
    blocks = [b for b in fitted.model.blocks if group in (b.group, b.group.partition(" of ")[0])]
    return rms(np.concatenate([sharp(fitted, b) for b in blocks]))


def within_images(fitted: Estimate) -> tuple[float | None, int]:
    """Standard deviation of corners about the best pose of their image, m, and its degrees of freedom.

    Errors of the arm move an image as a whole. That of its readings, as stated, belongs to the noise. Of
    sharp images, without outliers; None without any.
    """
    scene, model, square, dof, readings = fitted.model.scene, fitted.model, 0.0, 0, [0.0]
    for b in model.blocks:
        if b.name not in model.slices or b.size < POSE or not isinstance(b.kind, Camera):
            continue
        slopes = b.linearise(fitted.arm, fitted.z[model.slices[b.name]])[2]
        every, clear = np.column_stack([fitted.residuals(b).ravel(), slopes]), sharp_of(scene, b)
        kept = np.tile(fitted.weights.row[b.name] > 0, b.kind.rows) & clear
        of_readings = fitted.weights.sigma[b.name] ** 2 - np.tile(b.sigma**2, b.kind.rows)
        readings.append(float(np.mean(of_readings[clear])))
        image = np.tile(poses(scene.dataset.measurements, b.rows), b.kind.rows)
        for one in np.unique(image[kept]):
            index = np.flatnonzero(kept & (image == one))
            r, by = every[index, 0], every[index, 1:]
            if len(r) > POSE:
                square += float(np.sum((r - by @ np.linalg.lstsq(by, r)[0]) ** 2))
                dof += len(r) - POSE
    return (float(np.sqrt(square / dof + max(readings))), dof) if dof >= FEWEST_REPEATS else (None, dof)


def noise_again(fitted: Estimate, group: str) -> tuple[float | None, int]:
    """Noise of a group, m, from what a session measures again, and its degrees of freedom; see `AGAIN`.

    Points count where they scatter more than stated: read again, an arm may not have left its pose, and its
    repeatability is part of the stated noise.
    """
    if group == IMAGE:
        return within_images(fitted)
    repeats, dof = repeat_scatter(fitted.model.scene, fitted, group)
    fewer = group == POINT and repeats is not None and repeats < stated_noise(fitted, group)
    return None if fewer else repeats, dof


def scatter(groups: Sequence[np.ndarray]) -> tuple[float | None, int]:
    """Standard deviation of repeated values about the mean of their group, and its degrees of freedom.

    Outliers do not count (`outliers`): a deviation has one row, and the scale comes from the median. None
    with fewer than `FEWEST_REPEATS` degrees of freedom, or without a scatter above `FINEST`.
    """
    dof = sum(len(values) - 1 for values in groups)
    if dof < FEWEST_REPEATS:
        return None, dof
    # corrected for the estimated mean: deviations then have the variance of one contact
    chi2 = np.concatenate([(v - v.mean()) ** 2 * len(v) / (len(v) - 1) for v in groups])
    robust = float(np.sqrt(np.median(chi2) / chdtri(1.0, 0.5)))
    if robust <= FINEST:
        return None, dof
    good = ~rejected(chi2, 1, robust, MEDIAN_WORTH * dof)
    return float(np.sqrt(np.mean(chi2[good]))), dof


def unexplained(fitted: Estimate) -> Unexplained:
    """Compare the residuals of a fit with the noise of one contact."""
    scales = fitted.weights.scale
    kind_of = {name: name.partition(" of ")[0] for name in scales}  # sessions may have groups of their own
    group = next((g for g in GROUPS if g in kind_of.values()), GROUPS[0])
    blocks = [b for b in fitted.model.blocks if kind_of[b.group] == group]
    sigma, stated = [sharp(fitted, b) for b in blocks], stated_noise(fitted, group)
    scaled = [scales[b.group] * noise for b, noise in zip(blocks, sigma, strict=True)]
    scale = rms(np.concatenate(scaled)) / stated
    dof = max(sum(fitted.dof[name] for name, kind in kind_of.items() if kind == group), 1.0)
    repeats, repeats_dof = noise_again(fitted, group)
    if repeats is None:
        floor, p = stated, float(chi2_sf(dof * (scale / STATED_FACTOR) ** 2, dof))
    else:
        floor = repeats
        p = float(f_sf((scale * stated / repeats) ** 2, dof, repeats_dof))
    square = (scale * stated) ** 2 - floor**2
    excess = float(np.sqrt(max(square, 0.0))) if p < P_VALUE else 0.0
    return Unexplained(group, stated, repeats, repeats_dof, scale * stated, excess, p, dof)


FAMILY_P = 1e-4  # probability that any face of a session of flat faces is called uneven
ROUNDS = 12
FORM = PLANE_FORM.name


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
    faces = model.scene.circumstances().faces
    for face in faces:
        block = model.block_of[face.name]
        rows = fitted.linear.of_block[face.name]
        whiten = fitted.weights.whitening(block)
        columns = np.stack([values[block.rows] for _, _, values in shapes(face)], axis=1) * whiten[:, None]
        jacobian = fitted.linear.jacobian[rows]
        shared = jacobian.T @ columns
        information = columns.T @ columns - shared.T @ fitted.covariance @ shared
        score = columns.T @ fitted.linear.residual[rows]
        size, dof = len(score), fitted.dof[block.group]
        ridge = information + 1e-6 * np.trace(information) / size * np.eye(size)
        amplitude = np.linalg.solve(ridge, score)
        statistic = float(score @ amplitude) / size
        p = min(1.0, float(f_sf(statistic, size, max(dof, 1.0))) * len(faces))
        smooth = columns @ amplitude / np.where(whiten > 0, whiten, 1.0)
        form = rms(smooth[whiten > 0])
        out.append(FaceCheck(face.name, form, p, p < FAMILY_P and form > float(np.median(block.sigma))))
    return tuple(out)


def with_uneven_faces(fitted: Estimate, faces: Sequence[FaceCheck], robust: bool = True) -> Estimate:
    """The fit, with the form of uneven faces as further unknowns where its model lacks it.

    The prior scale of each face is a variance component, estimated by expectation-maximisation.

    Parameters
    ----------
    fitted : Estimate
    faces : sequence of FaceCheck
        Of this estimate.
    robust : bool
        Reject outliers.
    """
    model = fitted.model
    form = {face.target: max(face.form, 1e-6) for face in faces if face.uneven}
    if not form or FORM in map(plain, model.effects):
        return fitted
    circumstances, start = replace(model.scene.circumstances(), fitted_tools=(), turned_tools=()), None
    for _ in range(ROUNDS):
        stated = (replace(f, u_form=form[f.name]) for f in circumstances.faces if f.name in form)
        extra = parameters_of((FORM,), replace(circumstances, faces=tuple(stated)))
        formed = with_parameters(model.scene, (*model.effects, FORM), (*model.parameters, *extra))
        out = estimate(formed, robust=robust, start=start)
        start, before = out.z, dict(form)
        second = out.z**2 + np.diag(out.covariance)
        for name in form:
            index = [k for k, p in enumerate(formed.parameters) if p.name.startswith(f"{name} form ")]
            form[name] = max(before[name] * float(np.sqrt(np.mean(second[index]))), 1e-7)
        if all(abs(np.log(form[name] / before[name])) < 0.02 for name in form):
            break
    return out
