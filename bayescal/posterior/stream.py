"""A file for a library that crashes if it cannot write: HDF5 ends the process on a full disk.

The first failed write is remembered. From then on the content continues in memory, so that the library works
to its end; then the error is raised.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any


class Patient(io.RawIOBase):
    """A binary stream to read, write and seek, of which no write fails; `error` is that of the first."""

    def __init__(self, path: Path) -> None:
        self._stream: io.RawIOBase | io.BytesIO = path.open("w+b", buffering=0)
        self.error: OSError | None = None

    def write(self, content: Any) -> int:
        """Write all of some content."""
        rest = memoryview(content).cast("B")
        size = len(rest)
        while rest:
            try:
                rest = rest[self._stream.write(rest) or 0 :]
            except OSError as error:
                self._continue_in_memory(error)
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the length."""
        try:
            return self._stream.truncate(size)
        except OSError as error:
            self._continue_in_memory(error)
            return self._stream.truncate(size)

    def _continue_in_memory(self, error: OSError) -> None:
        place, file = self._stream.tell(), self._stream
        file.seek(0)
        self._stream, self.error = io.BytesIO(file.read() or b""), error
        self._stream.seek(place)
        with suppress(OSError):
            file.close()

    def readinto(self, buffer: Any) -> int:
        """Read into a buffer; the number of bytes is returned."""
        return self._stream.readinto(buffer) or 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set the position."""
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        """The position."""
        return self._stream.tell()

    def close(self) -> None:
        """Close the file."""
        try:
            self._stream.close()
        except OSError as error:  # a network file system reports it here
            self.error = self.error or error
        super().close()


@contextmanager
def patient(path: Path) -> Iterator[Patient]:
    """A `Patient` stream; a write that failed is raised at the end.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    stream = Patient(path)
    try:
        yield stream
    finally:
        stream.close()
    if stream.error:
        raise stream.error
