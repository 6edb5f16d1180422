"""The request of an import, the formats it knows, and what the log does not contain: robot, tools, targets.

What is relied on is written down, with its source, in ``docs/importing.md``.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from bayescal.dataset import Dataset, Noise, Target, Tool
from bayescal.dataset.read import SETTINGS, expanded_robot, no_rows, read_settings
from bayescal.errors import BayescalError
from bayescal.importing.columns import DECIMALS, Columns, columns_of
from bayescal.importing.joint_formats import FORMATS
from bayescal.importing.log import Log, header_of
from bayescal.importing.mapping import Column, Map
from bayescal.importing.onto import files_of
from bayescal.importing.orientations import Loose
from bayescal.importing.roles import names, points
from bayescal.importing.units import UNITS, is_number, quantity, stated_rotation, unit_of
from bayescal.robots import full_name, load_robot
from bayescal.robots.servos import Servo, of_joints, read_calibration

MAPS = FORMATS["maps"]
"""The map of the columns of each format."""

UNSEEN = 1e-6
"""m: RoboDK writes zeros for a point that was not measured; its own scripts require more than 1 µm."""

SAME_TOOL = 1e-6
"""m: TCP positions this close are one."""


def robodk(log: Log, n: int) -> tuple[Columns, dict[str, np.ndarray]]:
    """Rows of a RoboDK table of an arm with `n` joints, and its TCP positions by name.

    Degrees and millimetres: the joints; where measured, x, y, z (and three angles, which are not
    taken); the TCP (and three angles). A row measured at 0, 0, 0 is left out.

    Returns
    -------
    tuple of Columns and dict
        Quantities j1 ... jn, x, y, z if measured, tool; TCP positions (3,) m in the flange frame.
    """
    layouts = {n + 3: (None, n), n + 6: (n, n + 3), n + 12: (n, n + 6)}
    if log.width not in layouts:
        what = f"{log.width} columns do not match a RoboDK table of {n} joints"
        remedy = f"it has {', '.join(map(str, layouts))} columns (joints, measured, tool); or give --map"
        raise BayescalError(what, log.name, remedy)
    measured, tool = layouts[log.width]
    map_ = {f"j{i + 1}": Column(f"#{i + 1}", UNITS["deg"]) for i in range(n)} | _xyz("tool_", tool)
    if measured is not None:
        map_ |= _xyz("", measured)
    columns = columns_of(log, map_)
    if measured is not None:
        xyz = np.column_stack([columns.cells[k] for k in "xyz"])
        columns = columns.take(np.abs(xyz).sum(axis=1) >= UNSEEN)
        if not columns.count:
            raise BayescalError("no measured row: all points are 0, 0, 0", log.name, "export the table again")
    names, tools = _tools(np.column_stack([columns.cells.pop(f"tool_{k}") for k in "xyz"]))
    return replace(columns, cells=columns.cells | {"tool": names}), tools


def _xyz(prefix: str, before: int) -> dict[str, Column]:
    return {f"{prefix}{k}": Column(f"#{before + i + 1}", UNITS["mm"]) for i, k in enumerate("xyz")}


def _tools(centres: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Names (N,) of TCP positions (N, 3), and the points: tcp1, tcp2, ... as they first come."""
    tools: dict[str, np.ndarray] = {}
    names = []
    for centre in centres:
        same = [name for name, c in tools.items() if np.linalg.norm(c - centre) < SAME_TOOL]
        names.append(same[0] if same else f"tcp{len(tools) + 1}")
        tools.setdefault(names[-1], centre)
    return np.array(names), tools


def points_map(log: Log, unit: str) -> Map:
    """The map of a file whose rows are ``x y z``, or names and then ``x y z``.

    Of names with several parts (collection, group, target) the last part counts. A file is refused if it
    is not clear which columns are x, y, z.
    """
    width = log.width
    texts = [i for i in range(width) if not all(is_number(row[i]) for row in log.rows)]
    start = width - 3
    if start < 0 or any(i >= start for i in texts) or (start > 1 and start - 1 not in texts):
        what = f"it is not clear which of the {width} columns are x, y, z"
        remedy = "state it in --points-map: `id=#1, x=#2 mm, y=#3 mm, z=#4 mm`"
        raise BayescalError(what, log.name, remedy)
    length = unit_of(unit, "length", "--points-map")
    map_ = {k: Column(f"#{start + i + 1}", length) for i, k in enumerate("xyz")}
    return map_ | ({"id": Column(f"#{start}")} if start else {})


