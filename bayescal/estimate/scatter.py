"""Errors that every image has anew: those of its readings, told by what its corners share.

Poses of an arm do not repeat, readings are written in steps, triggers vary, and lenses are stabilised. Such
an error moves all corners of an image, as errors of the readings do. Their standard uncertainty is that of
most evidence, with all unknowns of the fit integrated out (empirical Bayes, at its linearisation).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayescal.dataset.consistency import step_of, steps
from bayescal.estimate.correlated import Shared
from bayescal.estimate.estimate import Estimate
from bayescal.estimate.solver import STATED_WORTH, Evaluations, factored, linearise, of_images, solved
from bayescal.estimate.widths import Widened
from bayescal.model.scene import Scene
from bayescal.statistics import rms

RATIOS = np.geomspace(0.05, 50.0, 12)
"""Errors of an image over the noise of a corner that are tried (assumed: hardly an arm repeats a pose better,
and a model with larger ones fits nothing)."""
FIELDS = np.geomspace(0.05, 10.0, 8)
"""The same of errors of an image itself, each over the noise of a corner (assumed)."""
POWERS = 3
"""Of the place in an image, that such errors have: none, linear, quadratic."""
LEAST = 5.0
"""Nats of evidence from which on the stated errors of the readings are too small (convention)."""
NONE = 0.01
"""Share of the errors below which what is known of them is left out of the words (convention)."""
FITS = 4
"""Fits with larger errors, at most (cost)."""
ROUNDS = 20
"""Steps of the noise of the corners, at most."""


@dataclass(frozen=True)
class Scatter:
    """Standard uncertainty of the readings of images, and its evidence beyond what is known of it.

    In rad; in m of an arm that only slides.
    """

    u: float  # of the readings
    prior_u: float  # of the readings: stated, or that of the steps in which they are written
    nats: float
    unit: str = "rad"
    field: float = 0.0  # of errors of the image itself, over the noise of a corner
    power: int = 0  # of the place in the image, up to which these go

    @property
    def words(self) -> str:
        """The uncertainty, beside what is known of it."""
        by, unit = (np.degrees(1.0), "deg") if self.unit == "rad" else (1e3, "mm")
        prior_words = f"{by * self.prior_u:.2g} known" if self.prior_u > NONE * self.u else "none known"
        readings = f"as of readings with an uncertainty of {by * self.u:.2g} {unit} ({prior_words})"
        of = ("the same for all corners", "linear in their place", "smooth over its corners")[self.power]
        each = [of] * (self.field > 0.0) + [readings] * (self.u > self.prior_u or not self.field)
        return f"every image has an error of its own, {' and '.join(each)}"

    @property
    def beyond(self) -> bool:
        """Whether the images show more than what is known."""
        return self.nats > LEAST


def scatter_of(fitted: Estimate) -> Scatter | None:
    """The errors of the readings of images beyond the stated ones; None where a fit shows none."""
    scene, blocks = fitted.model.scene, fitted.model.blocks
    if scene.dataset.noise.field > 0 or not blocks or not all(scene.in_images[b.rows].all() for b in blocks):
        return None
    stated, share = scene.dataset.reading_noise
    slices, coupling = fitted.model.slices, scene.dataset.robot.link_from_reading * share
    by = {
        b.name: Shared.of(
            b.by_readings(fitted.arm, fitted.z[slices[b.target]], coupling),
            scene.dataset.measurements.readings[b.rows],
        )
        for b in blocks
    }
    noise = rms(np.concatenate([fitted.weights.scale[b.group] * b.sigma for b in blocks]))
    unit = noise / max(rms(np.concatenate([np.linalg.norm(x.by, axis=1) for x in by.values()])), 1e-300)
    prior_u = max(stated, _step(scene) / float(np.sqrt(12.0)))  # what is stated is often that of the steps
    evaluations = Evaluations(fitted.model)
    evidence = partial(_log_evidence, fitted, by, evaluations)
    tried = np.append(prior_u, unit * RATIOS[unit * RATIOS > prior_u])
    nats, plain = np.array([evidence(u) for u in tried]), evidence(stated)
    best = int(np.argmax(nats))
    u, most = float(tried[best]), float(nats[best])
    if 1 < best < len(tried) - 1:  # the first is not of the series
        near = slice(best - 1, best + 2)
        u = float(np.exp(_top(np.log(tried[near]), nats[near])))
        most = evidence(u)
    if most - nats[0] <= LEAST:
        u, most = prior_u, float(nats[0])
    readings = Scatter(u, prior_u, most - float(nats[0]), "m" if scene.dataset.robot.slides.all() else "rad")
    every = [readings, *_of_images(fitted, by, evaluations, readings)]
    # those of images beside those of readings are a further error
    leading = max(every, key=lambda s: s.nats - LEAST * (s.field > 0.0 and s.u > s.prior_u))
    return leading if leading.beyond or nats[0] - plain > LEAST else None


def _of_images(
    fitted: Estimate, by: Mapping[str, Shared], evaluations: Evaluations, readings: Scatter
) -> Iterator[Scatter]:
    """Errors of images themselves beside those of their readings, of each power, with the evidence of both.

    `by` are the slopes of the residuals of each block by the readings.
    """
    scene = fitted.model.scene
    every = [(readings.u, readings.nats)]
    every += [(readings.prior_u, 0.0)] * (readings.u > readings.prior_u)  # else they stand for these errors
    for power in range(POWERS):
        fields = {b.name: of_images(scene, b, power) for b in fitted.model.blocks}
        for u, nats in every:

            def both(field: float, u: float = u, fields: Mapping[str, np.ndarray] = fields) -> float:
                shared = {
                    name: replace(s, by=np.hstack([u * s.by, field * fields[name]])) for name, s in by.items()
                }
                return _log_evidence(fitted, shared, evaluations, 1.0)

            least = both(0.0) - nats
            each = np.array([both(field) for field in FIELDS])
            best = min(max(int(np.argmax(each)), 1), len(FIELDS) - 2)
            near = slice(best - 1, best + 2)
            if each[best] == np.max(each):
                field = float(np.exp(_top(np.log(FIELDS[near]), each[near])))
                yield replace(readings, u=u, nats=both(field) - least, field=field, power=power)


def _step(scene: Scene) -> float:
    """Step of the readings as written, rad: of each joint, or of all together where there are few values."""
    revolute = np.degrees(scene.dataset.measurements.readings[:, ~scene.dataset.robot.slides])
    each = steps(scene.dataset)
    return float(np.radians(rms(each[each > 0]) if np.any(each) else step_of(revolute.ravel())))


def _top(x: np.ndarray, y: np.ndarray) -> float:
    """Where the parabola through three points (3,), of which the middle one is the highest, is highest."""
    a, b, _ = np.polyfit(x - x[1], y, 2)
    return float(x[1] - b / (2.0 * a))


def with_scatter(scene: Scene, scatter: Scatter) -> Scene:
    """The scene whose readings have these errors; those of prismatic joints in the stated proportion."""
    noise, (stated, share) = scene.dataset.noise, scene.dataset.reading_noise
    slides = scene.dataset.robot.slides
    if scatter.field:
        noise = replace(noise, field=scatter.field, power=scatter.power)
    if slides.all():
        noise = replace(noise, slide=scatter.u)
    else:
        slide = scatter.u * float(np.max(share[slides])) if stated and slides.any() else noise.slide
        noise = replace(noise, joint=scatter.u, slide=slide)
    return Scene(replace(scene.dataset, noise=noise), oriented=True)


def scattered(
    scene: Scene, fitted: Callable[[Scene], Widened], prior_only: bool = False
) -> tuple[Scene, Widened, Scatter | None]:
    """A fit that weighs images by the errors that each has anew, the scene with these, and the errors.

    A fit with too small errors takes part of them for errors of the arm; they are told again after each fit.

    Parameters
    ----------
    scene : Scene
    fitted : callable
        Fits a scene.
    prior_only : bool
        Weigh images by what is known of their readings alone.
    """
    base = fitted(scene)
    scatter = scatter_of(base[0])
    more = None if prior_only and scatter is not None and scatter.beyond else scatter
    for _ in range(FITS):
        if more is None or scatter is None:
            break
        scene = with_scatter(scene, more)
        base = fitted(scene)
        scatter = replace(more, prior_u=scatter.prior_u, nats=max(scatter.nats, more.nats))
        more = scatter_of(base[0]) if scatter.beyond else None
    return scene, base, scatter


def _log_evidence(fitted: Estimate, by: Mapping[str, Shared], evaluations: Evaluations, u: float) -> float:
    """Log evidence of a standard uncertainty of the readings, at the most probable noise of the corners.

    `by` are the slopes of the residuals of each block by the readings.
    """
    model, row, out = fitted.model, fitted.weights.row, 0.0
    sigma, shared, count = dict[str, np.ndarray](), dict[str, Shared](), 0
    for b in model.blocks:
        each = by[b.name]
        sigma[b.name] = noise = np.hypot(np.tile(b.sigma, b.kind.rows), u * np.linalg.norm(each.by, axis=1))
        shared[b.name] = replace(each, by=u * each.by / noise[:, None])
        kept = np.tile(row[b.name] > 0, b.kind.rows)
        out += shared[b.name][kept].decorrelated().log_det - float(np.sum(np.log(noise[kept])))
        count += int(np.sum(kept))
    weights = replace(
        fitted.weights, sigma=sigma, shared=shared, scale=dict.fromkeys(fitted.weights.scale, 1.0)
    )
    linear, z = linearise(model, fitted.z, weights, evaluations), fitted.z
    ends = max(part.stop for part in linear.of_block.values())
    (j, fixed), (r, other) = ((x[:ends], x[ends:]) for x in (linear.jacobian, linear.residual))
    gram, score, scale = j.T @ j, j.T @ r, 1.0
    prior, push = fixed.T @ fixed + np.eye(len(z)), fixed.T @ other + z
    for _ in range(ROUNDS):
        factor = factored(gram / scale + prior)
        step = -solved(factor, score / scale + push)
        chi2 = float(r @ r + 2.0 * score @ step + step @ gram @ step)
        taken = float(np.trace(solved(factor, gram))) / scale
        before, scale = scale, (STATED_WORTH + chi2) / (STATED_WORTH + count - taken)
        if abs(np.log(scale / before)) < 1e-6:
            break
    prior_chi2 = float(other @ other + z @ z + 2.0 * push @ step + step @ prior @ step)
    half_log_det = float(np.sum(np.log(np.diag(factor))))
    out -= 0.5 * (chi2 / scale + count * float(np.log(scale)) + prior_chi2) + half_log_det
    return out - 0.5 * STATED_WORTH * (float(np.log(scale)) + 1.0 / scale)
