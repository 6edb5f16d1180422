"""JSON schemas of dataset.yaml and robot.yaml, with which editors complete and check these files."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from bayescal.dataset.artefact import ArtefactFile
from bayescal.dataset.schema import file_model
from bayescal.errors import BayescalError
from bayescal.files import Keys, stem_of
from bayescal.robots.schema import RobotFile

DIALECT = "https://json-schema.org/draft/2020-12/schema"
UNITS = {"degps": "deg/s", "nm": "N m", "mps2": "m/s²", "c": "°C", "degc": "°C", "rad_per_nm": "rad/(N m)"}
"""Units of keys that are not written as in the key."""

MODELS: dict[str, Callable[[], type[Keys]]] = {
    "dataset": file_model,
    "robot": lambda: RobotFile,
    "artefact": lambda: ArtefactFile,
}
"""Models of the files, by name."""


def schema_of(name: str) -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a file that users write, from the models that read it.

    Parameters
    ----------
    name : str
        Of `MODELS`.

    Raises
    ------
    BayescalError
        If there is no such file.
    """
    if name not in MODELS:
        raise BayescalError(f"there is no schema `{name}`", "schema", f"known: {', '.join(MODELS)}")
    found = MODELS[name]().model_json_schema(by_alias=True)
    for part in (found, *found.get("$defs", {}).values()):
        for key, entry in part.get("properties", {}).items():
            entry.pop("title", None)
            _add_unit(key, entry)
    return {"$schema": DIALECT, **found, "title": f"{name}.yaml of bayescal"}


def schema_text(name: str) -> str:
    """The schema of `schema_of` as text."""
    return json.dumps(schema_of(name), indent=1, ensure_ascii=False) + "\n"


def _add_unit(key: str, entry: dict[str, Any]) -> None:
    """State the unit of a key at the end of its description."""
    unit = stem_of(key)[1]
    if unit and "description" in entry:
        entry["description"] = f"{entry['description']} Unit: {UNITS.get(unit, unit)}."
