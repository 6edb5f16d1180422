"""Read and join the sessions of a command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayescal.dataset import Dataset


def read_sessions(
    folders: Sequence[Path], remounted: bool = False, own_noise: bool = True, allow_xacro: bool = False
) -> tuple[Dataset, str]:
    """The session of a folder, or several sessions joined, and the name of a run.

    `remounted` and `own_noise` as of `dataset.join.joined`, `allow_xacro` as of `dataset.read_dataset`.
    """
    from bayescal.dataset import read_dataset
    from bayescal.dataset.join import joined

    sessions = [read_dataset(folder, allow_xacro=allow_xacro) for folder in folders]
    session = joined(sessions, remounted, own_noise)
    return session, "+".join(folder.resolve().name for folder in folders)
