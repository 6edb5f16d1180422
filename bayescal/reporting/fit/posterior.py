"""`posterior.nc`: a calibration's draws, predictions and data as an ArviZ record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayescal import __version__
from bayescal.calibration import Fit, predicted_draws
from bayescal.model import Model
from bayescal.model.model import noise_groups
from bayescal.posterior import Pointwise, pointwise, prior_draws
from bayescal.posterior.inference import Record, Variables
from bayescal.posterior.linearised import scale_names
from bayescal.predict.validation import RowCheck
from bayescal.reporting.shared.text import MM, UM

MOST_VALUES = 1_000_000
"""Log likelihoods of single rows that are kept at most: with more rows, of fewer draws."""
FEWEST_DRAWS = 500
"""Of each chain, up to `MOST_OF_LARGE` values."""
MOST_OF_LARGE, FEWEST_OF_LARGE = 4_000_000, 25
"""The same of sessions that have more with `FEWEST_DRAWS`: of more than 2000 rows."""
PRIOR_CHAINS, PRIOR_DRAWS = 4, 500
REPLICATED = 0x5EED
"""Word of the seed of replicated data."""

Labelled = dict[str, tuple[tuple[str, ...], np.ndarray]]


def variable(name: str) -> str:
    """A parameter's name as a variable's: no blanks, and no slash, which divides groups in the file."""
    return name.replace(" ", "_").replace("/", "\N{DIVISION SLASH}")


def fit_draws(fit: Fit) -> Record:
    """The record of a fit: parameters in the files' units, one variable each; rows by `contact`."""
    level, draws = fit.final, fit.draws
    model, scene = level.estimate.model, level.estimate.model.scene
    m, ids = scene.dataset.measurements, np.array(scene.dataset.measurements.ids)
    names = [variable(name) for name in model.names]
    judged = _pointwise(fit)
    each = min(len(judged.replicated), predicted_draws(fit.dataset)) // len(draws.z)
    predictive, observed, coords = _predictions(fit, each)
    predictive["residual_um"] = (("contact",), _some(fit, judged.replicated, each))
    observed["residual_um"] = (("contact",), UM * judged.observed)
    rows = scene.rows("calibrate")
    prior = prior_draws(model.size, len(noise_groups(model)), PRIOR_CHAINS, PRIOR_DRAWS, fit.options.seed)
    reading = "reading" if scene.dataset.robot.slides.any() else "reading_deg"  # mm of prismatic joints
    constant: Labelled = {
        reading: (("row", "joint"), scene.dataset.robot.shown(m.readings[rows])),
        "target": (("row",), np.array([t.name for t in scene.dataset.targets])[m.target[rows]]),
        "rejected": (("row",), np.isin(rows, level.estimate.rejected).astype(np.int8)),
    }
    coords |= {
        "contact": ids[judged.rows],  # those that count
        "row": ids[rows],  # all that are there to fit
        "joint": list(scene.dataset.robot.joint_names),
        "parameter": names,
    }
    groups: dict[str, Variables] = {
        "posterior": _parameters(model, draws.z, draws.log_kappa),
        "sample_stats": {"lp": ((), draws.log_density)},
        "log_likelihood": {"residual_um": (("contact",), _chains(fit, judged.log_likelihood))},
        "posterior_predictive": predictive,
        "prior": _parameters(model, *prior),
        "observed_data": observed,
        "constant_data": constant,
    }
    attrs = {
        "dataset": fit.dataset.name,
        "dataset_sha256": fit.dataset.sha256,
        "model": ",".join(level.effects),
        "seed": str(fit.options.seed),
        "inference_library": "emcee" if draws.acceptance else "gaussian approximation",
        "creation_library": f"bayescal {__version__}",
    }
    units = dict(zip(names, model.in_file_units()[0], strict=True))
    units |= {name: name.rsplit("_", 1)[1] for name in (*predictive, *observed)}
    units[reading] = scene.dataset.robot.unit_words
    return Record(groups, coords, units, attrs, _labels(model))


def parameter_draws(fit: Fit) -> dict[str, np.ndarray]:
    """Draws (chains, draws) of the parameters by name, in file units."""
    model = fit.final.estimate.model
    values = model.physical(fit.draws.z) * model.in_file_units()[1]
    return {name: values[..., k] for k, name in enumerate(model.names)}


def _parameters(model: Model, z: np.ndarray, log_kappa: np.ndarray) -> Labelled:
    """Draws z (chains, draws, D) as variables in file units, noise scales, and z itself by `parameter`."""
    _, factor = model.in_file_units()
    values = model.physical(z) * factor
    out: Labelled = {variable(name): ((), values[..., k]) for k, name in enumerate(model.names)}
    for k, name in enumerate(scale_names(noise_groups(model))):
        out[variable(name)] = ((), np.exp(log_kappa[..., k]))
    out["z"] = (("parameter",), z)
    return out


