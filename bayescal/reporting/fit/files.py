"""The run folder of a fit."""

from __future__ import annotations

from pathlib import Path

from bayescal.assess.agreement import Agreement
from bayescal.assess.budget import usual
from bayescal.calibration import Fit
from bayescal.exporting.robot import robot_text
from bayescal.fitted.arm import of_fit
from bayescal.fitted.file import ARM_FILE, COPY, write_arm
from bayescal.posterior.inference import save
from bayescal.reporting.figures.process import begun
from bayescal.reporting.fit.budget import budget_csv, budget_record
from bayescal.reporting.fit.posterior import fit_draws, parameter_draws
from bayescal.reporting.fit.record import fit_contents
from bayescal.reporting.page.build import PAGES, write_page
from bayescal.storage.files import json_text
from bayescal.storage.folders import whole

FIT, ROBOT = "fit.json", "robot.yaml"
BUDGET, BUDGET_CSV = "budget.json", "budget.csv"
WRITTEN = (FIT, PAGES["fit"], "posterior.nc", BUDGET, BUDGET_CSV, ROBOT, ARM_FILE, COPY)
"""Names of all that `write_fit` writes, without the figures."""


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
    arm, contents = of_fit(fit), fit_contents(fit, compared)
    with whole(folder, FIT) as stage:
        drawn = begun(contents, parameter_draws(fit)) if pictures else dict
        budgets = usual(fit.basis)
        texts = {
            FIT: json_text(contents, rows=False),
            ROBOT: robot_text(arm, FIT),
            BUDGET: json_text(budget_record(budgets, fit.basis, fit.options.seed)),
            BUDGET_CSV: budget_csv(budgets),
        }
        for name, text in texts.items():
            (stage / name).write_text(text, encoding="utf-8")
        save(fit_draws(fit), stage / "posterior.nc")
        write_arm(arm, stage)
        figures = drawn()
        for name, content in figures.items():
            (stage / name).write_bytes(content)
        write_page(stage, folder)  # with the figures
    return (*WRITTEN, *figures)
