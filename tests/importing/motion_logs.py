"""A made-up session of joint motions, and its files as other programs write them."""

import json
from dataclasses import dataclass

import numpy as np
import pandas as pd

LINKS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR = tuple(f"{link}_joint" for link in LINKS)
CONSTANTS = np.array([12.0, 12.0, 10.0, 5.0, 5.0, 5.0])
"""N m/A."""
STEP, REST = 0.01, 0.8
ORDER = (1, 1, 2, 3, 4)
"""Trajectories of the motions: the second repeats the first."""


@dataclass(frozen=True)
class Session:
    """Rows (N,), (N, 6) in SI, and the number (N,) of each row's motion; rest before, between and behind."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    current: np.ndarray
    motion: np.ndarray


def trajectory(seed: int, time: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(seed)
    window = np.sin(np.pi * time / time[-1])[:, None] ** 2
    return 0.6 * window * np.sin(2 * np.pi * time[:, None] * rng.uniform(0.3, 1.0, 6) + rng.uniform(0, 6, 6))


def session(order: tuple[int, ...] = ORDER, length: float = 2.0) -> Session:
    go = np.arange(0.0, length, STEP)
    rest = np.zeros((round(REST / STEP), 6))
    parts, number = [rest], [np.zeros(len(rest), int)]
    for k, seed in enumerate(order, 1):
        parts += [trajectory(seed, go), rest]
        number += [np.full(len(go), k), np.full(len(rest), k)]
    position = np.concatenate(parts) + np.array([0.0, -1.2, 1.4, -1.0, -0.7, 0.2])
    time = 100.0 + STEP * np.arange(len(position))
    velocity = np.gradient(position, time, axis=0)
    torque = np.array([0, 60, 25, 4, 2, 0]) * np.cos(position) + 2 * np.gradient(velocity, time, axis=0)
    current = torque / CONSTANTS + 0.4 * np.tanh(velocity / 0.03) + 0.2 * velocity
    return Session(time, position, velocity, torque, current, np.concatenate(number))


def of_joints(name: str, values: np.ndarray, first: int = 0) -> dict[str, np.ndarray]:
    return {f"{name}{j + first}": column for j, column in enumerate(values.T)}


def write_csv(path, columns):
    pd.DataFrame(columns).to_csv(path, index=False, float_format="%.9g")
    return path


def rtde(path, s: Session, **more):
    """As csv_writer.py of the RTDE client writes it."""
    columns = {"timestamp": s.time} | of_joints("actual_q_", s.position) | of_joints("actual_qd_", s.velocity)
    columns |= of_joints("target_q_", s.position) | of_joints("actual_current_", s.current)
    columns |= of_joints("target_moment_", s.torque) | of_joints("target_current_", s.current)
    return write_csv(path, columns | of_joints("joint_temperatures_", 30 + 0 * s.position) | more)


def bag(path, topics, mcap=False, definitions=True):
    """A rosbag2 of `topics`: name, type and messages (time of reception in s, content) of each."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for text, name in DEFINITIONS:
        store.register(get_types_from_msg(text, name))
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, kind, make, stamps in topics:
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, stamp in enumerate(stamps):
                message = make(store.types, k)
                writer.write(connection, round(1e9 * stamp), store.serialize_cdr(message, kind))
    return path


JTC = "control_msgs/msg/JointTrajectoryControllerState"
STATE = "sensor_msgs/msg/JointState"
FRANKA = "franka_msgs/msg/FrankaState"
DEFINITIONS = (
    (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint reference\n"
        "trajectory_msgs/JointTrajectoryPoint feedback\ntrajectory_msgs/JointTrajectoryPoint error\n",
        JTC,
    ),
    ("std_msgs/Header header\nfloat64[7] q\nfloat64[7] q_d\nfloat64[7] dq\nfloat64[7] tau_J\n", FRANKA),
)
"""The fields that are read, of the public definitions."""


