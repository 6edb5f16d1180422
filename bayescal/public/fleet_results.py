"""The result of a fleet: its record with tables, and the robot file with what it learnt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import RenderableType

from bayescal.arm.chain import Prior, Robot
from bayescal.fleets.compare import Model, priors
from bayescal.public import Printed, table
from bayescal.reporting.fleet import summary
from bayescal.robots import robot_to_yaml
from bayescal.robots.schema import PRIOR_UNITS
from bayescal.storage.reading import Json

if TYPE_CHECKING:
    from pandas import DataFrame

CSV = "fleet.csv"


def robot_text(model: Model, robot: Robot) -> str:
    """The text of a robot file with the prior that was learnt from the arms of a model."""
    learnt = tuple(
        Prior(p.parameter.name, p.parameter.unit, p.mean, p.sd)
        for p in priors(model)
        if p.parameter.unit in PRIOR_UNITS.values()
    )
    others = tuple(p for p in robot.priors if p.name not in {q.name for q in learnt})
    comment = (
        f"{robot.name} with the priors learnt from {len(model.arms)} arms by bayescal fleet.\n"
        "For a further arm of this model: it is nominal, not calibrated."
    )
    return robot_to_yaml(replace(robot, priors=(*learnt, *others)), comment)


@dataclass(frozen=True, repr=False)
class FleetResult(Printed):
    """A fleet; `print` shows what was found. `record` is the content of fleet.json, in `folder`."""

    record: Json
    folder: Path

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        return summary(self.record)

    @cached_property
    def csv(self) -> str:
        """The sessions as CSV: the content of fleet.csv."""
        return str(self.sessions.to_csv(lineterminator="\n"))

    @property
    def written(self) -> tuple[str, ...]:
        """Names of the files of the fleet."""
        robots = [m["file"] for m in self.record["models"] if m["file"]]
        return ("fleet.json", "fleet.html", CSV, *robots)

    @property
    def arms(self) -> DataFrame:
        """One row per arm, those with findings first: robot, sessions, U, differences, changes, log score."""
        keys = "arm robot sessions expanded_U_um measured_rms_um effects differs changed log_score_nats"

        def names(entries: Sequence[Json], key: str) -> str:
            return ", ".join(e[key] for e in entries if e.get("stated", True))

        rows = [
            {
                **a,
                "sessions": len(a["sessions"]),
                "effects": ", ".join(f"{e['effect']} at {e['site']}" for e in a["effects"]),
                "differs": names(a["differs"], "parameter"),
                "changed": names(a["changed"], "parameter"),
            }
            for a in self.record["arms"]
        ]
        return table(rows, "arm", keys)

    @property
    def sessions(self) -> DataFrame:
        """One row per session: arm, status, error, what the fit and the diagnosis state."""
        figures = ("predicted_rms_um", "expanded_U_um", "measured_rms_um", "verdict")
        rows = [
            {
                **{key: s[key] for key in ("session", "arm", "robot", "date", "status", "error")},
                **{key: (s["fit"] or {}).get(key) for key in figures},
                "diagnosis": (s["gap"] or {}).get("verdict"),
                "effects": ", ".join(f"{e['effect']} at {e['site']}" for e in s["effects"]),
                "dataset": s["dataset"],
                "folder": s["folder"],
            }
            for s in self.record["sessions"]
        ]
        return table(rows, "session")

    @property
    def effects(self) -> DataFrame:
        """One row per effect and site: the arms that share it."""
        return table(self.record["effects"])

    @property
    def prior(self) -> DataFrame:
        """One row per parameter of each robot model: stated and learnt prior, deviations from nominal."""
        return table([{"robot": m["robot"], **p} for m in self.record["models"] for p in m["parameters"]])

    def __repr__(self) -> str:
        c = self.record["count"]
        return f"<fleet of {len(self.record['arms'])} arms: {c['sessions']} sessions, {c['failed']} failed>"

    def _repr_html_(self) -> str:
        return str(self.arms.to_html(float_format="%.3g"))
