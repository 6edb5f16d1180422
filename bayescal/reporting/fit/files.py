"""The run folder of a fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayescal.assess.agreement import Agreement
from bayescal.assess.budget import usual
from bayescal.calibration import Fit
from bayescal.exporting.robot import robot_text
from bayescal.fitted.arm import of_fit
from bayescal.fitted.file import ARM_FILE, COPY, write_arm
from bayescal.posterior.inference import save
from bayescal.reporting.figures.process import begun
from bayescal.reporting.fit.agreement import agreement_record, disagreement
from bayescal.reporting.fit.budget import budget_csv, budget_record
from bayescal.reporting.fit.posterior import fit_draws, parameter_draws
from bayescal.reporting.fit.record import fit_record
from bayescal.reporting.page.build import PAGES, write_page
from bayescal.storage.files import indented, json_text
from bayescal.storage.folders import whole

FIT, ROBOT = "fit.json", "robot.yaml"
BUDGET, BUDGET_CSV = "budget.json", "budget.csv"
WRITTEN = (FIT, PAGES["fit"], "posterior.nc", BUDGET, BUDGET_CSV, ROBOT, ARM_FILE, COPY)
"""Names of all that `write_fit` writes, without the figures."""


def fit_contents(fit: Fit, compared: Agreement | None = None) -> dict[str, Any]:
    """The content of fit.json; `compared` is what the sessions of a joint fit say each by itself."""
    contents = fit_record(fit)
    if compared is not None:
        contents["agreement"] = agreement_record(compared)
        contents["warnings"] += disagreement(compared)
    return contents


def write_fit(
    fit: Fit, folder: Path, compared: Agreement | None = None, pictures: bool = True
) -> tuple[str, ...]:
    """Write fit.json, report.html, posterior.nc, budgets, robot.yaml, arm.json, dataset, figures atomically.

    Parameters
    ----------
    fit : Fit
    folder : Path
        Where they are written; an earlier fit there is replaced.
    compared : Agreement, optional
        What the sessions of a joint fit say of the arm each by itself.
    pictures : bool
        Draw the figures too.

    Returns
    -------
    tuple of str
        Names of the files and of the folder of the dataset.
    """
    arm = of_fit(fit)
    contents = fit_contents(fit, compared)
    names = list(WRITTEN)
    with whole(folder, FIT) as stage:
        drawn = begun(contents, parameter_draws(fit)) if pictures else dict
        (stage / FIT).write_text(indented(contents) + "\n", encoding="utf-8")
        save(fit_draws(fit), stage / "posterior.nc")
        (stage / ROBOT).write_text(robot_text(arm, FIT), encoding="utf-8")
        budgets = usual(fit.basis)
        (stage / BUDGET).write_text(json_text(budget_record(budgets, fit.basis, fit.seed)), encoding="utf-8")
        (stage / BUDGET_CSV).write_text(budget_csv(budgets), encoding="utf-8")
        write_arm(arm, stage)
        for name, content in drawn().items():
            (stage / name).write_bytes(content)
            names.append(name)
        write_page(stage, folder)  # with the figures
    return tuple(names)
