"""`fit.json`: a calibration in numbers, units in the keys, by the output contract."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayescal.assess.budget import COVERAGE, Budget
from bayescal.assess.iso9283 import iso9283
from bayescal.assess.undetermined import Undetermined
from bayescal.calibration import Fit, ModelLevel
from bayescal.estimate import Estimate
from bayescal.fitted import gate
from bayescal.model import Block
from bayescal.predict import Forecast, RowCheck, Validation, inside95, interval95
from bayescal.reporting.fit.agreement import iso9283_record
from bayescal.reporting.fit.tables import tolerance_record, verdict_record
from bayescal.reporting.shared.body import arm_drawing
from bayescal.reporting.shared.origin import origin, rows_record
from bayescal.reporting.shared.text import MDEG, MM, UM

SCHEMA = "bayescal-fit/1"
LIBRARIES = ("gtsam", "numpy", "scipy", "numba", "emcee", "arviz")
CORRELATED = 0.3
"""Least absolute correlation of two parameters of the arm that is stored."""


def fit_record(fit: Fit) -> dict[str, Any]:
    """The contents of fit.json."""
    level = fit.final
    return {
        **origin(SCHEMA, fit.dataset, fit.options.seed, LIBRARIES),
        "verdict": verdict_record(fit.acceptance, fit.dataset),
        "use": gate.of_fit(fit).record(),
        "acceptance": None if fit.tolerance is None else tolerance_record(fit.tolerance),
        "model": list(level.effects),
        "prior_width": fit.options.prior_width,
        "parameters": _parameters(fit),
        "correlations": _correlations(fit),
        "noise": _noise(level),
        "discrepancy": _discrepancy(fit),
        "residuals": _residuals(level),
        "rejected": [fit.dataset.measurements.ids[row] for row in level.estimate.rejected],
        "identifiability": {
            "singular_values": _numbers(fit.identifiability.singular_values),
            "weak_directions": [
                {"singular_value": d.singular_value, "words": d.words, "loadings": dict(d.loadings)}
                for d in fit.identifiability.weak
            ],
            "determined": list(fit.identifiability.determined),
            "partly": list(fit.identifiability.partly),
            "prior_only": list(fit.identifiability.prior_only),
            "undetermined": [_undetermined(u) for u in fit.undetermined],
        },
        "faces": [
            {"target": f.target, "form_rms_um": UM * f.form, "p_value": f.p_value, "uneven": f.uneven}
            for f in fit.faces
        ],
        "predicted_distance": _forecast(fit.forecast),
        "directions": {
            "axes": fit.directions.axes.tolist(),
            "share": _numbers(fit.directions.share),
            "missing": fit.directions.missing.tolist(),
        },
        "sampler": _sampler(fit),
        "iso9283": iso9283_record(iso9283(fit.basis)),
        "validation": validation_record(fit.levels[0].validation, level.validation, fit.budgets),
        "ladder": [_level(r) for r in fit.levels],
        "findings": [{"code": f.code, "severity": f.severity, "text": f.text} for f in fit.findings],
        "warnings": list(fit.warnings),
        "arm": arm_drawing(level.estimate.model.scene),
        "rows": rows_record(level.estimate),
    }


def _undetermined(u: Undetermined) -> dict[str, Any]:
    """What is not determined, with what would determine it."""
    return {
        "parameters": list(u.parameters),
        "combinations": u.combinations,
        "state": u.state,
        "lacks": list(u.changes),
        "left_rms_um": UM * u.left,
        "words": u.words,
    }


def _numbers(values: np.ndarray) -> list[float]:
    return [float(v) for v in values]


def _parameters(fit: Fit) -> list[dict[str, Any]]:
    found, model = fit.final.estimate, fit.final.estimate.model
    units, factor = model.in_file_units()
    prior = np.concatenate([model.sd, *(b.sd for b in model.states)]) * factor
    draws = model.physical(fit.draws.flat) * factor
    at = model.physical(found.z) * factor
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    variance = np.var(fit.draws.flat, axis=0)
    plain = np.std(model.physical(fit.sampled.flat), axis=0) * factor
    out = []
    for k, name in enumerate(model.names):
        arm = model.parameters[k] if k < len(model.parameters) else None
        out.append(
            {
                "name": name,
                "effect": arm.effect if arm else "target",
                "unit": units[k],
                "nominal": float(arm.nominal * factor[k]) if arm else 0.0,
                "prior_mean": float(arm.centre * factor[k]) if arm else 0.0,
                "estimate": float(at[k]),
                "sd": float(np.std(draws[:, k])),
                "sd_without_discrepancy": float(plain[k]),
                "prior_sd": float(prior[k]),
                "contraction": float(1.0 - variance[k]),
                "interval95": [float(low[k]), float(high[k])],
                "ess": float(fit.draws.ess[k]),
                "ess_bulk": float(fit.draws.ess_bulk[k]),
                "ess_tail": float(fit.draws.ess_tail[k]),
                "rhat": _finite(fit.draws.rhat[k]),
            }
        )
    return out


def _correlations(fit: Fit) -> list[dict[str, Any]]:
    """Pairs of parameters of the arm with a correlation of at least `CORRELATED`, the strongest first."""
    model = fit.final.estimate.model
    size = len(model.parameters)
    if size < 2:
        return []
    r = np.corrcoef(fit.draws.flat[:, :size].T)
    pairs = [(i, j) for i in range(size) for j in range(i) if abs(r[i, j]) >= CORRELATED]
    pairs.sort(key=lambda pair: -abs(r[pair]))
    return [{"a": model.names[j], "b": model.names[i], "r": round(float(r[i, j]), 4)} for i, j in pairs]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _noise(level: ModelLevel) -> dict[str, Any]:
    left, found = level.unexplained, level.estimate
    return {
        "group": left.group,
        "stated_um": UM * left.stated,
        "estimated_um": UM * left.fitted,
        "repeats_um": None if left.repeats is None else UM * left.repeats,
        "repeats_dof": left.repeats_dof,
        "unexplained_um": UM * left.excess,
        "unexplained_p_value": left.p_value,
        "scale": {group: float(scale) for group, scale in found.weights.scale.items()},
    }


def _discrepancy(fit: Fit) -> dict[str, Any]:
    """Shares of the variance of residuals, and of stated variances of parameters by family, masses too."""
    return {
        "residual_share": 1.0 - fit.stated.white,
        "families": [
            {"family": name, "parameter_share": share} for name, share in fit.stated.parameter_shares.items()
        ],
    }


def _residuals(level: ModelLevel) -> list[dict[str, Any]]:
    found = level.estimate
    scene, out = found.model.scene, []
    for k, target in enumerate(scene.dataset.targets):
        for role in ("calibrate", "validate"):
            rows = scene.rows_of(k, scene.rows(role))
            if target.name not in found.model.block_of or not len(rows):
                continue
            size = _sizes(found, found.model.block(k, rows))
            kept = ~np.isin(rows, found.rejected)
            out.append(
                {
                    "target": target.name,
                    "role": role,
                    "count": len(rows),
                    "rejected": int(np.sum(~kept)),
                    "rms_um": UM * float(np.sqrt(np.mean(size[kept] ** 2))) if np.any(kept) else None,
                    "max_um": UM * float(np.max(size[kept])) if np.any(kept) else None,
                }
            )
    return out


def _sizes(found: Estimate, block: Block) -> np.ndarray:
    return np.linalg.norm(found.residuals(block), axis=0)


def _forecast(forecast: Forecast) -> dict[str, Any]:
    """Distance errors to expect: first those that lead the summary, then all."""
    every = [
        {
            "over": d.over,
            "count": d.count,
            "lengths_mm": [MM * d.shortest, MM * d.longest],
            "predicted_rms_um": UM * d.u,
            "expanded_U_um": UM * d.expanded,
            "k": d.k,
            "coverage": COVERAGE,
            "predicted_interval95_um": [UM * end for end in d.interval],
            "measured_rms_um": None if d.measured is None else UM * d.measured,
        }
        for d in forecast.every
    ]
    return {
        **every[0],
        "prior_share": forecast.prior_share,
        "prior_rms_um": UM * forecast.prior_rms,
        "unexplained_share": forecast.unexplained_share,
        "discrepancy_share": forecast.discrepancy_share,
        "masses_share": forecast.masses_share,
        "all": every,
    }


def _sampler(fit: Fit) -> dict[str, Any]:
    draws = fit.draws
    sd = np.std(draws.flat, axis=0)
    error = sd / np.sqrt(draws.ess_bulk[: len(sd)])
    return {
        "moves": draws.moves,
        "acceptance": draws.acceptance,
        "ensembles": int(draws.z.shape[0]),
        "walkers": draws.walkers,
        "steps": draws.steps,
        "draws": len(draws.flat),
        "ess": {
            "min": float(draws.ess.min()),
            "of": draws.names[int(draws.ess.argmin())],
            "bulk_min": float(draws.ess_bulk.min()),
            "tail_min": float(draws.ess_tail.min()),
            "counted_on": "the draws of posterior.nc, rank-normalised (Vehtari et al. 2021)",
        },
        "rhat": {"max": _finite(np.nanmax(draws.rhat)) if np.any(np.isfinite(draws.rhat)) else None},
        "monte_carlo_error": {"largest_over_sd": float(np.max(error / sd))},
        "converged": draws.converged,
        "complaint": draws.complaint,
    }


def ends(predicted: np.ndarray, factor: float) -> list[float]:
    """Central 95 % interval of draws, times a factor."""
    low, high = interval95(predicted)
    return [float(factor * low), float(factor * high)]


def validation_record(
    nominal: Validation, calibrated: Validation, budgets: Mapping[tuple[str, str], Budget]
) -> dict[str, Any]:
    """``validation`` of the contract: validation measurements under the nominal and the calibrated arm.

    The standard uncertainty of the error of a distance is that of its budget.
    """
    planes = [
        {
            "target": p.target,
            "role": "validate",
            "count": len(p.residuals),
            "nominal_rms_um": UM * _rms(n.residuals),
            "calibrated_rms_um": UM * _rms(p.residuals),
            "calibrated_max_um": UM * float(np.max(np.abs(p.residuals))),
            "predicted_rms_um": UM * float(np.sqrt(np.mean(p.predicted**2))),
            "inside95_fraction": float(np.mean(inside95(p.residuals, p.predicted))),
        }
        for n, p in zip(nominal.planes, calibrated.planes, strict=True)
    ]
    distances = []
    for n, d in zip(nominal.distances, calibrated.distances, strict=True):
        distances.append(
            {
                "between": list(d.between),
                "certified_mm": MM * d.certified,
                "nominal_error_um": UM * n.error,
                "calibrated_error_um": UM * d.error,
                "predicted_sd_um": UM * budgets[d.between].u,
                "predicted_interval95_um": ends(d.predicted, UM),
                "inside95": bool(inside95(d.error, d.predicted)),
            }
        )
    diameters = []
    for before, after in zip(nominal.diameters, calibrated.diameters, strict=True):
        diameters.append(
            {
                "target": after.target,
                "certified_mm": MM * after.certified,
                "nominal_error_um": UM * before.error,
                "calibrated_error_um": UM * after.error,
                "predicted_interval95_um": ends(after.predicted, UM),
                "inside95": bool(inside95(after.error, after.predicted)),
            }
        )
    return {
        "planes": planes,
        "distances": distances,
        "diameters": diameters,
        "points": _points(nominal.points, calibrated.points),
        "orientations": _turns(calibrated.turns),
        "worst_distance_um": {
            "nominal": _or_none(UM * nominal.maximum_distance_error),
            "calibrated": _or_none(UM * calibrated.maximum_distance_error),
        },
    }


def _or_none(value: float) -> float | None:
    return None if np.isnan(value) else value


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _points(nominal: tuple[RowCheck, ...], calibrated: tuple[RowCheck, ...]) -> dict[str, Any]:
    """Lengths of the residual vectors of validation points, of all targets."""
    if not calibrated:
        return {"count": 0}
    before = np.concatenate([np.linalg.norm(p.residuals, axis=0) for p in nominal])
    after = np.concatenate([np.linalg.norm(p.residuals, axis=0) for p in calibrated])
    lengths = np.concatenate([np.linalg.norm(p.predicted, axis=1) for p in calibrated], axis=1)
    flat = np.concatenate([p.residuals.ravel() for p in calibrated])
    drawn = np.concatenate([p.predicted.reshape(len(p.predicted), -1) for p in calibrated], axis=1)
    return {
        "count": len(after),
        "nominal_mean_um": UM * float(before.mean()),
        "nominal_max_um": UM * float(before.max()),
        "calibrated_mean_um": UM * float(after.mean()),
        "calibrated_rms_um": UM * _rms(after),
        "calibrated_max_um": UM * float(after.max()),
        "predicted_mean_um": UM * float(lengths.mean()),
        "predicted_mean_interval95_um": ends(lengths.mean(axis=1), UM),
        "predicted_upper95_um": UM * float(np.quantile(lengths, 0.95)),
        "inside95_fraction": float(np.mean(inside95(flat, drawn))),
    }


def _turns(checks: tuple[RowCheck, ...]) -> dict[str, Any]:
    """Angles between measured and predicted orientations of validation measurements, of all targets."""
    if not checks:
        return {"count": 0}
    angles = np.concatenate([np.linalg.norm(c.residuals, axis=0) for c in checks])
    drawn = np.concatenate([np.linalg.norm(c.predicted, axis=1) for c in checks], axis=1)
    inside = np.concatenate([inside95(c.residuals, c.predicted).ravel() for c in checks])
    return {
        "count": len(angles),
        "calibrated_mean_mdeg": MDEG * float(angles.mean()),
        "calibrated_rms_mdeg": MDEG * _rms(angles),
        "calibrated_max_mdeg": MDEG * float(angles.max()),
        "predicted_mean_mdeg": MDEG * float(drawn.mean()),
        "predicted_upper95_mdeg": MDEG * float(np.quantile(drawn, 0.95)),
        "inside95_fraction": float(np.mean(inside)),
    }


def _level(level: ModelLevel) -> dict[str, Any]:
    v = level.validation
    planes = [p.residuals for p in v.planes]
    distances = np.array([d.error for d in v.distances])
    predicted = np.array([d.predicted for d in v.distances])
    points = [np.linalg.norm(p.residuals, axis=0) for p in v.points]
    return {
        "model": list(level.effects),
        "noise_estimated_um": UM * level.unexplained.fitted,
        "unexplained_um": UM * level.unexplained.excess,
        "heldout_planes_rms_um": UM * _rms(np.concatenate(planes)) if planes else None,
        "distance_rms_um": UM * _rms(distances) if len(distances) else None,
        "worst_distance_um": _or_none(UM * v.maximum_distance_error),
        "predicted_distance_interval95_um": ends(predicted.ravel(), UM) if len(distances) else None,
        "points_mean_um": UM * float(np.mean(np.concatenate(points))) if points else None,
        "points_rms_um": UM * _rms(np.concatenate(points)) if points else None,
    }
