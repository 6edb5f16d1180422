"""The ground truth of a test session: hidden effects, their detectability, and the distance errors."""

from __future__ import annotations

import numpy as np

from bayescal.world import scene, visible
from bayescal.world.size import second_order, wrong_masses
from bayescal.world.touch import World


def told(
    world: World, model: visible.Fitted, found: list, quiet: np.ndarray, sigma: float, noise: np.ndarray
) -> dict:
    """Return hidden effects, their detectability, and the distance errors."""
    still, count = world.gap(quiet), int(np.sum(world.session.phase == 0))
    acts = [(act, size) for act, size, _ in found]
    shift = world.gap(quiet, acts) - still if acts else np.zeros(len(quiet))
    each = {act.name: note["value"] for act, _, note in found}
    free, certificates = (float(np.sum(model.left(shift, sigma, p) ** 2)) for p in (False, True))
    wrong = wrong_masses(world, model, quiet, sigma)
    rows, sc, out = world.session.phase == 0, world.scene, {}
    certified = dict(zip(scene.pairs(), sc.certified, strict=True))
    certificate_error = np.array(
        [np.linalg.norm(sc.ball[i] - sc.ball[j]) - certified[i, j] for i, j in visible.validating(world)]
    )
    cases = {"oracle": (noise, None), "fit_without_effect": (noise, rows), "baseline": (noise - shift, rows)}
    for label, (data, fit) in cases.items():
        errors = visible.distances(world, model, data, sigma, fit) + certificate_error
        out[label] = 1e6 * float(np.sqrt(np.mean(errors**2)))
    only = visible.distances(world, model, -shift, sigma, rows)
    out["baseline_noise_free"] = 1e6 * float(np.sqrt(np.mean(only**2)))
    rms = {act.name: 1e6 * sigma * np.sqrt(note["value"] / count) for act, _, note in found}
    return {
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
