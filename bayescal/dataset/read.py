"""A folder on disk to a `Dataset`."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayescal.dataset import artefact, session
from bayescal.dataset.checks import orientation_check, plausibility, torque_check
from bayescal.dataset.rows import measurements_of
from bayescal.dataset.schema import SCHEMA, file_model
from bayescal.dataset.solids import solids_of
from bayescal.dataset.table import Table, read_table
from bayescal.dataset.types import Certificate, Dataset, Measurements
from bayescal.errors import BayescalError, listed
from bayescal.files import Document, check_schema, read_document
from bayescal.reading import check_inside
from bayescal.robots import load_robot

SETTINGS, TABLE = "dataset.yaml", "measurements.csv"
MARKED = ("tools", "noise", "targets", "certificates")
"""Keys below which values that are not filled in may be assumed; the writer marks them again."""


def read_dataset(folder: Path | str, judge: bool = True, allow_xacro: bool = False) -> Dataset:
    """Read and check a dataset folder.

    Parameters
    ----------
    folder : Path or str
        Holds ``dataset.yaml``, ``measurements.csv`` and, unless it is a built-in one, the robot.
    judge : bool
        Whether what keeps the contract but cannot have been measured is refused.
    allow_xacro : bool
        Whether a robot in a xacro file, which is a program, may be executed; refused otherwise.

    Returns
    -------
    Dataset
        In SI units. Its `sha256` is that of dataset.yaml, measurements.csv and the robot's file.

    Raises
    ------
    BayescalError
        With file, line and remedy, of the first thing that breaks the contract or cannot be.
    """
    dataset, table, document = read_parts(folder, allow_xacro)
    if judge:
        torque_check.check_sign(dataset, document)
        plausibility.check(dataset, table, document)
        orientation_check.check(dataset, table)
    return dataset


def read_parts(folder: Path | str, allow_xacro: bool = False) -> tuple[Dataset, Table, Document]:
    """Read a dataset folder without judging it: the dataset, its table, and dataset.yaml.

    Raises
    ------
    BayescalError
        As `read_dataset`, of the first thing that breaks the format.
    """
    folder = Path(folder)
    if not folder.is_dir():
        remedy = "give the folder, not a file in it" if folder.exists() else "check the path"
        raise BayescalError("no such folder", str(folder), remedy)
    if not (folder / SETTINGS).exists():
        inside = sorted(str(p.parent) for level in ("*", "*/*") for p in folder.glob(f"{level}/{SETTINGS}"))
        if inside:
            what = f"no {SETTINGS} in it"
            raise BayescalError(what, str(folder), f"datasets in this folder: {listed(inside)}")
    bare, document, contents = read_settings(folder / SETTINGS, allow_xacro)
    n = bare.robot.n
    check_inside(folder / TABLE, folder, "the table")
    table = read_table(folder / TABLE, n)
    dataset = replace(
        bare,
        measurements=measurements_of(table, n, bare.tools, bare.targets, bare.noise),
        sha256=_digest(document.content, table.content, *contents),
    )
    torque_check.check_present(dataset, document)
    return dataset, table, document


def read_settings(
    path: Path, allow_xacro: bool = False, assume: bool = False
) -> tuple[Dataset, Document, tuple[bytes, ...]]:
    """Read a dataset.yaml, its robot and artefact: a `Dataset` of no rows, the document, the files' contents.

    Its `sha256` is that of all files. `allow_xacro` as of `read_dataset`. `assume`: values that are marked
    as not filled in are taken as assumed, and named in `unfilled`; they are refused otherwise.
    """
    check_inside(path, path.parent, "the file")
    document = read_document(path)
    check_schema(document, SCHEMA)
    file = document.parse(file_model(), MARKED if assume else ())
    try:
        robot, robot_content = load_robot(file.robot, path.parent, allow_xacro, inside=True)
    except BayescalError as error:
        raise BayescalError(error.what, error.where or document.where(("robot",)), error.remedy) from None
    gravity = session.gravity_of(document, file)
    tools, noise = session.tools_of(file), session.noise_of(file)
    targets = session.targets_of(document, file)
    certificates = session.certificates_of(document, file, targets)
    derived: tuple[Certificate, ...] = ()
    contents: tuple[bytes, ...] = (robot_content,)
    if file.artefact is not None:
        derived, content = artefact.certificates_of(path.parent, file.artefact, targets, certificates)
        contents = (robot_content, content)
    dataset = Dataset(
        name=file.name,
        folder=path.parent,
        robot=robot,
        robot_reference=file.robot,
        readings=file.readings,
        gravity=gravity,
        tools=tools,
        noise=noise,
        targets=targets,
        certificates=(*certificates, *derived),
        measurements=no_rows(robot.n),
        temperature_of=file.temperature_of,
        torques=file.torques,
        plan=session.plan_of(document, file, targets, robot.n),
        record=session.record_of(file),
        solids=solids_of(document, file.solids, path.parent, [t.name for t in targets]),
        source=file.source,
        unfilled=tuple(document.unfilled),
        sha256=_digest(document.content, *contents),
    )
    return dataset, document, contents


def no_rows(n: int) -> Measurements:
    """Measurements of an arm with n joints, before any was made."""
    none = np.zeros(0, int)
    return Measurements((), none.astype(str), none, none, np.zeros((0, n)), none)


def _digest(*contents: bytes) -> str:
    """SHA-256 of the files' own SHA-256, in order."""
    return hashlib.sha256(b"".join(hashlib.sha256(c).digest() for c in contents)).hexdigest()
