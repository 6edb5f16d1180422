"""The arm of a joint log for simulators: bodies, rotors and friction as MJCF, URDF and SDF.

What a format cannot hold is stated with its torque: a rotor at 1 rad/s2, an offset, the smooth reversal of
friction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bayescal.errors import BayescalError
from bayescal.exporting.sidecar import SUFFIX
from bayescal.exporting.xml_text import rendered
from bayescal.logs import Mechanism
from bayescal.logs.mechanism import PAIRS
from bayescal.logs.read import written_out
from bayescal.logs.schema import Arm
from bayescal.storage.files import json_text, write_together
from bayescal.storage.reading import Json, decoded

ARM_FILE = "arm.yaml"
SCHEMA = "bayescal-log-export/1"


@dataclass(frozen=True)
class LogFormat:
    """A format of simulators: suffix, template, and what it has no place for."""

    suffix: str
    template: str
    without: tuple[str, ...]


FORMATS: Mapping[str, LogFormat] = {
    "mjcf": LogFormat(".xml", "log_arm.mjcf.j2", ("offset", "transition")),
    "urdf": LogFormat(".urdf", "log_arm.urdf.j2", ("armature", "offset", "transition")),
    "sdf": LogFormat(".sdf", "log_arm.sdf.j2", ("armature", "offset", "transition")),
}
LEFT_OUT: Mapping[str, tuple[str, str]] = {
    "armature": ("rotors", "N m at 1 rad/s2"),
    "offset": ("offsets of the torque", "N m"),
    "transition": ("the smooth reversal of friction", "N m of Coulomb friction below the transition speed"),
}
"""Parameters that a format may not hold: words, and what their size is."""


@dataclass(frozen=True)
class LogExport:
    """A written arm, and what is not in it: of each part the size of every joint."""

    format: str
    name: str
    text: str
    missing: Mapping[str, tuple[float, ...]]
    origin: Mapping[str, Any]

    @property
    def suffix(self) -> str:
        """Of the file."""
        return FORMATS[self.format].suffix

    @property
    def record(self) -> dict[str, Any]:
        """The content of the sidecar."""
        return {
            "schema": SCHEMA,
            "format": self.format,
            **self.origin,
            "not_expressed": [
                {"part": LEFT_OUT[key][0], "unit": LEFT_OUT[key][1], "of_joints": list(sizes)}
                for key, sizes in self.missing.items()
            ],
        }

    def save(self, path: Path) -> tuple[Path, ...]:
        """Write the file and its sidecar; return their paths."""
        beside = path.with_name(path.name + SUFFIX)
        write_together({path: self.text, beside: json_text(self.record)})
        return path, beside


def mechanism_of_run(folder: Path, name: str) -> Mechanism:
    """The mechanism that a calibration from a log has written."""
    content = yaml.safe_load(decoded(folder / ARM_FILE)[0])
    return written_out(Arm.model_validate(content), name)


def export_log(folder: Path, record: Json, to: str) -> LogExport:
    """Write the arm of a run folder of `fit` of a joint log in a format.

    Raises
    ------
    BayescalError
        If there is no such format for the arm of a log.
    """
    if to not in FORMATS:
        what = f"the arm of a joint log cannot be written as {to}"
        raise BayescalError(what, "--to", f"known: {', '.join(FORMATS)}; arm.yaml of the run holds all of it")
    m = mechanism_of_run(folder, str(record["robot"]))
    estimates = {p["name"]: p["estimate"] for p in record["parameters"]}
    sizes: dict[str, Callable[[int], float]] = {
        "armature": lambda j: float(m.armature[j]),
        "offset": lambda j: abs(float(estimates[f"offset {j + 1}"])),
        "transition": lambda j: float(m.coulomb[j]),
    }
    missing = {key: tuple(sizes[key](j) for j in range(m.n)) for key in FORMATS[to].without}
    origin = {key: record[key] for key in ("dataset", "robot", "software")}
    return LogExport(to, m.name, text_of(m, to, np.array(record["gravity_mps2"])), missing, origin)


def text_of(m: Mechanism, to: str, gravity: np.ndarray) -> str:
    """A mechanism in a format; numbers have all their digits."""
    six = np.array([[inertia[i, j] for i, j in PAIRS] for inertia in m.inertia])
    return rendered(FORMATS[to].template, m=m, name=m.name, six=six, gravity=gravity)
