"""fit.json of a session and a log that were fitted together: record, terminal, folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from bayescal.motion.together import Together
from bayescal.reporting.fit.record import fit_record, write_fit
from bayescal.reporting.motion.fit import FIT, SCHEMA
from bayescal.reporting.motion.fit import fit_record as log_record
from bayescal.reporting.motion.fit import write_fit as write_log
from bayescal.reporting.motion.record import LIBRARIES
from bayescal.reporting.motion.sheets import together_sheet
from bayescal.reporting.shared.origin import plain, software
from bayescal.reporting.shared.sheet import screen, terminal
from bayescal.reporting.shared.text import Facts, p_value, under
from bayescal.statistics import chi2_sf
from bayescal.storage.files import json_text
from bayescal.storage.folders import whole
from bayescal.storage.reading import Json

CONTACTS, LOG = "contacts", "log"
"""Run folders of the two, in that of both."""
UNIT = "together"
"""In place of the unit of a record."""
UNLIKELY = 0.01
"""P of the change of the masses, below which the two contradict each other (convention)."""


def together_record(result: Together) -> dict[str, Any]:
    """The contents of fit.json."""
    log, session = result.log.log, result.contacts.dataset
    p = float(chi2_sf(result.chi2, result.dof)) if result.dof else 1.0
    record = {
        "schema": SCHEMA,
        "unit": UNIT,
        "session": session.name,
        "log": {"name": log.name, "sha256": log.digest},
        "software": software(LIBRARIES),
        "seed": result.log.seed,
        "robot": session.robot.name,
        "shared": [vars(s) | {"alone": _with_u(s.alone), "both": _with_u(s.both)} for s in result.shared],
        "agreement": {"chi2": result.chi2, "dof": result.dof, "p": p},
        "fits_of_session": result.rounds,
        "warnings": _warnings(result, p),
    }
    return {key: plain(value) for key, value in record.items()}


def _with_u(value: tuple[float, float]) -> Json:
    return dict(zip(("estimate", "u"), value, strict=True))


def _warnings(result: Together, p: float) -> list[str]:
    out = [f"{CONTACTS}: {text}" for text in result.contacts.warnings]
    if p < UNLIKELY:
        out.append(
            f"the session and the log contradict each other in the masses (P {p_value(p)}): another tool, "
            "payload or model; fit them one by one"
        )
    return out


def together_summary(record: Json, verbose: bool = False) -> RenderableType:
    """Parameters by one alone and by both."""
    title = Text.assemble(
        (f"{record['session']} + {record['log']['name']}", "bold"), f"  {record['robot']}  fitted together"
    )
    return screen(title, "", terminal(together_sheet(record, verbose)), _facts(record))


def _facts(record: Json) -> Facts:
    a = record["agreement"]
    words = f"chi-square {a['chi2']:.3g} of {a['dof']} directions of the masses that both determine"
    yield "agreement", f"{words} (P {p_value(a['p'])})", ""
    yield "", f"{CONTACTS}/ and {LOG}/ are the run folders of the two", "dim"
    yield from under("warning", record["warnings"], "yellow")


def write_together(
    result: Together, folder: Path, contents: Mapping[str, Any], pictures: bool
) -> tuple[str, ...]:
    """Write fit.json and the run folders of both atomically; return the names."""
    with whole(folder, FIT) as stage:
        (stage / FIT).write_text(json_text(contents, rows=False), encoding="utf-8")
        write_fit(result.contacts, stage / CONTACTS, fit_record(result.contacts), pictures, folder / CONTACTS)
        write_log(result.log, stage / LOG, log_record(result.log), folder / LOG)
        return FIT, CONTACTS, LOG
