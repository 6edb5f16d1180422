"""The record of the ground truth of a session, and the errors of the nominal arm."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from bayescal.dataset import Dataset, Target
from bayescal.effects import UNITS
from bayescal.model import Model
from bayescal.model.scene import Scene
from bayescal.simulation.options import Options
from bayescal.simulation.truth import draws

SCHEMA = "bayescal-truth/1"


def nominal_errors(dataset: Dataset) -> dict[tuple[str, ...], float]:
    """Error, m, of each certified distance measured by the nominal arm: centres fitted, diameters fixed."""
    p, rows = Scene(dataset).points, dataset.measurements
    radius = np.array([t.ball_radius for t in dataset.tools], float)[rows.tool]
    centres = {}
    for index, target in enumerate(dataset.targets):
        at = np.flatnonzero(rows.target == index)
        if target.kind != "sphere" or not len(at):
            continue
        centre = np.asarray(target.values["centre"], float)
        for _ in range(20):
            out = p[at] - centre
            length = np.linalg.norm(out, axis=1)
            off = length - (0.5 * float(target.values["diameter"]) + radius[at])
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
    options: Options,
    dataset: Dataset,
    model: Model,
    targets: Sequence[Target],
    gross: np.ndarray,
) -> dict[str, Any]:
    """The content of truth.json."""
    places = []
    for t in targets:
        place: dict[str, Any] = {"name": t.name, "kind": t.kind}
        for key, value in t.values.items():
            in_file = np.asarray(value, float) if key == "normal" else 1e3 * np.asarray(value, float)
            place[key if key == "normal" else f"{key}_mm"] = in_file.tolist()
        places.append(place)
    at = {t.name: np.asarray(t.values["centre"]) for t in targets if t.kind == "sphere"}
    errors = nominal_errors(dataset)
    distances = [
        {
            "between": list(pair),
            "certified_mm": next(1e3 * (c.distance or 0) for c in dataset.certificates if c.targets == pair),
            "true_mm": 1e3 * float(np.linalg.norm(at[pair[0]] - at[pair[1]])),
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
