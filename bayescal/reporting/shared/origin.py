"""The first keys of every record: schema, dataset, software, seed."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import version
from typing import Any

from bayescal import __version__
from bayescal.dataset import Dataset


def origin(schema: str, dataset: Dataset, seed: int, libraries: Iterable[str]) -> dict[str, Any]:
    """Schema, dataset (and each of several sessions) with its hash, versions of all software, seed."""
    named: dict[str, Any] = {"name": dataset.name, "sha256": dataset.sha256}
    if dataset.sessions:
        named["sessions"] = [
            {"name": s.name, "sha256": s.sha256, "rows": len(s.measurements.ids)} for s in dataset.sessions
        ]
    return {
        "schema": schema,
        "dataset": named,
        "software": software(libraries),
        "seed": seed,
    }


def software(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of bayescal, Python and the libraries."""
    ours = {"bayescal": __version__, "python": platform.python_version()}
    return ours | {name: version(name) for name in libraries}
