"""A folder on disk to a `Dataset`.

From the cells of measurements.csv to `Measurements`, checked against tools, targets and noise.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.dataset import consistency, plausibility, session
from bayescal.dataset.schema import SCHEMA, file_model
from bayescal.dataset.solids import solids_of
from bayescal.dataset.table import EMPTY, LABELS, PIXEL, RPY, XYZ, Table, fields_of_columns, table_of
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import ROLES, Certificate, Dataset, Measurements, Noise, Target, Tool
from bayescal.errors import BayescalError, listed
from bayescal.robots import Loaded, is_xacro, load_robot
from bayescal.storage.files import SMALLEST, Document, check_schema, read_document, si, unknown
from bayescal.storage.reading import check_inside, content_of


def measurements_of(
    table: Table, units: Sequence[str], tools: tuple[Tool, ...], targets: tuple[Target, ...], noise: Noise
) -> Measurements:
    """Turn a table to SI units, or refuse the first bad row of each check; `units` as of `Robot.units`."""
    _check_ids(table)
    role = np.array([r or "calibrate" for r in table.cells.get("role", ("",) * len(table.line))])
    table.first(~np.isin(role, ROLES), "unknown role '{role}'", f"must be {', '.join(ROLES)}, or empty")
    target = _indices(table, "target", [t.name for t in targets])
    tool = _indices(table, "tool", [t.name for t in tools])
    fields = {field: _field(table, field, columns) for field, columns in fields_of_columns(units).items()}
    rows = Measurements(table.cells["id"], role, target, tool, line=table.line, **fields)
    _check_kinds(table, rows, tools, targets)
    _check_values(table, rows)
    _check_noise(table, rows, targets, noise)
    return rows


def _check_ids(table: Table) -> None:
    ids = table.cells["id"]
    table.first(np.array([not i for i in ids]), "`id` is empty", "give every row an id of its own")
    _, first, of = np.unique(ids, return_index=True, return_inverse=True)
    twice, remedy = first[of] != np.arange(len(ids)), "the first is in line {line}; rename one"
    table.first(twice, "id `{id}` is given twice", remedy, line=table.line[first[of]])


def _indices(table: Table, column: str, names: list[str]) -> np.ndarray:
    """Row by row the index into `names`; the only tool needs no naming."""
    index = {name: i for i, name in enumerate(names)}
    alone = column == "tool" and len(names) == 1
    if column not in table.cells:
        if alone:
            return np.zeros(len(table.line), int)
        what = f"no column `tool`, but there are {len(names)} tools"
        raise BayescalError(what, f"{table.name}:1", "say which in each row")
    out = np.empty(len(table.line), int)
    for row, cell in enumerate(table.cells[column]):
        if not cell and not alone:
            raise table.error(row, f"`{column}` is empty", f"write one of {listed(names)}")
        if cell and cell not in index:
            remedy = unknown(column, cell, names)[1]
            remedy = remedy if remedy.startswith("is it") else f"add it to `{column}s` in dataset.yaml"
            raise table.error(row, f"no entry of `{column}s` is called `{cell}`", remedy)
        out[row] = index.get(cell, 0)
    return out


def _field(table: Table, field: str, columns: tuple[str, ...]) -> Any:
    """A field of `Measurements` (N,) or (N, k), or None where there is none of its columns."""
    if field in LABELS:
        return table.texts(field)
    values = table.block(columns, needed=field not in EMPTY)
    if values is None:
        return None
    empty = np.isnan(values)
    for column, missing in zip(columns, empty.T, strict=True):
        if field in ("velocity", "rpy"):
            remedy = f"give all of {', '.join(columns)}, or none"
            table.first(missing & ~empty.all(axis=1), f"`{column}` is empty", remedy)
    values = np.where(empty, EMPTY.get(field, np.nan), values)
    return values if len(columns) > 1 else values[:, 0]


def _check_kinds(
    table: Table, rows: Measurements, tools: tuple[Tool, ...], targets: tuple[Target, ...]
) -> None:
    """Every row has what its target's kind needs, and nothing that it cannot use."""
    kind = np.array([t.kind for t in targets])[rows.target]
    no_ball = np.array([t.ball_radius is None for t in tools])[rows.tool]
    bad = np.array([KINDS[t.kind].touched for t in targets])[rows.target] & no_ball
    what, names = "{kind} `{target}` touched with `{by}`, which has no ball", [t.name for t in tools]
    table.first(bad, what, "add `ball_radius_mm` to the tool", kind=kind, by=np.array(names)[rows.tool])
    reads = np.array([KINDS[t.kind].reads for t in targets])[rows.target]

    def check_cells(field: str, needed: tuple[str, ...], further: tuple[str, ...] = ()) -> None:
        for column in (*needed, *further):
            given = np.array([cell != "" for cell in table.cells.get(column, ("",) * len(kind))])
            for name in readers(field) if column in needed else ():
                what = f"{name} `{{target}}`, but `{column}` is empty"
                table.first((kind == name) & ~given, what, f"fill in {', '.join(needed)}")
            _refuse(table, (reads != field) & given, column, " or ".join(readers(field)))

    check_cells("xyz", XYZ, RPY)
    fixed = np.array([np.isfinite(t.values.get("length", np.nan)) for t in targets])[rows.target]
    read = np.zeros(len(kind), bool) if rows.length is None else np.isfinite(rows.length)
    for name in readers("length"):
        lengthless = f"{name} `{{target}}` has no `length_mm`"
        table.first((kind == name) & ~fixed & ~read, lengthless, "write it in the row, or in the target")
    _refuse(table, read & (reads != "length"), "length_mm", " or ".join(readers("length")))
    check_cells("pixel", PIXEL)


