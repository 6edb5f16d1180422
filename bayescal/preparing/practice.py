"""A practice session for a set-up: contacts that can be reached, as an arm with errors would measure them.

The set-up is that of `init` or of any dataset folder. Contacts are chosen at random among the candidates of a
plan. The true arm is drawn as in `simulation.record`, the true targets from small displacements that agree
with their certificates, within the stated uncertainties. Every row then has the residual that the noise
gives it.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.write import taken
from bayescal.errors import BayescalError
from bayescal.model import ARM, Model, arm_at_rest, with_parameters
from bayescal.model.scene import Scene
from bayescal.planning.candidates import candidates
from bayescal.planning.pool import Setup
from bayescal.simulation.record import Simulated, draws, heading, key_of, parameters_record
from bayescal.simulation.session import GROUP, Options, grouped
from bayescal.statistics import stream

SPARE = 1.3
"""Candidates for each contact."""
PLACE, ANGLE = 0.5e-3, 1e-3
"""m, rad: standard deviation of the displacement of a target, where its stated uncertainty is not smaller."""
PACE = 10.0
"""s per contact."""
CLOSED, STILL, PASSES = 1e-9, 1e-12, 30
"""m: residuals at which contacts are closed, of the deflection by gravity; passes to that."""
CORRECTIONS = 20
"""Passes that bring the true targets into agreement with their certificates."""


def practice(setup: Setup, options: Options) -> Simulated:
    """Simulate a session of a set-up, at its stated noise.

    Parameters
    ----------
    setup : Setup
    options : Options
        Effects, contacts, repeats, later contacts, error scale, seeds and name; no other field counts.

    Raises
    ------
    BayescalError
        If too few contacts are reached, the session lacks data for an effect, or a contact cannot be closed.
    """
    options.check()
    planned = _planned(setup, options)
    role = planned.measurements.role
    every = replace(planned, measurements=replace(planned.measurements, role=np.full(len(role), "calibrate")))
    try:
        model = _arm(every, options)
    except BayescalError as error:
        raise BayescalError(error.what, "--effects", error.remedy) from None
    z = _targets(model, options)
    exact, noise = _measured(every, model, z, options)
    m = exact.measurements
    errors = stream(options.seed, "joints").normal(size=m.readings.shape)
    u, share = setup.dataset.reading_noise
    readings = m.readings + u * share * errors
    dataset = replace(exact, measurements=replace(m, role=role, readings=readings), unfilled=())
    return Simulated(dataset, _truth(options, _arm(exact, options), z, noise))


def _planned(setup: Setup, options: Options) -> Dataset:
    """Contacts of the nominal arm: to calibrate with their repeats, on validation targets, and later ones."""
    for target in setup.dataset.targets:
        if KINDS[target.kind].posed:
            remedy = "leave cameras out, or take images"
            raise BayescalError("images cannot be simulated", target.name, remedy)
    rng = stream(options.seed, "practice")
    different = options.contacts - (GROUP - 1) * options.repeats
    pool = candidates(setup, int(SPARE * (different + options.later)), options.seed)
    rows = _in_turn(pool.session.measurements.target, rng.permutation(pool.candidates))
    if len(rows) < different + options.later:
        what = f"{len(rows)} different contacts are reached, {different + options.later} are asked for"
        remedy = "give fewer --contacts or --later, or enlarge the regions of the targets"
        raise BayescalError(what, setup.dataset.name, remedy)
    fitted, repeat = grouped(different, options.repeats, rng)
    later, rows = rows[: options.later], rng.permutation(rows[options.later : options.later + different])
    order = np.concatenate([rows[fitted], pool.validation, later])
    m = taken(pool.session.measurements, order)
    count = len(order)
    role = np.where(np.arange(count) < len(fitted), "calibrate", "validate")
    table = replace(
        m, ids=tuple(f"c{k:04d}" for k in range(count)), role=role, line=np.arange(count) + 2,
        time=np.round(PACE * np.arange(count) + rng.uniform(0, PACE / 2, count), 2),
        repeat=np.array([*repeat, *[""] * (count - len(fitted))]),
    )  # fmt: skip
    source = f"simulated (bayescal simulate --setup, seed {options.seed}); its ground truth is in truth.json"
    return replace(pool.session, name=options.name, measurements=table, source=source)


def _in_turn(target: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows (C,) in an order that takes the targets in turn."""
    turn = np.empty(len(rows), int)
    for t in np.unique(target[rows]):
        mine = target[rows] == t
        turn[mine] = np.arange(np.sum(mine))
    return rows[np.argsort(turn, kind="stable")]


