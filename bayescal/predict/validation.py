"""Held-out rows: planes by their contacts, spheres by distance and diameter, points by their reading.

Nothing here is fitted to the arm. A sphere's centre and diameter, an instrument's frame, a socket are
found from their own rows, a posterior draw at a time, with the noise that those rows had: the spread
over draws is the predicted error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.dataset import Certificate
from bayescal.effects.tool import LOOSE
from bayescal.estimate import Estimate
from bayescal.model import ARM, Block, Model
from bayescal.predict.locate import Found, find, robust_rows
from factors.fixed_point import FixedPoint
from factors.instrument import Instrument
from factors.sphere import Sphere


def interval95(predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central 95 % interval of draws (S, ...): lower and upper ends, (...)."""
    low, high = np.quantile(predicted, [0.025, 0.975], axis=0)
    return low, high


def inside95(measured: np.ndarray | float, predicted: np.ndarray) -> np.ndarray:
    """Which measured values (...) lie in the 95 % intervals of draws (S, ...)."""
    low, high = interval95(predicted)
    return (low <= measured) & (measured <= high)


@dataclass(frozen=True)
class PlaneCheck:
    """Held-out contacts of a fitted surface, m."""

    target: str
    residuals: np.ndarray  # (C,) at the estimate
    predicted: np.ndarray  # (S, C) draws of the residual: arm, target and noise


@dataclass(frozen=True)
class DistanceCheck:
    """Distance between two centres found apart, m."""

    between: tuple[str, str]
    certified: float
    u_certified: float
    error: float  # measured by the arm minus certified
    predicted: np.ndarray  # (S,) draws of that error


@dataclass(frozen=True)
class DiameterCheck:
    """Diameter of a sphere, m."""

    target: str
    certified: float
    error: float
    predicted: np.ndarray


@dataclass(frozen=True)
class PointCheck:
    """Held-out points of one target (instrument readings, a socket), m."""

    target: str
    residuals: np.ndarray  # (3, C) at the estimate
    predicted: np.ndarray  # (S, 3, C) draws of the residual


@dataclass(frozen=True)
class TurnCheck:
    """Held-out orientations of the tool, as rotation vectors in its own frame, rad."""

    target: str
    residuals: np.ndarray  # (3, C) at the estimate
    predicted: np.ndarray  # (S, 3, C) draws of the residual


@dataclass(frozen=True)
class Validation:
    """What one model says of all held-out rows."""

    effects: tuple[str, ...]
    planes: tuple[PlaneCheck, ...]
    distances: tuple[DistanceCheck, ...]
    diameters: tuple[DiameterCheck, ...]
    points: tuple[PointCheck, ...]
    turns: tuple[TurnCheck, ...] = ()

    @property
    def worst_distance(self) -> float:
        """Largest absolute error of a distance, m; nan without any."""
        return max((abs(d.error) for d in self.distances), default=float("nan"))


@dataclass(frozen=True)
class _Session:
    estimate: Estimate
    z: np.ndarray  # (S, D)
    kappa: np.ndarray  # (S,)
    excess: float  # m, error of a ball centre that neither noise nor parameters explain
    rng: np.random.Generator

    @property
    def model(self) -> Model:
        return self.estimate.model

    def sigma(self, block: Block) -> np.ndarray:
        """Standard uncertainty (rows, C), m, of a block's residuals at noise scale 1."""
        stated = np.tile(block.sigma, (block.kind.rows, 1))
        joint = self.model.scene.dataset.noise.joint
        if joint > 0:
            values = self.model.deviations(self.estimate.z[self.model.slices[ARM]])
            coupling = self.model.scene.dataset.robot.link_from_reading
            by = block.by_readings(values, np.zeros(block.size), coupling)
            stated = np.sqrt(stated**2 + joint**2 * np.sum(by**2, axis=1).reshape(stated.shape))
        return stated

    def scale(self, group: str) -> np.ndarray:
        """Noise scales (S,) of a group; one that was not fitted is taken as stated."""
        scales = self.estimate.weights.scale
        if group not in scales:
            return np.ones(len(self.kappa))
        main = max(scales, key=lambda g: sum(b.residuals for b in self.model.blocks if b.group == g))
        return self.kappa * scales[group] / scales[main]


