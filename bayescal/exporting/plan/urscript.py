"""A plan as URScript: a motion by joint angles to the approach, lines to the contact and back, a log line.

The contact is logged by its id and the joint positions, ``p001, [0.1, ...]``, rad, which `bayescal import`
reads. The program stops for each change of tool, artefact or payload.
"""

from __future__ import annotations

from collections.abc import Iterator

from bayescal.errors import BayescalError
from bayescal.exporting.compensate.formats.program import digits
from bayescal.exporting.compensate.formats.urscript import URSCRIPT as PROGRAM
from bayescal.exporting.plan.format import (
    APPROACH,
    CONTACT,
    MEASURE,
    PASS,
    RETRACT,
    STOP,
    Format,
    Motion,
    closed,
    motions,
)
from bayescal.planning.result import Plan

JOINTS = 6
"""Joints of every arm that runs URScript."""
MOVES = {
    APPROACH: "movej({}, a=1.0, v=0.5)",
    PASS: "movej({}, a=1.0, v=0.5)",
    STOP: "movej({}, a=1.0, v=0.5)",
    MEASURE: "movej({}, a=1.0, v=0.5)",
    CONTACT: "movel({}, a=0.1, v=0.005)",
    RETRACT: "movel({}, a=0.3, v=0.05)",
}
"""Moderate rates, rad/s2 and rad/s or m/s2 and m/s (assumed); contacts at the speed of candidates."""
STANDSTILL = 2.0
"""s at rest before an instrument reads a point (assumed)."""
LOGGED = (CONTACT, MEASURE)


def _text(plan: Plan) -> str:
    n = plan.session.robot.n
    if n != JOINTS:
        what = f"URScript is for arms of {JOINTS} joints; {plan.session.robot.name} has {n}"
        raise BayescalError(what, "--to urscript", "choose another format")
    return "\n".join(["def bayescal_plan():", *(f"  {line}" for line in _lines(plan)), "end", ""])


def _lines(plan: Plan) -> Iterator[str]:
    yield f"# {_plain(plan.session.name)}: {len(plan.purpose)} contacts in the order of probing"
    yield "# Contacts are those of the nominal arm: the arm can touch some mm before or behind them."
    yield "# Let the probe stop the motion to a contact, and log the joints where it has triggered."
    yield "# Motions are free of collisions of a simplified arm with the targets: run them slowly first."
    row = -1
    for motion in motions(plan):
        if motion.row != row:
            row = motion.row
            target = plan.session.targets[plan.session.measurements.target[row]].name
            yield f"# {_name(plan, row)}: {_plain(target)}"
            if closed(plan, row):
                yield f'popup("{_plain(plan.by_hand[row])}", title="path", blocking=True)'
        yield f"{MOVES[motion.kind].format(_list(motion))}  # {motion.kind}"
        if motion.kind == STOP and plan.changes[row]:
            yield f'popup("{_plain(plan.changes[row])}", title="change", blocking=True)'
        if motion.kind == MEASURE:
            yield f"sleep({STANDSTILL})"
        if motion.kind in LOGGED:
            yield f'textmsg("{_name(plan, row)}, ", get_actual_joint_positions())'


def _list(motion: Motion) -> str:
    """Joints in rad; a reading beyond one turn is kept as it is."""
    return f"[{', '.join(digits(number) for number in PROGRAM.joints(motion.readings))}]"


def _name(plan: Plan, row: int) -> str:
    return _plain(plan.session.measurements.ids[row])


def _plain(text: str) -> str:
    """A text without what would end a comment or a string."""
    return " ".join(text.split()).replace('"', "'")


URSCRIPT = Format("urscript", "plan.script", _text, "URScript: movej, movel, and a log line for each contact")
