"""A probing program: one sequence of steps, rendered by a table of dialects and their templates.

A template, ``programs/NAME.txt``, has sections that begin with ``=== section``. A section whose name has a
point is a file. It holds the sections of the steps as ``<<steps>>`` and, where readings are listed apart, as
``<<positions>>``. What a controller is relied on to do is stated in the header of its template.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.plan.format import Format, Probe
from bayescal.exporting.plan.probing import AHEAD, Step, guarded, steps
from bayescal.planning.result import Plan
from bayescal.probing.contacts import SPEED
from bayescal.programs.text import Number, degrees_of, digits
from bayescal.programs.urscript import URSCRIPT as UR

TEMPLATES = Path(__file__).parent / "programs"
JOINTS = 6
"""Joints of the arms that these controllers move."""
NEAR = 50e-3
"""m/s of lines that are not searches: to the beginning of a search, and back (assumed)."""
RAMP = 0.5
"""m/s2 of the stop behind a contact of a UR (assumed: gentle beside the 1.2 m/s2 of its usual motions)."""
STILL, REST = 2.0, 0.2
"""s at rest before an instrument reads a point, and between motions with another force (assumed)."""
LABELS = 10  # of FANUC, for each row


@dataclass(frozen=True)
class Dialect:
    """What differs between controllers beside the template.

    Attributes
    ----------
    name, summary : str
        As of `Format`.
    triggers : mapping of str to (str, str)
        Forms of ``--probe-input`` as patterns, and what is true of an input while the probe is pressed, and
        while it is not.
    first : str
        The input that is taken where none is stated.
    numbers : callable
        Numbers of readings (n,), rad.
    list : str
        A list of joints, of ``{}``; `joint` is one of them, by k from 1 and its number.
    position : str
        How a motion names listed readings, by their number from 1; "" if they stand in the motion.
    force : str
        As a trigger, by N; "" if the controller has no force.
    unsafe : str
        Characters that end a text or are not allowed in it.
    width : int
        Most characters of a line of a message.
    line : str
        A numbered line of the program, by k and text; "" if lines have no numbers.
    """

    name: str
    summary: str
    triggers: Mapping[str, tuple[str, str]]
    first: str
    numbers: Callable[[np.ndarray], Iterable[Number]]
    list: str
    joint: str
    separator: str
    position: str = ""
    force: str = ""
    unsafe: str = r'["]'
    width: int = 0
    line: str = ""

    @cached_property
    def sections(self) -> dict[str, str]:
        """Sections of the template, without the last line break."""
        text = (TEMPLATES / f"{self.name}.txt").read_text(encoding="utf-8")
        parts = re.split(r"^=== (\S+)\n", text, flags=re.MULTILINE)[1:]
        return {name: body.rstrip("\n") for name, body in zip(parts[::2], parts[1::2], strict=True)}

    def section(self, name: str, fields: Mapping[str, str]) -> str:
        """A section with its fields; those that are not given are kept."""
        return re.sub(r"<<(\w+)>>", lambda m: fields.get(m[1], m[0]), self.sections.get(name, ""))

    def joints(self, readings: np.ndarray) -> str:
        """Readings (n,), rad, as a list without its brackets."""
        every = (self.joint.format(k, digits(x)) for k, x in enumerate(self.numbers(readings), 1))
        return self.separator.join(every)

    def plain(self, text: str) -> str:
        """A text that does not end its string or comment."""
        return re.sub(self.unsafe, "'", " ".join(text.split()))

    def trigger(self, probe: Probe) -> tuple[str, str]:
        """What is true while the probe is pressed, and while it is not.

        Raises
        ------
        BayescalError
            If the controller has no such input or no force.
        """
        if probe.force is not None:
            if self.force:
                return self.force.format(f"{probe.force:g}"), ""
            what = f"a program of the format {self.name} cannot measure a force"
            raise BayescalError(what, "--probe-force-n", "give --probe-input")
        name = probe.input or self.first
        for pattern, expressions in self.triggers.items():
            if match := re.fullmatch(pattern, name):
                pressed, released = (e.format(*match.groups()) for e in expressions)
                return pressed, released
        forms = ", ".join(p.replace(r"(\d+)", "N").replace(r"([A-Za-z]\w*)", "NAME") for p in self.triggers)
        what = f"`{name}` is no input of the format {self.name}"
        raise BayescalError(what, "--probe-input", f"its inputs are {forms}")

    def format(self) -> Format:
        """As a format of plans."""
        return Format(self.name, lambda plan, probe: written(self, plan, probe), self.summary, self.check)

    def check(self, probe: Probe) -> None:
        """Refuse a probe that the controller does not have."""
        self.trigger(probe)


def written(dialect: Dialect, plan: Plan, probe: Probe) -> dict[str, str]:
    """The files of a plan by their names.

    Raises
    ------
    BayescalError
        For an arm that does not have six joints, or a probe that the controller does not have.
    """
    n = plan.session.robot.n
    if n != JOINTS:
        what = f"programs of the format {dialect.name} are for arms of {JOINTS} joints"
        raise BayescalError(f"{what}; {plan.session.robot.name} has {n}", "--to", "choose another format")
    common, positions = _common(dialect, plan, probe), list[np.ndarray]()
    every = list(steps(plan, guarded(plan, probe.beyond)))
    body = [dialect.section("header", common)] if "header" in dialect.sections else []
    if any(step.kind == "contact" for step in every):
        body.append(dialect.section("begin", common))
    body += [_step(dialect, step, common, positions) for step in every]
    lines = "\n".join(body)
    if dialect.line:
        lines = "\n".join(dialect.line.format(k, line) for k, line in enumerate(lines.split("\n"), 1))
    rows = [{"number": str(k)} for k in range(1, len(plan.purpose) + 1)]
    listed = (
        {"n": str(k), "at": dialect.position.format(k), "joints": dialect.joints(q)}
        for k, q in enumerate(positions, 1)
    )
    fields = common | {
        "steps": lines,
        "positions": "\n".join(dialect.section("position", common | own) for own in listed),
        "results": "\n".join(dialect.section("result", own) for own in rows),
        "resets": "\n".join(dialect.section("reset", own) for own in rows),
    }
    files = [name for name in dialect.sections if "." in name]
    return {name: dialect.section(name, fields) + "\n" for name in files}


def _step(dialect: Dialect, step: Step, common: Mapping[str, str], positions: list[np.ndarray]) -> str:
    """A step; readings that are listed apart are added to `positions`."""
    fields = dict(common) | {key: dialect.plain(text) for key, text in step.texts.items()}
    fields |= {f"label{k}": str(LABELS * int(step.texts["number"]) + k) for k in range(1, LABELS)}
    for name, readings in step.readings.items():
        if dialect.position:
            same = next((k for k, q in enumerate(positions[-3:], len(positions[:-3])) if q is readings), -1)
            if same < 0:
                positions.append(readings)
                same = len(positions) - 1
            fields[name] = dialect.position.format(same + 1)
        else:
            fields[name] = dialect.list.format(dialect.joints(readings))
    if dialect.width and step.kind == "stop":
        texts = textwrap.wrap(fields["text"], dialect.width)
        fields["lines"] = "\n".join(dialect.section("line", {"text": text}) for text in texts)
    return dialect.section(step.kind, fields)


def _common(dialect: Dialect, plan: Plan, probe: Probe) -> dict[str, str]:
    """Fields of all steps and of the header."""
    session, m = plan.session, plan.session.measurements
    pressed, released = dialect.trigger(probe)
    tools = [session.tools[k] for k in dict.fromkeys(m.tool.tolist())]
    centres = [", ".join(f"{1e3 * x:g}" for x in tool.centre) for tool in tools]
    names = [f"{dialect.plain(tool.name)} " if len(tools) > 1 else "" for tool in tools]
    tool = tools[0]
    cog = tool.centre if tool.centre_of_mass is None else tool.centre_of_mass
    out = {
        "name": dialect.plain(session.name),
        "count": str(len(m.ids)),
        "rows": str(len(m.ids)),
        "tcp": "; ".join(f"{name}{c} mm" for name, c in zip(names, centres, strict=True)),
        "tcp_numbers": ",".join(f"{1e3 * x:.4f}" for x in tool.centre),
        "mass": f"{max(tool.mass, 0.001):g}",
        "cog": ",".join(f"{1e3 * x:.1f}" for x in cog),
        "tool": "1",
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
        out |= {f"late{cycle}": f"{1e3 * late:.2g}", f"over{cycle}": f"{1e3 * over_travel(late):.2g}"}
    return out


def over_travel(late: float) -> float:
    """Way from the contact to standstill, m: `late`, m, before the stop begins, and v2/(2 a)."""
    return late + SPEED**2 / (2 * RAMP)


DIALECTS = (
    Dialect(
        "urscript",
        "URScript (UR): guarded motions until the probe triggers, and a log line for each contact",
        {
            r"(\d+)": ("get_standard_digital_in({})", ""),
            r"tool:(\d+)": ("get_tool_digital_in({})", ""),
            r"configurable:(\d+)": ("get_configurable_digital_in({})", ""),
        },
        "0",
        UR.joints,
        list="[{}]",
        joint="{1}",
        separator=", ",
        force="bc_force() > {}",
    ),
    Dialect(
        "fanuc",
        "FANUC LS: SKIP CONDITION, readings in position registers",
        {r"(\d+)": ("DI[{}]=ON", "DI[{}]=OFF"), r"tool:(\d+)": ("RI[{}]=ON", "RI[{}]=OFF")},
        "1",
        degrees_of,
        list="",
        joint="J{}= {} deg",
        separator=",\t",
        position="P[{}]",
        unsafe=r"[\];:\"]",
        width=24,
        line="{:4d}:  {} ;",
    ),
    Dialect(
        "kuka",
        "KUKA KRL: interrupt, readings in the data list",
        {
            r"(\d+)": ("$IN[{}]==TRUE", "$IN[{}]==FALSE"),
            r"measure:(\d+)": ("$MEAS_PULSE[{}]==TRUE", "$MEAS_PULSE[{}]==FALSE"),
        },
        "1",
        degrees_of,
        list="",
        joint="A{} {}",
        separator=",",
        position="XP{}",
    ),
    Dialect(
        "abb",
        "ABB RAPID: SearchL, readings in a log",
        {r"([A-Za-z]\w*)": ("{}", "{}")},
        "diProbe",
        degrees_of,
        list="[[{}],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]",
        joint="{1}",
        separator=",",
        width=40,
    ),
)
"""Dialects of controllers; their inputs count as the controllers count them."""
PROGRAMS = tuple(dialect.format() for dialect in DIALECTS)
