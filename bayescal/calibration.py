"""The calibration, end to end: models side by side, the posterior of the last, what it predicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.assess.directions import Directions, directions
from bayescal.assess.false_comfort import false_comfort
from bayescal.assess.identifiability import Identifiability, identifiability
from bayescal.dataset import Dataset
from bayescal.effects.geometry import GEOMETRY
from bayescal.effects.joint import JOINT
from bayescal.estimate import Estimate, calibrated, estimate
from bayescal.estimate.flatness import FORM, FaceCheck, check_faces, with_form
from bayescal.estimate.latent import with_latent_readings
from bayescal.estimate.unexplained import Unexplained, unexplained
from bayescal.model import ORIENTATION, check_asked, with_parameters
from bayescal.model.scene import Scene
from bayescal.posterior import Draws, gaussian, sample
from bayescal.predict import Forecast, Validation, forecast, validate

VALIDATION_DRAWS = 2000
NOMINAL = ("nominal",)
IN_ROBOT_FILE = (
    "geometry",
    "joint",
    "encoder-scale",
    "compliance",
    FORM,
    "artefact",
)  # a face's form, a paper: no part of the arm
WILD_SCALE = 100.0  # times the stated noise: no calibration any more


@dataclass(frozen=True)
class ModelLevel:
    """One model of the ladder: its estimate and what it says of the held-out rows."""

    effects: tuple[str, ...]
    estimate: Estimate
    unexplained: Unexplained
    validation: Validation


@dataclass(frozen=True)
class Fit:
    """A calibration and all that is to be said of it."""

    dataset: Dataset
    seed: int
    prior_width: float
    ladder: tuple[ModelLevel, ...]  # nominal first, the fitted model last
    draws: Draws
    identifiability: Identifiability
    faces: tuple[FaceCheck, ...]
    forecast: Forecast
    directions: Directions
    warnings: tuple[str, ...]

    @property
    def final(self) -> ModelLevel:
        """The model that was asked for."""
        return self.ladder[-1]


def fit(
    dataset: Dataset,
    effects: tuple[str, ...] = ("geometry", "compliance"),
    samples: int = 5000,
    seed: int = 0,
    robust: bool = True,
    prior_width: float = 1.0,
    latent_joints: bool = False,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Fit:
    """Calibrate an arm from a session.

    Parameters
    ----------
    dataset : Dataset
    effects : tuple of str
        The model: names of `effects.MODELS`.
    samples : int
        Effective draws wanted of every parameter; 0 stops at the Gaussian approximation.
    seed : int
        One seed, one result.
    robust : bool
        Leave outliers out.
    prior_width : float
        Factor on the prior standard deviations of the arm.
    latent_joints : bool
        Keep the joint readings as variables of the graph.
    progress : callable
        Told the stage and the fraction of it that is done.

    Raises
    ------
    BayescalError
        Where the session cannot be fitted, with the reason.
    """
    check_asked(effects, prior_width)
    scene = Scene(dataset, oriented=True)
    steps = _steps(effects)
    ladder: list[ModelLevel] = []
    faces: tuple[FaceCheck, ...] = ()
    for k, step in enumerate(steps):
        progress("estimate", k / len(steps))
        if step:
            found = calibrated(scene, step, prior_width, robust)
        else:
            found = estimate(with_parameters(scene, (), ()), robust=robust)
        last = k == len(steps) - 1
        if last:
            faces = check_faces(found)
            uneven = tuple(f.target for f in faces if f.uneven)
            if uneven and FORM not in effects and effects:
                found = with_form(found.model.scene, found, uneven, robust)
            if latent_joints:
                found = with_latent_readings(found)
        left = unexplained(found)
        draws = gaussian(found, seed, VALIDATION_DRAWS)
        if last:
            progress("sample", 0.0)
            if samples:
                draws = sample(found, samples, seed, lambda fraction: progress("sample", fraction))
        z, kappa = _spread(draws)
        checked = validate(found, z, kappa, left.excess, seed)
        ladder.append(ModelLevel(found.model.effects or NOMINAL, found, left, checked))
    progress("done", 1.0)
    known, seen = identifiability(found), directions(found.model)
    expected = forecast(found, z, checked, left.excess, seed)
    warnings = (
        *_warnings(ladder[-1], known, faces, prior_width),
        *false_comfort(checked, left, expected, seen),
    )
    return Fit(
        dataset, seed, prior_width, tuple(ladder), draws, known, faces, expected, seen, warnings
    )  # fmt: skip


def _steps(effects: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Models of the ladder: the drawing, the joints alone where all of the geometry follows, then effects."""
    joints = [(JOINT.name,)] if effects[:1] == (GEOMETRY.name,) else []
    return [(), *joints, *(effects[:k] for k in range(1, len(effects) + 1))]


def _spread(draws: Draws) -> tuple[np.ndarray, np.ndarray]:
    """At most `VALIDATION_DRAWS` draws, evenly out of all."""
    pick = np.linspace(0, len(draws.flat) - 1, min(VALIDATION_DRAWS, len(draws.flat))).astype(int)
    return draws.flat[pick], draws.kappa[pick]


def _warnings(
    rung: ModelLevel, known: Identifiability, faces: tuple[FaceCheck, ...], prior_width: float
) -> tuple[str, ...]:
    """What a reader must know before believing a number, in words."""
    found, left = rung.estimate, rung.unexplained
    model, out = found.model, []
    uneven = [f for f in faces if f.uneven]
    if uneven:
        listed = ", ".join(f"{f.target} by {1e6 * f.form:.0f} um rms" for f in uneven)
        out.append(
            f"these planes are not flat, or the arm errs across them as if they were not: {listed}; "
            "their form is fitted along with the arm"
        )
    if left.excess:
        base = "repeated contacts scatter by" if left.repeats is not None else "the stated noise is"
        out.append(
            f"the fit leaves {1e6 * left.fitted:.1f} um where {base} {1e6 * left.floor:.1f} um: "
            f"{1e6 * left.excess:.1f} um is unexplained and added to every predicted point"
        )
    if len(known.weak) > 1:
        out.append(
            f"{len(known.weak)} directions of the arm are not identifiable from these contacts: "
            "there the prior decides"
        )
    if not model.knows_length:
        out.append(
            "no certified length among the fitted targets: the arm's size rests on the tolerance priors alone"
        )
    count = sum(len(b.rows) for b in model.states)
    if len(found.rejected) > 0.05 * count:
        out.append(
            f"{len(found.rejected)} of {count} rows were rejected as outliers: "
            "more than a session should have"
        )
    far = [
        p.name
        for p, z in zip(model.parameters, found.z, strict=False)
        if abs(z) > 4 * max(1.0, 1 / prior_width)
    ]
    if far:
        out.append(
            f"{', '.join(far)}: more than 4 prior standard deviations off the drawing; check the robot file"
        )
    if max(s for group, s in found.weights.scale.items() if group != ORIENTATION) > WILD_SCALE:
        out.append(
            f"the rows miss by {1e3 * left.fitted:.1f} mm, far more than any small error of an arm: "
            "check offset_deg, the signs of link_from_reading, units, and the tools"
        )
    values = model.physical(found.z)
    negative = [p.name for p, v in zip(model.parameters, values, strict=False) if p.positive and v < 0]
    if negative:
        out.append(f"{', '.join(negative)}: negative, which is not physical; these contacts do not tell it")
    kept_back = [name for name in model.effects if name not in IN_ROBOT_FILE]
    if kept_back:
        out.append(f"robot.yaml holds geometry and compliance only: {', '.join(kept_back)} is not in it")
    return tuple(out)
