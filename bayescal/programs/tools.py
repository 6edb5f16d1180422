"""The working tool: a tool of the session, or another one that was not measured.

Of a tool that the fitted rows used, the fit knows the point. Another one is carried by the fitted flange, at
the place that is stated. The fitted offset of the probe is no part of it. But that offset has taken up the
zero and the length of the last joint, unless the place of the probe was stated: for another tool these are
known by their tolerances only, which are part of the uncertainty of its point.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import Robot
from bayescal.arm.motion import NominalArm
from bayescal.arm.transforms import rigid, rpy_matrix, rpy_of
from bayescal.dataset import Tool
from bayescal.effects import Parameter, parameters_of
from bayescal.effects.geometry import GEOMETRY
from bayescal.errors import BayescalError
from bayescal.fitted.arm import FittedArm, Poses
from bayescal.fitted.unmodelled import state_row

TCP = "tcp"
"""Name of a working tool that is given by its pose."""
SAME, SAME_ANGLE = 10e-6, np.radians(0.01)
"""m and rad: two statements of a tool that differ by less are one (rounded numbers)."""


@dataclass(frozen=True)
class Working:
    """A working tool, and the arm that carries it.

    `u` is the standard uncertainty, m, of each coordinate of a stated point that was not fitted, `flange` the
    parameters of the arm that the offset of another tool has taken up; `probe` is the tool of the session
    whose points tell where it has probed. A tool is `chosen` by its name or pose.
    """

    arm: FittedArm
    tool: Tool
    u: float
    probe: str
    chosen: bool
    flange: tuple[Parameter, ...] = ()

    def covariance(self, poses: Poses) -> np.ndarray:
        """Covariance (C, 3, 3), m2, of the points by errors of a tool that was not fitted, in F0."""
        by = poses.slopes_with(self.flange)[..., len(poses.arm.values) :]
        return by @ np.swapaxes(by, -1, -2) + self.u**2 * np.eye(3)

    def probed(self, poses: Poses) -> np.ndarray:
        """Points (C, 3), m, of the probe at the poses of the working tool."""
        if self.probe == self.tool.name:
            return poses.points
        names = [t.name for t in self.arm.dataset.tools]
        return poses.again(tool=names.index(self.probe)).points

    @cached_property
    def nominal(self) -> NominalArm:
        """The nominal arm with the tool."""
        return nominal_arm(self.arm.dataset.robot, self.tool)

    @property
    def pose(self) -> np.ndarray:
        """The stated pose (4, 4) of its frame in that of the flange."""
        return rigid(axes_of(self.tool), self.tool.centre)


@dataclass(frozen=True)
class ToolStatement:
    """A tool that a program states: where and in which words, and its pose (4, 4) where it is in numbers."""

    where: str
    text: str
    pose: np.ndarray | None = None


def axes_of(tool: Tool) -> np.ndarray:
    """Axes (3, 3) of a tool's frame in that of the flange: as stated, else those of the flange."""
    return np.eye(3) if tool.rpy is None else rpy_matrix(tool.rpy)


def nominal_arm(robot: Robot, tool: Tool) -> NominalArm:
    """The nominal arm with a tool: its stated point, and its stated orientation or that of the flange."""
    return NominalArm(robot, tool.centre, axes_of(tool))


