"""Formats of a plan for controllers: tables of its motions, and probing programs.

A probing program is one sequence of steps (`motions.steps`), rendered by a template of a controller,
``templates/NAME.txt``, in which ``=== NAME`` begins a file. Readings of the steps are also listed apart, with
a number. What a controller is relied on to do is stated in the header of its template.
"""

import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.errors import BayescalError
from bayescal.planning.result import Plan
from bayescal.probing.contacts import SPEED
from bayescal.programs import PROGRAMS
from bayescal.programs.motions import AHEAD, guarded, poses_table, readings_table, robodk_table, steps
from bayescal.programs.text import Dialect, Format, digits
from bayescal.robots import only_revolute
from bayescal.storage.writing import templates_beside

BRACED = {
    "variable_start_string": "<<",
    "variable_end_string": ">>",
    "block_start_string": "<%",
    "block_end_string": "%>",
}
"""Syntax of the templates: statements of the controllers have braces."""
TEMPLATES = templates_beside(
    __file__,
    {
        "wrapped": textwrap.wrap,
        "numbered": lambda text: "".join(
            f"{k:4d}:  {line} ;\n" for k, line in enumerate(text.splitlines(), 1)
        ),
    },
    **BRACED,
)
"""Templates of probing programs."""
JOINTS = 6
"""Joints of the arms that these controllers move."""
NEAR = 50e-3
"""m/s of lines that are not searches: to the beginning of a search, and back (assumed)."""
RAMP = 0.5
"""m/s2 of the stop behind a contact of a UR (assumed: gentle beside the 1.2 m/s2 of its usual motions)."""
STILL, REST = 2.0, 0.2
"""s at rest before an instrument reads a point, and between motions with another force (assumed)."""
BEYOND = 5e-3
"""m beyond the expected surface where a guarded motion ends (assumed)."""
MOST_BEYOND = 50e-3
"""m: more is no search for a surface."""


@dataclass(frozen=True)
class Probe:
    """How a controller notices a contact, and how far it searches.

    Attributes
    ----------
    input : str
        Digital input as the controller names it; "" for the first of the format.
    force : float or None
        N: change of the force at the tool from which on it is a contact, in place of the input.
    beyond : float
        m beyond the expected surface where the guarded motion ends.
    """

    input: str = ""
    force: float | None = None
    beyond: float = BEYOND

    def __post_init__(self) -> None:
        """Refuse what is no threshold and no length."""
        if self.force is not None and not (np.isfinite(self.force) and self.force > 0):
            raise BayescalError(f"a force of {self.force:g} N", "--probe-force-n", "give a positive number")
        if self.force is not None and self.input:
            what = "either the input or the force states a contact"
            raise BayescalError(what, "--probe-force-n", "remove it or --probe-input")
        if not 0 < self.beyond <= MOST_BEYOND:
            what = f"a search {1e3 * self.beyond:g} mm beyond the surface"
            raise BayescalError(what, "--probe-beyond-mm", f"give more than 0, to {1e3 * MOST_BEYOND:g}")


@dataclass(frozen=True)
class PlanFormat:
    """A format of planned motions.

    Attributes
    ----------
    name : str
        In options.
    files : callable
        Texts of a plan by the names of their files in the run folder; only programs depend on the probe.
    check : callable
        Refuses a probe that the format cannot use, before a plan is made.
    moves : callable
        Refuses an arm that the format cannot move, before a plan is made.
    """

    name: str
    files: Callable[[Plan, Probe], Mapping[str, str]]
    check: Callable[[Probe], object] = lambda probe: None
    moves: Callable[[Robot], None] = lambda robot: None


@dataclass(frozen=True)
class Writer:
    """The dialect of a controller with its template."""

    form: Format
    dialect: Dialect

    def plain(self, text: str) -> str:
        """A text that does not end its string or comment."""
        return re.sub(self.dialect.unsafe, "'", " ".join(text.split()))

    def moves(self, robot: Robot) -> None:
        """Refuse an arm that the controller does not move.

        Raises
        ------
        BayescalError
            For an arm that does not have six joints, or has prismatic ones.
        """
        only_revolute(robot, f"programs of {self.form.name}", "write motions as a table")
        if robot.n != JOINTS:
            what = f"programs of the format {self.form.name} are for arms of {JOINTS} joints"
            raise BayescalError(f"{what}; {robot.name} has {robot.n}", "--to", "choose another format")

    def trigger(self, probe: Probe) -> tuple[str, str]:
        """What is true while the probe is pressed, and while it is not.

        Raises
        ------
        BayescalError
            If the controller has no such input or no force.
        """
        if probe.force is not None:
            if self.dialect.force:
                return self.dialect.force.format(f"{probe.force:g}"), ""
            what = f"a program of the format {self.form.name} cannot measure a force"
            raise BayescalError(what, "--probe-force-n", "give --probe-input")
        name = probe.input or self.dialect.first
        for pattern, expressions in self.dialect.triggers.items():
            if match := re.fullmatch(pattern, name):
                pressed, released = (e.format(*match.groups()) for e in expressions)
                return pressed, released
        forms = (p.replace(r"(\d+)", "N").replace(r"([A-Za-z]\w*)", "NAME") for p in self.dialect.triggers)
        what = f"`{name}` is no input of the format {self.form.name}"
        raise BayescalError(what, "--probe-input", f"its inputs are {', '.join(forms)}")


