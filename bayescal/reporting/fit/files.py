"""Files beside fit.json: uncertainty budgets (also as a table of the terminal), and `posterior.nc`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import RenderableType

from bayescal import __version__
from bayescal.assess.budget import COVERAGE, MOST_DOF, Budget, Component
from bayescal.assess.inputs import Basis
from bayescal.assess.measurand import PARAMETER
from bayescal.calibration import Fit, predicted_draws
from bayescal.dataset.table import csv_text
from bayescal.effects import UNITS
from bayescal.effects.vocabulary import unit_label
from bayescal.model import Model
from bayescal.model.model import noise_groups
from bayescal.posterior import Pointwise, pointwise, prior_draws
from bayescal.posterior.inference import Record, Variables
from bayescal.posterior.linearised import scale_names
from bayescal.predict.validation import RowCheck
from bayescal.reporting.origin import entry, origin, plain, scaled
from bayescal.reporting.sheet import screen, sheet_of_cells
from bayescal.reporting.text import MISSING, MM, UM, Facts, percent, rounded, size, two_digits

SCHEMA = "bayescal-budget/1"
LIBRARIES = ("numpy", "scipy")
COLUMNS = (
    "group", "name", "type", "distribution", "value", "u", "unit", "dof", "sensitivity", "sensitivity_unit",
    "contribution", "contribution_um", "share",
)  # fmt: skip
PRIORS = 0.5
"""Share of the variance from which on priors, not rows, determine a result."""
SHOWN = 1e-3
"""Share of the variance below which the terminal does not list a component."""


def budget_record(budgets: Sequence[Budget], basis: Basis, seed: int) -> dict[str, Any]:
    """The content of budget.json: the first budget at the top, and all of them as a list."""
    every = [measurand_record(b) for b in budgets]
    record = {
        **origin(SCHEMA, basis.stated.plain.model.scene.dataset, seed, LIBRARIES),
        **every[0],
        "unexplained_um": 1e6 * basis.excess,
        "unexplained_dof": basis.excess_dof,
        "correlations": [{"between": [a, b], "correlation": r} for a, b, r in budgets[0].correlations],
        "budgets": every,
    }
    return plain(record)


def measurand_record(budget: Budget) -> dict[str, Any]:
    """One budget. Contributions are in the unit of the measurand, and in µm where that is a length."""
    m = budget.measurand
    unit, factor = UNITS[m.unit]
    length = m.unit == "m"
    return {
        "measurand": m.name, "kind": m.kind, "unit": unit, "value": scaled(m.value, factor),
        "position_mm": None if m.position is None else 1e3 * m.position,
        "components": [_component(budget, c) for c in budget.components], "u": factor * budget.u,
        "U": factor * budget.expanded,
        **(entry(budget, "u_um", "U_um=expanded") if length else {"u_um": None, "U_um": None}),
        **entry(budget, "effective_dof=dof", "k"), "coverage": COVERAGE, "prior_share": budget.prior_share,
        "text": in_words(budget),
    }  # fmt: skip


def _component(budget: Budget, c: Component) -> dict[str, Any]:
    unit, factor = UNITS[c.input.unit]
    of, scale = UNITS[budget.measurand.unit]

    def contribution(value: float) -> dict[str, Any]:
        length = budget.measurand.unit == "m"
        return {"contribution": scale * value, "contribution_um": 1e6 * value if length else None}

    return {
        **entry(c.input, "group", "name", "type=evaluation", "distribution"),
        "value": scaled(c.input.value, factor),
        "u": scaled(c.input.u, factor),
        "unit": unit,
        "dof": c.input.dof,
        "sensitivity": None if c.sensitivity is None else c.sensitivity * scale / factor,
        "sensitivity_unit": f"{of}/{unit}" if of != unit else "1",
        **contribution(c.contribution),
        "share": c.contribution**2 / budget.u**2 if budget.u else 0.0,
        "by_target": [{"target": name, **contribution(value)} for name, value in c.by_target],
    }


def budget_csv(budgets: Sequence[Budget]) -> str:
    """All components of all budgets, and the sum of each, as CSV."""
    rows = []
    for b in budgets:
        record = plain(measurand_record(b))
        components = record["components"]
        for name, key in (("combined standard uncertainty", "u"), ("expanded uncertainty", "U")):
            total = {"group": key, "name": name, "unit": record["unit"], "value": record["value"]}
            total |= {"contribution": record[key], "contribution_um": record[f"{key}_um"]}
            sensitivity = record["k"] if key == "U" else None
            components.append(total | {"dof": record["effective_dof"] or None, "sensitivity": sensitivity})
        rows += [(b.measurand.name, *(c.get(key) for key in COLUMNS)) for c in components]
    return csv_text(("measurand", *COLUMNS), rows)


def in_words(budget: Budget) -> str:
    """``(0.1 ± 15.2) µm, k = 2.00``: two digits of U, the value to the same decimal (JCGM 100, 7.2.6)."""
    m = budget.measurand
    error = m.value is None or abs(m.value) < 1e3 * budget.u  # then a length is in µm
    unit, factor = ("um", 1e6) if m.unit == "m" and m.kind != PARAMETER and error else UNITS[m.unit]
    value, u = rounded(factor * (m.value or 0.0), factor * budget.expanded)
    of = unit_label(unit)
    text = f"U = {u} {of}" if m.value is None else f"({value} ± {u}) {of}"
    return f"{text.rstrip()}, k = {budget.k:.2f}"


def budget_table(budget: Budget) -> RenderableType:
    """The components of a budget, the largest first, its sum and its expanded uncertainty."""
    m = budget.measurand
    unit, factor = ("um", 1e6) if m.unit == "m" else UNITS[m.unit]
    ranked = sorted(budget.components, key=lambda c: -abs(c.contribution))
    shown = [c for c in ranked if c.contribution**2 >= SHOWN * budget.u**2]
    rows = [
        (
            c.input.name,
            c.input.evaluation,
            MISSING if c.input.u is None else size(c.input.u, c.input.unit),
            _sensitivity(budget, c),
            two_digits(factor * c.contribution),
            percent(c.contribution**2 / budget.u**2),
        )
        for c in shown
    ]
    if small := ranked[len(shown) :]:
        together = float(np.sqrt(sum(c.contribution**2 for c in small)))
        share = percent(together**2 / budget.u**2)
        rows.append((f"{len(small)} smaller components", "", "", "", two_digits(factor * together), share))
    contribution = f"contribution ({unit_label(unit) or '1'})"
    headings = ("component", "type", "u", "sensitivity", contribution, "share")
    return screen(sheet_of_cells(headings, rows), "", _sums(budget))


def _sensitivity(budget: Budget, c: Component) -> str:
    if c.sensitivity is None:
        return "-"
    (of, scale), (unit, factor) = UNITS[budget.measurand.unit], UNITS[c.input.unit]
    number = f"{c.sensitivity * scale / factor:.2g}"
    return number if of == unit else f"{number} {unit_label(of) or '1'}/{unit_label(unit)}".removesuffix("/")


def _sums(budget: Budget) -> Facts:
    """The measurand, its uncertainty, and whether priors determine it."""
    unit, factor = ("um", 1e6) if budget.measurand.unit == "m" else UNITS[budget.measurand.unit]
    dof = "normal" if budget.dof > MOST_DOF else f"{budget.dof:.0f} effective degrees of freedom"
    u = rounded(0.0, factor * budget.u)[1]
    yield "measurand", budget.measurand.name, "bold"
    if budget.measurand.position is not None:
        coordinates = ", ".join(f"{1e3 * x:.3f}" for x in budget.measurand.position)
        yield "position", f"({coordinates}) mm in F0", ""
    yield "u", f"{u} {unit_label(unit)} ({dof})", ""
    yield "result", f"{in_words(budget)}, coverage {100 * COVERAGE:.2f} %", "bold"
    if budget.prior_share >= PRIORS:
        words = f"by the measurements: {percent(budget.prior_share)} of the variance is that of priors"
        yield "not determined", words, "yellow"


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
