"""Run folders that appear complete or not at all, and replace nothing but what bayescal wrote itself.

Every folder holds a list of the files that were written into it, with their SHA-256 (`LIST`). A folder is
replaced only where it holds these files and no other, unchanged. The new files are written to a staging
folder beside it and synchronised with the disk; then the two folders are exchanged in one system call, and
the old one is removed. So there is the earlier result or the new one under the folder's name, whenever the
process ends.

Where the file system cannot exchange (NFS, Windows), the earlier folder is moved aside for one system call. A
process that ends just there leaves it under a hidden name; the next command for that folder moves it back.
Names of staging folders hold the host and the number of their process: what a dead process left is removed.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayescal.errors import BayescalError

LIST = ".bayescal-files.json"
SCHEMA = "bayescal-files/1"
STAGE, ASIDE = "part", "old"
TOKEN = secrets.token_hex(4)
"""Of this process: another one of the same number, as in a container, had another."""
SHOWN = 3
"""How many foreign files a refusal names."""
OTHER_OUT = "give another --out"


def check_free(folder: Path, marker: str) -> None:
    """Refuse a folder that holds anything but an earlier result of ours, unchanged.

    What killed processes left beside it is put in order first.

    Parameters
    ----------
    folder : Path
        Where a result is to go.
    marker : str
        The file by which an earlier result of the same command is known.

    Raises
    ------
    BayescalError
        Naming the files that would be lost.
    """
    if folder.exists() and not folder.is_dir():
        raise BayescalError("a file of that name is there already", str(folder), OTHER_OUT)
    _recover(folder.resolve())
    try:
        if not folder.is_dir() or not any(folder.iterdir()):
            return
    except OSError as error:
        raise BayescalError(error.strerror or "cannot be read", str(folder), OTHER_OUT) from None
    written = _written(folder)
    if marker not in written:
        what = f"the folder holds something else, not the {marker} of an earlier run"
        raise BayescalError(what, str(folder), f"{OTHER_OUT}, or remove the folder")
    if foreign := _foreign(folder, written):
        told = ", ".join(foreign[:SHOWN]) + (", ..." if len(foreign) > SHOWN else "")
        what = f"the folder holds something else than an unchanged earlier result: {told}"
        raise BayescalError(what, str(folder), f"{OTHER_OUT}, or move these files")


@contextmanager
def whole(folder: Path, marker: str) -> Iterator[Path]:
    """A new folder to write into, which takes the place of `folder` once all is written.

    An earlier result, known by `marker`, is replaced; whatever fails, it stays as it was.

    Raises
    ------
    BayescalError
        As `check_free`; or where the folder cannot be written.
    """
    folder = folder.resolve()
    check_free(folder, marker)
    stage = _beside(folder, STAGE)
    try:
        stage.mkdir(parents=True)
        yield stage
        _seal(stage)
        check_free(folder, marker)  # a long run: someone may have put a file there meanwhile
        _put(stage, folder)
    except OSError as error:
        told = error.strerror or "cannot be written"
        raise BayescalError(told, str(folder), OTHER_OUT) from None
    finally:
        _discard(stage)


def _beside(folder: Path, kind: str) -> Path:
    """A new hidden name beside a folder that tells which process uses it."""
    own = f".{folder.name}.{socket.gethostname()}.{os.getpid()}.{TOKEN}.{kind}"
    return folder.parent / own


def _written(folder: Path) -> dict[str, str]:
    """SHA-256 by name of the files that we wrote into a folder; none where it has no list of them."""
    try:
        found = json.loads((folder / LIST).read_bytes())
        return dict(found["files"]) if found["schema"] == SCHEMA else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _files(folder: Path) -> list[Path]:
    """All below a folder but folders that hold something, and the list."""
    every = (p for p in folder.rglob("*") if p.is_symlink() or not p.is_dir() or not any(p.iterdir()))
    return sorted(p for p in every if p != folder / LIST)


def _foreign(folder: Path, written: dict[str, str]) -> list[str]:
    """Names of the files below a folder that are not as we wrote them."""
    return [
        name
        for path in _files(folder)
        if (name := path.relative_to(folder).as_posix()) not in written
        or path.is_symlink()
        or _sha256(path) != written[name]
    ]


def _sha256(path: Path) -> str:
    """SHA-256 of a file; "" where it cannot be read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


def _seal(stage: Path) -> None:
    """Write the list of a staging folder's files, and have all on the disk."""
    files = {p.relative_to(stage).as_posix(): _sha256(p) for p in _files(stage)}
    text = json.dumps({"schema": SCHEMA, "files": files}, indent=1) + "\n"
    (stage / LIST).write_text(text, encoding="utf-8")
    for path in (*_files(stage), stage / LIST, stage):
        _synchronise(path)


def _synchronise(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk."""
    if os.name == "nt" and path.is_dir():
        return
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _put(stage: Path, folder: Path) -> None:
    """Put a finished folder in the place of another one, of an empty one or of none."""
    if folder.exists():
        shutil.copymode(folder, stage)
    if not folder.exists() or not any(folder.iterdir()):
        if os.name == "nt" and folder.exists():
            folder.rmdir()
        os.rename(stage, folder)
    elif not _exchanged(stage, folder):
        aside = _beside(folder, ASIDE)
        os.rename(folder, aside)
        try:
            os.rename(stage, folder)
        except OSError:
            os.rename(aside, folder)
            raise
        _discard(aside)
    _synchronise(folder.parent)


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two folders in one system call; false where the OS or the file system cannot."""
    if os.name != "posix":
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    paths = os.fsencode(one), os.fsencode(other)
    if hasattr(libc, "renameat2"):  # Linux: AT_FDCWD, RENAME_EXCHANGE
        code = libc.renameat2(-100, paths[0], -100, paths[1], 2)
    elif sys.platform == "darwin" and hasattr(libc, "renamex_np"):  # RENAME_SWAP
        code = libc.renamex_np(*paths, 2)
    else:
        return False
    number = ctypes.get_errno()
    if code and number not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EPERM):
        raise OSError(number, os.strerror(number))
    return code == 0


def _recover(folder: Path) -> None:
    """Move back what a dead process had moved aside, and remove what else it left."""
    own = rf"\.{re.escape(folder.name)}\.{re.escape(socket.gethostname())}"
    name = re.compile(rf"{own}\.(\d+)\.([0-9a-f]+)\.({STAGE}|{ASIDE})")
    for path in _hidden(folder):
        found = name.fullmatch(path.name)
        if not found or _runs(int(found[1]), found[2]):
            continue
        if found[3] == ASIDE and not (folder.is_dir() and any(folder.iterdir())):
            with suppress(OSError):
                os.rename(path, folder)
                continue
        _discard(path)


def _hidden(folder: Path) -> list[Path]:
    try:
        return sorted(p for p in folder.parent.iterdir() if p.name.startswith(f".{folder.name}."))
    except OSError:
        return []


def _runs(process: int, token: str) -> bool:
    """Whether a process of this host is alive."""
    if process == os.getpid():
        return token == TOKEN
    if os.name == "nt":
        return True  # there, asking would end it; what is left is the user's to remove
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def _discard(folder: Path) -> None:
    """Remove a staging folder or an earlier result; not where a file came into it that is not ours."""
    written = _written(folder)
    if not written or not _foreign(folder, written):
        shutil.rmtree(folder, ignore_errors=True)
