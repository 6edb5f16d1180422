"""The run folder of a fit."""

from __future__ import annotations

import json
from pathlib import Path

from bayescal.export import calibrated_robot
from bayescal.fit import Fit
from bayescal.folders import whole
from bayescal.posterior.inference import save
from bayescal.report.posterior import fit_inference_data
from bayescal.report.record import fit_record
from bayescal.robots import robot_to_yaml

FIT = "fit.json"


def write_fit(fit: Fit, folder: Path) -> None:
    """Write fit.json, posterior.nc and the calibrated robot.yaml, whole or not at all."""
    robot = robot_to_yaml(
        calibrated_robot(fit.final.estimate),
        comment=f"{fit.dataset.robot.name} calibrated on {fit.dataset.name}: {', '.join(fit.final.effects)}. "
        "The tool is not part of it: see fit.json.",
    )
    record = json.dumps(fit_record(fit), indent=1, allow_nan=False) + "\n"
    with whole(folder, FIT) as stage:
        (stage / FIT).write_text(record, encoding="utf-8")
        save(fit_inference_data(fit), stage / "posterior.nc")
        (stage / "robot.yaml").write_text(robot, encoding="utf-8")
