"""`posterior.nc`: a calibration's draws, predictions and data as an ArviZ record."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayescal import __version__
from bayescal.calibration import Fit
from bayescal.posterior.inference import Variables, inference_data


def variable(name: str) -> str:
    """A parameter's name as a variable's: no blanks."""
    return name.replace(" ", "_")


def fit_inference_data(fit: Fit) -> Any:
    """The record of a fit: parameters in the files' units, one variable each."""
    rung, draws = fit.final, fit.draws
    model, scene = rung.estimate.model, rung.estimate.model.scene
    unit_names, factor = model.in_file_units()
    values = model.physical(draws.z) * factor
    names = [variable(name) for name in model.names]
    units = dict(zip(names, unit_names, strict=True))
    posterior: dict[str, tuple[tuple[str, ...], np.ndarray]] = {
        name: ((), values[..., k]) for k, name in enumerate(names)
    }
    posterior["noise_scale"] = ((), np.exp(draws.log_kappa))
    predictive, observed, coords = _predictions(fit)
    rows = scene.rows("calibrate")
    m = scene.dataset.measurements
    coords |= {
        "contact": np.array(m.ids)[rows],
        "joint": list(scene.dataset.robot.joint_names),
    }
    observed["residual_um"] = (("contact",), _residuals(fit, rows) * 1e6)
    constant: dict[str, tuple[tuple[str, ...], np.ndarray]] = {
        "reading_deg": (("contact", "joint"), np.degrees(m.readings[rows])),
        "target": (("contact",), np.array([t.name for t in scene.dataset.targets])[m.target[rows]]),
        "rejected": (("contact",), np.isin(rows, rung.estimate.rejected).astype(np.int8)),
    }
    groups: dict[str, Variables] = {
        "posterior": posterior,
        "sample_stats": {"lp": ((), draws.log_density)},
        "posterior_predictive": predictive,
        "observed_data": observed,
        "constant_data": constant,
    }
    attrs = {
        "dataset": fit.dataset.name,
        "dataset_sha256": fit.dataset.sha256,
        "model": ",".join(rung.effects),
        "seed": str(fit.seed),
        "inference_library": "emcee" if draws.acceptance else "gaussian approximation",
        "creation_library": f"bayescal {__version__}",
    }
    suffixed = {name: name.rsplit("_", 1)[1] for name in (*predictive, *observed, "reading_deg")}
    return inference_data({k: v for k, v in groups.items() if v}, coords, units | suffixed, attrs)


def _predictions(fit: Fit) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Sphere distances and held-out residuals: draws (chain, draw, ...), what was measured, labels."""
    v = fit.final.validation
    scene = fit.final.estimate.model.scene
    ids, m = np.array(fit.dataset.measurements.ids), fit.dataset.measurements
    index = {t.name: k for k, t in enumerate(fit.dataset.targets)}
    held = scene.rows("validate")
    predictive: dict[str, Any] = {}
    observed: dict[str, Any] = {}
    coords: dict[str, Any] = {}
    if v.distances:
        coords["pair"] = ["|".join(d.between) for d in v.distances]
        drawn = np.stack([d.error - d.predicted + d.certified for d in v.distances], axis=-1)
        predictive["distance_mm"] = (("pair",), _chains(fit, 1e3 * drawn))
        observed["distance_mm"] = (("pair",), 1e3 * np.array([d.certified for d in v.distances]))
    if v.planes:
        coords["heldout"] = np.concatenate([ids[held[m.target[held] == index[p.target]]] for p in v.planes])
        drawn = np.concatenate([p.predicted for p in v.planes], axis=1)
        predictive["heldout_um"] = (("heldout",), _chains(fit, 1e6 * drawn))
        observed["heldout_um"] = (("heldout",), 1e6 * np.concatenate([p.residuals for p in v.planes]))
    if v.points:
        coords["point"] = np.concatenate([ids[held[m.target[held] == index[p.target]]] for p in v.points])
        coords["axis"] = ["x", "y", "z"]
        drawn = np.concatenate([np.swapaxes(p.predicted, 1, 2) for p in v.points], axis=1)
        predictive["point_um"] = (("point", "axis"), _chains(fit, 1e6 * drawn))
        observed["point_um"] = (("point", "axis"), 1e6 * np.concatenate([p.residuals.T for p in v.points]))
    return predictive, observed, coords


def _chains(fit: Fit, drawn: np.ndarray) -> np.ndarray:
    """Draws (S, ...) as (chain, draw, ...): the validation took them evenly out of the chains in turn."""
    chains = fit.draws.z.shape[0]
    each = len(drawn) // chains
    return drawn[: chains * each].reshape(chains, each, *drawn.shape[1:])


def _residuals(fit: Fit, rows: np.ndarray) -> np.ndarray:
    """Length of each fitted row's residual at the estimate, (C,), m; signed where it has one residual."""
    found, out = fit.final.estimate, np.full(len(rows), np.nan)
    for block in found.model.states:
        r = found.residuals(block)
        out[np.searchsorted(rows, block.rows)] = r[0] if len(r) == 1 else np.linalg.norm(r, axis=0)
    return out
