"""Motion: the arm at a set of rows, as a function of parameters that displace its frames.

The nominal arm with its tool: poses, slopes by the joints, and the limits of the joints.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bayescal.arm.chain import Chain, Robot, chain_of, frames, link_angles
from bayescal.arm.transforms import AXES, cross

CONTACT = -1
"""The frame of a term that moves the ball along the direction of its contact, not the arm."""
CERTIFICATE = -2
"""The frame of a term that moves nothing, but shifts what a certificate states."""
TURN = -3
"""The frame of a term that turns the tool about its own point, so that only its orientation tells."""
IMAGE = -4
"""The frame of a term that moves a point in an image, along its axis u or v; drivers are lengths, m."""


@dataclass(frozen=True)
class Term:
    """Displacement of one axis of one frame by parameter x driver.

    `frame` counts 0 (base), 1 to n, n + 1 (tool), or is `CONTACT`, `CERTIFICATE`, `TURN` or `IMAGE`; `axis`
    is one of `transforms.AXES`, "normal" at the contact, "u" or "v", or the number of a certificate; `driver`
    is a number or one value a row, (N,): of a certificate one value for each that it states.
    """

    frame: int
    axis: str
    driver: np.ndarray | float = 1.0


Numbered = tuple[int, Term]
"""Index of a parameter, and a term of it."""


def _padded(rows: np.ndarray) -> np.ndarray:
    """Rows (R, C) padded with the last column to a multiple of the kernel's width."""
    from bayescal.arm import kernel  # compiled: whoever only reads about effects need not load it

    count = rows.shape[1]
    width = -(-max(count, 1) // kernel.WIDTH) * kernel.WIDTH
    out = np.zeros((rows.shape[0], width))
    out[:, :count] = rows
    if count:
        out[:, count:] = rows[:, -1:]
    return out


@dataclass(frozen=True)
class Terms:
    """The T terms of several parameters that move frames, with each of their K drivers once.

    Prepared once for motions of any rows.
    """

    sites: np.ndarray  # (T,) 6 x frame + axis
    parameters: np.ndarray  # (T,)
    index: np.ndarray  # (T,) its driver
    drivers: tuple[np.ndarray | float, ...]  # (K,) numbers, or one value per row, (N,)

    @classmethod
    def of(cls, terms: Iterable[Numbered]) -> Terms:
        """Of parameter indices and terms; those that are not of a frame, or always zero, are left out."""
        table, row_of = list[tuple[int, int, int]](), dict[bytes, int]()
        drivers = list[np.ndarray | float]()
        for parameter, term in terms:
            if term.frame < 0 or (isinstance(term.driver, float) and not term.driver):
                continue
            key = np.asarray(term.driver, float).tobytes()
            if key not in row_of:
                row_of[key] = len(drivers)
                drivers.append(term.driver)
            table.append((6 * term.frame + AXES.index(term.axis), parameter, row_of[key]))
        sites, parameters, index = np.array(table, np.int64).reshape(-1, 3).T
        return cls(sites, parameters, index, tuple(drivers))

    def at_rows(self, rows: np.ndarray) -> Terms:
        """The terms in some of the rows."""
        drivers = (d if np.ndim(d) == 0 else np.asarray(d)[rows] for d in self.drivers)
        return replace(self, drivers=tuple(drivers))


def _sorted(table: np.ndarray) -> np.ndarray:
    """Rows of a table (R, 3) in order of their first value, then of the second, then of the third."""
    return np.ascontiguousarray(table[np.lexsort(table.T[::-1])])


class Motion:
    """Ball centres of C rows and their derivatives, for P parameters (the kernel's prepared input).

    Parameters
    ----------
    chain : Chain
    q : np.ndarray, shape (C, n)
        Nominal link angles, rad; shifts of prismatic joints, m.
    tool : np.ndarray, shape (C, 3)
        Nominal ball centres in the flange frame, m.
    terms : Terms, or sequence of (int, Term)
        Parameter index and term; drivers are numbers or of shape (C,). Those at the contact, of a
        certificate or of the tool's own turn move no frame and are left to the residual.
    size : int
        Number P of parameters.
    """

    def __init__(
        self, chain: Chain, q: np.ndarray, tool: np.ndarray, terms: Terms | Sequence[Numbered], size: int
    ) -> None:
        self.chain, self.q, self.tool, self.size = chain, q, tool, size
        self.count, self._slides = len(q), bool(chain.slides.any())
        n, of = chain.n, terms if isinstance(terms, Terms) else Terms.of(terms)
        drivers = np.empty((len(of.drivers), self.count))
        for row, driver in zip(drivers, of.drivers, strict=True):
            row[:] = driver
        one = np.all(drivers == 1.0, axis=1)[of.index]
        varies = np.any(drivers, axis=1)[of.index] & ~one
        used, driver = np.unique(of.index[varies], return_inverse=True)
        constant = np.column_stack([of.sites, of.parameters])[one]
        varying = _sorted(np.column_stack([of.sites[varies], of.parameters[varies], driver]))
        every = _sorted(np.concatenate([varying, np.insert(constant, 2, len(used), axis=1)]))
        used_drivers = [drivers[used], np.ones((1, self.count))]
        if len(slides := np.flatnonzero(chain.slides)):  # one parameter more, which is 1, shifts these by q
            number = len(used) + 1 + np.arange(len(slides))
            along = np.column_stack([6 * (slides + 1) + AXES.index("tz"), np.full(len(slides), size), number])
            varying = _sorted(np.concatenate([varying, along]))
            used_drivers.append(q.T[slides])
        sites = np.arange(6 * (n + 2) + 1)
        self._constant, self._varying, self._every = constant, varying, every
        self._firsts = np.searchsorted(varying[:, 0], sites).astype(np.int64)
        self._every_firsts = np.searchsorted(every[:, 0], sites).astype(np.int64)
        self._general = np.zeros(n + 2, np.bool_)
        frames, axes = np.divmod(varying[:, 0], 6)
        self._general[frames[(axes != 0) | (frames < 1) | (frames > n)]] = True
        # a tool turned about its own point moves it only together with a slide: leave that to the exact path
        self._general[n + 1] |= bool(np.any((constant[:, 0] >= 6 * (n + 1)) & (constant[:, 0] % 2 == 0)))
        self._drivers = _padded(np.concatenate(used_drivers))
        angle = chain.moved(q)[0].T
        self._sines = _padded(np.sin(angle))
        self._cosines = _padded(np.cos(angle))
        self._tool = _padded(np.broadcast_to(tool, (self.count, 3)).T)
        self._base = np.ascontiguousarray(chain.base, float)
        self._link = np.ascontiguousarray(chain.link, float)
        self._d = np.ascontiguousarray(chain.d, float)

    @property
    def terms(self) -> list[Numbered]:
        """Parameter index and term, in order of frames and axes; without terms that are zero in all rows."""
        return [
            (parameter, Term(site // 6, AXES[site % 6], self._drivers[driver, : self.count]))
            for site, parameter, driver in self._every.tolist()
        ]

    @property
    def drivers(self) -> np.ndarray:
        """Drivers of all terms, (drivers, C)."""
        return self._drivers[:, : self.count]

    def at_rows(self, rows: np.ndarray) -> Motion:
        """The same motion of some of its rows."""
        terms = [(k, Term(t.frame, t.axis, np.asarray(t.driver)[rows])) for k, t in self.terms]
        return Motion(self.chain, self.q[rows], self.tool[rows], terms, self.size)

    def points(self, values: np.ndarray) -> np.ndarray:
        """Ball centres in F0, (..., 3, C), m, at parameter deviations `values` (..., P), SI."""
        from bayescal.arm import kernel

        values = np.ascontiguousarray(values, float)
        flat = self._with_slides(values.reshape(math.prod(values.shape[:-1]), self.size))
        out = np.empty((len(flat), 3, self._tool.shape[1]))
        kernel.points(
            flat, self._constant, self._varying, self._firsts, self._general, self._drivers, self._sines,
            self._cosines, self._tool, self._base, self._link, self._d, out,
        )  # fmt: skip
        return out[..., : self.count].reshape(*values.shape[:-1], 3, self.count)

    def columns(self, values: np.ndarray, p: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Derivatives of ``u . p`` by each parameter, (P, C), at `values` (P,) with ball centres p (3, C)."""
        from bayescal.arm import kernel

        out = np.empty((self.size, self._tool.shape[1]))
        kernel.columns(
            self._with_slides(np.ascontiguousarray(values, float)), self._constant, self._varying,
            self._firsts, self._general, self._every, self._every_firsts, self._drivers, self._sines,
            self._cosines, self._tool, self._base, self._link, self._d, np.ascontiguousarray(p),
            np.array(u, order="C"), out,  # a copy: of what may not be written Numba compiles the kernel again
        )  # fmt: skip
        return out[:, : self.count]

    def _with_slides(self, values: np.ndarray) -> np.ndarray:
        """Parameter values (..., P) of the kernel: with the 1 that drives prismatic joints, if any."""
        if not self._slides:
            return values
        return np.concatenate([values, np.ones((*values.shape[:-1], 1))], axis=-1)

    def carrying(self, tool: np.ndarray) -> Motion:
        """The same motion of other points of the flange, (C, 3) or (3,), m."""
        out = copy.copy(self)
        out.tool = np.broadcast_to(tool, (self.count, 3))
        out._tool = _padded(out.tool.T)
        return out

    def turns(self, values: np.ndarray) -> np.ndarray:
        """Orientations of the flange in F0, (..., 3, 3, C), at parameter deviations `values` (..., P), SI."""
        # a point of the flange is affine in its place there, and the slopes are the flange's axes
        origin = self.carrying(np.zeros(3)).points(values)
        return np.stack([self.carrying(axis).points(values) - origin for axis in np.eye(3)], axis=-2)

    def turning_columns(self, values: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Turn of the flange about `axis` (3, C) in F0 by each parameter, (P, C), at `values` (P,).

        A couple is two forces: `columns` is linear in the wrench that it carries down the arm.
        """
        length = np.linalg.norm(axis, axis=0)
        unit = axis / length
        across = np.cross(np.eye(3)[np.argmin(np.abs(unit), axis=0)], unit.T)
        force = (across / np.linalg.norm(across, axis=1)[:, None]).T
        lever = np.cross(force, unit, axis=0)
        forward, back = (self.columns(values, p, force) for p in (lever, np.zeros_like(lever)))
        return length * (forward - back)

    def displacements(self, values: np.ndarray) -> np.ndarray:
        """Displacements of all frames, (..., C, n + 2, 6), rad and m, at `values` (..., P)."""
        values = np.asarray(values, float)
        out = np.zeros((*values.shape[:-1], self.count, self.chain.n + 2, 6))
        for parameter, term in self.terms:
            if np.any(values[..., parameter]):  # memory that stays zero is not taken from the system
                out[..., term.frame, AXES.index(term.axis)] += values[..., parameter, None] * term.driver
        return out


@dataclass(frozen=True)
class NominalArm:
    """The nominal arm with a tool: its point (3,) m, and the orientation of its frame (3, 3), on the flange.

    Joint limits apply to `angles`: readings times `link_from_reading`, with the signs of the diagonal taken
    out. Inverse kinematics moves in these angles.
    """

    robot: Robot
    tool: np.ndarray
    tool_axes: np.ndarray = field(default_factory=lambda: np.eye(3))

    @cached_property
    def chain(self) -> Chain:
        """The nominal chain."""
        return chain_of(self.robot)

    @cached_property
    def sign(self) -> np.ndarray:
        """Signs (n,) of the diagonal of `link_from_reading`; limits are stated without them."""
        return np.where(np.diag(self.robot.link_from_reading) < 0, -1.0, 1.0)

    @cached_property
    def reading_from_link(self) -> np.ndarray:
        """Inverse of the robot's `link_from_reading`, (n, n)."""
        return np.linalg.inv(self.robot.link_from_reading)

    def readings_of(self, angles: np.ndarray) -> np.ndarray:
        """Readings (N, n), rad, of angles (N, n) to which the limits apply."""
        return (angles * self.sign) @ self.reading_from_link.T

    def angles_of(self, readings: np.ndarray) -> np.ndarray:
        """Angles (N, n), rad, to which the limits apply: by `link_from_reading` with a positive diagonal."""
        return readings @ self.robot.link_from_reading.T * self.sign

    def frames(self, readings: np.ndarray) -> np.ndarray:
        """Poses in F0 of all frames and the flange, (N, n + 2, 4, 4)."""
        return frames(self.chain, link_angles(self.robot, readings))

    def ball(self, pose: np.ndarray) -> np.ndarray:
        """TCP positions (N, 3), m, of the poses of `frames`."""
        return pose[:, -1, :3, :3] @ self.tool + pose[:, -1, :3, 3]

    def tool_axis(self, pose: np.ndarray) -> np.ndarray:
        """Directions (N, 3) in F0 of the z axis of the tool's frame, of the poses of `frames`."""
        return pose[:, -1, :3, :3] @ self.tool_axes[:, 2]

    def tool_poses(self, pose: np.ndarray) -> np.ndarray:
        """Poses of the tool's frame in F0, (N, 4, 4), of the poses of `frames`."""
        out = np.zeros((len(pose), 4, 4))
        out[:, :3, :3] = pose[:, -1, :3, :3] @ self.tool_axes
        out[:, :3, 3] = self.ball(pose)
        out[:, 3, 3] = 1.0
        return out

    def jacobian(self, pose: np.ndarray) -> np.ndarray:
        """Derivatives (N, 6, n) of the TCP (m/rad) and of its rotation by the limited angles."""
        axis, origin = pose[:, 1:-1, :3, 2], pose[:, 1:-1, :3, 3]
        slide = cross(axis, self.ball(pose)[:, None] - origin)
        if (slides := self.robot.slides[:, None]).any():
            slide, axis = np.where(slides, axis, slide), np.where(slides, 0.0, axis)
        return np.swapaxes(np.concatenate([slide, axis], axis=2), 1, 2) * self.sign
