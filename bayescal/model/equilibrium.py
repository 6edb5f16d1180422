"""Equilibrium: the pose at which an arm and the gravity that deflects it agree.

Gravity moments depend on where the arm stands, which depends on the deflection by these moments. A TCP
is 7 to 130 µm off with moments at the nominal pose (most with a payload), and up to 2 µm with moments at
the pose so found. Each further pass divides the rest by about 50.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayescal.arm.chain import link_angles
from bayescal.arm.statics import Stance
from bayescal.effects import Parameter, compliances, parameters_of
from bayescal.effects.location import PLACEMENT
from bayescal.errors import BayescalError
from bayescal.model.model import Model, with_parameters
from bayescal.model.scene import Scene

STILL = 1e-9
"""Displacement of the TCP by a pass, m, below which the arm is at rest."""
PASSES = 30
"""Maximum number of passes; an arm that is 1000 times as compliant as usual needs about ten."""
SETTLED = 1e-13
"""Displacement of a TCP by a pass, m, at which the equilibrium of a known arm has converged."""


def standing(model: Model, values: np.ndarray) -> Scene:
    """The scene with its gravity moments and compliances at the pose of the arm for deviations (P,), SI.

    Where targets were placed anew, the arm stands as before: gravity in F0 is as stated.
    """
    scene, motion = model.scene, model.motion(np.arange(len(model.scene.q)))
    values = np.where([p.effect == PLACEMENT for p in model.parameters], 0.0, values)
    delta = motion.displacements(values)
    varies = [any(np.ndim(term.driver) for term in p.terms) for p in model.parameters]
    yields = motion.displacements(np.where(varies, values, 0.0))
    # the model's reference includes the deflection by the robot file's compliances; the statics' does not
    given = scene.q - link_angles(scene.dataset.robot, scene.dataset.measurements.readings)
    slides = scene.dataset.robot.slides
    delta[:, 1:-1, 0] += np.where(slides, 0.0, given)
    delta[:, 1:-1, 1] += np.where(slides, given, 0.0)
    return scene.posed_at(Stance(delta, yields), compliances(model.parameters, values))


def by_name(model: Model, values: np.ndarray, of: Model) -> np.ndarray:
    """Deviations (P',) of the parameters of `model` from those (P,) of a model `of` other moments, SI.

    A tilt may give a torque to a joint that had none: a parameter that is new is at its nominal value.
    """
    deviations = dict(zip((p.name for p in of.parameters), values.tolist(), strict=True))
    return np.array([deviations.get(p.name, 0.0) for p in model.parameters])


def tool_points(model: Model, values: np.ndarray) -> np.ndarray:
    """TCP positions of all rows (3, N) in F0, m, at deviations (P,), SI."""
    return model.motion(np.arange(len(model.scene.q))).points(values)


def moved(before: np.ndarray, after: np.ndarray) -> float:
    """Largest distance between TCP positions (3, N), m."""
    return float(np.sqrt(np.max(np.sum((after - before) ** 2, axis=0), initial=0.0)))


def equilibrium(
    scene: Scene, make: Callable[[Scene], Model], values: Callable[[Model], np.ndarray], still: float = STILL
) -> Model:
    """The model of an arm of known parameters, with gravity moments at the pose where the arm comes to rest.

    Parameters
    ----------
    scene : Scene
    make : callable
        The model of a scene at any pose.
    values : callable
        Deviations (P,) of the parameters of such a model from nominal, SI.
    still : float
        Displacement of the TCP by a pass, m, at which the iteration ends.

    Raises
    ------
    BayescalError
        If the arm does not come to rest, as with a compliance that is far too large.
    """
    model = make(scene)
    if scene.moments is None:
        return model
    points, off = tool_points(model, values(model)), np.inf
    for _ in range(PASSES):
        model = make(standing(model, values(model)))
        before, points = points, tool_points(model, values(model))
        off = moved(before, points)
        if off < still:
            return model
    what = f"the arm does not come to rest under gravity: after {PASSES} passes it still moves by {off:.1e} m"
    raise BayescalError(what, "compliance", "check masses (kg) and compliances (µrad/(N m))")


def arm_at_rest(
    scene: Scene, effects: tuple[str, ...], values: Callable[[Model], np.ndarray], still: float,
    near: Scene | None = None,
) -> Model:  # fmt: skip
    """The model of known effects in equilibrium, with their drivers and without any blocks.

    Parameters and errors as of `equilibrium`; `near` is a scene of almost the same readings from whose pose
    that of the arm is searched.
    """

    def make(scene: Scene) -> Model:
        parameters = parameters_of(effects, scene.circumstances(scene.rows("calibrate")))
        return Model(scene, effects, parameters, (), ())

    if near is not None and near.stance is not None:
        scene = scene.posed_at(near.stance, near.compliances)
    return equilibrium(scene, make, values, still)


def standing_model(model: Model, values: np.ndarray) -> Model:
    """The model with its gravity moments at the pose of the arm for values (P,), in all rows of the session.

    Raises
    ------
    BayescalError
        If the arm has no equilibrium.
    """
    out = settled_model(model, model.scene, values)
    return with_parameters(out.scene, model.effects, out.parameters)


def settled_model(
    model: Model, scene: Scene, values: np.ndarray, modified: Callable[[Parameter], Parameter] = lambda p: p
) -> Model:
    """The model's parameters in a scene, in equilibrium for values (P,); a model without any blocks."""

    def make(scene: Scene) -> Model:
        c = scene.circumstances()
        named = {p.name: p for p in parameters_of(model.effects, c, lenient=True)}
        # a joint without torque has no parameter of it: then it displaces nothing
        terms = ((p, named[p.name].terms if p.name in named else ()) for p in model.parameters)
        parameters = tuple(modified(replace(p, terms=t)) for p, t in terms)
        return Model(scene, model.effects, parameters, (), ())

    return equilibrium(scene, make, lambda _: values, SETTLED)
