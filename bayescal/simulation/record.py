"""Ground truth of a simulated session, drawn from its options, and its record, truth.json."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.arm.transforms import alignment, rpy_matrix
from bayescal.dataset import Certificate, Dataset, Target
from bayescal.dataset.write import write_files
from bayescal.effects import EFFECTS, UNITS
from bayescal.model import Model
from bayescal.model.scene import Scene
from bayescal.probing.scene import U_ANGLE, U_DISTANCE, U_SPHERE, Scenery, sphere_names
from bayescal.simulation.session import Options
from bayescal.statistics import stream
from bayescal.storage.files import json_text
from bayescal.storage.folders import whole

TRUTH = "truth.json"


@dataclass(frozen=True)
class Simulated:
    """A simulated session, and its ground truth: the content of truth.json."""

    dataset: Dataset
    truth: dict[str, Any]


def write(simulation: Simulated, folder: Path) -> None:
    """Write dataset.yaml, measurements.csv, truth.json, and robot.yaml where the robot is not built in.

    Raises
    ------
    BayescalError
        If the folder contains files other than a simulated session, or cannot be written.
    """
    with whole(folder, TRUTH) as stage:
        write_files(simulation.dataset, stage)
        text = json_text(simulation.truth, rows=False)
        (stage / TRUTH).write_text(text, encoding="utf-8", newline="")


def summary(simulation: Simulated) -> str:
    """A few lines: contacts per target and the maximum error of the nominal arm."""
    dataset, truth = simulation.dataset, simulation.truth
    rows = dataset.measurements
    names = [dataset.targets[i].name for i in rows.target]
    counts = Counter(zip(names, rows.role, strict=True))
    lines = [f"{dataset.name}: {dataset.robot.name}, {', '.join(truth['effects']) or 'nominal'}"]
    for target in dataset.targets:
        if target.kind != "sphere":
            fitted, held = counts[target.name, "calibrate"], counts[target.name, "validate"]
            lines.append(f"  {target.name}: {fitted} contacts to calibrate, {held} to validate")
    balls = [t.name for t in dataset.targets if t.kind == "sphere"]
    if balls:
        each = [counts[name, "calibrate"] + counts[name, "validate"] for name in balls]
        number = f"{min(each)}" if min(each) == max(each) else f"{min(each)} to {max(each)}"
        lines.append(f"  {len(balls)} spheres ({balls[0]} to {balls[-1]}): {number} contacts each")
    if truth["distances"]:
        largest, count = truth["worst_distance_um"]["nominal"], len(truth["distances"])
        lines.append(f"  maximum error of the nominal arm: {largest:.0f} µm over {count} distances")
    return "\n".join(lines)


TOOL_SD = 0.5e-3  # m: of the position of a ball without a stated uncertainty
PLACE_SD, ANGLE_SD = 1e-3, 2e-3  # m, rad: of the pose of a cube or an artefact against its stated one
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
        seed = options.seed if p.effect in EFFECTS and EFFECTS[p.effect].of_session else options.seed_of_arm
        z = _standard(seed, p.effect, p.name)
        if p.positive:
            value = p.centre * np.exp(np.log1p(p.sd / p.centre) * z) if p.centre > 0 else abs(p.sd * z)
        else:
            value = p.centre + z * (min(p.sd, TOOL_SD) if p.effect == "tool" else p.sd)
        out[k] = value - p.nominal
    return options.error_scale * out


def true_targets(options: Options, scenery: Scenery) -> tuple[Target, ...]:
    """The true targets: with a small error of position, and in agreement with their certificates.

    They are placed anew in every session; sessions of one arm have the same cube and artefact.
    """
    streams = [stream(seed, "targets") for seed in (options.seed, options.seed_of_arm)]

    def drawn(sd: float, size: tuple[int, ...] = (3,)) -> tuple[np.ndarray, np.ndarray]:
        """Errors of a placement, and of what is placed."""
        placed, made = (rng.normal(0, sd, size) for rng in streams)
        return placed, made

    cube, out = scenery.cube, []
    turn, shift = rpy_matrix(drawn(ANGLE_SD)[0]), drawn(PLACE_SD)[0]
    for face in scenery.faces:
        tilt = rpy_matrix(drawn(U_ANGLE / np.sqrt(2))[1])
        normal = tilt @ turn @ cube.normal(face)
        middle = cube.edge / 2 + float(drawn(U_DISTANCE / np.sqrt(2), ())[1])
        offset = normal @ (cube.centre + shift) + middle * (normal @ (turn @ cube.normal(face)))
        out.append(Target(f"cube.{face}", "plane", {"normal": normal, "offset": float(offset)}))
    placements, spheres = scenery.spheres.shape[:2]
    made = drawn(50e-6, (spheres, 3))[1]  # manufacturing errors of the artefact, which is certified
    diameters = scenery.diameter + drawn(U_SPHERE, (spheres,))[1]
    names = iter(sphere_names(placements, spheres))
    # nominal frame: that of the first placement
    drawing = scenery.spheres[:1].sum(axis=0)
    drawing = drawing - drawing.mean(axis=0, keepdims=True) if spheres else drawing
    for centres in scenery.spheres:
        middle = centres.mean(axis=0)
        turn = rpy_matrix(drawn(ANGLE_SD)[0]) @ alignment(centres - middle, drawing)
        shift = drawn(PLACE_SD)[0]
        for k in range(spheres):
            centre = middle + shift + turn @ (drawing[k] + made[k])
            out.append(Target(next(names), "sphere", {"centre": centre, "diameter": float(diameters[k])}))
    return tuple(out)


def distance_certificates(
    options: Options, scenery: Scenery, targets: Sequence[Target]
) -> tuple[Certificate, ...]:
    """Certified distances of the spheres of the artefact: a value per pair, for all placements."""
    placements, spheres = scenery.spheres.shape[:2]
    names, rng = sphere_names(placements, spheres), stream(options.seed_of_arm, "paper")
    centre_of = {t.name: np.asarray(t.values["centre"]) for t in targets if t.kind == "sphere"}
    pairs = list(combinations(range(spheres), 2)) if placements else []
    said = [
        round(float(np.linalg.norm(centre_of[names[a]] - centre_of[names[b]])) + rng.normal(0, U_SPHERE), 9)
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


SCHEMA = "bayescal-truth/1"


def nominal_errors(dataset: Dataset) -> dict[tuple[str, ...], float]:
    """Error, m, of each certified distance measured by the nominal arm: centres fitted, diameters fixed."""
    p, rows = Scene(dataset).points, dataset.measurements
    radius = np.array([t.ball_radius for t in dataset.tools], float)[rows.tool]
    centres = {}
    for index, target in enumerate(dataset.targets):
        touching = np.flatnonzero(rows.target == index)
        if target.kind != "sphere" or not len(touching):
            continue
        centre = np.asarray(target.values["centre"], float)
        for _ in range(20):
            out = p[touching] - centre
            length = np.linalg.norm(out, axis=1)
            off = length - (0.5 * float(target.values["diameter"]) + radius[touching])
            centre = centre + np.linalg.lstsq(out / length[:, None], off, rcond=None)[0]
        centres[target.name] = centre
    return {
        c.targets: float(np.linalg.norm(centres[c.targets[0]] - centres[c.targets[1]])) - c.distance
        for c in dataset.certificates
        if c.kind == "distance" and c.distance is not None
    }


def key_of(unit: str) -> tuple[str, float]:
    """Key of a value in a file, with its unit, and the factor from SI."""
    name, factor = UNITS.get(unit, (unit, 1.0))
    suffix = re.sub(r"[^a-z0-9_]+", "", name.lower().replace("/", "_per_"))
    return ("value" if suffix in ("", "1") else f"value_{suffix}"), factor


def parameters_record(options: Options, model: Model) -> list[dict[str, Any]]:
    """True and nominal values of the parameters of the arm, units in the keys."""
    arm = []
    for p, deviation in zip(model.parameters, draws(options, model), strict=True):
        key, factor = key_of(p.unit)
        value, nominal = (p.nominal + deviation) * factor, p.nominal * factor
        arm.append({"name": p.name, "effect": p.effect, key: value, key.replace("value", "nominal"): nominal})
    return arm


def heading(options: Options) -> dict[str, Any]:
    """What truth.json states of the options from which a session follows."""
    return {
        "schema": SCHEMA,
        "seed": options.seed,
        "arm_seed": options.seed_of_arm,
        "effects": list(options.effects),
        "error_scale": options.error_scale,
    }


def document(
    options: Options, dataset: Dataset, model: Model, targets: Sequence[Target], gross: np.ndarray
) -> dict[str, Any]:
    """The content of truth.json."""
    places = []
    for t in targets:
        place: dict[str, Any] = {"name": t.name, "kind": t.kind}
        for key, value in t.values.items():
            in_file = np.asarray(value, float) if key == "normal" else 1e3 * np.asarray(value, float)
            place[key if key == "normal" else f"{key}_mm"] = in_file.tolist()
        places.append(place)
    centre_of = {t.name: np.asarray(t.values["centre"]) for t in targets if t.kind == "sphere"}
    errors = nominal_errors(dataset)
    distances = [
        {
            "between": list(pair),
            "certified_mm": next(1e3 * (c.distance or 0) for c in dataset.certificates if c.targets == pair),
            "true_mm": 1e3 * float(np.linalg.norm(centre_of[pair[0]] - centre_of[pair[1]])),
            "nominal_error_um": 1e6 * error,
        }
        for pair, error in errors.items()
    ]
    return {
        **heading(options),
        "noise": {"contact_um": 1e6 * options.noise, "joint_deg": float(np.degrees(options.joint_noise))},
        "outliers": [dataset.measurements.ids[i] for i in gross],
        "parameters": parameters_record(options, model),
        "targets": places,
        "distances": distances,
        "worst_distance_um": {"nominal": 1e6 * max(map(abs, errors.values()), default=0.0)},
    }
