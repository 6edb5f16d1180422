"""The model: a scene and its effects as named, whitened parameters with their residuals.

The vector z = (arm, first target, second target, ...) is standard normal a priori. The arm's part
maps to physical values by `Parameter`, a target's part by the `sd` of its kind.

Blocks whose residuals are lengths: contacts and points, not the orientations that instruments read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.arm.motion import CERTIFICATE, CONTACT, IMAGE, TURN, Motion, Terms
from bayescal.dataset import Certificate as CertificateEntry
from bayescal.dataset.contacts import measured_again
from bayescal.dataset.target_kinds import KINDS
from bayescal.effects import UNITS, Parameter, parameters_of
from bayescal.errors import BayescalError
from bayescal.model.block import ARM, Block, Constraint, Posed, Turned, sigma
from bayescal.model.options import USUAL, FitOptions, kept
from bayescal.model.parts import POINTS, u_of
from bayescal.model.scene import Scene
from factors import certificate
from factors.certificate import again, certified_points, whitening
from factors.contacts import Cylinder, Sphere
from factors.kind import Kind

ORIENTATION = "orientation"
"""Noise group of all orientations."""

LENGTHS = ("parallel", "distance", "diameter")
"""Certificates that state a length."""
TURNS = ("rx", "ry", "rz")
KNOWN_PLACE = 1e-3
"""Standard uncertainty, m, up to which the positions of two targets, or a certificate, define a length."""


@dataclass(frozen=True)
class Model:
    """Parameters, blocks of contacts, and certificates, for the fitted measurements.

    A target's first block contains its contacts or points; a further block of the target shares its state.
    """

    scene: Scene
    effects: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    blocks: tuple[Block, ...]
    constraints: tuple[Constraint, ...]

    @cached_property
    def slices(self) -> Mapping[str, slice]:
        """Slices of z for the arm and each target."""
        out = {ARM: slice(0, len(self.parameters))}
        start = len(self.parameters)
        for block in self.states:
            out[block.target] = slice(start, start + block.size)
            start += block.size
        return out

    @property
    def states(self) -> tuple[Block, ...]:
        """The first block of every target; z contains their states."""
        return tuple(self.block_of.values())

    @cached_property
    def size(self) -> int:
        """Length of z."""
        return len(self.parameters) + sum(block.size for block in self.states)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """A name for every component of z."""
        states = (f"{b.target} {b.kind.parts[k][0]}" for b in self.states for k in b.free)
        return (*(p.name for p in self.parameters), *states)

    @cached_property
    def block_of(self) -> Mapping[str, Block]:
        """The first block of each target, by its name."""
        out: dict[str, Block] = {}
        for block in self.blocks:
            out.setdefault(block.target, block)
        return out

    @cached_property
    def sd(self) -> np.ndarray:
        """Prior standard deviations of the arm's parameters, (P,), SI: also the slopes of `deviations`."""
        return np.array([p.sd for p in self.parameters])

    @cached_property
    def shift(self) -> np.ndarray:
        """Prior means minus nominal values, (P,), SI."""
        return np.array([p.centre - p.nominal for p in self.parameters])

    def deviations(self, z: np.ndarray) -> np.ndarray:
        """Deviations of the arm's parameters from nominal (..., P), SI, from the arm's z (..., P)."""
        return z * self.sd + self.shift

    def physical(self, z: np.ndarray) -> np.ndarray:
        """Every component of z (..., size) in SI: arm parameters as values, targets as displacements."""
        arm = z[..., self.slices[ARM]] * self.sd + np.array([p.centre for p in self.parameters])
        parts = [z[..., self.slices[b.target]] * b.sd for b in self.states]
        return np.concatenate([arm, *parts], axis=-1)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """SI unit of every component of z."""
        states = (b.kind.parts[k][1] for b in self.states for k in b.free)
        return (*(p.unit for p in self.parameters), *states)

    @property
    def knows_length(self) -> bool:
        """Whether the data determine the size of the arm, and not only the priors."""
        stated = {t.name for t in self.scene.dataset.targets if t.u is not None and t.u <= KNOWN_PLACE}
        fitted = {b.target for b in self.blocks}
        return (
            any(t.kind == POINTS for t in self.constraints)
            or any(t.kind in LENGTHS and self._looseness(t) <= KNOWN_PLACE for t in self.constraints)
            or any(KINDS[t.kind].metric for t in self.scene.dataset.targets if t.name in fitted)
            or sum(b.target in stated for b in self.blocks) > 1
        )

    def _looseness(self, constraint: Constraint) -> float:
        """Standard uncertainty, m, that parameters add to the length (last value) of a constraint."""
        return float(constraint.u[-1] * np.linalg.norm(constraint.shift[:, -1] * self.sd[constraint.index]))

    def linearised(
        self, constraint: Constraint, parts: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Residuals (rows,) of a constraint, and gradients (rows, size) by each variable of z."""
        blocks = [self.block_of[name] for name in constraint.targets]
        values = self.deviations(parts[ARM]) if ARM in constraint.variables else np.zeros(0)
        r, slopes = constraint.linearise(values, *(b.state(parts[b.target]) for b in blocks))
        by = {b.target: b.by_z(s) for b, s in zip(blocks, slopes, strict=True)}
        if ARM in constraint.variables:
            by[ARM] = np.zeros((constraint.rows, len(self.parameters)))
            by[ARM][:, constraint.index] = -(constraint.shift.T * self.sd[constraint.index])
        return r, by

    def driven(self, frame: int, axes: Sequence[str], count: int) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (P',) with terms along axes of a frame, and their drivers (P', axes, count)."""
        index, out = [], []
        for k, p in enumerate(self.parameters):
            if here := [t for t in p.terms if t.frame == frame and t.axis in axes]:
                driver = np.zeros((len(axes), count))
                for t in here:
                    driver[axes.index(t.axis)] += t.driver
                index.append(k)
                out.append(driver)
        return np.array(index, int), np.array(out).reshape(len(index), len(axes), count)

    def _along(self, frame: int, axes: Sequence[str], rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same with the drivers in some rows (C,) of the session."""
        index, drivers = self.driven(frame, axes, len(self.scene.q))
        return index, np.take(drivers, rows, axis=-1)

    def in_file_units(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Units for files, and the factors (size,) to them from SI."""
        pairs = [UNITS[unit] for unit in self.units]
        return tuple(name for name, _ in pairs), np.array([factor for _, factor in pairs])

    @cached_property
    def terms(self) -> Terms:
        """All terms that move the arm, in all rows of the session."""
        return Terms.of((k, t) for k, p in enumerate(self.parameters) for t in p.terms)

    def motion(self, rows: np.ndarray) -> Motion:
        """Motion of any rows of the session under this model's parameters."""
        q, tools = self.scene.q[rows], self.scene.tools[rows]
        return Motion(self.scene.chain, q, tools, self.terms.at_rows(rows), len(self.parameters))

    def block(self, target: int, rows: np.ndarray) -> Block:
        """Any rows of one target under this model's parameters."""
        scene, none = self.scene, (np.zeros(0, int), np.zeros((0, len(rows))))
        name, kind = scene.dataset.targets[target].name, scene.kind(target, rows)
        plain = name, scene.group(target), rows, self.motion(rows), kind, scene.sigma(rows)
        if not scene.declared[target].posed:
            index, drivers = self.driven(CONTACT, ("normal",), len(scene.q))
            return Block(*plain, index, drivers[:, 0][:, rows])
        turned, image = self._along(TURN, TURNS, rows), self._along(IMAGE, ("u", "v"), rows)
        return Posed(*plain, *none, scene.tool_frames[rows], *turned, *image)

    def turned(self, target: int, rows: np.ndarray) -> Turned:
        """Any rows of an instrument that read the tool's orientation too, as a block of orientations."""
        scene, none = self.scene, (np.zeros(0, int), np.zeros((0, len(rows))))
        name, kind = scene.dataset.targets[target].name, scene.orientation(target, rows)
        plain = name, ORIENTATION, rows, self.motion(rows), kind, sigma(scene.dataset, len(rows))
        return Turned(*plain, *none, scene.tool_frames[rows], *self._along(TURN, TURNS, rows))

    def part(self, block: Block, rows: np.ndarray) -> Block:
        """Any rows of a block's target as such a block."""
        target = self.scene.index[block.target]
        return self.turned(target, rows) if isinstance(block, Turned) else self.block(target, rows)


def build(scene: Scene, effects: tuple[str, ...], options: FitOptions = USUAL) -> Model:
    """The model of a scene's `calibrate` rows.

    Parameters
    ----------
    scene : Scene
    effects : tuple of str
        Names of `effects.MODELS`; () is the nominal arm.
    options : FitOptions
        With the width of the priors, and the parts of the effects that stay nominal.

    Raises
    ------
    BayescalError
        If there are no rows to fit, the session lacks data for an effect, or an effect has no such part.
    """
    circumstances = scene.circumstances(_rows(scene))
    parameters = kept(parameters_of(effects, circumstances), options.without)
    return with_parameters(scene, effects, tuple(map(options.wider, parameters)))


def with_parameters(scene: Scene, effects: tuple[str, ...], parameters: tuple[Parameter, ...]) -> Model:
    """The model of a scene's `calibrate` rows with the given parameters.

    Raises
    ------
    BayescalError
        If there are no rows to fit.
    """
    rows = _rows(scene)
    bare = Model(scene, effects, parameters, (), ())
    present = np.unique(scene.dataset.measurements.target[rows])
    blocks = tuple(bare.block(int(t), scene.rows_of(int(t), rows)) for t in present)
    kinds = {b.target: b.kind for b in blocks}
    of_turns = [(int(t), scene.rows_of(int(t), rows[scene.posed[rows]])) for t in present]
    blocks += tuple(bare.turned(t, posed) for t, posed in of_turns if len(posed))
    every = measured_again(scene.dataset.certificates, kinds.keys())
    constraints = tuple(c for numbers in every if (c := _constraint(bare, numbers, kinds)) is not None)
    return Model(scene, effects, parameters, blocks, constraints)


def _rows(scene: Scene) -> np.ndarray:
    """The rows to fit."""
    rows = scene.rows("calibrate")
    if not len(rows):
        remedy = "nothing can be fitted without such rows"
        raise BayescalError("no row has the role calibrate", "measurements.csv", remedy)
    return rows


def _constraint(model: Model, numbers: tuple[int, ...], kinds: Mapping[str, Kind]) -> Constraint | None:
    """Certificates of one value as a factor, or None if a target of them is not fitted."""
    entries = [model.scene.dataset.certificates[number] for number in numbers]
    entry, times = entries[0], len(entries)
    if entry.points is not None:
        certified = model.scene.shape_of(entry, kinds)
        if certified is None:
            return None
        of, names = certified
        function, u = certified_points(of, [kinds[name] for name in names]), np.ones(len(of.whiten))
    else:
        names = tuple(name for e in entries for name in e.targets)
        stated = model.scene.stated(entry)
        if not stated:
            return None
        each = [_function(model.scene, e, [kinds[name] for name in e.targets]) for e in entries]
        function, u = again(each, len(entry.targets)), np.tile(u_of(entry, stated), times)
    index, drivers = model.driven(CERTIFICATE, [str(number) for number in numbers], len(u) // times)
    shift = np.tensordot(drivers, whitening(times), (1, 1)).swapaxes(1, 2).reshape(len(index), len(u)) / u
    return Constraint(entry.kind, names, numbers, function, u, index, shift)


def _function(scene: Scene, entry: CertificateEntry, of: Sequence[Kind]) -> certificate.Certificate:
    """Residuals of a certificate's targets, in the order of `Scene.stated`."""
    if entry.kind == "diameter":
        (one,) = of
        assert isinstance(one, Sphere | Cylinder)
        assert entry.u_distance is not None
        return certificate.diameter(one, one.diameter, entry.u_distance)
    a, b = of
    forms = scene.forms(entry)
    return certificate.join(entry.kind, forms, (a, b), entry.distance, entry.u_distance, entry.u_angle)


def length_blocks(model: Model) -> tuple[Block, ...]:
    """Blocks whose residuals are lengths, m; in a model they precede those of orientations, rad."""
    return tuple(b for b in model.blocks if not isinstance(b, Turned))


def main_group(model: Model) -> str:
    """The noise group with most lengths: reports give other noise scales in addition to its scale."""
    count = Counter[str]()
    for b in length_blocks(model):
        count[b.group] += b.residuals
    return count.most_common(1)[0][0]


def noise_groups(model: Model) -> tuple[str, ...]:
    """All noise groups of a fitted model, that of most lengths first; none if nothing is fitted."""
    present = dict.fromkeys(b.group for b in model.blocks)
    if not length_blocks(model):
        return tuple(present)
    first = main_group(model)
    return (first, *(g for g in present if g != first))
