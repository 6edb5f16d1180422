"""The run folder of a fit: `fit.json`, units in the keys, by the output contract, and the files beside it."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.assess.acceptance import Acceptance
from bayescal.assess.agreement import Agreement
from bayescal.assess.budget import COVERAGE, usual
from bayescal.assess.conformance import Tolerance, iso9283
from bayescal.calibration import Fit, ModelLevel
from bayescal.dataset import Dataset
from bayescal.exporting.hand_eye import hand_eye_records
from bayescal.exporting.robot import robot_text
from bayescal.fitted import gate
from bayescal.fitted.arm import of_fit
from bayescal.fitted.file import ARM_FILE, COPY, write_arm
from bayescal.model.model import length_blocks
from bayescal.posterior.inference import save
from bayescal.predict.crossvalidation import inside95, interval95
from bayescal.predict.forecast import Forecast
from bayescal.predict.validation import DiameterCheck, DistanceCheck, Errors, RowCheck
from bayescal.reporting.body import arm_drawing
from bayescal.reporting.figures import begun
from bayescal.reporting.fit import agreement_record, disagreement
from bayescal.reporting.fit.files import budget_csv, budget_record, fit_draws, parameter_draws
from bayescal.reporting.origin import LIBRARIES, by_target, entry, images_record, origin, plain, rows_record
from bayescal.reporting.page.build import KINDS, write_page
from bayescal.reporting.text import MDEG, MM, UM
from bayescal.statistics import rms
from bayescal.storage.files import json_text
from bayescal.storage.folders import put, whole

SCHEMA = "bayescal-fit/1"
SIZES = {"mean": "mean", "rms": "rms", "max": "maximum"}
"""Sizes of errors by what they are called in a key."""
NOISE = (
    *("group", "stated_um", "estimated_um=fitted", "repeats_um=repeats", "repeats_dof"),
    *("unexplained_um=excess", "unexplained_p_value=p_value"),
)
ISO9283 = ("symbol", "name=words", "count", "mean_um", "max_um=maximum", "u_mean_um=u", "u_max_um=u_max")
"""Fields of ``noise``, and of figures of ``iso9283``, where u is of the measurement, k = 1."""
LEVEL = (
    *("model=effects", "noise_estimated_um=unexplained.fitted", "unexplained_um=unexplained.excess"),
    *("heldout_planes_rms_um=validation.contacts.rms", "distance_rms_um=validation.distance_errors.rms"),
    "worst_distance_um=validation.distance_errors.maximum",
)
POINTS = ("points_mean_um=mean", "points_rms_um=rms")
"""Fields of model levels."""
UNDETERMINED = ("parameters", "combinations", "state", "lacks=changes", "left_rms_um=displacement", "words")
"""Fields of what is not determined."""
CORRELATED = 0.3
"""Least absolute correlation of two parameters of the arm that is stored."""


def fit_record(fit: Fit, compared: Agreement | None = None) -> dict[str, Any]:
    """The content of fit.json; `compared` is what the sessions of a joint fit say each by itself."""
    level, figures = fit.final, iso9283(fit.basis)
    record = {
        **origin(SCHEMA, fit.dataset, fit.options.seed, (*LIBRARIES, "emcee", "arviz")),
        "verdict": _verdict(fit.acceptance, fit.dataset),
        "use": gate.of_fit(fit).record(),
        "acceptance": None if fit.tolerance is None else _tolerance(fit.tolerance),
        **entry(fit, "model=final.effects", "without=options.omitted", "prior_width=options.prior_width"),
        "prior_widths": [entry(w, "family", "factor", "nats", "parameters") for w in fit.widths],
        "parameters": _parameters(fit),
        "correlations": _correlations(fit),
        "noise": entry(level.unexplained, *NOISE)
        | {"scale": {group: float(value) for group, value in level.estimate.weights.scale.items()}}
        | {"components": max((b.kind.rows for b in length_blocks(level.estimate.model)), default=1)},
        "discrepancy": {
            "residual_share": 1.0 - fit.stated.white,
            "families": [
                {"family": name, "parameter_share": share}
                for name, share in fit.stated.parameter_shares.items()
            ],
        },
        "residuals": list(_residuals(level)),
        "images": images_record(level.estimate),
        "hand_eye": hand_eye_records(of_fit(fit)),
        "rejected": [fit.dataset.measurements.ids[row] for row in level.estimate.rejected],
        "identifiability": {
            **entry(fit.identifiability, "singular_values"),
            "weak_directions": [
                entry(d, "singular_value", "words") | {"loadings": dict(d.loadings)}
                for d in fit.identifiability.weak
            ],
            **entry(fit.identifiability, "determined", "partly", "prior_only"),
            "undetermined": [entry(u, *UNDETERMINED) for u in fit.undetermined],
        },
        "faces": [entry(f, "target", "form_rms_um=form", "p_value", "uneven") for f in fit.faces],
        "predicted_distance": _forecast(fit.forecast),
        "directions": entry(fit.directions, "axes", "share", "missing"),
        "sampler": _sampler(fit),
        "iso9283": {
            "figures": [entry(f, *ISO9283) for f in figures.figures],
            "differs_from_norm": list(figures.differs),
        },
        "validation": _validation(fit),
        "ladder": [_level(r) for r in fit.levels],
        "findings": [entry(f, "code", "severity", "text") for f in fit.findings],
        "warnings": list(fit.warnings),
        "arm": arm_drawing(level.estimate.model.scene),
        "rows": rows_record(level.estimate),
    }
    if compared is not None:
        record["agreement"] = agreement_record(compared)
        record["warnings"] = [*fit.warnings, *disagreement(compared)]
    return record


def _parameters(fit: Fit) -> list[dict[str, Any]]:
    """``parameters``: of the arm, then of the targets."""
    model = fit.final.estimate.model
    units, factor = model.in_file_units()
    prior = np.concatenate([model.sd, *(b.sd for b in model.states)])
    draws = model.physical(fit.draws.flat) * factor
    of_targets = [0.0] * (model.size - len(model.parameters))
    nominal = np.array([*(p.nominal for p in model.parameters), *of_targets])
    centre = np.array([*(p.centre for p in model.parameters), *of_targets])
    columns = {
        "nominal": nominal * factor, "prior_mean": centre * factor,
        "estimate": model.physical(fit.final.estimate.z) * factor,
        "sd": [np.std(column) for column in draws.T],
        "sd_without_discrepancy": np.std(model.physical(fit.sampled.flat), axis=0) * factor,
        "prior_sd": prior * factor, "contraction": 1.0 - np.var(fit.draws.flat, axis=0),
        "interval95": np.quantile(draws, [0.025, 0.975], axis=0).T, "ess": fit.draws.ess,
        "ess_bulk": fit.draws.ess_bulk, "ess_tail": fit.draws.ess_tail, "rhat": fit.draws.rhat,
    }  # fmt: skip
    effects = [*(p.effect for p in model.parameters), *["target"] * len(of_targets)]
    return [
        {"name": name, "effect": effects[k], "unit": units[k]}
        | {key: plain(values[k]) for key, values in columns.items()}
        for k, name in enumerate(model.names)
    ]


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


def _residuals(level: ModelLevel) -> Iterator[dict[str, Any]]:
    for target, role, rows, residuals in by_target(level.estimate):
        kept = ~np.isin(rows, level.estimate.rejected)
        errors = Errors(np.linalg.norm(residuals, axis=0)[kept], np.empty((0, 0)))
        yield (
            {"target": target, "role": role, "count": len(rows), "rejected": int(np.sum(~kept))}
            | entry(errors, "rms_um", "max_um=maximum")
        )


def _forecast(forecast: Forecast) -> dict[str, Any]:
    """Distance errors to expect: first those that lead the summary, then all."""
    every = [
        entry(d, "over", "count")
        | {"lengths_mm": [MM * d.shortest, MM * d.longest]}
        | entry(d, "predicted_rms_um=u", "expanded_U_um=expanded", "k")
        | {"coverage": COVERAGE}
        | entry(d, "predicted_interval95_um=interval", "measured_rms_um=measured")
        for d in forecast.every
    ]
    shares = ("unexplained_share", "discrepancy_share", "masses_share")
    return every[0] | entry(forecast, "prior_share", "prior_rms_um", *shares) | {"all": every}


def _sampler(fit: Fit) -> dict[str, Any]:
    draws = fit.draws
    sd = np.std(draws.flat, axis=0)
    error = sd / np.sqrt(draws.ess_bulk[: len(sd)])
    return {
        **entry(draws, "moves", "acceptance"),
        "ensembles": len(draws.z),
        **entry(draws, "walkers", "steps"),
        "draws": len(draws.flat),
        "ess": {
            "min": float(draws.ess.min()),
            "of": draws.names[int(draws.ess.argmin())],
            "bulk_min": float(draws.ess_bulk.min()),
            "tail_min": float(draws.ess_tail.min()),
            "counted_on": "the draws of posterior.nc, rank-normalised (Vehtari et al. 2021)",
        },
        "rhat": {"max": plain(np.nanmax(draws.rhat)) if np.any(np.isfinite(draws.rhat)) else None},
        "monte_carlo_error": {"largest_over_sd": float(np.max(error / sd))},
        **entry(draws, "converged", "complaint"),
    }


def _ends(predicted: np.ndarray) -> list[float]:
    """Central 95 % interval of draws, µm."""
    return [float(UM * end) for end in interval95(predicted)]


def _validation(fit: Fit) -> dict[str, Any]:
    """``validation`` of the contract: validation measurements under the nominal and the calibrated arm.

    The standard uncertainty of the error of a distance is that of its budget.
    """
    nominal, calibrated = fit.levels[0].validation, fit.final.validation

    def errors(before: DistanceCheck | DiameterCheck, after: DistanceCheck | DiameterCheck) -> dict[str, Any]:
        return entry(before, "nominal_error_um=error") | entry(after, "calibrated_error_um=error")

    planes = [
        {"target": p.target, "role": "validate", "count": len(p.residuals)}
        | entry(n.errors, "nominal_rms_um=rms")
        | entry(p.errors, "calibrated_rms_um=rms", "calibrated_max_um=maximum")
        | {"predicted_rms_um": UM * rms(p.predicted)}
        | {"inside95_fraction": float(np.mean(inside95(p.residuals, p.predicted)))}
        for n, p in zip(nominal.planes, calibrated.planes, strict=True)
    ]
    distances = [
        entry(d, "between", "certified_mm")
        | errors(n, d)
        | {"predicted_sd_um": UM * fit.budgets[d.between].u}
        | _interval(d)
        for n, d in zip(nominal.distances, calibrated.distances, strict=True)
    ]
    diameters = [
        entry(d, "target", "certified_mm") | errors(n, d) | _interval(d)
        for n, d in zip(nominal.diameters, calibrated.diameters, strict=True)
    ]
    return {
        "planes": planes,
        "distances": distances,
        "diameters": diameters,
        "points": _sizes(calibrated.points, calibrated.point_lengths, "um", nominal.point_lengths),
        "orientations": _sizes(calibrated.turns, calibrated.turn_angles, "mdeg", None),
        "worst_distance_um": {
            "nominal": plain(UM * nominal.distance_errors.maximum),
            "calibrated": plain(UM * calibrated.distance_errors.maximum),
        },
    }


def _interval(d: DistanceCheck | DiameterCheck) -> dict[str, Any]:
    inside = bool(inside95(d.error, d.predicted))
    return {"predicted_interval95_um": _ends(d.predicted), "inside95": inside}


def _sizes(checks: Sequence[RowCheck], after: Errors, unit: str, before: Errors | None) -> dict[str, Any]:
    """Sizes of the errors of validation measurements of all targets: lengths (µm) or angles (mdeg)."""
    if not checks:
        return {"count": 0}
    factor = MDEG if unit == "mdeg" else UM
    inside = [inside95(c.residuals, c.predicted).ravel() for c in checks]
    nominal, interval = {}, {}
    if before is not None:
        nominal = entry(before, f"nominal_mean_{unit}=mean", f"nominal_max_{unit}=maximum")
        interval = {f"predicted_mean_interval95_{unit}": _ends(after.predicted.mean(axis=1))}
    return {
        "count": len(after.values),
        **nominal,
        **entry(after, *(f"calibrated_{of}_{unit}={name}" for of, name in SIZES.items())),
        f"predicted_mean_{unit}": factor * float(after.predicted.mean()),
        **interval,
        f"predicted_upper95_{unit}": factor * float(np.quantile(after.predicted, 0.95)),
        "inside95_fraction": float(np.mean(np.concatenate(inside))),
    }


def _level(level: ModelLevel) -> dict[str, Any]:
    ends = UM * level.validation.distance_errors.interval95 if level.validation.distances else None
    interval = {"predicted_distance_interval95_um": plain(ends)}
    return entry(level, *LEVEL) | interval | entry(level.validation.point_lengths, *POINTS)


def _verdict(tests: Acceptance, dataset: Dataset) -> dict[str, Any]:
    """``verdict``: the word, the tests that fail (`reasons`) and all of them, shared causes of rejections."""
    check = ("test", "value", "limit", "p=p_value", "level", "words")
    return {
        "words": tests.verdict,
        **entry(tests, "explains", "validated", "determined"),
        "reasons": [entry(c, *check) for c in tests.failed],
        "doubts": [entry(c, *check) for c in tests.doubts],
        "tests": [entry(c, *check) for c in tests.checks],
        "shared_causes": [
            entry(cause, "kind", "label")
            | {"rows": [dataset.measurements.ids[row] for row in cause.rows]}
            | entry(cause, "rows_in_group=size", "rejected", "count", "p=p_value")
            for cause in tests.causes
        ],
    }


def _tolerance(decided: Tolerance) -> dict[str, Any]:
    """``acceptance``: decisions by ISO 14253-1 on a tolerance of distance errors."""
    return {
        "rule": "ISO 14253-1: PASS where abs(error) + U <= tolerance, FAIL where abs(error) - U > tolerance",
        **entry(decided, "tolerance_mm", "k"),
        "coverage": COVERAGE,
        **entry(decided, "decision", "why"),
        "volume": entry(decided, "probability", "U_um=expanded"),
        "distances": [
            entry(d, "between", "error_um", "U_um=expanded", "k", "probability", "decision")
            for d in decided.distances
        ],
    }


FIT, ROBOT = "fit.json", "robot.yaml"
BUDGET, BUDGET_CSV = "budget.json", "budget.csv"


def write_fit(
    fit: Fit, folder: Path, contents: Mapping[str, Any], pictures: bool = True, shown: Path | None = None,
    more: Mapping[str, bytes] | None = None,
) -> tuple[str, ...]:  # fmt: skip
    """Write fit.json, report.html, posterior.nc, budgets, robot.yaml, arm.json, dataset, figures atomically.

    Parameters
    ----------
    fit : Fit
    folder : Path
        Where they are written; an earlier fit there is replaced.
    contents : mapping
        The content of fit.json.
    pictures : bool
        Draw the figures too.
    shown : Path, optional
        Where the folder will be, for the page; default: `folder`.
    more : mapping of str to bytes
        Contents of further files by their names.

    Returns
    -------
    tuple of str
        Names of the files and of the folder of the dataset.
    """
    arm, posterior = of_fit(fit), "posterior.nc"
    with whole(folder, FIT) as stage:
        drawn = begun(contents, parameter_draws(fit)) if pictures else dict
        budgets = usual(fit.basis)
        texts = {
            FIT: json_text(contents, rows=False),
            ROBOT: robot_text(arm, FIT),
            BUDGET: json_text(budget_record(budgets, fit.basis, fit.options.seed)),
            BUDGET_CSV: budget_csv(budgets),
        }
        put(stage, texts)
        save(fit_draws(fit), stage / posterior)
        write_arm(arm, stage, {"hand_eye": contents["hand_eye"]})
        figures = put(stage, {**drawn(), **(more or {})})
        write_page(stage, shown or folder)  # with the figures
    return (FIT, KINDS["fit"][0], posterior, BUDGET, BUDGET_CSV, ROBOT, ARM_FILE, COPY, *figures)
