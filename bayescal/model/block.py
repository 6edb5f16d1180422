"""Residuals of blocks (the rows of one target) and of constraints (certificates).

Orientations that instruments read in addition to points have blocks of their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.arm.motion import Motion, Term
from bayescal.arm.transforms import common_rotation, rpy_matrix
from bayescal.dataset import Dataset
from factors import certificate
from factors.camera import Camera
from factors.kind import Kind, left_jacobian, product, turned

ARM = "arm"


@dataclass(frozen=True)
class Block:
    """The rows of one target, with their motion and measurement kind.

    `sigma` (C,) m is the stated uncertainty of a residual. The parameters `contact_index` (P',) change the
    residual directly, with the drivers `contact` (P', C). `group` is the name of its noise group.
    Residuals of `Turned` blocks are in rad.
    """

    target: str
    group: str
    rows: np.ndarray
    motion: Motion
    kind: Kind
    sigma: np.ndarray
    contact_index: np.ndarray
    contact: np.ndarray

    @property
    def name(self) -> str:
        """Key of its weights: the target's name, except for orientations."""
        return self.target

    @cached_property
    def free(self) -> np.ndarray:
        """Indices of the unknown components of the target's state, (size,)."""
        return np.flatnonzero(self.kind.sd > 0)

    @cached_property
    def sd(self) -> np.ndarray:
        """Prior standard deviations of the unknown components, (size,), m and rad."""
        return self.kind.sd[self.free]

    @property
    def size(self) -> int:
        """Length of the target's part of z."""
        return len(self.free)

    @property
    def residuals(self) -> int:
        """Number of residuals: rows of the kind times contacts."""
        return self.kind.rows * len(self.rows)

    def state(self, z: np.ndarray) -> np.ndarray:
        """The target's state (..., kind size), m and rad, from its part of z (..., size)."""
        if self.size == len(self.kind.sd):
            return z * self.sd
        out = np.zeros((*z.shape[:-1], len(self.kind.sd)))
        out[..., self.free] = z * self.sd
        return out

    def by_z(self, by_state: np.ndarray) -> np.ndarray:
        """Gradients (..., size) by the target's part of z, from those by its state (..., kind size)."""
        return (by_state if self.size == by_state.shape[-1] else by_state[..., self.free]) * self.sd

    def seen(self, values: np.ndarray) -> np.ndarray:
        """The quantity that the kind measures, at arm deviations (..., P): ball centres (..., 3, C), m."""
        return self.motion.points(values)

    def columns(self, values: np.ndarray, seen: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Derivatives (P, C) of `seen` along u (3, C), at deviations (P,)."""
        return self.motion.columns(values, seen, u)

    def residual(self, values: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Residuals (..., rows, C), m, at arm deviations (..., P) and target z (..., size)."""
        return self.residual_of(self.seen(values), values, self.state(z))

    def residual_of(self, seen: np.ndarray, values: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Residuals (..., rows, C), m, of what is `seen`, at arm deviations (..., P) and a target's state."""
        r = self.kind.residual(state, seen)
        return r + self.direct(values) if self.has_direct else r

    @property
    def has_direct(self) -> bool:
        """Whether parameters change the residuals directly."""
        return bool(len(self.contact_index))

    def direct(self, values: np.ndarray) -> np.ndarray:
        """Part of residuals from parameters that change them directly, (..., rows or 1, C), m."""
        return self.at_contact(values)[..., None, :]

    def add_direct(self, by_arm: np.ndarray) -> None:
        """Add the slopes of `direct` to those of the residuals (P, R) by the arm's parameters."""
        by_arm[self.contact_index] += np.tile(self.contact, self.kind.rows)

    def points(self, values: np.ndarray) -> np.ndarray:
        """Ball centres (..., 3, C), m, at arm deviations (..., P)."""
        return self.motion.points(values)

    def by_point(self, state: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Derivatives (rows, 3, C) of residuals by a shift of the ball centres in F0; 0 of orientations."""
        return self.kind.linearise(state, seen)[1]

    def at_contact(self, values: np.ndarray) -> np.ndarray:
        """Part of residuals from parameters that act at the contact, (..., C), m, at deviations (..., P)."""
        return values[..., self.contact_index] @ self.contact

    def touched(self, values: np.ndarray) -> Kind:
        """The kind with the model's effective ball radius at each contact, at deviations (P,)."""
        if not len(self.contact_index) or not hasattr(self.kind, "radius"):
            return self.kind
        return replace(self.kind, radius=self.kind.radius - self.at_contact(values))  # type: ignore[type-var]

    def linearise(self, values: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (R,), m, and gradients by the arm's deviations (R, P) and the target's z (R, size)."""
        p = self.seen(values)
        r, u, dx = self.kind.linearise(self.state(z), p)
        # in order of the parameters, as in the kernel and the solver
        arm = [self.columns(values, p, u[k]) for k in range(self.kind.rows)]
        by_arm = arm[0] if len(arm) == 1 else np.concatenate(arm, axis=1)
        if self.has_direct:
            r = r + self.direct(values)
            self.add_direct(by_arm)
        return r.ravel(), by_arm.T, self.by_z(dx).reshape(self.residuals, self.size)

    def by_readings(self, values: np.ndarray, z: np.ndarray, coupling: np.ndarray) -> np.ndarray:
        """Gradients (R, n) of residuals by joint readings, SI; coupling (n, n) is link from reading."""
        n, size = self.motion.chain.n, self.motion.size
        axes = np.where(self.motion.chain.slides, "tz", "rz")
        joints = [(size + j, Term(j + 1, str(axis))) for j, axis in enumerate(np.broadcast_to(axes, n))]
        terms = [*self.motion.terms, *joints]
        motion = Motion(self.motion.chain, self.motion.q, self.motion.tool, terms, size + n)
        turning = replace(self, motion=motion)
        deviations = np.append(values, np.zeros(n))
        p = turning.seen(deviations)
        _, u, _ = self.kind.linearise(self.state(z), p)
        return np.concatenate(
            [turning.columns(deviations, p, u[k])[size:].T @ coupling for k in range(self.kind.rows)]
        )


@dataclass(frozen=True)
class Oriented(Block):
    """Rows to which it matters how the tool stands on the flange.

    `frame` (C, 3, 3) is the nominal orientation of each row's tool on the flange. The parameters `turn_index`
    (P',) rotate it by a rotation vector in its own frame, with the drivers `turn` (P', 3, C).
    """

    frame: np.ndarray
    turn_index: np.ndarray
    turn: np.ndarray

    @cached_property
    def _mounts(self) -> tuple[np.ndarray, np.ndarray]:
        """`frame` (C, 3, 3) and `turn` (P', 3, C), of a single row where all rows are alike."""
        alike = np.all(self.frame == self.frame[:1]) and np.all(self.turn == self.turn[..., :1])
        last = 1 if alike else len(self.frame)
        return self.frame[:last], self.turn[..., :last]

    def _vector(self, values: np.ndarray) -> np.ndarray:
        """Rotation vectors of the mounts relative to the nominal ones, (..., 1 or C, 3), rad."""
        return np.einsum("...k,kac->...ca", values[..., self.turn_index], self._mounts[1])

    def turns(self, values: np.ndarray) -> np.ndarray:
        """Orientations of the tool's frame in F0, (..., 3, 3, C), at arm deviations (..., P)."""
        mounted = self._mounts[0] @ turned(self._vector(values))
        return product(self.motion.turns(values), np.moveaxis(mounted, -3, -1))

    def add_turns(self, out: np.ndarray, values: np.ndarray, turns: np.ndarray, u: np.ndarray) -> None:
        """Add rotations about u (3, C) of the tool's orientation `turns` on the flange to columns (P, C)."""
        if len(self.turn_index):
            # exp(v + dv) = exp(v) exp(J dv) with the left Jacobian of -v: a rotation in the tool's frame
            by = np.moveaxis(left_jacobian(-self._vector(values)), -3, -1)
            gradient = product(product(u[None], turns), by)
            out[self.turn_index] += np.sum(gradient * self._mounts[1], axis=1)


@dataclass(frozen=True)
class Turned(Oriented):
    """The rows in which an instrument also reads the tool's orientation; shares the state of its points.

    Residuals are in rad.
    """

    @property
    def name(self) -> str:
        """Key of its weights; differs from that of the points of the same target."""
        return f"{self.target} (orientation)"

    def seen(self, values: np.ndarray) -> np.ndarray:
        """Orientations of the tool's frame in F0, (..., 3, 3, C), at arm deviations (..., P)."""
        return self.turns(values)

    def columns(self, values: np.ndarray, seen: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Rotations (P, C) of the tool about u (3, C) by each parameter, at deviations (P,)."""
        out = self.motion.turning_columns(values, u)
        self.add_turns(out, values, seen, u)
        return out

    def by_point(self, state: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Zeros: a shift of the ball turns nothing."""
        return np.zeros((self.kind.rows, 3, len(self.rows)))


@dataclass(frozen=True)
class Posed(Oriented):
    """Rows whose kind judges poses of the tool, as a camera does.

    The parameters `image_index` (P',) change the components of the residuals directly, with the drivers
    `image` (P', rows, C).
    """

    image_index: np.ndarray
    image: np.ndarray

    @cached_property
    def images(self) -> tuple[Posed, np.ndarray]:
        """The first row of each image, with a kind that takes their poses, and the image of every row, (C,).

        An image is successive rows in which the arm and the tool stand alike.
        """
        motion = self.motion
        stands = [motion.q, motion.tool, motion.drivers.T]
        stands += [self.frame, np.moveaxis(self.turn, -1, 0)]
        flat = np.concatenate([x.reshape(len(x), math.prod(x.shape[1:])) for x in stands], axis=1)
        first = np.any(flat[1:] != flat[:-1], axis=1)
        first = np.concatenate([[True], first])[: len(self.rows)]
        image = np.cumsum(first) - 1
        one = replace(
            self,
            rows=self.rows[first],
            kind=replace(self.kind, image=image),  # type: ignore[type-var]
            motion=motion.at_rows(first),
            frame=self.frame[first],
            turn=self.turn[..., first],
        )
        return one, image

    def _poses(self, values: np.ndarray) -> np.ndarray:
        """Poses of the tool in F0, (..., 3, 4, C), at arm deviations (..., P)."""
        return np.concatenate([self.turns(values), self.points(values)[..., None, :]], axis=-2)

    def seen(self, values: np.ndarray) -> np.ndarray:
        """The same, of the images."""
        one, image = self.images
        return np.take(one._poses(values), image, axis=-1)

    def residual(self, values: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Residuals (..., rows, C), m, at arm deviations (..., P) and target z (..., size)."""
        one, _ = self.images
        return one.kind.residual(self.state(z), one._poses(values)) + self.direct(values)

    def columns(self, values: np.ndarray, seen: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Derivatives (P, C) of `seen` along u (6, C): a force and its moment about the tool's point.

        A moment normal to its force is that of the force at another point of the flange.
        """
        force, moment = u[:3], u[3:]
        square = np.maximum(np.sum(force**2, axis=0), np.finfo(float).tiny)
        points = seen[:, 3] + np.cross(force, moment, axis=0) / square
        out = self.motion.columns(values, points, force)
        self.add_turns(out, values, seen[:, :3], moment)
        return out

    def by_point(self, state: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Derivatives (rows, 3, C) of the residuals by a shift of the tool in F0."""
        return self.kind.linearise(state, seen)[1][:, :3]

    def touched(self, values: np.ndarray) -> Kind:
        """The kind with its pixels where the parameters of lens and board have them, at deviations (P,)."""
        assert isinstance(self.kind, Camera)
        return replace(self.kind, pixel=self.kind.pixel - (self.direct(values) / self.kind.scale).T)

    @property
    def has_direct(self) -> bool:
        """Whether parameters change the residuals directly."""
        return bool(len(self.image_index))

    def direct(self, values: np.ndarray) -> np.ndarray:
        """Part of residuals from parameters that change them directly, (..., rows, C), m."""
        return np.tensordot(values[..., self.image_index], self.image, axes=1)

    def add_direct(self, by_arm: np.ndarray) -> None:
        """Add the slopes of `direct` to those of the residuals (P, R) by the arm's parameters."""
        by_arm[self.image_index] += self.image.reshape(len(self.image_index), -1)


@dataclass(frozen=True)
class Constraint:
    """Certificates between fitted targets: whitened residuals of their states.

    `numbers` are those of one certificate, or of one length at several placements. A unit of each of the
    parameters `index` (P',) shifts the certified value by `shift` (P', rows), in units of its stated
    uncertainties `u` (rows,).
    """

    kind: str
    targets: tuple[str, ...]
    numbers: tuple[int, ...]
    function: certificate.Certificate
    u: np.ndarray
    index: np.ndarray
    shift: np.ndarray

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return len(self.u)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the parts of z on which it depends, including the arm's if a parameter shifts it."""
        return (ARM, *self.targets) if len(self.index) else self.targets

    def linearise(self, values: np.ndarray, *states: np.ndarray) -> certificate.Residual:
        """Residuals (..., rows) at arm deviations (..., P) and states, and gradients by each state."""
        r, slopes = self.function(*states)
        return (r - values[..., self.index] @ self.shift if len(self.index) else r), slopes


USUAL = np.radians(0.01)
"""rad, assumed noise of an orientation if none is stated: that of a laser tracker's 6-DoF probe."""


def posed(dataset: Dataset) -> np.ndarray:
    """Which rows also read the tool's orientation, (N,)."""
    rpy = dataset.measurements.rpy
    return np.zeros(len(dataset.measurements.ids), bool) if rpy is None else ~np.isnan(rpy).any(axis=1)


def read(dataset: Dataset, rows: np.ndarray) -> np.ndarray:
    """Orientations as read, in the frames of their instruments, (C, 3, 3)."""
    assert dataset.measurements.rpy is not None
    return rpy_matrix(dataset.measurements.rpy[rows])


def sigma(dataset: Dataset, count: int) -> np.ndarray:
    """Stated standard uncertainty of a rotation about each axis, (count,), rad; default `USUAL`."""
    stated = dataset.noise.orientation
    return np.full(count, USUAL if stated is None else stated)


def tool_frames(dataset: Dataset, flange: np.ndarray) -> np.ndarray:
    """Nominal orientation of every tool on the flange, (tools, 3, 3).

    If a tool states none, it is the mean over its rows' readings, with the nominal arm and instruments.
    `flange` (N, 3, 3) is in F0.
    """
    m, measured = dataset.measurements, posed(dataset)
    out = np.tile(np.eye(3), (len(dataset.tools), 1, 1))
    for k, tool in enumerate(dataset.tools):
        rows = np.flatnonzero(measured & (m.tool == k))
        if tool.rpy is not None:
            out[k] = rpy_matrix(tool.rpy)
        elif len(rows):
            turns = [np.asarray(dataset.targets[t].values["rpy"]) for t in m.target[rows]]
            seen = rpy_matrix(np.array(turns)) @ read(dataset, rows)
            out[k] = common_rotation(np.swapaxes(flange[rows], -1, -2) @ seen)[0]
    return out