def validate(
    estimate: Estimate, z: np.ndarray, kappa: np.ndarray, excess: float = 0.0, seed: int = 0
) -> Validation:
    """Predict every held-out row under a fitted model.

    Parameters
    ----------
    estimate : Estimate
    z : np.ndarray, shape (S, D)
        Posterior draws.
    kappa : np.ndarray, shape (S,)
        Their noise scales.
    excess : float
        Standard deviation of what neither explains (`unexplained`), m a coordinate. It is one shift for
        contacts that lie together on a sphere or in a socket, and another for every point of an
        instrument's volume.
    seed : int
        Of the simulated noise.
    """
    s = _Session(estimate, z, kappa, excess, np.random.default_rng(seed))
    scene = estimate.model.scene
    m = scene.dataset.measurements
    fitted = estimate.model.block_of
    rows = scene.rows("validate")
    stated = {c.targets[0]: c.u_distance for c in scene.dataset.certificates if c.kind == "diameter"}
    surfaces: list[PlaneCheck | PointCheck] = []
    turns: list[TurnCheck] = []
    centres: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    diameters: dict[str, tuple[float, np.ndarray]] = {}
    for t in np.unique(m.target[rows]):
        name, own = scene.dataset.targets[t].name, scene.rows_of(int(t), rows)
        locate = scene.rows_of(int(t), scene.rows("locate"))
        kind = scene.kind(int(t), own)
        posed = _known_turns(s.model, own)
        if name in fitted:
            surfaces.append(_against_fitted(s, estimate.model.block(int(t), own)))
            mine, own_z = fitted[name], estimate.model.slices[name]
            turns += _turns(s, int(t), posed, mine.state(estimate.z[own_z]), mine.state(z[:, own_z]))
        elif isinstance(kind, Sphere):
            at, drawn = _found(s, int(t), own)
            diameters[name] = float(at.x[0, 3]), drawn.x[:, 3]
            if name in stated:  # the centre is sharper where the diameter is certified
                at, drawn = _found(s, int(t), own, stated[name])
            centres[name] = kind.centre + at.x[0, :3], kind.centre + drawn.x[:, :3]
        else:
            at, drawn = _found(s, int(t), locate if len(locate) else own)
            if isinstance(kind, FixedPoint):
                centres[name] = kind.centre + at.x[0], kind.centre + drawn.x
            surfaces.append(_against_found(s, int(t), own, at, drawn))
            turns += _turns(s, int(t), posed, at.x[0], drawn.x)
    return Validation(
        estimate.model.effects,
        tuple(p for p in surfaces if isinstance(p, PlaneCheck)),
        tuple(_distances(s, scene.dataset.certificates, centres)),
        tuple(_diameters(s, stated, diameters)),
        tuple(p for p in surfaces if isinstance(p, PointCheck)),
        tuple(turns),
    )


def _noise(s: _Session, block: Block) -> np.ndarray:
    scale = s.scale(block.group)[:, None, None]
    return scale * s.sigma(block) * s.rng.standard_normal((len(s.z), block.kind.rows, len(block.rows)))


def _against_fitted(s: _Session, block: Block) -> PlaneCheck | PointCheck:
    at = s.estimate.residuals(block)
    drawn = s.estimate.residuals(block, s.z)
    # the residual that a new contact would show at the estimate, were the draw the truth
    predicted = at - drawn + _noise(s, block)
    if block.kind.rows > 1:
        return PointCheck(block.target, at, predicted)
    return PlaneCheck(block.target, at[0], predicted[:, 0])


def _known_turns(model: Model, rows: np.ndarray) -> np.ndarray:
    """Those of rows that read an orientation of a tool whose own on the flange is fitted, or stated."""
    scene, m = model.scene, model.scene.dataset.measurements
    posed = rows[scene.posed[rows]]
    fitted = scene.rows("calibrate")
    known = np.array([tool.rpy is not None and tool.u_angle is not None for tool in scene.dataset.tools])
    known[m.tool[fitted[scene.posed[fitted]]]] = True
    return posed[known[m.tool[posed]]]


def _turns(s: _Session, target: int, rows: np.ndarray, at: np.ndarray, drawn: np.ndarray) -> list[TurnCheck]:
    """Orientations of rows, with the instrument's state at the estimate (size,) and by draw (S, size)."""
    if not len(rows):
        return []
    block, arm = s.model.turned(target, rows), s.model.slices[ARM]
    residual = block.kind.residual(at, block.seen(s.model.deviations(s.estimate.z[arm])))
    by_draw = block.kind.residual(drawn, block.seen(s.model.deviations(s.z[:, arm])))
    return [TurnCheck(block.target, residual, residual - by_draw + _noise(s, block))]


def _unknown_tool(model: Model, rows: np.ndarray) -> float:
    """Prior sd of the centre of the tool that these rows use, m; 0 where it is fitted, known or mixed."""
    scene = model.scene
    used = np.unique(scene.dataset.measurements.tool[rows])
    fitted = scene.dataset.measurements.tool[scene.rows("calibrate")]
    if len(used) != 1 or used[0] in fitted:
        return 0.0
    stated = scene.dataset.tools[used[0]].u
    return LOOSE if stated is None else stated


