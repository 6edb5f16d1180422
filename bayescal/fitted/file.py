"""The arm of a run folder: `arm.json`, and a copy of its dataset.

The file states the model as text, the values of its parameters by name with the prior of each, the positions
of the targets and the rejected measurements. The model is built again from the copy of the dataset
(`dataset/`; `dataset/1`, `dataset/2` of several sessions), and the estimate linearised again at these values:
nothing is fitted. Row weights, noise scales, covariance and discrepancy follow from them; the stated
covariance must be that of arm.json.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.dataset import Dataset, read_dataset
from bayescal.dataset.join import joined
from bayescal.dataset.write import write_files
from bayescal.effects import UNITS, Parameter, parameters_of
from bayescal.errors import BayescalError
from bayescal.estimate import Estimate
from bayescal.estimate.estimate import at_solution
from bayescal.fitted.arm import FittedArm, Origin, refitted
from bayescal.fitted.gate import Use
from bayescal.fitted.unmodelled import Unmodelled
from bayescal.model import ARM, Model, equilibrium, with_parameters
from bayescal.model.equilibrium import SETTLED
from bayescal.model.options import FitOptions, parts_of
from bayescal.model.scene import Scene
from bayescal.storage.files import json_text
from bayescal.storage.folders import check_unchanged
from bayescal.storage.reading import read_record

SCHEMA = "bayescal-arm/1"
ARM_FILE, COPY = "arm.json", "dataset"
IMAGES = "field", "power"
"""What a fit tells of the noise of images beside what a dataset states (`dataset.Noise`)."""
OF_LOG = "arm.yaml"
"""The arm in a run folder of a joint log."""
ROUNDING = 1e-6
"""Of a covariance over its standard deviations: beyond, it was changed by hand."""


def arm_record(arm: FittedArm) -> dict[str, Any]:
    """The content of arm.json: values and u in the units of files, covariance and states in SI."""
    u = np.sqrt(np.diag(arm.covariance))
    parameters = []
    for p, value, u_of_value in zip(arm.model.parameters, arm.values.tolist(), u.tolist(), strict=True):
        unit, factor = UNITS[p.unit]
        parameters.append(
            {
                "name": p.name,
                "effect": p.effect,
                "site": str(p.site),
                "driver": str(p.driver),
                "unit": unit,
                "nominal": p.nominal * factor,
                "value": (p.nominal + value) * factor,
                "deviation": value * factor,
                "u": u_of_value * factor,
                "prior_mean": p.centre * factor,
                "prior_sd": p.sd * factor,
            }
        )
    dataset, options = arm.dataset, arm.origin.options
    own_noise, remounted = _joining(dataset)
    return {
        "schema": SCHEMA,
        "command": arm.origin.command,
        "dataset": {
            "name": dataset.name,
            "sha256": dataset.sha256,
            "folders": list(_folders(dataset)),
            "remounted": remounted,
            "own_noise": own_noise,
            # no dataset file states errors of images themselves
            "image_errors": {key: getattr(dataset.noise, key) for key in IMAGES},
        },
        "model": list(arm.effects),
        "without": list(options.omitted),
        "prior_width": options.prior_width,
        "prior_widths": dict(options.widths),
        "robust": options.robust,
        "seed": options.seed,
        "parameters": parameters,
        "covariance_si": arm.covariance.tolist(),
        "solver_covariance_si": None if arm.solved is None else arm.solved.tolist(),
        **arm.beyond.record(),
        "targets_si": {name: state.tolist() for name, state in arm.states.items()},
        "rejected": list(arm.rejected),
        "use": arm.use.record(),
        "doubts": list(arm.use.against),
        "notes": list(arm.use.notes),
    }


def _folders(dataset: Dataset) -> dict[str, Dataset]:
    """The sessions of a dataset by the folders of their copies."""
    return {f"{COPY}/{k}": s for k, s in enumerate(dataset.sessions, start=1)} or {COPY: dataset}


def _joining(dataset: Dataset) -> tuple[bool, bool]:
    """How sessions were joined: each with its own noise, with remounted tools."""
    if not dataset.sessions:
        return True, False
    own_noise = any(t.noise for t in dataset.targets)
    usual = joined(dataset.sessions, False, own_noise)
    return own_noise, [t.name for t in usual.tools] != [t.name for t in dataset.tools]


def write_arm(arm: FittedArm, folder: Path, more: Mapping[str, Any] | None = None) -> tuple[str, str]:
    """Write arm.json, with `more` entries, and the copy of the dataset to a run folder; return names."""
    for name, session in _folders(arm.dataset).items():
        (folder / name).mkdir(parents=True)
        write_files(session, folder / name)
    (folder / ARM_FILE).write_text(json_text({**arm_record(arm), **(more or {})}), encoding="utf-8")
    return ARM_FILE, COPY


def read_arm(folder: Path) -> FittedArm:
    """Read the arm of a run folder.

    Raises
    ------
    BayescalError
        If the folder has no arm, an incomplete one, or one that was changed after it was written.
    """
    path = folder / ARM_FILE
    repeat = "repeat bayescal fit or gap with this version"
    if not path.is_file():
        if (folder / OF_LOG).is_file():
            remedy = "export and verify take it; other commands need the run of a session"
            raise BayescalError("is the run of a joint log", str(folder), remedy)
        within = next((str(below) for below in sorted(folder.glob("*")) if (below / ARM_FILE).is_file()), "")
        remedy = f"give {within}" if within else f"give a run folder of fit or gap, or {repeat}"
        raise BayescalError(f"there is no {ARM_FILE}", str(folder), remedy)
    record = read_record(path, SCHEMA, repeat)
    check_unchanged(folder, (ARM_FILE, COPY))
    try:
        return _arm(record, folder)
    except KeyError as error:
        raise BayescalError(f"{error} is missing", str(path), repeat) from None
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise BayescalError(f"incomplete or changed: {error}", str(path), repeat) from None


def _copies(names: Sequence[str], folder: Path) -> list[Path]:
    """Folders of the copies of the dataset, as arm.json names them: none outside the run folder is read."""
    for name in names:
        if not re.fullmatch(rf"{COPY}(/[1-9][0-9]*)?", name):
            what = f"`{name}` is not a copy of the dataset in the run folder"
            raise BayescalError(what, str(folder / ARM_FILE), f"it must be {COPY}, or {COPY}/1, {COPY}/2 ...")
    return [folder / name for name in names]


def _prior(p: Parameter, entry: dict[str, Any]) -> Parameter:
    """A parameter with the prior that it was fitted with."""
    if "prior_sd" not in entry:  # written by an earlier version
        return p
    factor = UNITS[p.unit][1]
    mean = entry["prior_mean"] / factor
    return replace(p, sd=entry["prior_sd"] / factor, mean=p.mean if p.centre == mean else mean)


def _covariance(entries: Any, count: int) -> np.ndarray:
    """A covariance (P, P) of so many parameters, symmetric and without negative variances.

    Raises
    ------
    ValueError
        Otherwise, beyond rounding.
    """
    out = np.array(entries, float).reshape(count, count)
    sd = np.sqrt(np.maximum(np.diag(out), 0.0))
    each = np.divide(1.0, sd, out=np.zeros(count), where=sd > 0)
    scaled, most = out * np.outer(each, each), np.outer(sd, sd)
    within = np.all(np.abs(out) <= (1.0 + ROUNDING) * most)  # also where a variance is 0 or negative
    symmetric = np.all(np.abs(out - out.T) <= ROUNDING * most)
    if not (within and symmetric and np.all(np.linalg.eigvalsh(scaled) > -ROUNDING)):
        raise ValueError("`covariance_si` is no covariance")
    return out


def _arm(record: dict[str, Any], folder: Path) -> FittedArm:
    of = record["dataset"]
    sessions = [read_dataset(copy, judge=False) for copy in _copies(of["folders"], folder)]
    dataset = joined(sessions, of["remounted"], of["own_noise"])
    noise = replace(dataset.noise, **of.get("image_errors", {}))  # runs of earlier versions have none
    # the hash is that of the user's files, of which the copy has the values
    scene = Scene(replace(dataset, noise=noise, sha256=of["sha256"] or dataset.sha256), oriented=True)
    effects = tuple(record["model"])
    entries = {e["name"]: e for e in record["parameters"]}

    def make(scene: Scene) -> Model:
        made = parameters_of(effects, scene.circumstances(scene.rows("calibrate")))
        by_name = {p.name: _prior(p, entries.get(p.name, {})) for p in made}
        return Model(scene, effects, tuple(by_name[name] for name in entries if name in by_name), (), ())

    def deviations(model: Model) -> np.ndarray:
        return np.array([entries[p.name]["value"] / UNITS[p.unit][1] - p.nominal for p in model.parameters])

    # a joint may carry a torque only where the arm stands as it was fitted
    settled = equilibrium(scene, make, deviations, SETTLED)
    if missing := entries.keys() - {p.name for p in settled.parameters}:
        what = f"the model of the dataset's copy has no parameter `{min(missing)}`"
        raise BayescalError(what, str(folder / ARM_FILE), "repeat the command with this version")
    model, values = with_parameters(settled.scene, effects, settled.parameters), deviations(settled)
    parts = parts_of(record["without"], effects)
    widths = record.get("prior_widths", {})  # none of an earlier version
    options = FitOptions(parts, record["robust"], record["prior_width"], record["seed"], widths=widths)
    solved = record.get("solver_covariance_si")
    return FittedArm(
        model,
        values,
        _covariance(record["covariance_si"], len(values)),
        effects,
        {name: np.array(state, float) for name, state in record["targets_si"].items()},
        tuple(record["rejected"]),
        Origin(record["command"], options),
        Use.read(record, model.parameters),
        Unmodelled.read(record, len(values)),
        None if solved is None else _covariance(solved, len(values)),
    )


def open_run(folder: Path, with_: Sequence[str] = (), without: Sequence[str] = ()) -> FittedArm:
    """The arm of a run folder of `fit` or `gap`; with other effects, it is fitted again (`refitted`).

    Raises
    ------
    BayescalError
        If the folder has no arm, or an incomplete one.
    """
    arm = read_arm(Path(folder))
    return refitted(arm, with_, without) if with_ or without else arm


AGREES = 0.02
"""Largest difference of a stated standard uncertainty from that of arm.json, relative."""


def restored(arm: FittedArm) -> Estimate:
    """The estimate of an arm that was read from a run folder.

    Raises
    ------
    BayescalError
        If arm.json does not state the position of a fitted target.
    """
    model = arm.model
    z = np.zeros(model.size)
    z[model.slices[ARM]] = (arm.values - model.shift) / model.sd
    for block in model.states:
        if block.target not in arm.states:
            raise BayescalError(f"no position of {block.target}", "arm.json", "repeat the command")
        state = arm.states[block.target]
        z[model.slices[block.target]] = state[block.free] / block.sd
    ids = model.scene.dataset.measurements.ids
    rejected = np.array([ids.index(name) for name in arm.rejected], int)
    held = tuple(n.parameter for n in arm.use.rigid.parameters)
    return replace(at_solution(model, z, rejected), held=held, least=arm.beyond.variances)


def check_restored(arm: FittedArm, covariance: np.ndarray) -> None:
    """Refuse an estimate whose stated covariance (D, D) is not that of the arm.

    Raises
    ------
    BayescalError
        With the parameter that differs most.
    """
    model = arm.model
    computed = covariance[model.slices[ARM], model.slices[ARM]] * np.outer(model.sd, model.sd)
    ratio = np.sqrt(np.diag(computed) / np.maximum(np.diag(arm.covariance), np.finfo(float).tiny))
    k = int(np.argmax(np.abs(np.log(ratio)))) if len(ratio) else 0
    if len(ratio) and abs(np.log(ratio[k])) > AGREES:
        what = f"u of {model.names[k]} is {ratio[k]:.3g} times that of arm.json when it is computed again"
        remedy = "repeat bayescal fit with this version, without --latent-joints"
        raise BayescalError(what, "arm.json", remedy)
