"""Hand-eye transforms of cameras with covariances, for easy_handeye2, ROS and OpenCV.

Of every camera: where it is (on the flange, or in F0), and where the board is. A covariance (6, 6) is of the
rotation vector (rad) and the origin (m) of a frame, for a small turn of the frame about its own axes and a
shift in the frame that it is given in.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.motion import TURN
from bayescal.arm.transforms import rigid
from bayescal.dataset.cameras import FLANGE, board, carried, lens_of
from bayescal.effects.geometry import TOOL
from bayescal.errors import BayescalError
from bayescal.exporting.geometry import STATE
from bayescal.exporting.written import Format, Options, Written, item
from bayescal.exporting.xml_text import rendered
from bayescal.fitted.arm import FittedArm
from bayescal.storage.writing import scalar
from factors.camera import NAMES, Camera
from factors.kind import left_jacobian, turned

TURNS_SHIFTS = ("rx", "ry", "rz", "tx", "ty", "tz")
BASE, END = "base_link", "tool0"
"""Frames of ROS: the arm's F0 and its flange. Camera and board have the names of target and tool."""


@dataclass(frozen=True)
class Transform:
    """Pose (4, 4) of the frame `child` in `parent`, and its covariance (6, 6), turn and shift."""

    parent: str
    child: str
    pose: np.ndarray
    covariance: np.ndarray

    @property
    def quaternion(self) -> np.ndarray:
        """x, y, z, w."""
        return np.asarray(Rotation.from_matrix(self.pose[:3, :3]).as_quat())


@dataclass(frozen=True)
class HandEye:
    """One camera: what is on the flange, and what is fixed in F0."""

    target: str
    tool: str
    mount: str
    on_flange: Transform
    fixed: Transform


def hand_eyes(arm: FittedArm, state: int = -1) -> list[HandEye]:
    """The transforms of every fitted camera of a session, one for each tool that it has.

    What shifted during the session is where it is in the row `state`, by default the last one.
    """
    model, m = arm.model, arm.dataset.measurements
    state = state % len(m.ids)
    out = []
    for block in model.states:
        if not isinstance(block.kind, Camera):
            continue
        t = arm.dataset.targets[model.scene.index[block.target]]
        camera, seen = f"{t.name}_camera", f"{t.name}_board"
        for k in np.unique(m.tool[block.rows]).tolist():
            tool = arm.dataset.tools[k]
            names = (camera, seen) if carried(t) else (seen, camera)
            held, fixed = _on_flange(arm, k, names[0], state), _fixed(arm, block.target, names[1], state)
            out.append(HandEye(t.name, tool.name, t.texts["mount"], held, fixed))
    return out


def _shifts(arm: FittedArm, row: int, where: tuple[int, ...], steady: bool) -> np.ndarray:
    """Turns and shifts (6, P) of frames by the parameters in a row; `steady`: also what never changes."""
    by, count = np.zeros((6, len(arm.values))), len(arm.model.scene.q)
    for k, p in enumerate(arm.model.parameters):
        if p.driver.kind in STATE or (steady and p.effect == TOOL.name):
            for t in (t for t in p.terms if t.frame in where):
                by[TURNS_SHIFTS.index(t.axis), k] += float(np.broadcast_to(t.driver, count)[row])
    return by


def _on_flange(arm: FittedArm, tool: int, child: str, state: int) -> Transform:
    """The tool on the flange: its parameters are those of the arm."""
    of = arm.dataset.tools[tool]
    rows = np.flatnonzero(arm.dataset.measurements.tool == tool)
    row = int(rows[max(int(np.searchsorted(rows, state, "right")) - 1, 0)])
    by = _shifts(arm, row, (arm.model.scene.chain.n + 1, TURN), steady=True)
    values = by @ arm.values
    axes = arm.model.scene.tool_frames[row] @ turned(values[:3])
    by[:3] = left_jacobian(-values[:3]) @ by[:3]
    return Transform(END, child, rigid(axes, of.centre + values[3:]), by @ arm.covariance @ by.T)


