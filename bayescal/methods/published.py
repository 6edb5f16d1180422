"""Methods of the survey, and bayescal's own: the rows that each uses, and what a session lacks for it.

A session goes in, corrected parameters of the arm come out.

- known planes (Besnard; Hage): the faces were measured beforehand to one another, where the arm stands before
  them is unknown: six numbers of the base, found with the arm.
- linear steps (Joubair and Bonev): the text of the article was not available; this is the iteration as
  generally known. Distances to planes that are fitted anew at every step, linear in the arm's parameters,
  columns scaled, no priors. What QR finds redundant (the base against the planes, d of parallel axes) stays
  nominal. The size of the arm comes from certified distances.
- inverse: joints as they would have to be for the arm to be where it was, against readings. A row says where
  the tool is: a point for an instrument or a socket, an orientation beside it for a pose, one direction for a
  surface. The joint change that would bring the nominal arm there is that of least length,
  dq = J' (J J')^-1 r with J the row's gradients by the readings: the first step of inverse kinematics. Its
  squares are summed, so a millimetre counts more where the joints must turn further for it.
- open loop: an instrument reads the tool, and the arm is fitted to its readings.
- bayescal: the estimate of `bayescal fit`, with the form of uneven faces.

Hand-eye calibration by the classical solvers of OpenCV, where it is installed: the arm stays nominal.

Tsai and Lenz (1989), Park and Martin (1994), Horaud and Dornaika (1995), Andreff et al. (1999) and Daniilidis
(1999), as `cv2.calibrateHandEye` has them. Poses of the board in the images are those of the closed form.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec

import numpy as np

from bayescal.arm.hand_eye import inverse, product
from bayescal.assess.shared_causes import completed
from bayescal.dataset.cameras import carried, closed_form
from bayescal.dataset.contacts import connected
from bayescal.effects import parameters_of
from bayescal.estimate import calibrated
from bayescal.estimate.bounds import bounded
from bayescal.estimate.widths import with_widths
from bayescal.methods.solving import Rows, RowsOf, Solution, System, contacts, levenberg, linear_steps, part
from bayescal.model import ARM, Block, Model, build, standing, with_parameters
from bayescal.model.model import KNOWN_PLACE
from bayescal.model.options import USUAL
from bayescal.model.scene import Scene
from factors.camera import Camera
from factors.contacts import Plane
from factors.kind import rotation_vector


@dataclass(frozen=True)
class Method:
    """A way to calibrate: some blocks of the model, their rows, and how these are solved.

    Attributes
    ----------
    name, source, idea : str
        Whose idea it is, and the idea in a line.
    missing : callable
        What a model of a session lacks for it, or "".
    uses : callable
        Whether a block's rows are used.
    rows : callable
        For a model, the equations of a block's rows.
    search : callable
        Solves the system of these equations.
    solver : callable, optional
        Fits a scene with some effects in another way, in place of `rows` and `search`.
    """

    name: str
    source: str
    idea: str
    missing: Callable[[Model], str] = lambda model: ""
    uses: Callable[[Block], bool] = lambda block: True
    rows: Callable[[Model], RowsOf] = lambda model: contacts
    search: Callable[[System], Solution] = levenberg
    solver: Callable[[Scene, tuple[str, ...]], Solution] | None = None

    def solve(self, scene: Scene, effects: tuple[str, ...]) -> Solution:
        """Fit a scene, and again with the gravity moments at the fitted poses: see `calibrated`."""
        solver = self.solver or self._solved
        first = solver(scene, effects)
        if first.settled or scene.moments is None or not effects:
            return first
        return solver(standing(first.model, first.values), effects)

    def _solved(self, scene: Scene, effects: tuple[str, ...]) -> Solution:
        model = part(build(scene, effects), self.uses)
        return self.search(System(model, self.rows(model)))


def nominal(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """The nominal arm."""
    model = build(scene, effects)
    names = tuple(p.name for p in model.parameters)
    return Solution(model, np.zeros(len(names)), names, settled=True)


NOMINAL = Method("nominal", "", "the robot file without calibration", solver=nominal)


NO_LENGTH = "no length is certified: without priors the scale of the arm is not identifiable"
FEWEST = 3


def is_plane(block: Block) -> bool:
    """Whether a block touches a face."""
    return isinstance(block.kind, Plane)


def lacks_known_planes(model: Model) -> str:
    """What a session lacks for known planes."""
    faces = part(model, is_plane)
    names = {block.target for block in faces.blocks}
    if len(names) < FEWEST:
        return f"{len(names) or 'no'} planes are probed; at least {FEWEST} are needed"
    stated = {t.name for t in model.scene.dataset.targets if t.u is not None and t.u <= KNOWN_PLACE}
    pairs = [c.targets for c in faces.constraints if len(c.targets) == 2]
    if names <= stated or len(connected(names, pairs)) == 1:
        return ""
    return "the relative positions of the planes are not stated (u_mm, or certificates between them)"


def known_planes(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """Fit the arm and its base to the planes as stated; where nothing ties the base, the planes moved."""
    circumstances = replace(scene.circumstances(scene.rows("calibrate")), tied_base=True)
    model = with_parameters(scene, effects, parameters_of(effects, circumstances))
    tied = levenberg(System(part(model, is_plane), fixed=True))
    plain = build(scene, effects)
    values = {p.name: value for p, value in zip(model.parameters, tied.values, strict=True)}
    names = [p.name for p in plain.parameters]
    held = tuple(name for name in tied.held if name in names)
    return Solution(plain, np.array([values[name] for name in names]), held, tied.condition)


def touches(block: Block) -> bool:
    """Whether a block's rows are constraints, not an instrument's readings."""
    return block.group == "contact"


def is_read(block: Block) -> bool:
    """Whether an instrument reads a block's rows."""
    return not touches(block)