def written(writer: Writer, plan: Plan, probe: Probe) -> dict[str, str]:
    """The files of a plan by their names.

    Raises
    ------
    BayescalError
        For an arm that does not have six joints, or a probe that the controller does not have.
    """
    writer.moves(plan.session.robot)
    positions: list[dict[str, Any]] = []

    def listed(readings: np.ndarray) -> dict[str, Any]:
        """Readings, rad, as an entry of the list of positions; those of the steps just before are one."""
        if not (same := [p for p in positions[-3:] if p["readings"] is readings]):
            joints = [digits(x) for x in writer.form.joints(readings)]
            positions.append({"number": len(positions) + 1, "readings": readings, "joints": joints})
        return same[0] if same else positions[-1]

    every = [
        {"kind": step.kind, "number": step.number}
        | {key: writer.plain(text) for key, text in step.texts.items()}
        | {key: listed(readings) for key, readings in step.readings.items()}
        for step in steps(plan, guarded(plan, probe.beyond))
    ]
    fields = _common(writer, plan, probe) | {"steps": every, "positions": positions}
    text = TEMPLATES.get_template(f"{writer.form.name}.txt").render(fields)
    parts = re.split(r"^=== (\S+)\n", text, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def _common(writer: Writer, plan: Plan, probe: Probe) -> dict[str, Any]:
    """Fields of all steps and of the header."""
    session, m = plan.session, plan.session.measurements
    pressed, released = writer.trigger(probe)
    tools = [session.tools[k] for k in dict.fromkeys(m.tool.tolist())]
    centres = [", ".join(f"{1e3 * x:g}" for x in tool.centre) for tool in tools]
    names = [f"{writer.plain(tool.name)} " if len(tools) > 1 else "" for tool in tools]
    tool = tools[0]
    cog = tool.centre if tool.centre_of_mass is None else tool.centre_of_mass
    out: dict[str, Any] = {
        "name": writer.plain(session.name),
        "count": len(m.ids),
        "tcp": "; ".join(f"{name}{c} mm" for name, c in zip(names, centres, strict=True)),
        "tcp_numbers": ",".join(f"{1e3 * x:.4f}" for x in tool.centre),
        "mass": f"{max(tool.mass, 0.001):g}",
        "cog": ",".join(f"{1e3 * x:.1f}" for x in cog),
        "tool": 1,
        "trigger": pressed,
        "released": released,
        "watched": "" if probe.force is None else "kind > 0 and ",
        "beyond": f"{1e3 * probe.beyond:g}",
        "ahead": f"{1e3 * AHEAD:g}",
        "v": f"{1e3 * SPEED:g}",
        "v_m": f"{SPEED:g}",
        "v_near": f"{1e3 * NEAR:g}",
        "v_near_m": f"{NEAR:g}",
        "a_stop": f"{RAMP:g}",
        "still": f"{STILL:.2f}",
        "rest": f"{REST:g}",
    }
    for cycle in (2, 8, 12):  # ms
        late = SPEED * 1e-3 * cycle
        over = late + SPEED**2 / (2 * RAMP)  # from the contact to standstill
        out |= {f"late{cycle}": f"{1e3 * late:.2g}", f"over{cycle}": f"{1e3 * over:.2g}"}
    return out


def _table(name: str, text: Callable[[Plan], str], file: str) -> PlanFormat:
    return PlanFormat(name, lambda plan, probe: {file: text(plan)})


WRITERS = [Writer(form, form.dialect) for form in PROGRAMS.values() if form.dialect is not None]
EVERY = (
    _table("csv", readings_table, "plan-joints.csv"),
    *(
        PlanFormat(writer.form.name, partial(written, writer), writer.trigger, writer.moves)
        for writer in WRITERS
    ),
    _table("robodk", robodk_table, "plan-robodk.csv"),
    _table("poses", poses_table, "plan-poses.csv"),
)
FORMATS: dict[str, PlanFormat] = {form.name: form for form in EVERY}
"""Formats by their names."""


def formats_of(names: Sequence[str], probe: Probe | None = None) -> tuple[PlanFormat, ...]:
    """Formats with these names, each once.

    Raises
    ------
    BayescalError
        For a name that is not known, or a probe that a format cannot use.
    """
    for name in names:
        if name not in FORMATS:
            raise BayescalError(f"there is no format `{name}`", "--to", f"known: {', '.join(FORMATS)}")
    formats = tuple(FORMATS[name] for name in dict.fromkeys(names))
    for form in formats:
        form.check(probe or Probe())
    return formats