def _fixed(arm: FittedArm, target: str, child: str, state_row: int) -> Transform:
    """What is fixed, in the base as it stands in a row, with the uncertainty of the arm and of the images."""
    block = arm.model.block_of[target]
    state = arm.states[target]
    frame = np.asarray(block.kind.describe(state)["frame"])
    z = (state / np.where(block.kind.sd > 0, block.kind.sd, 1.0))[block.free]
    _, by_arm, by_own = block.linearise(arm.values, z)
    kept = ~np.isin(np.array(arm.dataset.measurements.ids)[block.rows], arm.rejected)
    weight = np.tile(kept / arm.beyond.noise_of(block) ** 2, block.kind.rows)
    covariance = np.linalg.inv(by_own.T @ (by_own * weight[:, None]) + np.eye(block.size))
    by = -covariance @ by_own.T @ (by_arm * weight[:, None])
    spread = np.zeros((len(state), block.size))
    spread[block.free] = np.diag(block.sd)
    # from a turn about the pivot in F0 to one about the frame's own axes, and to a shift of its origin
    pose = block.kind.feature(state)  # type: ignore[attr-defined]
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = frame[:3, :3].T @ left_jacobian(state[:3])
    jacobian[3:] = pose.by_place.T
    # a shift of the base moves what is fixed to the other side
    base = _shifts(arm, state_row, (0,), steady=False)
    shift = base @ arm.values
    back = np.linalg.inv(rigid(turned(shift[:3]), shift[3:]))
    lever = np.cross(np.eye(3), frame[:3, 3])  # of a turn of the base, on the origin
    by_base = np.vstack([-frame[:3, :3].T @ base[:3], -base[3:] - lever.T @ base[:3]])
    by_base[3:] = back[:3, :3] @ by_base[3:]
    jacobian[3:] = back[:3, :3] @ jacobian[3:]
    by = jacobian @ spread @ by + by_base
    covariance = jacobian @ spread @ covariance @ spread.T @ jacobian.T
    return Transform(BASE, child, back @ frame, covariance + by @ arm.covariance @ by.T)


def _write(arm: FittedArm, options: Options) -> Written:
    solutions = hand_eyes(arm, options.state)
    if not solutions:
        remedy = "fit a session that has a target of kind camera"
        raise BayescalError("the session has no camera", "--to hand-eye", remedy)
    places = {f"{h.tool} {axis}": h for h in solutions for axis in ("x", "y", "z", "rx", "ry", "rz")}
    placed = ((k, places[p.name]) for k, p in enumerate(arm.model.parameters) if p.name in places)
    items = [item(arm, k, h.on_flange.child, "on the flange") for k, h in placed]
    beside = {".launch.py": _launch(solutions), ".opencv.json": _opencv(arm, solutions)}
    notes = [f"frames of ROS: {BASE} is F0, {END} is the flange; rename them where yours differ"]
    if len(solutions) > 1:
        others = ", ".join(h.target for h in solutions[1:])
        notes.append(f"the YAML file has {solutions[0].target} alone, the others all; not in it: {others}")
    details = {"hand_eye": [_record(h, _matrices) for h in solutions]}
    return Written(_easy_handeye(solutions[0]), items, beside, notes, details)


def _record(h: HandEye, entry: Callable[[Transform], dict[str, object]]) -> dict[str, object]:
    names = {"target": h.target, "tool": h.tool, "mount": h.mount}
    return names | {"on_flange": entry(h.on_flange), "fixed": entry(h.fixed)}


def _matrices(t: Transform) -> dict[str, object]:
    matrices = {"matrix": t.pose.tolist(), "covariance": t.covariance.tolist()}
    return {"parent": t.parent, "child": t.child, **matrices}


def hand_eye_records(arm: FittedArm) -> list[dict[str, object]]:
    """The transforms of every camera as entries of files: mm, quaternion x, y, z, w, u in mm and deg.

    Their u are of the axes of the parent (of shifts), and of turns about the frame's own axes.
    """
    return [_record(h, _entry) for h in hand_eyes(arm)]


