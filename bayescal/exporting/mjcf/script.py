"""The table of a replay script: the law of the readings, which the light model does not have."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayescal.exporting.mjcf import replay
from bayescal.exporting.mjcf.content import Content
from bayescal.exporting.mjcf.law import law_of
from bayescal.exporting.mjcf.mechanism import loads
from bayescal.exporting.mjcf.readings import Joints

PROBE = {
    "lobing sin": "lobing_sin_m",
    "lobing cos": "lobing_cos_m",
    "latency": "latency_s",
}
"""Keys of a table by the names of parameters."""
SCRIPT, TABLE = "-replay.py", "-replay.json"


def beside(
    content: Content, joints: Joints, servos: bool, renamed: Mapping[str, Mapping[str, str]]
) -> dict[str, str]:
    """Further files of an export: the script and its table.

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
    table = json.dumps(replay_table(content, joints, servos, renamed), indent=1, allow_nan=False) + "\n"
    return {SCRIPT: Path(replay.__file__).read_text(encoding="utf-8"), TABLE: table}


def replay_table(
    content: Content, joints: Joints, servos: bool, renamed: Mapping[str, Mapping[str, str]]
) -> dict[str, Any]:
    """The table of a script; arguments as of `beside`."""
    law, dataset = law_of(content), content.arm.dataset
    tool = dataset.tools[int(dataset.measurements.tool[content.row])].name
    probe = dict.fromkeys((*PROBE.values(), "ball_radius_m"), 0.0)
    for p, value in content.valued:
        if p.name in PROBE:
            probe[PROBE[p.name]] = value
        elif p.name == f"ball-radius {tool}":
            probe["ball_radius_m"] = value
    return {
        "joints": list(joints.names),
        "signs": joints.signs.tolist(),
        "servos": list(joints.names) if servos else [],
        "tip": renamed.get("site", {}).get(tool, tool),
        "payload_body": renamed.get("body", {}).get("payload", "payload"),
        "payload_factor": next(load.factor for load in loads(content) if load.name == tool),
        "nominal": law.nominal.tolist(),
        "exact": law.exact.tolist(),
        "offset_rad": law.offset.tolist(),
        "waves": [
            {"joint": w.joint, "order": w.order, "sine_rad": w.sine, "cosine_rad": w.cosine}
            for w in law.waves
        ],
        "lost_motion_rad": law.lost.tolist(),
        "geared": law.geared.tolist(),
        "probe": probe,
    }
