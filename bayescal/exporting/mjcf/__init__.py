"""The fitted arm as a MuJoCo model (MJCF): a new file, or a file of the user, and a replay script.

The table of the script has the law of the readings, which the model beside a script does not have.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.effects import ALWAYS, Parameter
from bayescal.exporting.geometry import carries
from bayescal.exporting.mjcf import replay
from bayescal.exporting.mjcf.elastic import STATE, UNHELD, Content, springless, sprung
from bayescal.exporting.mjcf.mechanism import PARTS, loads, mechanism, merge, merge_held, names, within
from bayescal.exporting.mjcf.readings import DAMPED, STIFF, Joints, bare, law_of, shown
from bayescal.exporting.written import Format, Item, Options, Written, item
from bayescal.exporting.xml_text import rendered
from bayescal.fitted.arm import FittedArm
from bayescal.storage.files import json_text
from bayescal.storage.reading import table_beside


def mjcf(arm: FittedArm, row: int, script: bool = False) -> str:
    """The text of an MJCF file.

    Parameters
    ----------
    arm : FittedArm
    row : int
        Row of the session whose state the file has.
    script : bool
        Whether a script corrects the commands: then the file has no errors of the readings.

    Raises
    ------
    BayescalError
        If no spring holds a fitted deflection, or a fitted lost motion leads without a script.
    """
    content = Content(arm, row)
    law = bare(law_of(content)) if script else law_of(content)
    machine = mechanism(content, law)
    joints, number = arm.dataset.robot.joint_names, int(arm.dataset.measurements.tool[row])
    text = rendered(
        "arm.mjcf.j2", name=arm.dataset.robot.name, gravity=machine.gravity, machine=machine,
        bodies=within(machine.bodies, machine.flange), passed=within(machine.passed),
        load=machine.loads[number],
    )  # fmt: skip
    root = ET.fromstring(text)
    merge_held(root, content, machine, law, Joints.of(joints))
    merge(root, PARTS.servos(shown(law, joints), STIFF, DAMPED))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


PROBE = {"lobing sin": "lobing_sin_m", "lobing cos": "lobing_cos_m", "latency": "latency_s"}
"""Keys of a table by the names of parameters."""
SCRIPT, TABLE = "-replay.py", "-replay.json"


def replay_table(
    content: Content, joints: Joints, servos: bool, renamed: Mapping[str, Mapping[str, str]]
) -> dict[str, Any]:
    """The table of a script.

    Parameters
    ----------
    content : Content
    joints : Joints
        Of the file.
    servos : bool
        Whether its actuators command the readings, by the names of the joints.
    renamed : mapping
        Names in the file of added parts that are called otherwise there, by kind.
    """
    law, dataset = law_of(content), content.arm.dataset
    tool = dataset.tools[int(dataset.measurements.tool[content.row])].name
    values = {p.name: value for p, value in content.valued}
    probe = {key: values.get(name, 0.0) for name, key in PROBE.items()}
    probe["ball_radius_m"] = values.get(f"ball-radius {tool}", 0.0)
    return {
        "joints": list(joints.names), "signs": joints.signs.tolist(),
        "servos": list(joints.names) if servos else [], "tip": renamed.get("site", {}).get(tool, tool),
        "payload_body": renamed.get("body", {}).get("payload", "payload"),
        "payload_factor": next(load.factor for load in loads(content) if load.name == tool),
        "nominal": law.nominal.tolist(), "exact": law.exact.tolist(), "offset_rad": law.offset.tolist(),
        "waves": [
            {"joint": w.joint, "order": w.order, "sine_rad": w.sine, "cosine_rad": w.cosine}
            for w in law.waves
        ],
        "lost_motion_rad": law.lost.tolist(), "geared": law.geared.tolist(), "probe": probe,
    }  # fmt: skip


PLACES = table_beside(__file__, "places.toml")
"""Element and attribute of a parameter, by the kind of its driver."""
WEIGHED = ("torque", "bending moment", "base moment", "mass")
"""Drivers that need the masses of the links."""


def write(arm: FittedArm, options: Options) -> Written:
    """The MJCF file of an arm."""
    script, whole, arm = options.readings == "script", arm, sprung(arm)
    content, robot = Content(arm, options.state), arm.dataset.robot
    if options.into:
        from bayescal.exporting.mjcf.scene_patch import patched

        file, bodies = patched(arm, options)
        joints = Joints(tuple(file.details["joints"].values()), np.array(file.details["signs"]))
    else:
        file, bodies = Written(mjcf(arm, options.state, script)), names(robot.n, robot.ground)
        joints = Joints.of(robot.joint_names)
    more = {}
    if script:
        table = replay_table(content, joints, not options.into, file.details.get("renamed", {}))
        more[SCRIPT] = Path(replay.__file__).read_text(encoding="utf-8")
        more[TABLE] = json_text(table, rows=False)
    text = "a further mass acts {:.6g} times: set the body payload so (tool {})"
    factors = [text.format(load.factor, load.name) for load in loads(content) if load.factor != 1.0]
    items = tuple(_items(whole, joints.names, bodies))
    details = {**file.details, "readings": options.readings}
    return replace(file, items=items, beside=more, notes=[*file.notes, *factors], details=details)


def holds(arm: FittedArm, k: int) -> bool:
    """Whether an MJCF file can hold a parameter."""
    p = arm.model.parameters[k]
    if p.driver.kind in STATE:
        return all(term.frame >= 0 for term in p.terms)
    weighed = p.driver.kind not in WEIGHED or arm.model.scene.moments is not None
    if p.driver.kind == "position" and p.driver.order:
        return False
    return p.driver.kind in PLACES and p.driver.form not in UNHELD and weighed and not springless(arm)[k]


def _items(arm: FittedArm, joints: Sequence[str], bodies: Sequence[str]) -> Iterator[Item]:
    """Parameters in a file with these names of its joints, and of the bodies of base, links and flange."""
    for k, p in enumerate(arm.model.parameters):
        if holds(arm, k):
            yield item(arm, k, *_place(p, joints, bodies))


def _place(p: Parameter, joints: Sequence[str], bodies: Sequence[str]) -> tuple[str, str]:
    if p.effect in ALWAYS:
        return f"site {p.name.rpartition(' ')[0]}", "pos"
    if p.driver.kind in PLACES:
        element, attribute = PLACES[p.driver.kind]
        return element.format(name=joints[p.site.number - 1] if p.site.number else "..."), attribute
    term = p.terms[0]
    return f"body {bodies[0 if term.frame == 0 else carries(term) + 1]}", "pos, quat"


MJCF = Format(
    ".xml", write, holds, "MuJoCo has no such element", readings=("plain", "script"), into=True,
    prismatic=True, two_arms=("plain",),
)  # fmt: skip
"""The whole arm, for MuJoCo 4: geometry, springs, errors of the readings, lost motion."""
