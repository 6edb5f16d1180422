"""Columns in a temporary file: an hour of joint log has 10^9 bytes of them."""

from __future__ import annotations

from collections.abc import Callable
from tempfile import TemporaryFile

import numpy as np

Block = Callable[[], np.ndarray]
"""Gives columns, in single precision."""


class Temporary:
    """A file without a name for columns, which are mapped when they are asked for."""

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115 (closed with the last block)

    def __del__(self) -> None:
        self._file.close()

    def put(self, x: np.ndarray) -> Block:
        """Append columns (M, k)."""
        start, shape = self._file.tell(), x.shape
        if not x.size:  # nothing cannot be mapped
            return lambda: np.empty(shape, np.float32)
        self._file.write(np.ascontiguousarray(x, np.float32).data)
        self._file.flush()
        return lambda: np.asarray(np.memmap(self._file, np.float32, "r", start, shape))
