"""Joint states of ROS bags: rosbag2 (sqlite3, MCAP) and rosbag1, by the package rosbags.

Of the messages of `MESSAGES`; their definitions are those in the bag, or where it has none, of ROS 2 Humble.
"""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import BayescalError, listed, refused_as
from bayescal.importing.joint_formats import EFFORTS, MESSAGES, Message, Record, Stream, joint_order, of_logs
from bayescal.statistics import grouped

SUFFIXES = (".mcap", ".db3", ".bag")
METADATA = "metadata.yaml"
NEAR = 1.0
"""s: the stamps of a header are this near to the time of reception, or the two are not of one clock."""
COMMANDS = re.compile(r"command|desired|target|reference|goal|leader")
"""Topics, beside others, whose joint states are what the arm shall do (Isaac Sim, drivers, leader arms)."""
OFTEN = 0.2
"""Of the messages of a topic: a publisher with fewer gives the rows only if no other has more (assumed)."""


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file of one, or a folder with its metadata."""
    return path.suffix in SUFFIXES if path.is_file() else (path / METADATA).is_file()


def read_bag(path: Path, joints: Sequence[str], robot: str, stated: str, topic: str) -> Record:
    """The joint states of a bag.

    Parameters
    ----------
    path : Path
        Its folder, or a file of one.
    joints : sequence of str
        Joint names of the robot.
    robot : str
        Name of the robot, by whose driver efforts are of a kind; "" where their kind is stated.
    stated : str
        As of `joint_order`.
    topic : str
        Of the rows; "" for the only one.

    Raises
    ------
    BayescalError
        Without the package, for a bag that cannot be read, and where no topic has the positions of all
        joints, or several have.
    """
    reader = of_logs("rosbags.highlevel", path.name).AnyReader
    types = of_logs("rosbags.typesys", path.name)
    store = types.get_typestore(types.Stores.ROS2_HUMBLE)
    remedy = "`ros2 bag reindex` repairs a recording that was stopped"
    # rosbags fails in any way at parts that are damaged
    refusal = refused_as("the bag cannot be read", path.name, remedy, Exception)
    with refusal, reader([path], default_typestore=store) as bag:
        return _record(bag, path.name, joints, robot, stated, topic)


def _record(bag: Any, name: str, joints: Sequence[str], robot: str, stated: str, topic: str) -> Record:
    streams: list[tuple[str, Stream, tuple[str, ...]]] = []
    notes, why = [], []
    for kind, message in MESSAGES.items():
        topics = grouped((c.topic, c) for c in bag.connections if c.msgtype == kind and c.msgcount)
        commands = {t for t in topics if kind.endswith("JointState") and t != topic and COMMANDS.search(t)}
        commands = set() if len(commands) == len(topics) else commands
        for topic_, connections in topics.items():
            try:
                stream, said = _stream(bag, connections, message, joints, stated)
                if topic_ in commands:
                    commanded = stream.cells.get("position")
                    stream = replace(stream, cells={} if commanded is None else {"command": commanded})
                streams.append((kind, stream, said))
            except BayescalError as error:
                why.append(str(error))
    seen = {c.topic for c in bag.connections if c.msgtype in MESSAGES}
    if lost := sorted({c.msgtype for c in bag.connections if "State" in c.msgtype and c.topic not in seen}):
        notes.append(f"messages that are not read: {listed(lost)}")
    full = [s for s in streams if "position" in s[1].cells and topic in ("", s[1].name)]
    if topic and not full:
        remedy = f"topics with joint states: {listed(sorted(s[1].name for s in streams)) or 'none'}"
        raise BayescalError(f"no joint positions on `{topic}`", name, remedy)
    first = [s for s in full if s[0] == full[0][0]]
    usual = [s for s in first if s[1].name.endswith("/joint_states")]
    if not full:
        there = listed(sorted({f"{c.topic} ({c.msgtype})" for c in bag.connections}))
        remedy = why[0] if why else "record /joint_states"
        raise BayescalError(f"no joint positions of the {len(joints)} joints; topics: {there}", name, remedy)
    if len(first) > 1 and len(usual) != 1:
        what = f"joint positions on several topics: {listed([s[1].name for s in first])}"
        raise BayescalError(what, name, "choose one: `--topic NAME`")
    kind, rows, said = (usual if len(usual) == 1 else first)[0]
    notes = [f"rows of {rows.name} ({kind})", *said, *notes]
    torque = MESSAGES[kind].torque
    of_driver = next((e for e in EFFORTS if re.search(e[0], robot.lower())), None)
    if of_driver and kind.endswith("JointState") and "torque" in rows.cells:
        _, torque, words = of_driver
        notes.append(f"efforts of {words}, as its driver writes them")
    have = {*rows.cells}
    others = []
    for other_kind, other, _ in streams:
        new = {k: v for k, v in other.cells.items() if k not in have and k != "position"}
        if other is not rows and new and other.name != rows.name:
            have |= new.keys()
            others.append(replace(other, cells=new))
            notes.append(f"{', '.join(new)} of {other.name} ({other_kind}), interpolated")
    return Record(name, rows, tuple(others), torque=torque, clock="session", notes=tuple(notes))


def _stream(
    bag: Any, connections: Sequence[Any], message: Message, joints: Sequence[str], stated: str
) -> tuple[Stream, tuple[str, ...]]:
    """The messages of a topic that have all joints, of one publisher.

    Messages of one publisher have the same names in one order, the same frame and the same quantities.
    """
    topic, kind = connections[0].topic, connections[0].msgtype
    orders: dict[tuple[str, ...], tuple[list[int], str] | None] = {(): (list(range(len(joints))), "")}
    few, why = 0, None
    readers = {key: [_getter(path) for path in paths] for key, paths in message.joints.items()}
    name_of, frame_of = _getter(message.names), _getter("header.frame_id")
    layouts: dict[tuple[Any, ...], list[tuple[int, int, list[np.ndarray]]]] = {}
    for _, stamp, raw in bag.messages(connections=connections):
        content = bag.deserialize(raw, kind)
        names = tuple(name_of(content)) if message.names else ()
        if names not in orders:
            try:
                orders[names] = joint_order(names, joints, stated, topic)
            except BayescalError as error:  # a gripper may publish on the topic of the arm
                orders[names], why = None, why or error
        if (ordering := orders[names]) is None:
            few += 1
            continue
        order, there = ordering[0], {}
        for key, getters in readers.items():
            value = next((v for get in getters if (v := get(content)) is not None and len(v)), ())
            if len(value) > max(order):
                there[key] = np.asarray(value)[order]
        layout = (tuple(there), names, frame_of(content))
        sample = (stamp, _nanoseconds(content, message.stamp), [*there.values()])
        layouts.setdefault(layout, []).append(sample)
    if why is not None and not layouts:
        with suppress(BayescalError):
            joint_order([name for names in orders for name in names], joints, stated, topic)
            what = f"several publishers have parts of the {len(joints)} joints, none has all"
            why = BayescalError(what, topic, "record a topic that has all of them in each message")
        raise why
    count = sum(map(len, layouts.values()))
    often = [key for key, samples in layouts.items() if len(samples) >= OFTEN * count]
    chosen = max(often or layouts, key=lambda key: (len(key[0]), len(layouts[key])))
    received, header, values = zip(*layouts[chosen], strict=True)
    blocks = {k: np.array(v, float) for k, v in zip(chosen[0], zip(*values, strict=True), strict=True)}
    time, said = _clock(np.array(received), np.array(header), message.stamp)
    _, how = orders[chosen[1]] or ([], "")
    notes = [how, said, f"{few} messages without all joints left out" if few else ""]
    if others := count - len(received):
        what = "other names, frames or quantities: those of another publisher (assumed)"
        notes.append(f"{others} of {count} messages of {topic} left out, with {what}")
    return Stream(topic, time, blocks), tuple(filter(None, notes))


def _getter(path: str) -> Callable[[Any], Any]:
    parts = path.split(".")
    return lambda content: reduce(lambda of, part: getattr(of, part, None), parts, content)


def _nanoseconds(content: Any, path: str) -> int:
    """Stamp of a message, ns; 0 where there is none."""
    stamp = _getter(path)(content)
    if isinstance(stamp, (int, float)):
        return round(1e9 * stamp)
    return 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _clock(received: np.ndarray, header: np.ndarray, field: str) -> tuple[np.ndarray, str]:
    """Times (N,), s: the stamps of the messages, or if these are not set, of reception; in words which."""
    late = (received - header) * 1e-9
    if not header.all():
        return received * 1e-9, "times are those of reception: the messages have no stamps"
    text = f"times are the stamps of the messages ({field})"
    if abs(np.median(late)) > NEAR:
        return header * 1e-9, f"{text}, of another clock than that of reception"
    spread = np.percentile(late, [5, 50, 95]) * 1e3
    text += f"; received {spread[1]:.2g} ms later (5 to 95 %: {spread[0]:.2g} to {spread[2]:.2g} ms)"
    return header * 1e-9, text
