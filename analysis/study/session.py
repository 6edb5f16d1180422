"""A session of the study: simulate, calibrate, compare with the ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bayescal.calibration import VALIDATION_DRAWS, Fit, fit
from bayescal.errors import BayescalError
from bayescal.model.options import FitOptions
from bayescal.posterior.sample import sample
from bayescal.predict.validation import Validation, validate
from bayescal.simulation import Options, Simulation, simulate

MODEL = ("geometry", "compliance")
LEVELS = ("nominal", "joint offsets", "geometry", "geometry + compliance")
"""Model levels of a fit with `MODEL`, in order."""
SUMS = (("d2", "d3"),)
"""Parameters of which only the sum is identifiable (parallel axes 2 and 3), by the names of a LR Mate."""
EFFECTIVE = 4000  # draws of every parameter where emcee is run too
UM = 1e6

Record = dict[str, Any]


@dataclass(frozen=True)
class Quantities:
    """Identifiable quantities of the arm: parameters, and sums where only the sum is identifiable.

    `matrix` (Q, P) computes them from the arm's parameters, SI.
    """

    names: tuple[str, ...]
    matrix: np.ndarray

    @classmethod
    def of(cls, parameters: tuple[str, ...]) -> Quantities:
        """Quantities of the named parameters."""
        names, rows, unit = [], [], np.eye(len(parameters))
        for k, name in enumerate(parameters):
            own = next((pair for pair in SUMS if name in pair), None)
            if own is None:
                names.append(name)
                rows.append(unit[k])
            elif name == own[0]:
                names.append(" + ".join(own))
                rows.append(sum(unit[parameters.index(part)] for part in own))
        return cls(tuple(names), np.array(rows))


def true_values(simulation: Simulation) -> dict[str, float]:
    """True values of the arm's parameters, SI, in the model's own parametrisation."""
    model = simulation.world.model(simulation.dataset)
    values = simulation.world.deviations(model)
    return {p.name: p.nominal + float(v) for p, v in zip(model.parameters, values, strict=True)}


def run(options: Options, with_emcee: bool = False) -> Record:
    """Simulate a session, calibrate it with the Gaussian posterior, and compare with the ground truth.

    For a session that cannot be laid out (no place for the spheres), the record contains only the reason.
    """
    try:
        simulation = simulate(options)
    except BayescalError as error:
        return {"seed": options.seed, "refused": str(error)}
    fitted = fit(simulation.dataset, MODEL, FitOptions(seed=options.seed), samples=0)
    record = compared(simulation, fitted)
    if with_emcee:
        record["emcee"] = agreement(fitted, options.seed)
    return record


def compared(simulation: Simulation, fitted: Fit) -> Record:
    """Compare a fit with the truth: z-scores, quantiles of the truth in predictive distributions, errors."""
    truth = true_values(simulation)
    found = fitted.final.estimate
    arm = [k for k, p in enumerate(found.model.parameters) if p.name in truth]
    parameters = tuple(found.model.parameters[k].name for k in arm)
    told = Quantities.of(parameters)
    scale = np.concatenate([found.model.sd, *(b.sd for b in found.model.blocks)])[arm]
    to_told = told.matrix * scale
    off = told.matrix @ (found.model.physical(found.z)[arm] - [truth[name] for name in parameters])
    covariance = to_told @ found.covariance[np.ix_(arm, arm)] @ to_told.T
    sd = np.sqrt(np.diag(covariance))
    drawn = found.model.physical(fitted.draws.flat)[:, arm] @ told.matrix.T
    exact = told.matrix @ [truth[name] for name in parameters]
    v = fitted.final.validation
    return {
        "seed": fitted.options.seed,
        "names": list(told.names),
        "z": (off / sd).tolist(),
        "independent_z": np.linalg.solve(np.linalg.cholesky(covariance), off).tolist(),
        "contraction": (1.0 - sd**2 / np.sum(to_told**2, axis=1)).tolist(),
        "pit": np.mean(drawn < exact, axis=0).tolist(),
        "least_compliance_urad_per_nm": UM * min(v for k, v in truth.items() if k.startswith("compliance")),
        "noise_scale": float(found.weights.scale["contact"]),
        "rejected": {r: len(step.estimate.rejected) for r, step in zip(LEVELS, fitted.levels, strict=True)},
        "contacts": sum(len(block.rows) for block in found.model.blocks),
        "uneven_faces": sum(face.uneven for face in fitted.faces),
        "unexplained_um": UM * fitted.final.unexplained.excess,
        "distance_error_um": {
            level: [UM * d.error for d in step.validation.distances]
            for level, step in zip(LEVELS, fitted.levels, strict=True)
        },
        "distance_sd_um": [UM * float(np.std(d.predicted)) for d in v.distances],
        "distance_pit": [_place(d.error, d.predicted) for d in v.distances],
        "diameter_error_um": [UM * d.error for d in v.diameters],
        "diameter_sd_um": [UM * float(np.std(d.predicted)) for d in v.diameters],
        "diameter_pit": [_place(d.error, d.predicted) for d in v.diameters],
        "contact_pit": np.concatenate(
            [np.mean(p.predicted < p.residuals, axis=0) for p in v.planes]
        ).tolist(),
    }


def _place(value: float, predicted: np.ndarray) -> float:
    """Share of the predictive draws (S,) below a value: uniform over 0 to 1 where the prediction is right."""
    return float(np.mean(predicted < value))


def agreement(fitted: Fit, seed: int) -> Record:
    """Compare the posterior sampled by emcee with its Gaussian approximation."""
    found = fitted.final.estimate
    drawn = sample(found, EFFECTIVE, seed)
    arm = [k for k, p in enumerate(found.model.parameters) if p.name not in sum(SUMS, ())]
    shift = (drawn.flat.mean(axis=0) - found.z) / found.sd
    ratio = drawn.flat.std(axis=0) / found.sd
    pick = np.linspace(0, len(drawn.flat) - 1, VALIDATION_DRAWS).astype(int)
    checked = validate(found, drawn.flat[pick], drawn.kappa[pick], fitted.final.unexplained.excess, seed)
    wider = _distance_sd(checked) / _distance_sd(fitted.final.validation)
    return {
        "seed": seed,
        "converged": drawn.converged,
        "least_ess": float(drawn.ess.min()),
        "largest_rhat": float(np.nanmax(drawn.rhat)),
        "acceptance": drawn.acceptance,
        "largest_shift_over_sd": float(np.max(np.abs(shift[arm]))),
        "sd_ratio": [float(ratio[arm].min()), float(ratio[arm].max())],
        "distance_sd_ratio": [float(wider.min()), float(wider.max())],
        "distance_inside_by_both": float(np.mean(_inside(checked) == _inside(fitted.final.validation))),
    }


def _distance_sd(v: Validation) -> np.ndarray:
    return np.array([np.std(d.predicted) for d in v.distances])


def _inside(v: Validation) -> np.ndarray:
    return np.array([abs(_place(d.error, d.predicted) - 0.5) <= 0.475 for d in v.distances])
