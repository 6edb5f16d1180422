"""Sessions of a camera and a board, simulated with a few lines that share only the arm with the model."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.chain import chain_of, frames, link_angles
from bayescal.arm.transforms import rpy_of
from bayescal.dataset import Noise, Target, Tool
from bayescal.dataset.types import Dataset, Measurements
from bayescal.robots import load_robot

NAN = float("nan")
BOARD = np.array([[30e-3 * (x + 1), 30e-3 * (y + 1), 0.0] for y in range(4) for x in range(6)])
FOCAL, CENTRE, SIZE = np.array([910.0, 905.0]), np.array([640.0, 360.0]), np.array([1280.0, 720.0])
LEFT_OUT = dict.fromkeys(
    ("distortion", "u_focal", "u_centre", "u_distortion", "points", "u_scale", "u_flatness"), NAN
)


def pose(euler_deg, shift):
    """A pose (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("xyz", euler_deg, degrees=True).as_matrix()
    out[:3, 3] = shift
    return out


ON_FLANGE = pose([3, -2, 40], [0.03, -0.05, 0.06])
FIXED = {"flange": pose([180, 0, 17], [0.42, -0.1, 0.02]), "fixed": pose([-100, 5, -90], [-0.1, 0.1, 0.5])}


def camera_session(
    mount="flange", images=20, noise=0.2, seed=0, arm=None, scale=1.0, placed=True, velocity=True, validate=0
):
    """A session of `images` full views of a ChArUco board; `arm`: errors of the joints' zeros, rad."""
    rng = np.random.default_rng(seed)
    robot, _ = load_robot("fanuc-lrmate200ic")
    chain, zeros = chain_of(robot), np.zeros(robot.n) if arm is None else np.asarray(arm)
    fixed, board = FIXED[mount], scale * BOARD
    readings, pixels = [], []
    while len(readings) < images:
        q = rng.uniform(robot.limits[:, 0], robot.limits[:, 1], (4000, robot.n))
        reading = (q * np.sign(np.diag(robot.link_from_reading))) @ np.linalg.inv(robot.link_from_reading).T
        angles = link_angles(robot, reading)
        tool = frames(chain, angles + zeros)[:, -1] @ ON_FLANGE
        seen = np.linalg.inv(tool) @ fixed if mount == "flange" else np.linalg.inv(fixed) @ tool
        reading, seen = reading[facing := seen[:, 2, 2] > 0.6], seen[facing]
        at = np.einsum("nij,kj->nki", seen[:, :3, :3], board) + seen[:, None, :3, 3]
        uv = at[..., :2] / at[..., 2:] * FOCAL + CENTRE
        good = (at[..., 2].min(axis=1) > 0.2) & (at[..., 2].max(axis=1) < 1.0)
        good &= np.all((uv > 0) & (uv < SIZE), axis=(1, 2))
        readings += list(reading[good])
        pixels += list(uv[good])
    count = len(BOARD)
    pixel = np.array(pixels[:images]) + noise * rng.standard_normal((images, count, 2))
    rows = np.repeat(np.arange(images), count)
    number = np.tile(np.arange(count), images)
    role = np.where(rows >= images - validate, "validate", "calibrate")
    m = Measurements(
        tuple(f"i{i}c{k}" for i, k in zip(rows, number, strict=True)), role, np.zeros(len(rows), int),
        np.zeros(len(rows), int), np.array(readings[:images])[rows], np.arange(len(rows)) + 2,
        velocity=rng.uniform(-0.3, 0.3, (images, robot.n))[rows] if velocity else None,
        pixel=np.column_stack([pixel.reshape(-1, 2), number]), stop=np.array([f"i{i}" for i in rows]),
    )  # fmt: skip
    values = {"xyz": NAN, "rpy": NAN, "size": SIZE, "fx": FOCAL[0], "fy": FOCAL[1], "cx": CENTRE[0]}
    values |= {"cy": CENTRE[1], **LEFT_OUT}
    tool_at = Tool("on-flange", np.zeros(3))
    if placed:
        values |= {"xyz": fixed[:3, 3] + 2e-3, "rpy": rpy_of(fixed[:3, :3])}
        tool_at = Tool("on-flange", ON_FLANGE[:3, 3] + 1e-3, rpy=rpy_of(ON_FLANGE[:3, :3]))
    target = Target("cam", "camera", values, texts={"mount": mount, "board": "charuco:7x5:30mm:22mm"})
    return Dataset(
        "cam", Path("."), robot, "fanuc-lrmate200ic", "encoder", np.array([0, 0, -9.81]), (tool_at,),
        Noise(pixel=noise), (target,), (), m,
    )  # fmt: skip