def readers(field: str) -> list[str]:
    """Kinds of target whose rows read a field of `Measurements`."""
    return [kind.name for kind in KINDS.values() if kind.reads == field]


def _refuse(table: Table, bad: np.ndarray, column: str, kind: str) -> None:
    what = f"`{column}` is given, but `{{target}}` is no {kind}"
    table.first(bad, what, f"leave the cell empty, or name the {kind}")


def _check_values(table: Table, rows: Measurements) -> None:
    if rows.payload is not None:
        table.first(rows.payload < 0, "`payload_kg` is {payload_kg}", "a mass is not negative")
    if rows.u is not None:
        remedy = f"must be more than 0, at least {SMALLEST:g}, or empty for the stated noise"
        table.first(rows.u < si("u_mm") * SMALLEST, "`u_mm` is {u_mm}", remedy)
    if rows.length is not None:
        table.first(rows.length <= 0, "`length_mm` is {length_mm}", "must be more than 0")

    # A clock that goes back is let pass: a long real session has poses measured again and appended.


def _check_noise(table: Table, rows: Measurements, targets: tuple[Target, ...], noise: Noise) -> None:
    """Every row knows its standard uncertainty: its own, or the stated one of its kind."""
    of = np.array([KINDS[t.kind].noise for t in targets])[rows.target]
    in_row = np.zeros(len(of), bool) if rows.u is None else np.isfinite(rows.u)
    for kind in ("contact", "point"):
        if getattr(noise, kind) is None:
            what = f"no noise is stated for a row of `{{target}}`: `noise` has no `{kind}_mm`"
            remedy = f"add `{kind}_mm` to `noise` in dataset.yaml, or `u_mm` to the row"
            table.first((of == kind) & ~in_row, what, remedy)


SETTINGS, TABLE = "dataset.yaml", "measurements.csv"
MARKED = ("tools", "noise", "targets", "certificates")
"""Keys below which values that are not filled in may be assumed; the writer marks them again."""


def read_dataset(
    folder: Path | str, judge: bool = True, robot: Loaded | None = None, rows: bytes | None = None
) -> Dataset:
    """Read and check a dataset folder.

    Parameters
    ----------
    folder : Path or str
        Holds ``dataset.yaml``, ``measurements.csv`` and, unless it is a built-in one, the robot.
    judge : bool
        Whether what keeps the contract but cannot have been measured is refused.
    robot : Loaded, optional
        In place of the one that dataset.yaml names, as of `expanded_robot`.
    rows : bytes, optional
        In place of the content of measurements.csv, as its first lines.

    Returns
    -------
    Dataset
        In SI units. Its `sha256` is that of dataset.yaml, measurements.csv and the robot's file.

    Raises
    ------
    BayescalError
        With file, line and remedy, of the first thing that breaks the contract or cannot be.
    """
    dataset, table, document = read_parts(folder, robot, rows)
    if judge:
        consistency.check_sign(dataset, document)
        plausibility.check(dataset, table, document)
        consistency.check(dataset, table)
    return dataset


