"""The arm of a joint log for simulators: bodies, rotors and friction as MJCF, URDF and SDF, drives as BAM.

What a format cannot hold is stated with its torque: a rotor at 1 rad/s2, an offset, the smooth reversal of
friction, named effects; and with the error of position that it makes, where the stiffness of the drives is
known.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bayescal.errors import BayescalError
from bayescal.exporting.urdf import most_of
from bayescal.exporting.written import digest, replace_earlier
from bayescal.exporting.xml_text import rendered
from bayescal.logs import Mechanism
from bayescal.logs.read import written_out
from bayescal.logs.schema import Arm
from bayescal.logs.types import PAIRS
from bayescal.robots.tree import UNLIMITED
from bayescal.storage.files import json_text
from bayescal.storage.reading import Json, decoded, table_beside

ARM_FILE = "arm.yaml"
SCHEMA = "bayescal-log-export/1"


TABLES = table_beside(__file__, "log_formats.toml")
FORMATS, LEFT_OUT = TABLES["formats"], TABLES["left_out"]
"""By name what a format holds; of parameters that it may not hold the words, and what their size is."""
LEAST_MASS, LEAST_SIZE = 1e-9, 0.03
"""kg, m: of links without mass, which simulators refuse."""
OF_SERVOS = "deg"
"""Unit of the residuals of position servos without torques, whose stiffness is an estimate."""


@dataclass(frozen=True)
class Drives:
    """The drives (n,), SI: stiffness and damping of position servos, friction as BAM states it."""

    stiffness: np.ndarray | None
    damping: np.ndarray
    offset: np.ndarray  # N m
    stribeck: Sequence[tuple[float, float, float]]  # N m, rad/s, power
    load: np.ndarray  # friction over the torque of the load


@dataclass(frozen=True)
class LogExport:
    """A written arm, and what is not in it: of each part the size of every joint."""

    format: str
    robot: str
    content: str
    missing: Mapping[str, tuple[float, ...]]  # N m
    effects: tuple[Json, ...]  # that are not in it, with their RMS in the log
    origin: Mapping[str, Any]
    stiffness: np.ndarray | None = None  # (n,) N m/rad, of the servos

    @property
    def left_out(self) -> tuple[tuple[str, str, tuple[float, ...]], ...]:
        """Parts that the file does not hold: words, unit, size of every joint."""
        out = [(*LEFT_OUT[key], sizes) for key, sizes in self.missing.items()]
        out += [(e["effect"], f"{e['unit']} RMS in the log", tuple(e["of_joints"])) for e in self.effects]
        return tuple(out)

    def mrad(self, unit: str, sizes: Sequence[float]) -> list[float] | None:
        """The errors of position of servos that torques make; None where no stiffness is known."""
        if self.stiffness is None or not unit.startswith("N m"):
            return None
        return np.asarray(1e3 * np.array(sizes) / self.stiffness).tolist()

    @property
    def suffix(self) -> str:
        """Of the file."""
        return str(FORMATS[self.format]["suffix"])

    def record(self, name: str) -> dict[str, Any]:
        """The content of the sidecar of a file called `name`."""
        return {
            "schema": SCHEMA, "format": self.format, **self.origin,
            "not_expressed": [
                {"part": words, "unit": unit, "of_joints": list(sizes), "mrad": self.mrad(unit, sizes)}
                for words, unit, sizes in self.left_out
            ],
            "file": name, "sha256": digest(self.content), "beside": {},
        }  # fmt: skip

    def save(self, path: Path) -> tuple[Path, ...]:
        """Write the file and its sidecar in place of an earlier export; return their paths.

        Raises
        ------
        BayescalError
            If one of them is no unchanged earlier export.
        """
        return replace_earlier(path, {path: self.content}, self.record(path.name))


def mechanism_of_run(folder: Path, name: str) -> Mechanism:
    """The mechanism that a calibration from a log has written."""
    if not (folder / ARM_FILE).is_file():
        what = f"the run has no {ARM_FILE}: the joints of its arm are coupled, which no format of it holds"
        raise BayescalError(what, str(folder), "fit.json or gap.json of the run has all values")
    return written_out(Arm.model_validate(yaml.safe_load(decoded(folder / ARM_FILE)[0])), name)


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
    drives = drives_of(record, m.n)
    values = values_of(record)
    gravity = np.array(record["gravity_mps2"])
    sizes = {"armature": m.armature, "offset": np.abs(drives.offset), "transition": m.coulomb}
    form = FORMATS[to]
    missing = {key: tuple(sizes[key].tolist()) for key in form["without"]}
    holds = tuple(form["holds"])

    def held(effect: str) -> bool:
        of_it = [name for name in values if name.partition(" ")[0] == effect]
        return bool(of_it) and all(name.startswith(holds) and SQUARE not in name for name in of_it)

    effects = tuple(e for e in record.get("beside", ()) if not held(e["effect"]))
    origin = {key: record[key] for key in ("dataset", "robot", "software", "gravity_mps2")}
    names = {e["effect"] for e in effects}
    origin["terms"] = {name: x for name, x in values.items() if name.partition(" ")[0] in names}
    bam = to == "bam"
    text = bam_of(m, drives) if bam else text_of(m, to, gravity, drives.stiffness, drives.damping)
    return LogExport(to, m.name, text, missing, effects, origin, drives.stiffness)


def values_of(record: Json) -> dict[str, float]:
    """Deviations from nominal of a calibration, or of the model of a diagnosis with the named effects."""
    if "arm" in record:
        return dict(record["arm"])
    return {p["name"]: p["estimate"] - p["nominal"] for p in record["parameters"]}


def drives_of(record: Json, n: int) -> Drives:
    """The drives of a run of `fit` or `gap` of a joint log."""
    values, control = values_of(record), record["controller"]

    def each(name: str) -> np.ndarray:
        return np.array([values.get(name.format(j + 1), 0.0) for j in range(n)])

    stiffness, damping = control["kp_Nm_per_rad"], np.array(control["kd_Nms_per_rad"] or np.zeros(n))
    if stiffness is not None:
        if record["unit"] == OF_SERVOS:  # the arm is in true torques, of which these are `constant` larger
            stiffness = np.array(stiffness) / (1.0 + each("constant {}"))
        softer = each("servo-stiffness joint {} torque")
        damping = np.maximum(damping + np.array(stiffness) * each("tracking lag {}"), 0.0)
        stiffness = np.array(stiffness) / (1.0 + softer)
    stribeck = [(0.0, 0.1, 1.0)] * n
    load = each("load-friction joint {} torque times direction")
    for name, value in values.items():
        if match := STRIBECK.fullmatch(name):
            j, speed, power = int(match[1]) - 1, float(match[2]), float(match[3])
            stribeck[j] = (stribeck[j][0] + value, speed, power)
    return Drives(stiffness, damping, each("offset {}"), stribeck, load)


STRIBECK = re.compile(r"stribeck joint (\d+) low speed (\S+) rad/s, power (\S+)")
"""The term of an effect, with its speed and power."""
SQUARE = "square of the torque"
"""Setting of a load friction that is not in proportion."""


def text_of(
    m: Mechanism, to: str, gravity: np.ndarray, stiffness: np.ndarray | None = None, damping: Any = None
) -> str:
    """A mechanism in a format of XML; numbers have all their digits. With a stiffness drives are servos."""
    bare = ~(m.mass > 0.0)
    m = replace(
        m, mass=np.where(bare, LEAST_MASS, m.mass),
        inertia=np.where(bare[:, None, None], LEAST_MASS * LEAST_SIZE**2 * np.eye(3), m.inertia),
    )  # fmt: skip
    six = m.inertia[:, *np.transpose(PAIRS)]
    limits = [None if np.isnan(both).any() else both.tolist() for both in m.limits]
    most, remark = most_of(m.rated, m.fastest)
    fields = {"m": m, "name": m.name, "six": six, "gravity": gravity, "kp": stiffness, "kd": damping}
    fields |= {"limits": limits, "most": most, "unlimited": UNLIMITED, "remark": remark}
    return rendered(f"log_arm.{to}.j2", **fields)


def bam_of(m: Mechanism, d: Drives) -> str:
    """Drives by the friction models m1 and m5 of BAM (Duclusaud et al., ICRA 2025), one by joint name.

    kt, R and the name of the actuator do not follow from torques in N m: BAM takes those of the motor.
    """
    out = {}
    for j, name in enumerate(m.joint_names):
        rise, speed, power = d.stribeck[j]
        friction = {"friction_base": m.coulomb[j], "friction_viscous": m.viscous[j]}
        out[name] = {"model": "m1", "armature": m.armature[j], **friction}
        if rise or d.load[j]:
            load = {"load_friction_motor": 0.0, "load_friction_external": d.load[j]}
            stribeck = {"friction_stribeck": rise, "dtheta_stribeck": speed, "alpha": power}
            load |= {"load_friction_motor_stribeck": 0.0, "load_friction_external_stribeck": 0.0}
            out[name] |= {"model": "m5", **stribeck, **load}
    return json_text(out)
