"""Folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayescal.errors import BayescalError


def check_free(folder: Path, marker: str) -> None:
    """Refuse a folder that holds anything but an earlier result of ours.

    Parameters
    ----------
    folder : Path
        Where a result is to go.
    marker : str
        The file by which an earlier result is known.
    """
    if folder.exists() and not folder.is_dir():
        raise BayescalError("a file of that name is there already", str(folder), "give another --out")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / marker).is_file():
        raise BayescalError(
            f"the folder holds something else (no {marker})", str(folder), "give another --out"
        )


@contextmanager
def whole(folder: Path, marker: str) -> Iterator[Path]:
    """A new folder to write into, which takes the place of `folder` once all is written.

    An earlier result, known by `marker`, is replaced; whatever fails, it stays as it was.
    """
    folder = folder.resolve()
    check_free(folder, marker)
    stage = folder.parent / f".{folder.name}.{os.getpid()}.part"
    old = folder.parent / f".{folder.name}.{os.getpid()}.old"
    try:
        stage.mkdir(parents=True)
        yield stage
        if folder.exists():
            folder.rename(old)
        stage.rename(folder)
    except OSError as error:
        raise BayescalError(
            error.strerror or "cannot be written", str(folder), "give another --out"
        ) from None
    finally:
        if old.exists() and not folder.exists():
            old.rename(folder)
        shutil.rmtree(old, ignore_errors=True)
        shutil.rmtree(stage, ignore_errors=True)
