"""Verification of a written file: levels, the gap, and whether it passed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.mjcf.elastic import sprung
from bayescal.exporting.sidecar import AGAIN, mujoco, read_sidecar, sidecar_of
from bayescal.fitted.arm import FittedArm, open_run, refitted
from bayescal.fitted.unmodelled import state_row
from bayescal.storage.reading import decoded
from bayescal.verifying.gap import Gap, Reported, in_simulator, read_reported, simulated_gap
from bayescal.verifying.levels import File, Level, Place, levels
from bayescal.verifying.urdf import held, simulators, tool_points, urdf_levels

Notify = Callable[[str, float], None]


@dataclass(frozen=True)
class Verification:
    """A written file in its simulator."""

    arm: FittedArm
    path: Path
    format: str
    state: int
    software: str
    levels: tuple[Level, ...]
    gap: Gap | None
    missing: Mapping[str, float]  # RMS, m, of each effect that is not in the file

    @property
    def passed(self) -> bool:
        """Whether all differences are within their limits."""
        return all(level.passed for level in self.levels)


def verify(run: Path, path: Path, notify: Notify = lambda stage, share: None) -> Verification:
    """Load a written file in its simulator, and replay the session.

    Raises
    ------
    BayescalError
        If the run folder has no arm, the simulator is not installed, or the file is not of this arm.
    """
    try:
        text = decoded(path)[0]
    except BayescalError as error:
        raise BayescalError(error.what, str(path), "give a file of bayescal export") from None
    sidecar = read_sidecar(path)
    if sidecar["format"] not in VERIFIED:
        what = f"is a file of the format {sidecar['format']}"
        raise BayescalError(what, str(path), f"bayescal verifies {' and '.join(VERIFIED)}")
    arm = _arm(run, sidecar, str(path))
    _check_alike(arm, sidecar, str(sidecar_of(path)))
    state = state_row(arm.dataset, row=sidecar["state"]["row"])
    return VERIFIED[sidecar["format"]](arm, path, text, sidecar, state, read_reported(run), notify)


def _mjcf(
    arm: FittedArm, path: Path, text: str, sidecar: Mapping[str, Any], state: int, reported: Reported,
    notify: Notify,
) -> Verification:  # fmt: skip
    arm = sprung(arm)
    file = File(text, path.parent, str(path), Place.of(arm, sidecar))
    software = f"MuJoCo {mujoco().__version__}"
    found = levels(arm, file, state, lambda share: notify("levels", share))
    notify("replay", 0.0)

    def before(other: FittedArm, rows: np.ndarray) -> np.ndarray:
        return in_simulator(other, File.new(other, state, file.place.script), rows, state)

    gap = simulated_gap(arm, before, lambda rows: in_simulator(arm, file, rows, state), reported)
    return Verification(arm, path, "mjcf", state, software, found, gap, _missing(sidecar))


def _urdf(
    arm: FittedArm, path: Path, text: str, sidecar: Mapping[str, Any], state: int, reported: Reported,
    notify: Notify,
) -> Verification:  # fmt: skip
    every = simulators(text, sidecar, str(path))
    first = next(iter(every.values()))
    found = urdf_levels(arm, every, sidecar, state)
    notify("replay", 0.0)
    gap = simulated_gap(
        arm,
        lambda other, rows: held(other).at_rows(rows).points,
        lambda rows: tool_points(arm, first, sidecar, rows),
        reported,
    )
    return Verification(arm, path, "urdf", state, ", ".join(every), found, gap, _missing(sidecar))


def _missing(sidecar: Mapping[str, Any]) -> dict[str, float]:
    """RMS size, m, of each effect that a file with this sidecar does not hold, where it has one."""
    sizes = {e["effect"]: e.get("rms_um") for e in sidecar["not_expressed"]}
    return {name: 1e-6 * size for name, size in sizes.items() if size}


VERIFIED = {"mjcf": _mjcf, "urdf": _urdf}
"""Formats that are verified."""


def _arm(run: Path, sidecar: Mapping[str, Any], where: str) -> FittedArm:
    """The arm that was exported: that of the run, or of the same refit.

    Raises
    ------
    BayescalError
        If the file is of another session.
    """
    arm = open_run(run)
    if sidecar["dataset"]["name"] != arm.dataset.name or sidecar["robot"] != arm.dataset.robot.name:
        what = f"was exported from the session {sidecar['dataset']['name']}, not from {arm.dataset.name}"
        raise BayescalError(what, where, "give the run that was exported")
    more = [name for name in sidecar["model"] if name not in arm.effects]
    less = [name for name in arm.effects if name not in sidecar["model"]]
    less += [part for part in sidecar["without"] if part not in arm.origin.without]
    return refitted(arm, more, less) if more or less else arm


def _check_alike(arm: FittedArm, sidecar: Mapping[str, Any], where: str) -> None:
    """Refuse a sidecar with another row, other tools or other joints than the arm has."""
    n = arm.dataset.robot.n
    names = [t.name for t in arm.dataset.tools]
    sizes = [len(sidecar[key]) for key in ("joints", "signs", "joint_from_reading") if key in sidecar]
    sizes += [len(row) for row in sidecar.get("joint_from_reading", ())]
    for alike, what in (
        (sidecar["state"]["row"] in arm.dataset.measurements.ids, "the session has no row `state.row`"),
        (
            [t["name"] for t in sidecar["tools"]] == names,
            f"`tools` are not {', '.join(names)}",
        ),
        (all(size == n for size in sizes), f"`joints` or their matrices are not of an arm with {n} joints"),
    ):
        if not alike:
            raise BayescalError(what, where, AGAIN)
