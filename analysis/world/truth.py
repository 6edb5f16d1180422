"""The ground truth of a test session: hidden effects, their detectability, and the distance errors."""

from __future__ import annotations

import numpy as np

from analysis.world import validation, visible
from analysis.world.session import TRACKER
from analysis.world.size import second_order, wrong_masses
from analysis.world.touch import World


def told(
    world: World, model: visible.Fitted, found: list, quiet: np.ndarray, sigma: float, noise: np.ndarray
) -> dict:
    """Return hidden effects, their detectability, and the distance errors."""
    still, rows = world.gap(quiet), model.used
    acts = [(act, size) for act, size, _ in found]
    shift = world.gap(quiet, acts) - still if acts else np.zeros(len(still))
    each = {act.name: note["value"] for act, _, note in found}
    free, certificates = (float(np.sum(model.left(shift, sigma, p) ** 2)) for p in (False, True))
    wrong = wrong_masses(world, model, quiet, sigma)
    certificate_error, out, points = validation.certificate_errors(world), {}, {}
    cases = {"oracle": (noise, None), "fit_without_effect": (noise, rows), "baseline": (noise - shift, rows)}
    for label, (data, fit) in cases.items():
        rest = data if fit is None else data - model.absorbed(data, sigma, fit)
        errors = validation.distances(world, model, rest, still) + certificate_error
        out[label], points[label] = _rms_um(errors), _rms_um(rest[~rows])
    only = validation.distances(world, model, -shift + model.absorbed(shift, sigma, rows), still)
    out["baseline_noise_free"] = _rms_um(only)
    rms = {act.name: 1e6 * sigma * np.sqrt(note["value"] / np.sum(rows)) for act, _, note in found}
    more = {"point_rms_um": points} if world.session.stage == TRACKER else {}
    return more | {
        "effects": [act.name for act, _, _ in found],
        "outside": None,
        "form": {act.name: act.form for act, _, _ in found},
        "where": [w for act, _, _ in found for w in act.where],
        "lambda": {
            "value": min(each.values(), default=0.0),
            "each": each,
            "free_planes": free,
            "with_certificates": certificates,
            "unknown_masses": wrong,
            "second_order": second_order(world, model, quiet, sigma),
        },
        "lambda_goal": {act.name: note["goal"] for act, _, note in found},
        "capped": {act.name: note["capped"] for act, _, note in found},
        "amplitude": {
            a.name: {"value": s, "unit": a.unit, "visible_rms_um": rms[a.name]} for a, s, _ in found
        },
        "effect_parameters": {act.name: act.detail for act, _, _ in found},
        "distance_rms_um": out,
    }


def _rms_um(errors: np.ndarray) -> float:
    return 1e6 * float(np.sqrt(np.mean(errors**2)))
