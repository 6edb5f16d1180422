"""The run folder of a plan."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path

from bayescal.dataset.write import table_text, write_setup
from bayescal.exporting.plan import Probe, formats_of
from bayescal.folders import whole
from bayescal.importing.onto import MEASURED
from bayescal.importing.onto import PLAN as CONTACTS
from bayescal.planning.result import Plan
from bayescal.reporting.plan.contacts import table_of_plan
from bayescal.reporting.plan.record import plan_record

PLAN, PICTURE, PAGE = "plan.json", "plan.png", "plan.html"


def commands(folder: Path) -> dict[str, str]:
    """What to run when the contacts are measured: the import of their log, and the calibration."""
    run = shlex.quote(str(folder))
    return {
        "import": f"bayescal import LOG.csv --plan {run} --out SESSION",
        "fit": "bayescal fit SESSION",
        "gap": "bayescal gap SESSION",
    }


def write_plan(
    plan: Plan, folder: Path, formats: Sequence[str] = (), probe: Probe | None = None
) -> tuple[str, ...]:
    """Write plan.csv, plan.json, the page, the figure and the setup atomically.

    Parameters
    ----------
    plan : Plan
    folder : Path
        Where they are written; an earlier plan there is replaced.
    formats : sequence of str
        Names of formats for a controller that are written too; see `bayescal.exporting.plan`.
    probe : Probe, optional
        How the controller notices a contact.

    Returns
    -------
    tuple of str
        File names.
    """
    from bayescal.reporting.plan.page import plan_page
    from bayescal.reporting.plan.picture import draw_plan
    from bayescal.reporting.shared.style import save_figure

    later = commands(folder)
    texts = {
        CONTACTS: table_of_plan(plan),
        PLAN: json.dumps(plan_record(plan, later), allow_nan=False, indent=1) + "\n",
    }
    if plan.pool.measured:
        texts[MEASURED] = table_text(plan.pool.setup.dataset)
    for form in formats_of(formats, probe):
        texts |= form.files(plan, probe or Probe())
    with whole(folder, PLAN) as stage:
        save_figure(draw_plan(plan), stage / PICTURE)
        texts[PAGE] = plan_page(plan, (stage / PICTURE).read_bytes(), tuple(later.items()))
        for name, text in texts.items():
            (stage / name).write_text(text, encoding="utf-8", newline="")
        setup = write_setup(plan.pool.setup.dataset, stage)
    return (*texts, PICTURE, *setup)