UPRIGHT = np.array([0.0, 0.0, -9.81])
"""m/s2, in F0."""

MOTION_FORMATS = ("rosbag", "lerobot", "sage")
"""Formats of joint logs alone; csv and ur-rtde are joint logs where `--motions` is given, or of a folder."""

CHOICES = {"format": (*MAPS, *MOTION_FORMATS), "readings": ("encoder", "command"), "decimal": DECIMALS}
"""Options with a fixed set of values."""


@dataclass(frozen=True)
class Request:
    """The options of an import, as given by the user; `bayescal import --help` describes them."""

    log: Path
    map: str = ""
    format: str = "csv"
    robot: str = ""
    points: Path | Sequence[Path] | None = None
    points_map: str | Sequence[str] = ""
    pair: str = "row"
    template: Path | None = None
    plan: Path | None = None
    tool: str = ""
    noise: str = ""
    readings: str = "encoder"
    name: str = ""
    validate: str = ""
    decimal: str = ""
    allow_xacro: bool = False
    motions: str = ""
    joints: str = ""
    board: str = ""
    torque: str = ""
    topic: str = ""
    table: str = "csv"
    calibration: Path | None = None

    def servos(self, joints: Sequence[str]) -> tuple[Servo, ...]:
        """The calibrated servos of the joints of a robot; () without a calibration."""
        if self.calibration is None:
            return ()
        return of_joints(read_calibration(self.calibration), joints, self.calibration.name)

    @property
    def files(self) -> tuple[tuple[Path, str], ...]:
        """Files beside the log, each with its map."""
        paths = [self.points] if isinstance(self.points, Path) else list(self.points or ())
        maps = [self.points_map] if isinstance(self.points_map, str) else list(self.points_map)
        maps = maps * len(paths) if len(maps) == 1 else maps
        if len(maps) != len(paths):
            what = f"{len(paths)} files of points, but {len(maps)} maps"
            remedy = "give one for each file, in their order, or one for all"
            raise BayescalError(what, "--points-map", remedy)
        return tuple(zip(paths, maps, strict=True))

    @property
    def source(self) -> Path | None:
        """The dataset.yaml, or its folder, with tools and targets; None if there is none."""
        return self.template if self.plan is None else files_of(self.plan)[1]

    def refuse_other(self, options: Collection[str], kind: str) -> None:
        """Refuse options other than these, which do nothing for a kind of log."""
        for option in fields(self):
            given = getattr(self, option.name)
            if option.name not in ("log", *options) and (given or option.default) != option.default:
                flag = "--tcp" if option.name == "tool" else f"--{option.name.replace('_', '-')}"
                raise BayescalError(f"is not an option of {kind}", flag, f"remove {flag}")

    def check(self) -> None:
        """Refuse missing and invalid options of a log of contacts."""
        for option in ("joints", "torque", "topic", "table"):
            if getattr(self, option) != ("csv" if option == "table" else ""):
                raise BayescalError("is an option of logs of motions", f"--{option}", "give --motions too")
        for option, choices in CHOICES.items():
            if getattr(self, option) not in choices:
                what = f"`{getattr(self, option)}` is not known"
                raise BayescalError(what, f"--{option}", f"must be {' or '.join(filter(None, choices))}")
        if self.plan is not None and (self.robot or self.template is not None):
            option = "--robot" if self.robot else "--template"
            what = "the plan states robot, tools and targets already"
            raise BayescalError(what, option, f"remove {option} or --plan")
        if not self.robot and self.source is None:
            remedy = "give its name or file, or a --template"
            raise BayescalError("the robot is not stated", "--robot", remedy)
        if self.source is not None and self.tool:
            raise BayescalError("the template states the tools already", "--tcp", "remove one of the two")
        if self.format == "csv" and not self.map and self.plan is None:
            columns = ", ".join(header_of(self.log)) or "#1, #2, ... (without names)"
            remedy = f'write --map "j*=A* deg, x=X mm, ..."; the columns are {columns}'
            if "actual_q_0" in columns:
                as_joint_log = "with `--motions pause:2s` as a joint log"
                remedy = f"a record of RTDE is read by `--format ur-rtde`, {as_joint_log}"
            raise BayescalError("the contents and units of the columns are not stated", self.log.name, remedy)
        for path, said in self.files if self.points else ():
            if not said:
                remedy = 'write `--points-map mm`, or `--points-map "id=#1, x=#2 mm, y=#3 mm, z=#4 mm"`'
                raise BayescalError("the unit of the points is not stated", path.name, remedy)