def lacks_constraints(model: Model) -> str:
    """What a session lacks for constraints with unknown targets."""
    touched = part(model, touches)
    if not touched.blocks:
        return "no contacts: all rows are measured by an instrument"
    return "" if touched.knows_length else NO_LENGTH


SINGULAR = 0.03
"""Least share of the largest singular value of a row's J that a direction counts with near singular poses."""


def joint_change(block: Block, coupling: np.ndarray) -> np.ndarray:
    """Factors (C, rows, rows), rad/m, that turn a row's residuals into ones as long as its joint change."""
    still = np.zeros(block.motion.size), np.zeros(block.size)
    gradients = block.by_readings(*still, coupling)
    slopes = gradients.reshape(block.kind.rows, len(block.rows), -1).swapaxes(0, 1)
    u, size, _ = np.linalg.svd(slopes, full_matrices=False)
    reach = np.maximum(size, SINGULAR * size[:, :1])
    return u / reach[:, None, :] @ u.swapaxes(1, 2)


def in_joints(model: Model) -> RowsOf:
    """Rows in joint space, over the stated noise of a block at its median reach."""
    coupling = model.scene.dataset.robot.link_from_reading
    factors = {block.name: joint_change(block, coupling) for block in model.blocks}

    def rows(block: Block, values: np.ndarray, z: np.ndarray) -> Rows:
        factor = factors[block.name]
        usual = np.median(np.trace(factor, axis1=1, axis2=2)) / block.kind.rows
        factor = factor / (usual * block.sigma[:, None, None])

        def turned(columns: np.ndarray) -> np.ndarray:
            by_row = columns.reshape(block.kind.rows, len(block.rows), -1)
            return np.einsum("cij,jck->ick", factor, by_row).reshape(columns.shape)

        r, by_arm, by_target = block.linearise(values, z)
        return turned(r), turned(by_arm), turned(by_target)

    return rows


