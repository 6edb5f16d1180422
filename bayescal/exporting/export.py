"""An arm in a format: the file, what it lacks, and the sidecar that says both."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.effects import UNITS
from bayescal.errors import BayescalError
from bayescal.exporting import CERTIFICATE, FORMATS
from bayescal.exporting.geometry import Missing, not_expressed
from bayescal.exporting.written import SCHEMA, Format, Options, Written, digest, path_of, replace_earlier
from bayescal.fitted import gate
from bayescal.fitted.arm import FittedArm
from bayescal.fitted.unmodelled import state_row
from bayescal.robots import only_one_arm, only_revolute


def format_of(name: str) -> Format:
    """A format by its name.

    Raises
    ------
    BayescalError
        If there is no such format.
    """
    if name not in FORMATS:
        names = ", ".join((*FORMATS, CERTIFICATE))
        raise BayescalError(f"there is no format `{name}`", "--to", f"formats: {names}")
    loaded: Format = EntryPoint(name, FORMATS[name], "bayescal.formats").load()
    return loaded


UM = 1e6
AT_FLANGE = 1e-6
"""m and rad: a tip that is closer to the flange is the flange."""


@dataclass(frozen=True)
class Exported:
    """An arm in a format, not yet written.

    `missing` is what the file does not hold, by effect; `total` is all of it together.
    """

    format: str
    suffix: str
    options: Options
    written: Written
    missing: tuple[Missing, ...]
    total: Missing
    arm: FittedArm

    @property
    def content(self) -> str | bytes:
        """The content of the file."""
        return self.written.content

    @property
    def robot(self) -> str:
        """The name of the robot."""
        return self.arm.dataset.robot.name

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of this file."""
        forced = (f"exported with --force: {reason}" for reason in self.arm.use.against)
        return (*self.arm.use.notes, *self.written.notes, *self._off_flange(), *forced)

    def _off_flange(self) -> Iterator[str]:
        """Where the tools are in a tip of the file that is not the flange of the model."""
        details = self.written.details
        if np.max(np.abs(np.array(details.get("flange_in_tip", np.eye(4))) - np.eye(4))) > AT_FLANGE:
            for tool in _tools(self.arm, details):
                place = ", ".join(f"{x:.3f}" for x in tool["centre_in_tip_mm"])
                where = f"the centre of tool {tool['name']} is at {place} mm in it"
                yield f"{details['tip']} is not the flange: {where}"

    def _beside(self, path: Path) -> dict[Path, str | bytes]:
        return {path.with_name(path.stem + suffix): text for suffix, text in self.written.beside.items()}

    def record(self, name: str) -> dict[str, Any]:
        """The content of the sidecar of a file called `name`."""
        arm, dataset, state = self.arm, self.arm.dataset, self.options.state
        m = dataset.measurements
        return {
            "schema": SCHEMA, "format": self.format, "file": name, "sha256": digest(self.written.content),
            "beside": {p.name: digest(text) for p, text in self._beside(Path(name)).items()},
            "dataset": {"name": dataset.name, "sha256": dataset.sha256}, "robot": dataset.robot.name,
            "model": list(arm.effects), "without": list(arm.origin.options.omitted),
            "state": {"row": m.ids[state], **({} if m.time is None else {"time_s": float(m.time[state])})},
            "written": [vars(item) for item in self.written.items],
            "not_expressed": [
                {"effect": m.effect, "why": m.why, **_sizes(m), "parameters": list(m.parameters)}
                for m in self.missing
            ],
            "remaining": _sizes(self.total), "tools": _tools(arm, self.written.details),
            **self.written.details, "use": arm.use.record(), "notes": list(self.notes),
        }  # fmt: skip

    def save(self, path: Path) -> tuple[Path, ...]:
        """Write the file, those beside it and the sidecar; an earlier export of that name is replaced.

        Raises
        ------
        BayescalError
            If one of them is the user's own file, or another file that is no unchanged earlier export.
        """
        written, beside = self.written, self._beside(path)
        if path in beside:
            raise BayescalError("a further file would have this name", str(path), "give another --out")
        if written.placed is not None:
            written = replace(written, content=written.placed(path.parent))
        record = replace(self, written=written).record(path.name)
        patched = path_of(self.options.into)[0] if self.options.into else None
        return replace_earlier(path, {path: written.content, **beside}, record, patched)


def export(
    arm: FittedArm, to: str, *, into: str = "", readings: str = "plain", time: float | None = None,
    row: str | int | None = None, force: bool = False, name: str = "arm",
) -> Exported:  # fmt: skip
    """Convert a fitted arm to a format.

    Parameters
    ----------
    arm : FittedArm
    to : str
        A name of `FORMATS`.
    into : str
        Path of a file of the user, which is patched in a copy; of a URDF ``arm.urdf#tool0`` names the link
        that carries the tool.
    readings : str
        'plain' or 'script', for formats that have both.
    time : float, optional
        s since the session began, at which the file holds (drift, steps); default: the last fitted row.
    row : str or int, optional
        The row at which it holds.
    force : bool
        Export in spite of reasons against it (`gate`).
    name : str
        Of the robot in a new file.

    Raises
    ------
    BayescalError
        If the arm should not be exported, or the format cannot hold it, or the user's file is of another arm.
    """
    format_ = format_of(to)
    if into and not format_.into:
        raise BayescalError(f"{to} is always a new file", f"--into {into}", "leave --into out")
    if readings not in format_.readings:
        what = f"{to} has no readings `{readings}`"
        raise BayescalError(what, "--readings", f"say {' or '.join(format_.readings)}")
    gate.check(arm.use, force)
    options = Options(state_row(arm.dataset, time, row), name, into, readings)
    of = f"files patched by --into {into}" if into else f"files of the format {to}"
    of = of if readings == "plain" else "replay scripts"
    if ("into" if into else readings) not in format_.two_arms:
        only_one_arm(arm.dataset.robot, of)
    if into or readings != "plain" or not format_.prismatic:
        only_revolute(arm.dataset.robot, of, two_arms=True)
    written = format_.write(arm, options)
    missing, total = not_expressed(arm, format_, options.state)
    return Exported(to, format_.suffix, options, written, missing, total, arm)


def _sizes(m: Missing) -> dict[str, float | None]:
    """RMS and maximum of a part of the model, µm; None where it moves no TCP."""
    sizes = {"rms_um": UM * m.rms, "max_um": UM * m.maximum}
    return {key: size if np.isfinite(size) else None for key, size in sizes.items()}


def _tools(arm: FittedArm, details: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Fitted centres of the tools in the flange, which no file holds, and in the tip of the file."""
    factor, out = UNITS["m"][1], []
    names = (p.name for p in arm.model.parameters)
    fitted = dict(zip(names, zip(arm.values, np.sqrt(np.diag(arm.covariance)), strict=True), strict=True))
    for tool in arm.dataset.tools:
        off, u_off = np.array([fitted.get(f"{tool.name} {axis}", (0.0, 0.0)) for axis in "xyz"]).T
        centre = factor * (tool.centre + off)
        out.append({"name": tool.name, "centre_mm": centre.tolist(), "u_mm": (factor * u_off).tolist()})
        if "flange_in_tip" in details:
            pose = np.array(details["flange_in_tip"])
            out[-1]["centre_in_tip_mm"] = (pose[:3, :3] @ centre + factor * pose[:3, 3]).tolist()
    return out
