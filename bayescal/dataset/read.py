"""A folder on disk to a `Dataset`."""

from __future__ import annotations

import hashlib
from pathlib import Path

from bayescal.dataset import plausible, session
from bayescal.dataset.rows import measurements_of
from bayescal.dataset.schema import SCHEMA, DatasetFile
from bayescal.dataset.table import read_table
from bayescal.dataset.types import Dataset
from bayescal.errors import BayescalError
from bayescal.files import check_schema, read_document
from bayescal.robots import load_robot

SETTINGS, TABLE = "dataset.yaml", "measurements.csv"


def read_dataset(folder: Path | str) -> Dataset:
    """Read and check a dataset folder.

    Parameters
    ----------
    folder : Path or str
        Holds ``dataset.yaml``, ``measurements.csv`` and, unless it is a built-in one, the robot.

    Returns
    -------
    Dataset
        In SI units. Its `sha256` is that of dataset.yaml, measurements.csv and the robot's file.

    Raises
    ------
    BayescalError
        With file, line and remedy, of the first thing that breaks the contract or cannot be.
    """
    folder = Path(folder)
    if not folder.is_dir():
        remedy = "give the folder, not a file in it" if folder.exists() else "check the path"
        raise BayescalError("no such folder", str(folder), remedy)
    document = read_document(folder / SETTINGS)
    check_schema(document, SCHEMA)
    file = document.parse(DatasetFile)
    try:
        robot, robot_content = load_robot(file.robot, folder)
    except BayescalError as error:
        raise BayescalError(error.what, error.where or document.where(("robot",)), error.remedy) from None
    gravity = session.gravity_of(document, file)
    tools, noise = session.tools_of(file), session.noise_of(file)
    targets = session.targets_of(document, file)
    certificates = session.certificates_of(document, file, targets)
    table = read_table(folder / TABLE, robot.n)
    dataset = Dataset(
        name=file.name,
        folder=folder,
        robot=robot,
        robot_reference=file.robot,
        readings=file.readings,
        gravity=gravity,
        tools=tools,
        noise=noise,
        targets=targets,
        certificates=certificates,
        measurements=measurements_of(table, robot.n, tools, targets, noise),
        temperature_of=file.temperature_of,
        source=file.source,
        sha256=_digest(document.content, table.content, robot_content),
    )
    plausible.check(dataset, table, document)
    return dataset


def _digest(*contents: bytes) -> str:
    """SHA-256 of the files' own SHA-256, in order."""
    return hashlib.sha256(b"".join(hashlib.sha256(c).digest() for c in contents)).hexdigest()