def estimated(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """The estimate of `bayescal fit`: prior widths that the data tell, form of uneven faces, bounds."""
    level = with_widths(calibrated(scene, effects), scene, effects, USUAL)[0]
    level = bounded(completed(level).fitted)[0]
    values = level.model.deviations(level.z[level.model.slices[ARM]])
    return Solution(level.model, values, estimate=level, settled=True)


PLANES = Method(
    "known planes",
    "Besnard et al.; Hage et al.",
    "contacts lie on faces at stated positions; non-linear least squares of the arm and its base",
    lacks_known_planes,
    solver=known_planes,
)
LINEAR = Method(
    "linear steps",
    "Joubair and Bonev",
    "distances to planes, fitted again at each linear step; scaled columns; redundant parameters nominal",
    lacks_constraints,
    touches,
    search=linear_steps,
)
INVERSE = Method(
    "inverse",
    "joint residuals at known poses",
    "least squares of the joint corrections that reproduce the measured poses, along the measured directions",
    lambda model: "" if model.knows_length else NO_LENGTH,
    rows=in_joints,
)
OPEN_LOOP = Method(
    "open loop",
    "Mooring, Roth and Driels",
    "non-linear least squares of instrument readings with unknown frame; contacts are not used",
    lambda model: "" if part(model, is_read).blocks else "no calibration row is measured by an instrument",
    is_read,
)
OURS = Method(
    "bayescal",
    "",
    "maximum a posteriori with tolerance priors and certificates, without outliers; predicts uncertainties",
    solver=estimated,
)


SOLVERS = {
    "TSAI": "Tsai and Lenz",
    "PARK": "Park and Martin",
    "HORAUD": "Horaud and Dornaika",
    "ANDREFF": "Andreff et al.",
    "DANIILIDIS": "Daniilidis",
}
"""Solvers of OpenCV and their authors."""


def poses(scene: Scene, target: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses (I, 3, 4) of the flange in F0 and of the board in the camera."""
    rows = scene.rows_of(target, scene.rows("calibrate"))
    readings = scene.dataset.measurements.readings
    seen, good, _ = closed_form(scene.dataset, target, rows, readings)
    first = seen.first[good]
    origins = scene.points[first] - (scene.flange[first] @ scene.tools[first][..., None])[..., 0]
    return np.concatenate([scene.flange[first], origins[..., None]], axis=2), seen.poses[good]


def on_flange(scene: Scene, target: int, solver: str) -> np.ndarray:
    """Pose (3, 4) on the flange of the camera, or of the board of a fixed camera, by a solver of OpenCV."""
    import cv2

    flange, board = poses(scene, target)
    camera_moves = carried(scene.dataset.targets[target])
    given = flange if camera_moves else inverse(flange)
    method = getattr(cv2, f"CALIB_HAND_EYE_{solver}")
    turns, shifts = list(given[:, :, :3]), list(given[:, :, 3])
    turn, shift = cv2.calibrateHandEye(
        turns, shifts, list(board[:, :, :3]), list(board[:, :, 3]), method=method
    )
    pose = np.column_stack([turn, np.ravel(shift)])
    if camera_moves:
        return pose
    # a fixed camera: the board on the flange, as the median image has it
    every = product(inverse(flange), product(pose, board))
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
        pose, m = on_flange(scene, target, solver), scene.dataset.measurements
        tool = scene.dataset.tools[int(m.tool[block.rows[0]])]
        turn = rotation_vector(scene.tool_frames[block.rows[0]].T @ pose[:, :3])
        off = zip(("x", "y", "z", "rx", "ry", "rz"), (*(pose[:, 3] - tool.centre), *turn), strict=True)
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


CAMERA_METHODS = tuple(
    Method(
        f"hand-eye {solver.capitalize()}",
        authors,
        "hand-eye transform in closed form by OpenCV; the arm stays nominal",
        _missing,
        solver=partial(_solve, solver=solver),
    )
    for solver, authors in SOLVERS.items()
)
