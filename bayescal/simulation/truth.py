"""Ground truth of a simulated session, independent of its plan: arm, targets, certificates, noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations

import numpy as np

from bayescal.arm.transforms import alignment, rpy_matrix
from bayescal.dataset import Certificate, Target
from bayescal.model import Model
from bayescal.simulation.artefacts import Scenery, sphere_names
from bayescal.simulation.options import Options, stream
from bayescal.simulation.scenery import DIAMETER, SIZE, U_ANGLE, U_DISTANCE, U_SPHERE

TOOL_SD = 0.5e-3  # m: of the position of a ball without a stated uncertainty
PLACE_SD, ANGLE_SD = 1e-3, 2e-3  # m, rad: of the pose of a cube or an artefact against its stated one
OF_SESSION = ("thermal-drift", "step")  # effects that differ between sessions of the same arm
OUTLIER = 30e-6, 1e-3  # m: smallest and largest error of a gross contact


@lru_cache(4096)
def _standard(seed: int, effect: str, name: str) -> float:
    """The standard normal draw of a parameter; a simulation asks for it at every pass."""
    return float(stream(seed, "truth", effect, name).normal())


def draws(options: Options, model: Model) -> np.ndarray:
    """Deviations (P,) of the true arm from nominal, SI, times the error scale.

    Each parameter is drawn from its prior with an independent generator: the same seed gives the same arm,
    whichever effects are added. Effects of the session use the seed of the session. Physically positive
    parameters are drawn from a log-normal distribution with the standard deviation of the prior.
    """
    out = np.empty(len(model.parameters))
    for k, p in enumerate(model.parameters):
        seed = options.seed if p.effect in OF_SESSION else options.seed_of_arm
        z = _standard(seed, p.effect, p.name)
        if p.positive:
            value = p.centre * np.exp(np.log1p(p.sd / p.centre) * z) if p.centre > 0 else abs(p.sd * z)
        else:
            value = p.centre + z * (min(p.sd, TOOL_SD) if p.effect == "tool" else p.sd)
        out[k] = value - p.nominal
    return options.error_scale * out


def true_targets(options: Options, scenery: Scenery) -> tuple[Target, ...]:
    """The true targets: with a small error of position, and in agreement with their certificates."""
    rng = stream(options.seed, "targets")
    cube, out = scenery.cube, []
    turn, shift = rpy_matrix(rng.normal(0, ANGLE_SD, 3)), rng.normal(0, PLACE_SD, 3)
    for face in scenery.faces:
        tilt = rpy_matrix(rng.normal(0, U_ANGLE / np.sqrt(2), 3))
        normal = tilt @ turn @ cube.normal(face)
        middle = SIZE / 2 + rng.normal(0, U_DISTANCE / np.sqrt(2))
        offset = normal @ (cube.centre + shift) + middle * (normal @ (turn @ cube.normal(face)))
        out.append(Target(f"cube.{face}", "plane", {"normal": normal, "offset": float(offset)}))
    placements, spheres = scenery.spheres.shape[:2]
    made = rng.normal(0, 50e-6, (spheres, 3))  # manufacturing errors of the artefact, which is certified
    diameters = rng.normal(DIAMETER, U_SPHERE, (spheres,))
    names = iter(sphere_names(placements, spheres))
    # nominal frame: that of the first placement
    drawing = scenery.spheres[:1].sum(axis=0)
    drawing = drawing - drawing.mean(axis=0, keepdims=True) if spheres else drawing
    for centres in scenery.spheres:
        middle = centres.mean(axis=0)
        turn = rpy_matrix(rng.normal(0, ANGLE_SD, 3)) @ alignment(centres - middle, drawing)
        shift = rng.normal(0, PLACE_SD, 3)
        for k in range(spheres):
            centre = middle + shift + turn @ (drawing[k] + made[k])
            out.append(Target(next(names), "sphere", {"centre": centre, "diameter": float(diameters[k])}))
    return tuple(out)


def distance_certificates(
    options: Options, scenery: Scenery, targets: Sequence[Target]
) -> tuple[Certificate, ...]:
    """Certified distances of the spheres of the artefact: a value per pair, for all placements."""
    placements, spheres = scenery.spheres.shape[:2]
    names, rng = sphere_names(placements, spheres), stream(options.seed, "paper")
    at = {t.name: np.asarray(t.values["centre"]) for t in targets if t.kind == "sphere"}
    pairs = list(combinations(range(spheres), 2)) if placements else []
    said = [
        round(float(np.linalg.norm(at[names[a]] - at[names[b]])) + rng.normal(0, U_SPHERE), 9)
        for a, b in pairs
    ]
    return tuple(
        Certificate("distance", (names[p * spheres + a], names[p * spheres + b]), length, U_SPHERE)
        for p in range(placements)
        for (a, b), length in zip(pairs, said, strict=True)
    )


def noise(options: Options, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance outside of the surface at which each contact triggers (N,), m, and which are gross."""
    rng = stream(options.seed, "noise")
    shift = options.noise * rng.normal(size=count)
    gross = np.sort(rng.choice(count, round(options.outliers * count), replace=False))
    size = np.exp(rng.uniform(np.log(OUTLIER[0]), np.log(OUTLIER[1]), len(gross)))
    shift[gross] += size * rng.choice([-1.0, 1.0], len(gross))
    return shift, gross