def _entry(t: Transform) -> dict[str, object]:
    u = np.sqrt(np.diag(t.covariance))
    return {
        "parent": t.parent,
        "child": t.child,
        "translation_mm": (1e3 * t.pose[:3, 3]).tolist(),
        "quaternion_xyzw": t.quaternion.tolist(),
        "u_translation_mm": (1e3 * u[3:]).tolist(),
        "u_rotation_deg": np.degrees(u[:3]).tolist(),
    }


def _easy_handeye(h: HandEye) -> str:
    """A calibration as easy_handeye2 stores it; of several cameras the first."""
    t, seen = (h.on_flange, h.fixed) if h.mount == FLANGE else (h.fixed, h.on_flange)
    u = np.sqrt(np.diag(t.covariance))
    return rendered(
        "hand_eye.yaml.j2", name=scalar(h.target), in_hand=h.mount == FLANGE, base=BASE, end=END,
        tracked=scalar(t.child), seen=scalar(seen.child), shift=t.pose[:3, 3].tolist(),
        turn=t.quaternion.tolist(), u_shift=1e3 * np.max(u[3:]), u_turn=np.degrees(np.max(u[:3])),
    )  # fmt: skip


def _launch(solutions: list[HandEye]) -> str:
    """Static transforms of all cameras and boards, as a launch file of ROS 2."""
    nodes = []
    for t in (t for h in solutions for t in (h.on_flange, h.fixed)):
        values = [*t.pose[:3, 3].tolist(), *t.quaternion.tolist()]
        options = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), map(repr, values), strict=True))
        options |= {"frame-id": t.parent, "child-frame-id": t.child}
        # the name of a target is any text: a launch file is a program
        nodes.append([repr(text) for name, value in options.items() for text in (f"--{name}", value)])
    return rendered("hand_eye.launch.py.j2", nodes=nodes)


def _opencv(arm: FittedArm, solutions: list[HandEye]) -> str:
    """Matrices as of cv2.calibrateRobotWorldHandEye and cv2.calibrateCamera, with covariances, as JSON."""
    cameras = []
    for h in solutions:
        t = arm.dataset.targets[arm.model.scene.index[h.target]]
        lens, fitted = lens_of(t), {p.name: arm.values[k] for k, p in enumerate(arm.model.parameters)}

        def value(name: str, stated: float, h: HandEye = h, fitted: dict[str, float] = fitted) -> float:
            return float(stated + sum(fitted.get(f"{e}{h.target} {name}", 0.0) for e in ("", *EXTRA)))

        fx, fy = (value(f"f{a}", f) for a, f in zip("xy", lens.focal, strict=True))
        cx, cy = (value(f"c{a}", c) for a, c in zip("xy", lens.centre, strict=True))
        coefficients = [value(n, c) for n, c in zip(NAMES[lens.model], lens.coefficients, strict=True)]
        matrix = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
        of_lens = {"camera_matrix": matrix, "distortion": coefficients, "lens": lens.model}
        cameras.append(_record(h, _matrices) | of_lens | {"board_points_m": board(t).points.tolist()})
    note = "covariance: rotation vector about the frame's own axes (rad), then origin in the parent (m)"
    return json.dumps({"note": note, "cameras": cameras}, indent=1) + "\n"


EXTRA = ("focal-length ", "image-centre ", "lens-distortion ")
"""Beginnings of names of errors beyond the stated uncertainty that a diagnosis may have named."""


def _holds(arm: FittedArm, k: int) -> bool:
    """Whether a parameter is in the file: all that are of no robot file, and shifts of what they place."""
    p, ends = arm.model.parameters[k], (0, arm.model.scene.chain.n + 1)
    shifted = p.driver.kind in STATE and all(t.frame in ends for t in p.terms)
    return shifted or any(t.frame < 0 for t in p.terms)


LIMITS = "a hand-eye transform holds nothing of the arm itself"
HAND_EYE = Format(".yaml", _write, _holds, LIMITS, prismatic=True)
"""Where cameras and boards are, for programs that take the arm as nominal or as calibrated: with covariance
for easy_handeye2, as ROS static transforms, for OpenCV."""
