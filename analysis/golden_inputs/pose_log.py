"""Write a log of 60 poses that a simulated tracker read: ``python pose_log.py RUN LOG``; seeded."""

import csv
import sys

import numpy as np

import bayescal as bc

run, log = sys.argv[1:]
result = bc.load(run)
rng = np.random.default_rng(5)
readings = rng.uniform(-1, 1, (60, len(result.record["arm"]["joints"])))
poses = result.position(readings, tool="reflector").poses
points = 1e3 * poses[:, :3, 3] + rng.normal(0, 0.02, (60, 3))
yaw, pitch = np.arctan2(poses[:, 1, 0], poses[:, 0, 0]), -np.arcsin(poses[:, 2, 0])
roll = np.arctan2(poses[:, 2, 1], poses[:, 2, 2])
angles = np.degrees(np.column_stack([roll, pitch, yaw])) + rng.normal(0, 0.005, (60, 3))
with open(log, "w", newline="", encoding="utf-8") as file:
    out = csv.writer(file)
    out.writerow(["Point", *(f"A{j + 1}" for j in range(readings.shape[1])), "X", "Y", "Z", "RX", "RY", "RZ"])
    for i, row in enumerate(np.column_stack([np.degrees(readings), points, angles])):
        out.writerow([f"P{i}", *(f"{v:.6f}" for v in row)])
