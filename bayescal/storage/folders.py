"""Run folders: they are written atomically and replace only results that bayescal wrote itself.

Every folder contains a list of the files that were written into it, with their SHA-256 (`LIST`). A folder is
replaced only if it contains exactly these files, unchanged. The new files are written to a staging folder
beside it and synchronised with the disk. Then the earlier folder is renamed, then the new one, and the
earlier one is removed. A process that is killed between the two calls leaves the earlier folder under a
hidden name (`beside`); the next command for that folder restores it. No folder ever has a part of a result.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from bayescal.errors import BayescalError
from bayescal.storage.files import json_text
from bayescal.storage.locks import ASIDE, OTHER_OUT, PART, alone, beside, leftovers
from bayescal.storage.reading import content_of, open_regular
from bayescal.storage.stopping import completed

LIST = ".bayescal-files.json"
SCHEMA = "bayescal-files/1"
SHOWN = 3
"""Maximum number of files that an error message names."""


def check_free(folder: Path, marker: str) -> None:
    """Refuse a folder that contains anything except an unchanged earlier result of the same command.

    First, folders that killed processes left beside it are restored or removed.

    Parameters
    ----------
    folder : Path
        Output folder of a command.
    marker : str
        The file that identifies an earlier result of the same command.

    Raises
    ------
    BayescalError
        With the names of files that would be lost.
    """
    if folder.exists() and not folder.is_dir():
        raise BayescalError("a file with this name exists", str(folder), OTHER_OUT)
    _recover(folder.resolve())
    try:
        if not folder.is_dir() or not any(folder.iterdir()):
            return
    except OSError as error:
        raise BayescalError(error.strerror or "cannot be read", str(folder), OTHER_OUT) from None
    written = _written(folder)
    if foreign := _foreign(folder, written) if written else _top_level(folder):
        names = [f"{name} (changed)" if name in written else name for name in foreign[:SHOWN]]
        names += ["..."] if len(foreign) > SHOWN else []
        what = f"the folder contains files that bayescal did not write: {', '.join(names)}"
        raise BayescalError(what, str(folder), f"{OTHER_OUT}, or move these files")
    if marker not in written:
        what = f"the folder contains the result of another command, without {marker}"
        raise BayescalError(what, str(folder), f"{OTHER_OUT}, or remove the folder")


@contextmanager
def whole(folder: Path, marker: str) -> Iterator[Path]:
    """Yield a new folder to write into; it replaces `folder` when all files are written.

    An earlier result, identified by `marker`, is replaced. If anything fails, it is not changed.

    Raises
    ------
    BayescalError
        As `check_free`, or if the folder cannot be written.
    """
    folder = folder.resolve()
    with claimed(folder, marker):
        stage = beside(folder, PART)
        try:
            stage.mkdir()
            yield stage
            _seal(stage)
            check_free(folder, marker)  # files may have been added during a long run
            _put(stage, folder)
            completed(f"{folder} is complete")
        except OSError as error:
            raise BayescalError(error.strerror or "cannot be written", str(folder), OTHER_OUT) from None
        finally:
            _discard(stage)


def put(stage: Path, files: Mapping[str, str | bytes]) -> tuple[str, ...]:
    """Write texts and contents into a folder by name; return the names."""
    for name, content in files.items():
        (stage / name).write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
    return tuple(files)


def filled(folder: Path, texts: Mapping[str, str]) -> tuple[str, ...]:
    """Write a run folder of texts by name, the first of which identifies it; return the names."""
    with whole(folder, next(iter(texts))) as stage:
        return put(stage, texts)


@contextmanager
def claimed(folder: Path, marker: str) -> Iterator[Path]:
    """Lock a folder for the result of a command, before a long computation; see `check_free`, `alone`.

    Raises
    ------
    BayescalError
        As `check_free`, or if another run writes to it.
    """
    check_free(folder, marker)  # nothing is created beside a folder of the user
    with alone(folder):
        check_free(folder, marker)
        yield folder


def check_unchanged(folder: Path, names: Iterable[str]) -> None:
    """Refuse files of a run folder, or files below its folders, that are not as they were written.

    Without the list of written files (a part of a run folder was copied) nothing is refused.

    Raises
    ------
    BayescalError
        With the first file that was changed or removed.
    """
    written = _written(folder)
    for name in names:
        for file, digest in written.items():
            if (file == name or file.startswith(f"{name}/")) and _sha256(folder / file) != digest:
                what = f"{file} was changed or removed after the run had written it"
                raise BayescalError(what, str(folder), "repeat the command that wrote the folder")


def _written(folder: Path) -> dict[str, str]:
    """SHA-256 by name of the files that bayescal wrote into a folder; empty if it has no valid list."""
    try:
        content = json.loads(content_of(folder / LIST))
        return dict(content["files"]) if content["schema"] == SCHEMA else {}
    except (BayescalError, ValueError, KeyError, TypeError, RecursionError):
        return {}


def _files(folder: Path) -> list[Path]:
    """All files and empty folders below a folder, except the list."""
    every = (p for p in folder.rglob("*") if p.is_symlink() or not p.is_dir() or not any(p.iterdir()))
    return sorted(p for p in every if p != folder / LIST)


def _foreign(folder: Path, written: dict[str, str]) -> list[str]:
    """Names of the files below a folder that bayescal did not write or that have changed."""
    paths = {path.relative_to(folder).as_posix(): path for path in _files(folder)}
    return [n for n, p in paths.items() if n not in written or p.is_symlink() or _sha256(p) != written[n]]


def _top_level(folder: Path) -> list[str]:
    """Names directly in a folder: it may be large, for example a home folder."""
    names = sorted(p.name for p in folder.iterdir())
    return [name for name in names if name != LIST] or names


def _sha256(path: Path) -> str:
    """SHA-256 of a regular file; "" of another, or if it cannot be read."""
    try:
        with open_regular(path) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except (OSError, BayescalError):
        return ""


def _seal(stage: Path) -> None:
    """Write the list of a staging folder's files, and synchronise all of them with the disk."""
    files = {p.relative_to(stage).as_posix(): _sha256(p) for p in _files(stage)}
    text = json_text({"schema": SCHEMA, "files": files}, rows=False)
    (stage / LIST).write_text(text, encoding="utf-8")
    for path in (*_files(stage), stage / LIST, stage):
        _synchronise(path)


def _synchronise(path: Path) -> None:
    """Synchronise a file, or the names in a folder, with the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _put(stage: Path, folder: Path) -> None:
    """Move a complete folder to its final name; replace an earlier or empty folder of that name."""
    if folder.exists():
        shutil.copymode(folder, stage)
    if not folder.exists() or not any(folder.iterdir()):
        os.rename(stage, folder)
    else:
        aside = beside(folder, ASIDE)
        os.rename(folder, aside)
        try:
            os.rename(stage, folder)
        except OSError:
            os.rename(aside, folder)
            raise
        _discard(aside)
    _synchronise(folder.parent)


def _recover(folder: Path) -> None:
    """Restore an earlier folder that a killed process had moved aside, and remove its staging folders."""
    for path, kind in leftovers(folder):
        if kind == ASIDE and not (folder.is_dir() and any(folder.iterdir())):
            with suppress(OSError):
                os.rename(path, folder)
                continue
        _discard(path)


def _discard(folder: Path) -> None:
    """Remove a staging folder or an earlier result, unless it contains files of the user."""
    written = _written(folder)
    if not written or not _foreign(folder, written):
        shutil.rmtree(folder, ignore_errors=True)