def _labels(model: Model) -> dict[str, tuple[str, list[str]]]:
    """Joint and effect of every parameter; the joint is "" where it belongs to none."""
    names, of_targets = model.scene.dataset.robot.joint_names, model.size - len(model.parameters)
    numbers = [p.site.number for p in model.parameters]
    joints = [names[number - 1] if number else "" for number in numbers] + [""] * of_targets
    effects = [p.effect for p in model.parameters] + ["target"] * of_targets
    return {"joint": ("parameter", joints), "effect": ("parameter", effects)}


def _pointwise(fit: Fit) -> Pointwise:
    """What the draws say of each fitted row; of a large session, some draws evenly out of each chain."""
    estimate, draws = fit.final.estimate, fit.sampled
    chains, count, size = draws.z.shape
    rows = sum(len(b.rows) for b in estimate.model.states)
    most = max(MOST_VALUES // max(rows * chains, 1), FEWEST_DRAWS)
    most = min(most, max(MOST_OF_LARGE // max(rows * chains, 1), FEWEST_OF_LARGE))
    pick = np.linspace(0, count - 1, min(count, most)).astype(int)
    z, kappa = draws.z[:, pick].reshape(-1, size), np.exp(draws.log_kappa[:, pick])
    rng = np.random.default_rng([fit.options.seed, REPLICATED])
    return pointwise(estimate, z, kappa.reshape(len(z), -1), rng)


def _some(fit: Fit, drawn: np.ndarray, each: int) -> np.ndarray:
    """Draws (chain, each, ...) of all draws (S, ...), evenly out of each chain; single precision."""
    chains = _chains(fit, drawn)
    chosen = chains[:, np.linspace(0, chains.shape[1] - 1, each).astype(int)]
    return chosen.astype(np.float32, copy=False)  # draws differ by more than their seventh figure


def _predictions(fit: Fit, each: int) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Sphere distances and validation residuals: draws (chain, each, ...), measured values, labels."""
    v = fit.final.validation
    scene = fit.final.estimate.model.scene
    ids, m = np.array(fit.dataset.measurements.ids), fit.dataset.measurements
    index = {t.name: k for k, t in enumerate(fit.dataset.targets)}
    held = scene.rows("validate")
    predictive: dict[str, Any] = {}
    observed: dict[str, Any] = {}
    coords: dict[str, Any] = {}

    def add(name: str, dims: tuple[str, ...], drawn: np.ndarray, measured: np.ndarray) -> None:
        predictive[name], observed[name] = (dims, _some(fit, drawn, each)), (dims, measured)

    def rows_of(checks: Sequence[RowCheck]) -> np.ndarray:
        return np.concatenate([ids[held[m.target[held] == index[check.target]]] for check in checks])

    if v.distances:
        coords["pair"] = ["|".join(d.between) for d in v.distances]
        drawn = np.stack([d.error - d.predicted + d.certified for d in v.distances], axis=-1)
        add("distance_mm", ("pair",), MM * drawn, MM * np.array([d.certified for d in v.distances]))
    if v.planes:
        coords["heldout"] = rows_of(v.planes)
        drawn = np.concatenate([p.predicted for p in v.planes], axis=1)
        add("heldout_um", ("heldout",), UM * drawn, UM * np.concatenate([p.residuals for p in v.planes]))
    if v.points:
        width = max(len(p.residuals) for p in v.points)
        coords["point"], coords["axis"] = rows_of(v.points), list("uv" if width == 2 else "xyz")

        def wide(values: np.ndarray) -> np.ndarray:
            """Values (..., rows, C) of a kind as (..., C, width)."""
            more = [(0, 0)] * (values.ndim - 1) + [(0, width - values.shape[-2])]
            return np.pad(np.swapaxes(values, -1, -2), more, constant_values=np.nan)

        drawn = np.concatenate([wide(p.predicted) for p in v.points], axis=1)
        measured = np.concatenate([wide(p.residuals) for p in v.points])
        add("point_um", ("point", "axis"), UM * drawn, UM * measured)
    return predictive, observed, coords


def _chains(fit: Fit, drawn: np.ndarray) -> np.ndarray:
    """Draws (S, ...) as (chain, draw, ...): the validation took them evenly out of the chains in turn."""
    chains = fit.draws.z.shape[0]
    each = len(drawn) // chains
    return drawn[: chains * each].reshape(chains, each, *drawn.shape[1:])