def base_of(request: Request) -> Dataset:
    """A session of no rows: the template's (with another robot where one is named), or a bare one."""
    reference = full_name(request.robot)
    if (path := request.source) is not None:
        expanded = expanded_robot(path) if request.allow_xacro else None
        base, _, _ = read_settings(path / SETTINGS if path.is_dir() else path, expanded)
        if request.robot:
            robot, _ = load_robot(reference, allow_xacro=request.allow_xacro)
            base = replace(base, robot=robot, robot_reference=reference)
    else:
        robot, _ = load_robot(reference, allow_xacro=request.allow_xacro)
        base = Dataset(
            request.log.stem, request.log.parent, robot, reference, request.readings, UPRIGHT, (),
            Noise(), (), (), no_rows(robot.n),
        )  # fmt: skip
    noise = base.noise
    if request.noise:
        length, _, angle = request.noise.partition(",")
        noise = replace(noise, point=quantity(length, "length", 1, "--noise")[0])
        if angle.strip():
            noise = replace(noise, orientation=quantity(angle, "angle", 1, "--noise")[0])
    sources = filter(None, (f"imported from {request.log.name}", base.source))
    return replace(base, name=request.name or base.name, noise=noise, source="; ".join(sources))


def furnished(
    base: Dataset, request: Request, columns: Columns, centres: Mapping[str, np.ndarray]
) -> tuple[Dataset, Loose]:
    """Tools and targets for the rows: the template's; else instruments, and tools said, read or to be found.

    Parameters
    ----------
    base : Dataset
        A session of no rows (`base_of`).
    request : Request
    columns : Columns
        The rows.
    centres : mapping of str to np.ndarray
        TCP positions (3,), m, that the log itself holds, by the names its rows use.

    Returns
    -------
    tuple of Dataset and Loose
        Still of no rows; and the names of what is to be found from them.
    """
    if request.source is not None:
        return base, Loose()
    if points(columns) is None:
        what = "no points, and no template with targets"
        remedy = "map x, y, z, give --points FILE or a --template; of a joint log state --motions"
        raise BayescalError(what, columns.name, remedy)
    if base.noise.point is None and "u" not in columns.cells:
        remedy = 'state the standard uncertainty of a coordinate, `--noise "0.03 mm"`, or map `u`'
        raise BayescalError("the uncertainty of the instrument is not stated", "--noise", remedy)
    used = names(columns, "tool") or ["tool"]
    rpy = None
    if request.tool:
        if len(used) > 1:
            what = f"a single TCP, but the rows use {', '.join(used)}"
            raise BayescalError(what, "--tcp", "remove it to estimate the TCPs, or give a --template")
        point, _, turn = request.tool.partition(";")
        centres = {used[0]: np.array(quantity(point, "length", 3, "--tcp"))}
        rpy = stated_rotation(turn, "--tcp") if turn.strip() else None
    targets = names(columns, "target") or ["tracker"]
    place: dict[str, np.ndarray | float] = {"xyz": np.zeros(3), "rpy": np.zeros(3)}
    tools = tuple(Tool(name, centres.get(name, np.zeros(3)), rpy=rpy) for name in used)
    base = replace(base, tools=tools, targets=tuple(Target(name, "instrument", place) for name in targets))
    return base, Loose(tuple(targets), tuple(name for name in used if name not in centres))
