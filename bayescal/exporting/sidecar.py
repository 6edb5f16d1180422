"""The sidecar of an exported file, and simulators: what other commands need of an export."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from pydantic import BaseModel, Field, ValidationError

from bayescal.errors import BayescalError
from bayescal.storage.files import Number, Vector
from bayescal.storage.reading import library, read_record

SCHEMA: Literal["bayescal-export/1"] = "bayescal-export/1"
SUFFIX = ".bayescal.json"
AGAIN = "export the arm again"
Row = tuple[Number, Number, Number, Number]
Pose = tuple[Row, Row, Row, Row]


class _Dataset(BaseModel):
    name: str


class _State(BaseModel):
    row: str


class _Missing(BaseModel):
    effect: str
    rms_um: Number | None


class _Tool(BaseModel):
    name: str
    centre_mm: Vector


class _Sidecar(BaseModel):
    """Entries of every sidecar; further ones are not read."""

    schema_: Literal["bayescal-export/1"] = Field(alias="schema")
    sha256: str
    beside: dict[str, str]
    format: str
    dataset: _Dataset
    robot: str
    model: list[str]
    without: list[str]
    state: _State
    not_expressed: list[_Missing]
    tools: list[_Tool]


class _Placed(_Sidecar):
    """Of a file whose joints have names of its own, in a root of its own."""

    joints: dict[str, str]
    signs: list[Number]
    joint_from_reading: list[list[Number]]
    root_in_f0: Pose


class _Urdf(_Placed):
    tip: str
    flange_in_tip: Pose


def sidecar_of(path: Path) -> Path:
    """The sidecar beside an exported file."""
    return path.with_name(path.name + SUFFIX)


def read_sidecar(path: Path) -> Mapping[str, Any]:
    """The sidecar of an exported file, with all entries that its format needs.

    Raises
    ------
    BayescalError
        If there is none, it is of another version, an entry is missing or wrong, or the export was
        interrupted before all its files were in place.
    """
    beside = sidecar_of(path)
    record = read_record(beside, SCHEMA, AGAIN)
    try:
        _entries(record).model_validate_json(json.dumps(record), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        what = f"`{'.'.join(map(str, first['loc']))}`: {first['msg']}"
        raise BayescalError(what, str(beside), AGAIN) from None
    if "replaces" in record:
        _check_complete(path, record)
    return record


def _check_complete(path: Path, record: Mapping[str, Any]) -> None:
    """Refuse files of which one is still of the export before the one of the sidecar."""
    for name, digest in {path.name: record["sha256"], **record["beside"]}.items():
        file = path.parent / name
        if not file.is_file() or sha256(file.read_bytes()).hexdigest() != digest:
            what = f"the export was interrupted before {name} was in place"
            raise BayescalError(what, str(path), AGAIN)


def _entries(record: Mapping[str, Any]) -> type[_Sidecar]:
    """What a sidecar must have."""
    if record.get("format") == "urdf":
        return _Urdf
    placed = record.get("format") == "mjcf" and record.keys() & {"into", "joints", "root_in_f0"}
    return _Placed if placed else _Sidecar


def mujoco() -> ModuleType:
    """The module of MuJoCo. Its warnings are not written to a file of the working folder.

    Raises
    ------
    BayescalError
        If it is not installed.
    """
    library("mujoco", "MuJoCo is not installed", "simulator", "pip install 'bayescal[mujoco]'")
    import mujoco as module

    module.set_mju_user_warning(lambda _: None)
    return module


def pinocchio() -> ModuleType:
    """The module of Pinocchio.

    Raises
    ------
    BayescalError
        If it is not installed.
    """
    remedy = "pip install 'bayescal[mujoco]' or 'bayescal[pinocchio]'"
    library("pinocchio", "neither MuJoCo nor Pinocchio is installed", "simulator", remedy)
    import pinocchio as module

    return module
