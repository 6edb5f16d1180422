"""The first keys of every record: schema, dataset, what is filed of it, software, seed."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from typing import Any

from bayescal import __version__
from bayescal.dataset import Dataset
from bayescal.dataset.types import Record

SERIALS = ("arm", "probe", "artefact", "instrument")
NOT_STATED = "not stated"


def origin(schema: str, dataset: Dataset, seed: int, libraries: Iterable[str]) -> dict[str, Any]:
    """Schema, dataset (and each of several sessions) with its hash, its record, all software, seed."""
    named: dict[str, Any] = {"name": dataset.name, "sha256": dataset.sha256}
    if dataset.sessions:
        named["sessions"] = [
            {
                "name": s.name,
                "sha256": s.sha256,
                "rows": len(s.measurements.ids),
                "record": record_of(s.record),
            }
            for s in dataset.sessions
        ]
    return {
        "schema": schema,
        "dataset": named,
        "record": record_of(dataset.record),
        "software": software(libraries),
        "seed": seed,
    }


def record_of(record: Record) -> dict[str, Any]:
    """``record``: date, operator, serial numbers, certificates, temperature; null where not stated."""
    return {
        "date": record.date or None,
        "operator": record.operator or None,
        "serials": {what: record.serials.get(what) for what in SERIALS},
        "certificates": list(record.certificates),
        "temperature_degC": record.temperature,
    }


def filed(record: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """The header of a report: names and values of ``record``; () where the session states none of them.

    The serial number of the instrument, which not every session has, is left out where it is not stated.
    """
    serials, warm = record.get("serials") or {}, record.get("temperature_degC")
    values = {
        "Date": record.get("date"),
        "Operator": record.get("operator"),
        **{f"Serial number, {what}": serials.get(what) for what in SERIALS[:3]},
        **({"Serial number, instrument": serials["instrument"]} if serials.get("instrument") else {}),
        "Certificates": ", ".join(record.get("certificates") or ()),
        "Temperature": None if warm is None else f"{warm:g} °C",
    }
    return tuple((k, v or NOT_STATED) for k, v in values.items()) if any(values.values()) else ()


def filed_lines(dataset: Dataset) -> list[tuple[str, str, str]]:
    """The same as lines of the terminal, of each session: heading, text, style; without what is missing."""
    out: list[tuple[str, str, str]] = []
    for s in dataset.sessions or (dataset,):
        known = [f"{k[:1].lower()}{k[1:]} {v}" for k, v in filed(record_of(s.record)) if v != NOT_STATED]
        if known:
            out.append(("" if out else "record", "; ".join(known), "dim"))
    return out


def software(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of bayescal, Python and the libraries."""
    ours = {"bayescal": __version__, "python": platform.python_version()}
    return ours | {name: version(name) for name in libraries}