def tool_of(arm: FittedArm, name: str | None = None, tcp: np.ndarray | None = None) -> Working:
    """The working tool with a name, or with a pose.

    Parameters
    ----------
    arm : FittedArm
    name : str, optional
        A tool of dataset.yaml, whether rows use it or not; needed if there are several.
    tcp : np.ndarray, shape (6,), optional
        x, y, z in m, and fixed-axis roll, pitch, yaw in rad, in the frame of the flange. It weighs what the
        tool of the last fitted row does.

    Raises
    ------
    BayescalError
        For a name that is missing or does not exist, and where both are given.
    """
    tools = {t.name: t for t in arm.dataset.tools}
    names = f"tools: {', '.join(tools)}"
    m = arm.dataset.measurements
    probe = arm.dataset.tools[m.tool[state_row(arm.dataset)]]
    if tcp is not None:
        values = np.asarray(tcp, float)
        if name is not None:
            raise BayescalError("a tool and its pose are given", "--tcp", "give --tool or --tcp")
        if values.shape != (6,) or not np.all(np.isfinite(values)):
            raise BayescalError("is not six numbers", "--tcp", "give X,Y,Z,RX,RY,RZ in mm and deg")
        heavy = probe.centre if probe.centre_of_mass is None else probe.centre_of_mass
        tool = replace(probe, name=TCP, centre=values[:3], rpy=values[3:], u=0.0, centre_of_mass=heavy)
        return Working(_carrying(arm, tool), tool, 0.0, probe.name, True, _taken_up(arm))
    if name is None and len(tools) > 1:
        raise BayescalError("the session has several tools", "--tool", f"name one; {names}")
    if name is not None and name not in tools:
        raise BayescalError(f"there is no tool `{name}`", "--tool", names)
    tool = next(iter(tools.values())) if name is None else tools[name]
    used = {arm.dataset.tools[k].name for k in np.unique(m.tool[m.role == "calibrate"])}
    if tool.name in used:
        return Working(arm, tool, 0.0, tool.name, name is not None)
    return Working(arm, tool, tool.u or 0.0, probe.name, name is not None, _taken_up(arm))


def _taken_up(arm: FittedArm) -> tuple[Parameter, ...]:
    """Parameters of the geometry that the model lacks because the offset of a tool contains them."""
    scene, fitted = arm.model.scene, {p.name for p in arm.model.parameters}
    around = replace(scene.circumstances(scene.rows("calibrate")), tied_tool=True)
    every = parameters_of(arm.effects, around, lenient=True)
    width = arm.origin.options.prior_width
    further = [p for p in every if p.effect == GEOMETRY.name and p.name not in fitted]
    return tuple(replace(p, sd=width * p.sd) for p in further)


def _carrying(arm: FittedArm, tool: Tool) -> FittedArm:
    """The arm whose session has a further tool, which no row uses."""
    scene = arm.model.scene
    others = tuple(t for t in scene.dataset.tools if t.name != tool.name)
    if len(others) < len(scene.dataset.tools):
        raise BayescalError(f"the session has a tool `{tool.name}`", "--tcp", f"give --tool {tool.name}")
    dataset = replace(scene.dataset, tools=(*others, tool))
    return replace(arm, model=replace(arm.model, scene=replace(scene, dataset=dataset)))


def check_stated(stated: Sequence[ToolStatement], working: Working) -> None:
    """Refuse a program that has another tool, or whose tool cannot be compared and is not given.

    Raises
    ------
    BayescalError
        With the line; the remedy has the pose of the program's tool where it is in numbers.
    """
    if len(texts := list(dict.fromkeys(s.text for s in stated if s.pose is None))) > 1:
        what = f"the program has several tools ({', '.join(texts)})"
        raise BayescalError(what, stated[0].where, "split it by tools, and give --tool or --tcp for each")
    for s in stated:
        if s.pose is None:
            if not working.chosen:
                what = f"the pose of its tool is not in the program ({s.text})"
                raise BayescalError(what, s.where, "give --tool or --tcp: the tool that the controller has")
            continue
        away = float(np.linalg.norm(s.pose[:3, 3] - working.pose[:3, 3]))
        turn = Rotation.from_matrix(s.pose[:3, :3].T @ working.pose[:3, :3]).magnitude()
        if away > SAME or turn > SAME_ANGLE:
            pose = [*(1e3 * s.pose[:3, 3]), *np.degrees(rpy_of(s.pose[:3, :3]))]
            what = f"its tool ({s.text}) is {1e3 * away:.3g} mm and {np.degrees(turn):.3g} deg away from"
            stated_pose = ",".join(f"{round(x, 6) + 0.0:.8g}" for x in pose)
            remedy = f"give --tcp={stated_pose}, or correct the program"
            raise BayescalError(f"{what} `{working.tool.name}`", s.where, remedy)