def header(types, stamp):
    whole = types["builtin_interfaces/msg/Time"](sec=int(stamp), nanosec=round(1e9 * (stamp - int(stamp))))
    return types["std_msgs/msg/Header"](stamp=whole, frame_id="")


def joint_states(s: Session, names=UR, topic="/joint_states", late=0.002, unstamped=False):
    """The topic of a joint state broadcaster; joints as `names` order them."""
    order = [UR.index(name) for name in names]

    def make(types, k):
        position, velocity, effort = (x[k, order] for x in (s.position, s.velocity, s.current))
        stamp = header(types, 0.0 if unstamped else s.time[k])
        return types[STATE](stamp, list(names), position, velocity, effort)

    return topic, STATE, make, s.time + late


def controller_states(s: Session, every=2, first=0):
    """The state of a trajectory controller at a lower rate, from row `first` on; commands lead by 20 ms."""
    rows = np.arange(first, len(s.time), every)

    def make(types, k):
        def point(values):
            empty, zero = [np.zeros(0)] * 3, types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
            return types["trajectory_msgs/msg/JointTrajectoryPoint"](values, *empty, zero)

        row, ahead = rows[k], min(rows[k] + 2, len(s.time) - 1)
        actual = point(s.position[row])
        names = {"header": header(types, s.time[row]), "joint_names": list(UR)}
        return types[JTC](**names, reference=point(s.position[ahead]), feedback=actual, error=actual)

    return "/controller/state", JTC, make, s.time[rows] + 0.001


def lerobot(folder, s: Session, names, values, rate=100.0, info=True, real=False):
    """A data set of format v3: an episode of each motion, `values` (N, k) as observation.state and action."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = np.flatnonzero(s.motion > 0)
    episode = s.motion[rows] - 1
    frame = np.concatenate([np.arange((episode == e).sum()) for e in np.unique(episode)])
    stamps = frame / rate if not real else frame / rate + 1e-2 * np.sin(frame)
    lists = pa.array(list(values[rows].astype(np.float32)), pa.list_(pa.float32()))
    table = pa.table({
        "observation.state": lists,
        "action": lists,
        "timestamp": pa.array(stamps.astype(np.float32)),
        "frame_index": pa.array(frame),
        "episode_index": pa.array(episode),
        "task_index": pa.array((episode == episode.max()).astype(int)),
    })  # fmt: skip
    (folder / "data/chunk-000").mkdir(parents=True)
    pq.write_table(table, folder / "data/chunk-000/file-000.parquet")
    if info:
        (folder / "meta").mkdir()
        feature = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
        content = {"codebase_version": "v3.0", "fps": rate}
        content["features"] = {"observation.state": feature, "action": feature}
        (folder / "meta/info.json").write_text(json.dumps(content))
    return folder


def sage(folder, s: Session, number: int, names=UR, factor=1e6):
    """A motion as SAGE records it of a robot, with times in µs; commands at a quarter of the rate."""
    folder.mkdir(parents=True)
    rows = np.flatnonzero(s.motion == number)

    def lists(*values):
        return ",".join('"[' + ", ".join(f"{v:.7f}" for v in each) + ']"' for each in values)

    head = "type,timestamp,positions,velocities,torques\n"
    signals = [lists(s.position[r], s.velocity[r], s.torque[r]) for r in rows]
    state = [f"StateMotor,{factor * s.time[r]:.0f},{x}" for r, x in zip(rows, signals, strict=True)]
    control = [f"Control,{factor * s.time[r]:.0f},{lists(s.position[r])},,".rstrip(",") for r in rows[::4]]
    (folder / "state_motor.csv").write_text(head + "\n".join(state) + "\n")
    (folder / "control.csv").write_text("type,timestamp,positions\n" + "\n".join(control) + "\n")
    (folder / "joint_list.txt").write_text("\n".join(f"/World/arm/{n}" for n in names) + "\n")
    begin, end = (round(factor * s.time[rows[k]]) for k in (10, -11))
    (folder / "event.csv").write_text(f"timestamp,event\n{begin},MOTION_START\n{end},DISABLE\n")
    return folder
