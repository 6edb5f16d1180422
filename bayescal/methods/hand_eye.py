"""Hand-eye calibration by the classical solvers of OpenCV, where it is installed: the arm stays nominal.

Tsai and Lenz (1989), Park and Martin (1994), Horaud and Dornaika (1995), Andreff et al. (1999) and Daniilidis
(1999), as `cv2.calibrateHandEye` has them. Poses of the board in the images are those of the closed form.
"""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec

import numpy as np

from bayescal.arm.hand_eye import inverse, product
from bayescal.dataset.cameras import FLANGE, closed_form
from bayescal.methods.published import Method
from bayescal.methods.solving import Solution
from bayescal.model import Model, build
from bayescal.model.scene import Scene
from factors.camera import Camera
from factors.turns import rotation_vector

SOLVERS = {
    "TSAI": "Tsai and Lenz",
    "PARK": "Park and Martin",
    "HORAUD": "Horaud and Dornaika",
    "ANDREFF": "Andreff et al.",
    "DANIILIDIS": "Daniilidis",
}
"""Solvers of OpenCV and their authors."""


def poses(scene: Scene, target: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses (I, 3, 4) of the flange in F0 and of the board in the camera; a row (I,) of each image."""
    rows = scene.rows_of(target, scene.rows("calibrate"))
    readings = scene.dataset.measurements.readings
    seen, good, _ = closed_form(scene.dataset, target, rows, readings)
    first = seen.first[good]
    at = scene.points[first] - (scene.flange[first] @ scene.tools[first][..., None])[..., 0]
    return np.concatenate([scene.flange[first], at[..., None]], axis=2), seen.poses[good], first


def on_flange(scene: Scene, target: int, solver: str) -> np.ndarray:
    """Pose (3, 4) on the flange of the camera, or of the board of a fixed camera, by a solver of OpenCV."""
    import cv2

    flange, board, _ = poses(scene, target)
    carried = scene.dataset.targets[target].texts["mount"] == FLANGE
    given = flange if carried else inverse(flange)
    method = getattr(cv2, f"CALIB_HAND_EYE_{solver}")
    turns, shifts = list(given[:, :, :3]), list(given[:, :, 3])
    turn, shift = cv2.calibrateHandEye(
        turns, shifts, list(board[:, :, :3]), list(board[:, :, 3]), method=method
    )
    found = np.column_stack([turn, np.ravel(shift)])
    if carried:
        return found
    # a fixed camera: the board on the flange, as the median image has it
    every = product(inverse(flange), product(found, board))
    middle = np.median(every[:, :, 3], axis=0)
    return np.asarray(every[np.argmin(np.linalg.norm(every[:, :, 3] - middle, axis=1))])


def _solve(scene: Scene, effects: tuple[str, ...], solver: str) -> Solution:
    """The nominal arm with the tool where a solver puts it."""
    model = build(scene, effects)
    values, named = np.zeros(len(model.parameters)), {p.name: k for k, p in enumerate(model.parameters)}
    for block in model.states:
        if not isinstance(block.kind, Camera):
            continue
        target = scene.index[block.target]
        found, m = on_flange(scene, target, solver), scene.dataset.measurements
        tool = scene.dataset.tools[int(m.tool[block.rows[0]])]
        turn = rotation_vector(scene.tool_frames[block.rows[0]].T @ found[:, :3])
        off = zip(("x", "y", "z", "rx", "ry", "rz"), (*(found[:, 3] - tool.centre), *turn), strict=True)
        for axis, value in off:
            if (name := f"{tool.name} {axis}") in named:
                values[named[name]] = value
    held = tuple(p.name for p, v in zip(model.parameters, values, strict=True) if v == 0.0)
    return Solution(model, values, held, settled=True)


def _missing(model: Model) -> str:
    """What a session lacks for these solvers."""
    if not any(isinstance(b.kind, Camera) for b in model.blocks):
        return "no target is a camera"
    return "" if find_spec("cv2") else "OpenCV is not installed: pip install 'bayescal[camera]'"


METHODS = tuple(
    Method(
        f"hand-eye {solver.capitalize()}",
        authors,
        "hand-eye transform in closed form by OpenCV; the arm stays nominal",
        _missing,
        solver=partial(_solve, solver=solver),
    )
    for solver, authors in SOLVERS.items()
)