def read_parts(
    folder: Path | str, robot: Loaded | None = None, rows: bytes | None = None
) -> tuple[Dataset, Table, Document]:
    """Read a dataset folder without judging it: the dataset, its table, and dataset.yaml.

    Raises
    ------
    BayescalError
        As `read_dataset`, of the first thing that breaks the format.
    """
    folder = check_folder(folder)
    if not (folder / SETTINGS).exists():
        inside = sorted(str(p.parent) for level in ("*", "*/*") for p in folder.glob(f"{level}/{SETTINGS}"))
        if inside:
            what = f"no {SETTINGS} in it"
            raise BayescalError(what, str(folder), f"datasets in this folder: {listed(inside)}")
    bare, document, contents = read_settings(folder / SETTINGS, robot)
    units = bare.robot.units
    table = table_of(content_of_table(folder) if rows is None else rows, TABLE, units)
    m = measurements_of(table, units, bare.tools, bare.targets, bare.noise)
    dataset = replace(bare, measurements=m, sha256=_digest(document.content, table.content, *contents))
    for index, target in enumerate(dataset.targets):
        if (prepared := KINDS[target.kind].prepared) is not None:
            dataset = prepared(dataset, index, table, document)
    consistency.check_present(dataset, document)
    return dataset, table, document


def check_folder(folder: Path | str) -> Path:
    """Refuse a path that is no folder."""
    folder = Path(folder)
    if not folder.is_dir():
        remedy = "give the folder, not a file in it" if folder.exists() else "check the path"
        raise BayescalError("no such folder", str(folder), remedy)
    return folder


def content_of_table(folder: Path) -> bytes:
    """Bytes of measurements.csv of a dataset folder."""
    check_inside(folder / TABLE, folder, "the table")
    return content_of(folder / TABLE)


def read_settings(
    path: Path, robot: Loaded | None = None, assume: bool = False
) -> tuple[Dataset, Document, tuple[bytes, ...]]:
    """Read a dataset.yaml, its robot and artefact: a `Dataset` of no rows, the document, the files' contents.

    Its `sha256` is that of all files. `robot` as of `read_dataset`. `assume`: values that are marked
    as not filled in are taken as assumed, and named in `unfilled`; they are refused otherwise.
    """
    check_inside(path, path.parent, "the file")
    document = read_document(path)
    check_schema(document, SCHEMA)
    file = document.parse(file_model(), MARKED if assume else ())
    try:
        arm, robot_content = robot or load_robot(file.robot, path.parent, inside=True)
    except BayescalError as error:
        raise BayescalError(error.what, error.where or document.where(("robot",)), error.remedy) from None
    arm, gravity = session.holding(document, file, arm), session.gravity_of(document, file)
    tools = tuple(Tool(name, **session.fields_of(tool)) for name, tool in file.tools.items())
    targets = session.targets_of(document, file)
    certificates = session.certificates_of(document, file, targets)
    derived: tuple[Certificate, ...] = ()
    contents: tuple[bytes, ...] = (robot_content,)
    if file.artefact is not None:
        derived, content = session.certificates_of_points(path.parent, file.artefact, targets, certificates)
        contents = (robot_content, content)
    dataset = Dataset(
        name=file.name, folder=path.parent, robot=arm, robot_reference=file.robot, readings=file.readings,
        gravity=gravity, tools=tools, noise=Noise(**session.fields_of(file.noise)), targets=targets,
        certificates=(*certificates, *derived), measurements=no_rows(arm.n),
        temperature_of=file.temperature_of, torques=file.torques,
        plan=session.plan_of(document, file, targets, arm), record=session.record_of(file),
        solids=solids_of(document, file.solids, path.parent, [t.name for t in targets]), source=file.source,
        unfilled=tuple(document.unfilled), sha256=_digest(document.content, *contents),
    )  # fmt: skip
    return dataset, document, contents


def expanded_robot(path: Path) -> Loaded | None:
    """The robot of a dataset.yaml, or of its folder, that names a xacro file; None of another.

    The file, which is a program, is executed: only where the user allowed it.
    """
    path = path / SETTINGS if path.is_dir() else path
    try:
        reference = read_document(path).data.get("robot")
    except BayescalError:
        return None  # the reader says what is wrong
    if not isinstance(reference, str) or not is_xacro(reference):
        return None
    return load_robot(reference, path.parent, allow_xacro=True, inside=True)


def no_rows(n: int) -> Measurements:
    """Measurements of an arm with n joints, before any was made."""
    none = np.zeros(0, int)
    return Measurements((), none.astype(str), none, none, np.zeros((0, n)), none)


def _digest(*contents: bytes) -> str:
    """SHA-256 of the files' own SHA-256, in order."""
    return hashlib.sha256(b"".join(hashlib.sha256(c).digest() for c in contents)).hexdigest()