def _centres_of(
    s: _Session, block: Block, z: np.ndarray, tool_sd: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Ball centres (S, 3, C) by draw, and their slopes (S, 3, 3, C) by an unknown tool's shift."""
    values = s.model.deviations(z[:, s.model.slices[ARM]])
    p = block.motion.points(values)
    if not tool_sd:
        return _with_excess(s, block, p), None
    scene, slopes = s.model.scene, []
    for axis in range(3):  # the point is affine in its place on the flange
        moved = type(block.motion)(
            scene.chain, scene.q[block.rows], scene.tools[block.rows] + np.eye(3)[axis], block.motion.terms,
            block.motion.size,
        )  # fmt: skip
        slopes.append(moved.points(values) - p)
    return _with_excess(s, block, p), np.stack(slopes, axis=1)


def _with_excess(s: _Session, block: Block, p: np.ndarray) -> np.ndarray:
    """Draws of ball centres with the error left unexplained; the estimate itself (S = 1) as it is."""
    if not s.excess or len(p) == 1:
        return p
    spread = p.shape[-1] if isinstance(block.kind, Instrument) else 1
    return p + s.excess * s.rng.standard_normal((len(p), 3, spread))


def _found(
    s: _Session, target: int, rows: np.ndarray, u_diameter: float | None = None
) -> tuple[Found, Found]:
    """A target found from its rows: at the estimate, and by draw with the rows' noise.

    `u_diameter` is the standard uncertainty of a sphere's nominal diameter, m; None leaves it loose.
    """
    block = s.model.block(target, rows)
    if u_diameter is not None and isinstance(block.kind, Sphere):
        block = replace(block, kind=replace(block.kind, sd=np.append(block.kind.sd[:3], u_diameter)))
    sigma, tool_sd = s.sigma(block), _unknown_tool(s.model, rows)
    p0, slopes0 = _centres_of(s, block, s.estimate.z[None], tool_sd)
    p, slopes = _centres_of(s, block, s.z, tool_sd)
    scale = s.estimate.weights.scale.get(block.group, 1.0)
    values = s.model.deviations(s.estimate.z[s.model.slices[ARM]])
    kind, noise = block.touched(values), _noise(s, block)
    if len(block.contact_index):  # a draw's own lobing or ball, beside the estimate's
        drawn_values = s.model.deviations(s.z[:, s.model.slices[ARM]])
        noise = noise - (block.at_contact(drawn_values) - block.at_contact(values))[:, None, :]
    keep = robust_rows(kind, p0[0], scale * sigma, slopes0, tool_sd)
    at = find(kind, p0, keep / (scale * sigma), None, slopes0, tool_sd)
    drawn = find(kind, p, keep / (scale * sigma), noise, slopes, tool_sd)
    return at, drawn


def _against_found(
    s: _Session, target: int, rows: np.ndarray, at: Found, drawn: Found
) -> PlaneCheck | PointCheck:
    block = s.model.block(target, rows)
    tool_sd = _unknown_tool(s.model, rows)
    p0, slopes0 = _centres_of(s, block, s.estimate.z[None], tool_sd)
    p, slopes = _centres_of(s, block, s.z, tool_sd)
    if slopes0 is not None and slopes is not None:
        p0 = p0 + np.einsum("sj,sjkc->skc", at.tool, slopes0)
        p = p + np.einsum("sj,sjkc->skc", drawn.tool, slopes)
    residual = block.kind.residual(at.x, p0)[0]
    predicted = residual - block.kind.residual(drawn.x, p) + _noise(s, block)
    if block.kind.rows == 1:
        return PlaneCheck(block.target, residual[0], predicted[:, 0])
    return PointCheck(block.target, residual, predicted)


def _distances(
    s: _Session, certificates: tuple[Certificate, ...], centres: dict[str, tuple[np.ndarray, np.ndarray]]
) -> list[DistanceCheck]:
    out = []
    for c in certificates:
        if c.kind != "distance" or any(name not in centres for name in c.targets):
            continue
        (a0, a), (b0, b) = (centres[name] for name in c.targets)
        measured = float(np.linalg.norm(a0 - b0))
        drawn = np.linalg.norm(a - b, axis=1)
        assert c.distance is not None
        u = c.u_distance or 0.0
        predicted = measured - drawn + u * s.rng.standard_normal(len(drawn))
        out.append(
            DistanceCheck((c.targets[0], c.targets[1]), c.distance, u, measured - c.distance, predicted)
        )
    return out


def _diameters(
    s: _Session, stated: dict[str, float | None], diameters: dict[str, tuple[float, np.ndarray]]
) -> list[DiameterCheck]:
    nominal = {t.name: t.values.get("diameter") for t in s.model.scene.dataset.targets}
    out = []
    for name, (at, drawn) in diameters.items():
        predicted = at - drawn + (stated.get(name) or 0.0) * s.rng.standard_normal(len(drawn))
        out.append(DiameterCheck(name, float(nominal[name] or np.nan), at, predicted))
    return out