def _arm(dataset: Dataset, options: Options, near: Scene | None = None) -> Model:
    """The model of all rows whose parameters the true arm has, with gravity at its deflected pose."""
    model = arm_at_rest(Scene(dataset), options.effects, partial(draws, options), STILL, near)
    return with_parameters(model.scene, model.effects, model.parameters)


def _targets(model: Model, options: Options) -> np.ndarray:
    """True states of the targets as z (D,) of the model: small displacements that agree with certificates."""
    rng = stream(options.seed, "targets")
    sd = np.concatenate([np.zeros(len(model.parameters)), *(b.sd for b in model.states)])
    limit = np.array([ANGLE if unit == "rad" else PLACE for unit in model.units])
    scale = np.where(sd > 0, np.minimum(1.0, limit / np.where(sd > 0, sd, 1.0)), 0.0)
    z = scale * rng.normal(size=model.size)
    error = [rng.normal(size=c.rows) for c in model.constraints]
    for _ in range(CORRECTIONS if error else 0):
        off, by = [], []
        for constraint, wanted in zip(model.constraints, error, strict=True):
            parts = {name: z[part] for name, part in model.slices.items()}
            parts[ARM] = -model.shift / model.sd
            r, slopes = model.linearised(constraint, parts)
            row = np.zeros((constraint.rows, model.size))
            for name, slope in slopes.items():
                row[:, model.slices[name]] = slope
            off.append(r - wanted)
            by.append(row * scale)
        z = z - scale * np.linalg.lstsq(np.concatenate(by), np.concatenate(off), rcond=None)[0]
    return z


def _measured(
    dataset: Dataset, model: Model, z: np.ndarray, options: Options
) -> tuple[Dataset, dict[str, np.ndarray]]:
    """The session in which every residual is its noise, and the noise by block.

    What an instrument or a wire reads is set; otherwise the joints move by the least amount.
    """
    rng = stream(options.seed, "noise")
    noise = {b.name: np.tile(b.sigma, b.kind.rows) * rng.normal(size=b.residuals) for b in model.blocks}
    coupling = dataset.robot.link_from_reading
    for _ in range(PASSES):
        values, m = draws(options, model), dataset.measurements
        measured = {"readings": m.readings, "xyz": m.xyz, "length": m.length}
        columns: dict[str, Any] = {k: x.copy() for k, x in measured.items() if x is not None}
        largest = 0.0
        for block in model.blocks:
            state = z[model.slices[block.target]]
            off = (block.residual(values, state).ravel() - noise[block.name]).reshape(block.kind.rows, -1)
            largest = max(largest, float(np.max(np.abs(off))))
            reads = model.scene.declared_of(block.target).reads
            if reads == "xyz":
                columns["xyz"][block.rows] += off.T
            elif reads == "length" and m.length is not None and np.all(np.isfinite(m.length[block.rows])):
                columns["length"][block.rows] += off[0]
            else:
                by = block.by_readings(values, state, coupling).reshape(block.kind.rows, len(block.rows), -1)
                step = np.linalg.pinv(np.moveaxis(by, 1, 0)) @ off.T[..., None]
                columns["readings"][block.rows] -= step[..., 0]
        if largest < CLOSED:
            return dataset, noise
        dataset = replace(dataset, measurements=replace(m, **columns))
        model = _arm(dataset, options, model.scene)
    what = "the arm with its errors does not reach all contacts"
    raise BayescalError(what, dataset.name, "give a smaller --error-scale, or another --seed")


def _truth(options: Options, model: Model, z: np.ndarray, noise: dict[str, np.ndarray]) -> dict[str, Any]:
    """The content of truth.json."""
    states = []
    for name, unit, value in zip(model.names, model.units, model.physical(z), strict=True):
        if name not in {p.name for p in model.parameters}:
            key, factor = key_of(unit)
            states.append({"name": name, key: factor * float(value)})
    rms = float(np.sqrt(np.mean(np.concatenate([*noise.values()]) ** 2)))
    return {
        **heading(options),
        "noise": {"rms_um": 1e6 * rms},
        "parameters": parameters_record(options, model),
        "states": states,
        "distances": [],
    }
