"""fit.json of a joint log: record, terminal, folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from bayescal.motion.calibrate import MotionFit
from bayescal.motion.fit_settings import CALIBRATION
from bayescal.posterior.inference import Record, save
from bayescal.reporting.motion.record import controller, origin, shown_unit, write_arm
from bayescal.reporting.motion.sheets import parameter_sheet, title, withheld_sheet
from bayescal.reporting.page.build import write_page
from bayescal.reporting.shared.origin import plain
from bayescal.reporting.shared.sheet import below, screen, terminal
from bayescal.reporting.shared.text import Facts, under
from bayescal.storage.files import json_text
from bayescal.storage.folders import whole
from bayescal.storage.reading import Json

SCHEMA = "bayescal-fit/1"
FIT, POSTERIOR = "fit.json", "posterior.nc"


def fit_record(fit: MotionFit) -> dict[str, Any]:
    """The contents of fit.json; a value that is not finite is null."""
    unit, by = shown_unit(fit.log)
    record = {
        **origin(SCHEMA, fit.log, fit.seed),
        "model": ["inertials", "armature", "coulomb", "viscous", "offset", "alignment"],
        "parameters": [{**vars(p), "identifiable": p.identifiable} for p in fit.parameters],
        "determined": fit.determined,
        "combinations": list(fit.combinations),
        "withheld": [
            {
                "joint": w.joint,
                f"nominal_rms_{unit}": x * w.nominal,
                f"rms_{unit}": x * w.fitted,
                f"expected_rms_{unit}": x * w.expected,
                f"expected_interval95_{unit}": [x * end for end in w.interval95],
            }
            for w, x in zip(fit.withheld, by, strict=False)
        ],
        "noise": {"lag1": fit.lag1},
        "gravity_mps2": fit.log.gravity,
        "controller": controller(fit.log),
        "torque_shift_ms": 1e3 * fit.shift,
        "draws": fit.draws.shape[0] * fit.draws.shape[1],
        "motions": [{"id": m.name, "role": m.role, "kind": m.kind} for m in fit.log.motions],
        "warnings": [*fit.log.notes, *_outside(fit)],
    }
    return {key: plain(value) for key, value in record.items()}


def _outside(fit: MotionFit) -> list[str]:
    """Joints whose withheld error is beyond what is expected."""
    joints = [w.joint for w in fit.withheld if w.fitted > w.interval95[1]]
    text = "the error on withheld motions is larger than expected: bayescal gap looks for the cause"
    out = [f"{', '.join(joints)}: {text}"] if joints else []
    if fit.r_hat > CALIBRATION.r_hat:
        out.append(f"the sampler did not converge: R-hat {fit.r_hat:.2f}, ask for more --samples")
    if fit.mechanism.coupled:
        out.append("the joints are coupled, which arm.yaml cannot hold: it is not written")
    return out


def fit_summary(record: Json, verbose: bool = False) -> RenderableType:
    """Withheld errors, parameters that the log determines, combinations."""
    parameters = terminal(parameter_sheet(record, verbose))
    return screen(title(record), *below(withheld_sheet(record)), "", parameters, _facts(record))


def _facts(record: Json) -> Facts:
    total = len(record["parameters"])
    words = f"{record['determined']} of {total} directions of the parameters, better than half their prior"
    yield "determined", words, ""
    yield from under("only together", record["combinations"], "dim")
    if record["unit"] == "deg":
        yield "commands", f"acted on after {record['torque_shift_ms']:.0f} ms, beside viscous friction", "dim"
    else:
        yield "torque", f"{record['torque_shift_ms']:.2f} ms later than the positions", "dim"
    yield from under("warning", record["warnings"], "yellow")


def draws_of(fit: MotionFit) -> Record:
    """The posterior for ArviZ, one variable for all parameters."""
    names = [p.name for p in fit.parameters]
    groups = {"posterior": {"parameter_value": (("parameter",), fit.draws)}}
    units = {"parameter_value": "SI, see the coordinate unit"}
    labels = {"unit": ("parameter", [p.unit for p in fit.parameters])}
    return Record(groups, {"parameter": names}, units, {"log": fit.log.name}, labels)


def write_fit(
    fit: MotionFit, folder: Path, contents: Mapping[str, Any], shown: Path | None = None
) -> tuple[str, ...]:
    """Write fit.json, report.html, posterior.nc, arm.yaml and the log atomically; return their names.

    `shown` is where the folder will be, for the page.
    """
    with whole(folder, FIT) as stage:
        (stage / FIT).write_text(json_text(contents, rows=False), encoding="utf-8")
        save(draws_of(fit), stage / POSTERIOR)
        return FIT, write_page(stage, shown or folder), POSTERIOR, *write_arm(fit.mechanism, fit.log, stage)
