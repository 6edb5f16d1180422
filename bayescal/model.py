"""The model: a scene and its effects as named, whitened parameters with their residuals.

The vector z = (arm, first target, second target, ...) is standard normal a priori. The arm's part
maps to physical values by `Parameter`, a target's part by the `sd` of its kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.arm.motion import CERTIFICATE, CONTACT, Motion, Term
from bayescal.dataset import Certificate as CertificateEntry
from bayescal.effects import UNITS, Parameter, parameters_of
from bayescal.errors import BayescalError
from bayescal.parts import Part, kept
from bayescal.scene import Scene, stated_u
from factors import certificate
from factors.distance import Distance
from factors.instrument import Instrument
from factors.kind import Kind

ARM = "arm"
LENGTHS = ("parallel", "distance", "diameter")
"""Certificates that state a length."""
KNOWN_PLACE = 1e-3
"""Standard uncertainty, m, up to which two targets' places, or a paper that may be wrong, are a length."""


@dataclass(frozen=True)
class Block:
    """The rows of one target: their motion and kind, ready for residuals.

    `sigma` (C,) m is the stated uncertainty of a residual; `contact` (P', C) drives the residual
    directly by the parameters `contact_index` (P',). `group` names the noise scale that it shares.
    """

    target: str
    group: str
    rows: np.ndarray
    motion: Motion
    kind: Kind
    sigma: np.ndarray
    contact_index: np.ndarray
    contact: np.ndarray

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

    def residual(self, values: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Residuals (..., rows, C), m, at arm deviations (..., P) and target z (..., size)."""
        r = self.kind.residual(self.state(z), self.motion.points(values))
        if len(self.contact_index):
            r = r + (values[..., self.contact_index] @ self.contact)[..., None, :]
        return r

    def at_contact(self, values: np.ndarray) -> np.ndarray:
        """What the model adds to residuals at the contact itself, (..., C), m, at deviations (..., P)."""
        return values[..., self.contact_index] @ self.contact

    def touched(self, values: np.ndarray) -> Kind:
        """The kind with balls as large as the model says that they are at each contact, at (P,)."""
        if not len(self.contact_index) or not hasattr(self.kind, "radius"):
            return self.kind
        return replace(self.kind, radius=self.kind.radius - self.at_contact(values))  # type: ignore[type-var]

    def linearise(self, values: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (R,), m, and gradients by the arm's deviations (R, P) and the target's z (R, size)."""
        p = self.motion.points(values)
        r, u, dx = self.kind.linearise(self.state(z), p)
        # parameter after parameter, as the kernel gives and the solver takes them
        arm = [self.motion.columns(values, p, u[k]) for k in range(self.kind.rows)]
        by_arm = arm[0] if len(arm) == 1 else np.concatenate(arm, axis=1)
        if len(self.contact_index):
            r = r + values[self.contact_index] @ self.contact
            by_arm[self.contact_index] += np.tile(self.contact, self.kind.rows)
        return r.ravel(), by_arm.T, self.by_z(dx).reshape(self.residuals, self.size)

    def by_readings(self, values: np.ndarray, z: np.ndarray, coupling: np.ndarray) -> np.ndarray:
        """Gradients (R, n) of residuals by joint readings, m/rad; coupling (n, n) is link from reading."""
        n, size = self.motion.chain.n, self.motion.size
        joints = [(size + j, Term(j + 1, "rz")) for j in range(n)]
        turning = Motion(
            self.motion.chain, self.motion.q, self.motion.tool, [*self.motion.terms, *joints], size + n
        )
        at = np.append(values, np.zeros(n))
        p = turning.points(at)
        _, u, _ = self.kind.linearise(self.state(z), p)
        return np.concatenate(
            [turning.columns(at, p, u[k])[size:].T @ coupling for k in range(self.kind.rows)]
        )


@dataclass(frozen=True)
class Tie:
    """A certificate between fitted targets: whitened residuals of their states.

    `shift` (P', rows) is by how many of its stated uncertainties `u` (rows,) a unit of each of the
    parameters `index` (P',) shifts what it states.
    """

    kind: str
    targets: tuple[str, ...]
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
        """Names of the parts of z that it joins: the arm's too where a parameter shifts it."""
        return (ARM, *self.targets) if len(self.index) else self.targets

    def linearise(self, values: np.ndarray, *states: np.ndarray) -> certificate.Residual:
        """Residuals (..., rows) at arm deviations (..., P) and states, and gradients by each state."""
        r, slopes = self.function(*states)
        return (r - values[..., self.index] @ self.shift if len(self.index) else r), slopes


@dataclass(frozen=True)
class Model:
    """Parameters, blocks of contacts and certificates, over the rows that are fitted."""

    scene: Scene
    effects: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    blocks: tuple[Block, ...]
    ties: tuple[Tie, ...]

    @cached_property
    def slices(self) -> Mapping[str, slice]:
        """Where the arm and each target stand in z."""
        out = {ARM: slice(0, len(self.parameters))}
        at = len(self.parameters)
        for block in self.blocks:
            out[block.target] = slice(at, at + block.size)
            at += block.size
        return out

    @property
    def size(self) -> int:
        """Length of z."""
        return len(self.parameters) + sum(block.size for block in self.blocks)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """A name for every component of z."""
        out = [p.name for p in self.parameters]
        for block in self.blocks:
            out += [f"{block.target} {block.kind.parts[k][0]}" for k in block.free]
        return tuple(out)

    @cached_property
    def block_of(self) -> Mapping[str, Block]:
        """Blocks by their target's name."""
        return {block.target: block for block in self.blocks}

    @cached_property
    def sd(self) -> np.ndarray:
        """Prior standard deviations of the arm's parameters, (P,), SI: also the slopes of `deviations`."""
        return np.array([p.sd for p in self.parameters])

    @cached_property
    def shift(self) -> np.ndarray:
        """How far the prior means lie from the drawing, (P,), SI."""
        return np.array([p.centre - p.nominal for p in self.parameters])

    def deviations(self, z: np.ndarray) -> np.ndarray:
        """Deviations of the arm's parameters from the drawing (..., P), SI, from the arm's z (..., P)."""
        return z * self.sd + self.shift

    def physical(self, z: np.ndarray) -> np.ndarray:
        """Every component of z (..., size) in SI: arm parameters as values, targets as displacements."""
        arm = z[..., self.slices[ARM]] * self.sd + np.array([p.centre for p in self.parameters])
        parts = [z[..., self.slices[b.target]] * b.sd for b in self.blocks]
        return np.concatenate([arm, *parts], axis=-1)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """SI unit of every component of z."""
        out = [p.unit for p in self.parameters]
        for block in self.blocks:
            out += [block.kind.parts[k][1] for k in block.free]
        return tuple(out)

    @property
    def knows_length(self) -> bool:
        """Whether anything but the priors says how long the arm is."""
        stated = {t.name for t in self.scene.dataset.targets if t.u is not None and t.u <= KNOWN_PLACE}
        return (
            any(t.kind in LENGTHS and self._looseness(t) <= KNOWN_PLACE for t in self.ties)
            or any(isinstance(b.kind, Instrument | Distance) for b in self.blocks)
            or sum(b.target in stated for b in self.blocks) > 1
        )

    def _looseness(self, tie: Tie) -> float:
        """Standard uncertainty, m, that parameters add to the length, its last value, that a tie states."""
        return float(tie.u[-1] * np.linalg.norm(tie.shift[:, -1] * self.sd[tie.index]))

    def tied(self, tie: Tie, parts: Mapping[str, np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """A tie's residuals (rows,) and gradients (rows, size) by each of its variables' parts of z."""
        blocks = [self.block_of[name] for name in tie.targets]
        values = self.deviations(parts[ARM]) if ARM in tie.variables else np.zeros(0)
        r, slopes = tie.linearise(values, *(b.state(parts[b.target]) for b in blocks))
        by = {b.target: b.by_z(s) for b, s in zip(blocks, slopes, strict=True)}
        if ARM in tie.variables:
            by[ARM] = np.zeros((tie.rows, len(self.parameters)))
            by[ARM][:, tie.index] = -(tie.shift.T * self.sd[tie.index])
        return r, by

    def driven(self, frame: int, axis: str, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (P',) with a term at one axis of a frame, and its drivers (P', count)."""
        index, drivers = [], []
        for k, p in enumerate(self.parameters):
            here = [t.driver for t in p.terms if (t.frame, t.axis) == (frame, axis)]
            if here:
                index.append(k)
                drivers.append(np.sum([np.broadcast_to(d, count) for d in here], axis=0))
        return np.array(index, int), np.array(drivers, float).reshape(len(index), count)

    def in_file_units(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Units for files, and the factors (size,) to them from SI."""
        pairs = [UNITS[unit] for unit in self.units]
        return tuple(name for name, _ in pairs), np.array([factor for _, factor in pairs])

    def motion(self, rows: np.ndarray) -> Motion:
        """Motion of any rows of the session under this model's parameters."""
        terms = [
            (k, Term(t.frame, t.axis, t.driver if np.ndim(t.driver) == 0 else np.asarray(t.driver)[rows]))
            for k, p in enumerate(self.parameters)
            for t in p.terms
            if t.frame >= 0
        ]
        return Motion(
            self.scene.chain, self.scene.q[rows], self.scene.tools[rows], terms, len(self.parameters)
        )

    def block(self, target: int, rows: np.ndarray) -> Block:
        """Any rows of one target under this model's parameters."""
        kind = self.scene.kind(target, rows)
        index, drivers = self.driven(CONTACT, "normal", len(self.scene.q))
        return Block(
            self.scene.dataset.targets[target].name,
            self.scene.group(target),
            rows,
            self.motion(rows),
            kind,
            self.scene.sigma(rows),
            index,
            drivers[:, rows],
        )


def check_asked(effects: tuple[str, ...], prior_width: float) -> None:
    """Refuse what no model can be made of: priors of no width, an effect named twice."""
    if not 0 < prior_width < float("inf"):
        raise BayescalError(
            "a model without priors would shrink the arm to fit its contacts",
            "--prior-width",
            "give a number above 0",
        )
    if len({name.partition("@")[0] for name in effects}) < len(effects):
        raise BayescalError("an effect is named twice", "--model", "name it once")


def build(
    scene: Scene, effects: tuple[str, ...], prior_width: float = 1.0, without: Sequence[Part] = ()
) -> Model:
    """The model of a scene's `calibrate` rows.

    Parameters
    ----------
    scene : Scene
    effects : tuple of str
        Names of `effects.EFFECTS`; () leaves the arm as drawn.
    prior_width : float
        Factor on the prior standard deviations of the arm's parameters.
    without : sequence of Part
        Parts of the effects that stay as drawn.

    Raises
    ------
    BayescalError
        Without rows to fit, or where an effect lacks what it needs, or a part that it should be without.
    """
    rows = scene.rows("calibrate")
    if not len(rows):
        raise BayescalError("no row has the role calibrate", "measurements.csv", "nothing can be fitted")
    circumstances = scene.circumstances(rows)
    parameters = kept(parameters_of(effects, circumstances), without)
    parameters = tuple(p.widened(prior_width) for p in parameters)
    return with_parameters(scene, effects, parameters)


def with_parameters(scene: Scene, effects: tuple[str, ...], parameters: tuple[Parameter, ...]) -> Model:
    """The model of a scene's `calibrate` rows with any parameters."""
    rows = scene.rows("calibrate")
    bare = Model(scene, effects, parameters, (), ())
    present = np.unique(scene.dataset.measurements.target[rows])
    blocks = tuple(bare.block(int(t), scene.rows_of(int(t), rows)) for t in present)
    kinds = {b.target: b.kind for b in blocks}
    numbered = enumerate(scene.dataset.certificates)
    ties = tuple(tie for k, entry in numbered if (tie := _tie(bare, k, entry, kinds)) is not None)
    return Model(scene, effects, parameters, blocks, ties)


def _tie(model: Model, number: int, entry: CertificateEntry, kinds: Mapping[str, Kind]) -> Tie | None:
    """A certificate as a factor, or None where one of its targets is not fitted."""
    if entry.kind not in TIES or any(name not in kinds for name in entry.targets):
        return None
    function = TIES[entry.kind](entry, *(kinds[name] for name in entry.targets))
    u = stated_u(entry)
    index, drivers = model.driven(CERTIFICATE, str(number), len(u))
    return Tie(entry.kind, entry.targets, function, u, index, drivers / u)


def _centre(kind: Kind) -> np.ndarray:
    return kind.centre  # type: ignore[attr-defined]


TIES: dict[str, Callable[..., certificate.Certificate]] = {
    "parallel": lambda e, a, b: certificate.parallel(a, b, e.distance, e.u_distance, e.u_angle),
    "perpendicular": lambda e, a, b: certificate.perpendicular(a, b, e.u_angle),
    "distance": lambda e, a, b: certificate.distance(_centre(a), _centre(b), e.distance, e.u_distance),
    "diameter": lambda e, a: certificate.diameter(a, a.diameter, e.u_distance),
}
"""Of each kind of certificate its residuals, in the order of `scene.STATED`."""
