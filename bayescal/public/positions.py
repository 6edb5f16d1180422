"""Positions of the tool of a calibrated arm, of results that have an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from bayescal.errors import BayescalError

if TYPE_CHECKING:
    import numpy as np
    from pandas import DataFrame

    from bayescal.compensating.position import Positions
    from bayescal.fitted.arm import FittedArm


@dataclass(frozen=True, repr=False)
class PositionResult:
    """C positions of the tool of a calibrated arm; SI. `data` is the complete result."""

    data: Positions
    warnings: tuple[str, ...] = ()

    @property
    def points(self) -> np.ndarray:
        """TCP positions (C, 3), m, in the frame."""
        return self.data.poses[:, :3, 3]

    @property
    def poses(self) -> np.ndarray:
        """Poses (C, 4, 4) of the tool's frame, in the frame."""
        return self.data.poses

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (C, 3, 3), m2, of the points along the axes of the frame."""
        return self.data.uncertain.covariance

    @property
    def u(self) -> np.ndarray:
        """Standard uncertainty (C,), m, of the points: length of the vector."""
        return self.data.uncertain.u

    @property
    def U(self) -> np.ndarray:
        """Length (C,), m, that the error of the point does not exceed with a probability of 95.45 %."""
        return self.data.uncertain.expanded

    @property
    def inside(self) -> np.ndarray:
        """Whether (C,) the pose is within the region that the session has probed."""
        return self.data.inside

    @property
    def table(self) -> DataFrame:
        """The positions in the units of the columns; orientations are fixed-axis roll, pitch and yaw."""
        import numpy as np
        from pandas import DataFrame

        from bayescal.arm.transforms import rpy_of

        turns = np.degrees([rpy_of(pose[:3, :3]) for pose in self.poses])
        columns = dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * self.points.T, strict=True))
        columns |= dict(zip(("rx_deg", "ry_deg", "rz_deg"), turns.T, strict=True))
        return DataFrame(
            {**columns, "u_mm": 1e3 * self.u, "U_mm": 1e3 * self.U, "inside_probed_region": self.inside}
        )

    def __str__(self) -> str:
        text = self.table.to_string(index=False, float_format="%.4f")
        return "\n".join((*(f"warning: {warning}" for warning in self.warnings), text))

    def __repr__(self) -> str:
        return f"<{len(self.u)} positions, u {1e6 * max(self.u, default=0.0):.2g} µm at most>"


class Positioned:
    """A result with an arm, of which positions can be asked."""

    @cached_property
    def _arm(self) -> FittedArm:
        return arm_of(self)

    def position(
        self, readings: Sequence[float] | Sequence[Sequence[float]] | np.ndarray, *, tool: str | None = None,
        tcp: Sequence[float] | None = None, payload_kg: float | Sequence[float] = 0.0,
        velocity: Sequence[float] | np.ndarray | None = None, frame: str = "base",
        at_time: float | None = None, at_row: str | None = None, force: bool = False,
    ) -> PositionResult:  # fmt: skip
        """Where the calibrated arm puts its tool, with the uncertainty that `compensate` states.

        Parameters
        ----------
        readings : array_like, shape (n,) or (C, n)
            Joint readings, rad, as the controller shows them.
        tool : str, optional
            Name of a tool of dataset.yaml; needed if the session has several.
        tcp : sequence of float, optional
            x, y, z in m, and fixed-axis roll, pitch, yaw in rad, of another tool in the frame of the flange.
        payload_kg : float or sequence of float
            Additional payload, kg; one or (C,).
        velocity : array_like, shape (n,) or (C, n), optional
            Its signs are the directions of motion before the pose; 0 or none: not known, and part of u.
        frame : str
            'base' (F0), or a target of the session that was fitted.
        at_time, at_row, force
            As of `compensate`.

        Raises
        ------
        BayescalError
            For readings of another arm, a frame, tool or row that does not exist; with the reason, if the arm
            should not be used.

        Examples
        --------
        >>> import bayescal as bc
        >>> session = bc.simulate(effects="geometry", contacts=60, later=8, repeats=5, spheres=0, seed=1)
        >>> fitted = bc.fit(session, "geometry", samples=0)
        >>> found = fitted.position([0.1, 0.2, -0.3, 0.0, -1.2, 0.0])
        >>> found.points.shape, bool(found.u[0] < 1e-3)
        ((1, 3), True)
        """
        import numpy as np

        from bayescal.compensating.position import positions
        from bayescal.fitted import gate

        arm = self._arm
        gate.check(arm.use, force, "used")
        at_readings = positions(
            arm, np.asarray(readings, float), frame=frame, tool=tool,
            tcp=None if tcp is None else np.asarray(tcp, float), payload_kg=np.asarray(payload_kg, float),
            velocity=None if velocity is None else np.asarray(velocity, float), time=at_time, row=at_row,
        )  # fmt: skip
        return PositionResult(at_readings, arm.use.remarks)


def arm_of(run: object, with_: Sequence[str] = (), without: Sequence[str] = ()) -> FittedArm:
    """The arm of a result, new or read back, or of a run folder, with other effects fitted again."""
    from bayescal.fitted.file import open_run

    folder, data = (
        getattr(run, name) if isinstance(run, Positioned) else None for name in ("folder", "data")
    )
    if isinstance(run, str | PathLike):
        folder = Path(run)
    if folder is not None:
        return open_run(folder, with_, without)
    from bayescal.calibration import Fit
    from bayescal.fitted.arm import of_fit, of_gap, refitted
    from bayescal.gap.result import Gap

    if isinstance(data, Fit):
        arm = of_fit(data)
        return refitted(arm, with_, without) if with_ or without else arm
    if isinstance(data, Gap):
        return of_gap(data, with_, without)
    what = f"{type(run).__name__} has no arm"
    raise BayescalError(what, "run", "give a result of fit or diagnose, or its folder")
