"""What a format writes: its file, what is in it, and what it could hold; the sidecar that says both.

The sidecar names the simulators of a file: what other commands need of an export.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, Field, ValidationError

from bayescal.effects import UNITS
from bayescal.errors import BayescalError
from bayescal.fitted.arm import FittedArm
from bayescal.storage.files import Number, Vector, json_text, write_together
from bayescal.storage.reading import content_of, library, read_record

IN_F0 = "in_f0"
"""Name of the body, or link, of two arms whose frame is F0."""


@dataclass(frozen=True)
class Options:
    """What a user asks of an export.

    `state` is the row of the session whose state is written: time, temperature and events. `into` is the
    user's own file, which is patched in a copy.
    """

    state: int
    name: str = "arm"
    into: str = ""
    readings: str = "plain"


@dataclass(frozen=True)
class Item:
    """A fitted parameter in a file: value and u in `unit`, and the place where it acts."""

    parameter: str
    value: float
    u: float
    unit: str
    element: str
    attribute: str


Placed = Callable[[Path], str]
"""The content of a file that is written to a folder: what it names by relative paths is found from there."""


@dataclass(frozen=True)
class Written:
    """The content of an exported file.

    `beside` are further files by the suffix that is added to the name of the first one; `details` are further
    entries of the sidecar. `placed`, where the content depends on the folder, is that of a folder; else the
    content is right beside the file of the user.
    """

    content: str | bytes
    items: Sequence[Item] = ()
    beside: Mapping[str, str | bytes] = field(default_factory=dict)
    notes: Sequence[str] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    placed: Placed | None = None


@dataclass(frozen=True)
class Format:
    """One kind of file.

    Parameters
    ----------
    suffix : str
    write : callable
        The file of an arm.
    holds : callable
        Whether the file can hold a parameter, by its number; one that changes with time counts as held
        if the file can hold it at one state.
    limits : str
        What it cannot hold, as the reason for the user: 'a URDF has constant geometry only'.
    into : bool
        Whether it can patch a file of the user.
    readings : tuple of str
        How it can hold errors of the readings: 'plain' in the file, 'script' in a script beside it.
    prismatic : bool
        Whether a new file holds prismatic joints.
    two_arms : tuple of str
        Where it holds a chain through two arms: 'plain', in a new file, and 'into', in one of the user.
    """

    suffix: str
    write: Callable[[FittedArm, Options], Written]
    holds: Callable[[FittedArm, int], bool]
    limits: str
    into: bool = False
    readings: tuple[str, ...] = ("plain",)
    prismatic: bool = False
    two_arms: tuple[str, ...] = ()


def item(arm: FittedArm, k: int, element: str, attribute: str) -> Item:
    """Parameter number `k` of an arm as it stands in a file."""
    p = arm.model.parameters[k]
    unit, factor = UNITS[p.unit]
    value = (p.nominal + float(arm.values[k])) * factor
    return Item(p.name, value, float(arm.covariance[k, k]) ** 0.5 * factor, unit, element, attribute)


def path_of(into: str) -> tuple[Path, str]:
    """File and link of ``arm.urdf#tool0``; the link is "" where none is given."""
    file, _, tip = into.partition("#")
    return Path(file), tip


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


def digest(content: str | bytes) -> str:
    """SHA-256 of the content of a file."""
    return sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def replace_earlier(
    path: Path, content: Mapping[Path, str | bytes], record: Mapping[str, Any], to_patch: Path | None = None
) -> tuple[Path, ...]:
    """Write an export to `path`, its sidecar with `record` last, in place of an earlier one; all their paths.

    The sidecar is put in place first, with the hashes of the earlier files (`replaces`), and last without
    them. If the process is killed in between, no file is without a sidecar that knows it.

    Parameters
    ----------
    path : Path
        The main file.
    content : mapping
        Of all files but the sidecar.
    record : mapping
        Of the sidecar, with `schema`, `sha256` of the main file and `beside`, the hashes of the others.
    to_patch : Path, optional
        The user's file that the main file is a changed copy of.

    Raises
    ------
    BayescalError
        If one of them is the user's own file, or another file that is no unchanged earlier export.
    """
    sidecar = sidecar_of(path)
    files = {**content, sidecar: json_text(record)}
    earlier = _earlier(sidecar, path.name, record["schema"])
    there = {file: "" if file == sidecar else _found(file) for file in filter(Path.exists, files)}
    for file, checksum in there.items():
        if to_patch is not None and to_patch.exists() and file.samefile(to_patch):
            what = "is the file to patch itself"
            raise BayescalError(what, str(file), "give another --out: it is not changed")
        if file != sidecar and checksum not in earlier.get(file.name, ()):
            raise BayescalError("exists and is no unchanged export", str(file), "give another --out")
        if file == sidecar and not earlier:
            raise BayescalError("exists and is no sidecar of an export", str(file), "give another --out")
    replaced = {file.name: checksum for file, checksum in there.items() if file != sidecar}
    write_together(files, {sidecar: json_text({**record, "replaces": replaced})})
    return tuple(files)


def _found(file: Path) -> str:
    """SHA-256 of a file, "" of what is no file or cannot be read."""
    try:
        return digest(file.read_bytes()) if file.is_file() else ""
    except OSError:
        return ""


def _earlier(sidecar: Path, name: str, schema: str) -> dict[str, set[str]]:
    """Hashes of the files of an earlier export, by their names; none if the sidecar is of no export.

    Where an export was interrupted, a file is the earlier or the new one.
    """
    try:
        record = json.loads(content_of(sidecar).decode("utf-8"))
        new = {**record.get("beside", {}), name: record["sha256"]} if record["schema"] == schema else {}
        replaced = record.get("replaces", {})
        return {key: {checksum, replaced.get(key, checksum)} for key, checksum in new.items()}
    except (BayescalError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


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
    for name, wanted in {path.name: record["sha256"], **record["beside"]}.items():
        file = path.parent / name
        if not file.is_file() or digest(file.read_bytes()) != wanted:
            what = f"the export was interrupted before {name} was in place"
            raise BayescalError(what, str(path), AGAIN)


def _entries(record: Mapping[str, Any]) -> type[_Sidecar]:
    """What a sidecar must have."""
    if record.get("format") == "urdf":
        return _Urdf
    placed = record.get("format") == "mjcf" and record.keys() & {"into", "joints", "root_in_f0"}
    return _Placed if placed else _Sidecar


def mujoco() -> Any:
    """The module of MuJoCo. Its warnings are not written to a file of the working folder.

    Raises
    ------
    BayescalError
        If it is not installed.
    """
    module = library("mujoco", "MuJoCo is not installed", "simulator", "pip install 'bayescal[mujoco]'")
    module.set_mju_user_warning(lambda _: None)
    return module


def pinocchio() -> Any:
    """The module of Pinocchio.

    Raises
    ------
    BayescalError
        If it is not installed.
    """
    remedy = "pip install 'bayescal[mujoco]' or 'bayescal[pinocchio]'"
    return library("pinocchio", "neither MuJoCo nor Pinocchio is installed", "simulator", remedy)
