"""Sources of error of a calibration, and how each changes its unknowns and the centres of targets.

The error of the unknowns z of a fit is linear in independent errors: of the poses, of the certificates, of
the prior values, of the stated masses, and of the functions of the model discrepancy
(`estimate.discrepancy.Stated`). With a factor B_i for each source, the covariance that the fit states is the
sum of B_i B_i', without a remainder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np

from bayescal.dataset import Certificate
from bayescal.errors import BayescalError
from bayescal.estimate import STATED_WORTH, Estimate
from bayescal.estimate.discrepancy import Stated
from bayescal.estimate.families import poses
from bayescal.model import ARM, ORIENTATION, Block, Scene
from bayescal.predict.forecast import certified_sizes
from bayescal.predict.targets import LocatedTarget, Prepared, centre_of, certified_diameters, prepared
from bayescal.statistics import rms

NOISE, READINGS, CERTIFICATE, PRIOR = "noise", "joint readings", "certificate", "prior value"
DISCREPANCY, UNEXPLAINED, PROBING = "model discrepancy", "unexplained error", "location of the measurand"
MASSES = "masses and centres of mass"
GROUPS = (NOISE, READINGS, CERTIFICATE, PRIOR, MASSES, DISCREPANCY, UNEXPLAINED, PROBING)
"""Groups of components."""
NORMAL = "normal"
"""Distribution of every input: certificates and priors are stated by a standard uncertainty."""


@dataclass(frozen=True)
class Input:
    """A source of error; SI.

    `evaluation` is "A" (from the statistics of this session) or "B" (stated). `value` and `u` are None where
    inputs of several values form one component.
    """

    group: str
    name: str
    evaluation: str
    unit: str
    value: float | None
    u: float | None
    dof: float = inf
    common: str = ""  # name of the component of several such inputs
    scale: str = ""  # the estimate of variance that u is from, where other inputs have the same
    distribution: str = NORMAL


Contribution = tuple[Input, np.ndarray]
"""An input and the changes (K, M) of K quantities by its M independent unit errors."""


@dataclass(frozen=True)
class Basis:
    """What a fit states: its unknowns with their covariance, and what it leaves unexplained.

    Parameters
    ----------
    stated : Stated
    excess : float
        m, unexplained error of each coordinate of a point, beyond the model discrepancy.
    excess_dof : float
        Its effective degrees of freedom.
    precomputed : Prepared, optional
        Validation measurements and located targets of `stated.wide`, where they are known.
    """

    stated: Stated
    excess: float = 0.0
    excess_dof: float = inf
    precomputed: Prepared | None = None

    @cached_property
    def propagated(self) -> tuple[Propagated, ...]:
        """All inputs of the fit."""
        return propagated(self.stated)

    @cached_property
    def prepared(self) -> Prepared:
        """Validation measurements, and the targets that are located from them."""
        return self.precomputed or prepared(self.stated.wide, strict=False)

    def unexplained(self) -> Input:
        """The unexplained error of a coordinate."""
        return Input(UNEXPLAINED, UNEXPLAINED, "A", "m", 0.0, self.excess, self.excess_dof)


@dataclass(frozen=True)
class Propagated:
    """An input and the changes (D', M) of the unknowns of `Stated.wide` by its M independent unit errors.

    `targets` (M,) names the target that each error was measured on, where there are such.
    """

    input: Input
    by: np.ndarray
    targets: np.ndarray | None = None


def propagated(stated: Stated) -> tuple[Propagated, ...]:
    """All inputs of a fit; the sum of their ``by @ by.T`` is the covariance of `stated.wide`."""
    size = len(stated.wide.z)

    def wide(by: np.ndarray) -> np.ndarray:
        out = np.zeros((size, by.shape[1]))
        out[stated.index] = by
        return out

    plain = (*_noise(stated), *_certificates(stated.plain), *_priors(stated.plain))
    return (*(replace(p, by=wide(p.by)) for p in plain), *_functions(stated))


def reading_shares(fitted: Estimate, block: Block, z: np.ndarray) -> np.ndarray:
    """Share (C,) of the variance of a block's rows that noise of the joint readings has; z (size,)."""
    scene = fitted.model.scene
    joint, each = scene.dataset.reading_noise
    if joint <= 0:
        return np.zeros(len(block.rows))
    by = block.by_readings(fitted.arm, z, scene.dataset.robot.link_from_reading * each)
    of_readings = joint**2 * np.sum(by**2, axis=1).reshape(block.kind.rows, -1)
    return np.asarray(np.mean(of_readings / (of_readings + block.sigma**2), axis=0))


def _noise(stated: Stated) -> Iterator[Propagated]:
    """Noise of the poses, by the groups of noise of their rows; with the share of the joint readings."""
    plain = stated.plain
    model, scene = plain.model, plain.model.scene
    kept = {b.name: plain.weights.row[b.name] > 0 for b in model.blocks}
    rows = np.unique(np.concatenate([b.rows[kept[b.name]] for b in model.blocks]))
    pose = poses(scene.dataset.measurements, rows)
    share, groups = np.zeros(len(rows)), [list[str]() for _ in range(pose.max() + 1)]
    for block in model.blocks:
        index = np.searchsorted(rows, block.rows[kept[block.name]])
        if block.group != ORIENTATION:  # read together with a point of the same row
            share[index] = reading_shares(plain, block, plain.z[model.slices[block.target]])[kept[block.name]]
        for p in np.unique(pose[index]):
            if block.group not in groups[p]:
                groups[p].append(block.group)
    label = np.array([" and ".join(sorted(of_pose)) for of_pose in groups])[pose]
    names = np.array([t.name for t in scene.dataset.targets])[scene.dataset.measurements.target]
    index = np.searchsorted(rows, stated.noise_rows)
    for name in dict.fromkeys(label.tolist()):
        columns = np.flatnonzero(label[index] == name)
        dof = sum(plain.dof[g] for g in name.split(" and ")) + STATED_WORTH
        u, u_reading = _sizes(stated, name.split(" and ")[0])
        part, targets, by = share[index[columns]], names[stated.noise_rows[columns]], stated.noise[:, columns]
        unit = "rad" if name == ORIENTATION else "m"
        noise = Input(NOISE, f"noise of {_plural(name)}", "A", unit, 0.0, u, dof, scale=name)
        yield Propagated(noise, by * np.sqrt(1.0 - part), targets)
        if np.any(part):
            readings = Input(
                READINGS, f"noise of joint readings ({_plural(name)})", "A", _of_reading(scene), 0.0,
                u_reading, dof, scale=name,
            )  # fmt: skip
            yield Propagated(readings, by * np.sqrt(part), targets)


def _of_reading(scene: Scene) -> str:
    """SI unit of the noise of readings: that of a revolute joint, if any has noise."""
    return "rad" if scene.dataset.noise.joint or not scene.dataset.noise.slide else "m"


def _plural(group: str) -> str:
    """``contacts``, ``points and orientations``, ``contacts of session 2``."""
    each = (part.partition(" of ") for part in group.split(" and "))
    return " and ".join(f"{noun}s{of}{session}" for noun, of, session in each)


def _sizes(stated: Stated, group: str) -> tuple[float, float]:
    """Standard uncertainty of one residual of a group without the readings' part, and of one reading; SI."""
    plain = stated.plain
    scale = plain.weights.scale[group] * float(np.sqrt(stated.white))
    sigma = np.concatenate([np.tile(b.sigma, b.kind.rows) for b in plain.model.blocks if b.group == group])
    return scale * rms(sigma), scale * plain.model.scene.dataset.reading_noise[0]


def _certificates(fitted: Estimate) -> Iterator[Propagated]:
    """Every certificate that was fitted: its length and its angles."""
    model = fitted.model
    first = sum(b.residuals for b in model.blocks)
    for constraint in model.constraints:
        entry = model.scene.dataset.certificates[constraint.numbers[0]]
        several = len(constraint.numbers)
        by = fitted.covariance @ fitted.linear.jacobian[first : first + constraint.rows].T
        first += constraint.rows
        if entry.points is not None:
            name = f"certificate: coordinates of {entry.points.artefact}"
            common = "certificates of the distances"
            yield Propagated(Input(CERTIFICATE, name, "B", "m", None, None, common=common), by)
            continue
        units = np.array([unit for _, unit in model.scene.stated(entry)] * several)
        entry = replace(entry, targets=entry.parts) if several > 1 else entry
        for unit in dict.fromkeys(units.tolist()):
            columns = np.flatnonzero(units == unit)
            yield Propagated(certificate_input(entry, unit, float(constraint.u[columns[0]])), by[:, columns])


def certificate_input(entry: Certificate, unit: str, u: float) -> Input:
    """The component of the length, or of the angles, of a certificate."""
    what = {"m": "diameter" if entry.kind == "diameter" else "distance", "rad": entry.kind}[unit]
    name = f"certificate: {what} {' - '.join(entry.targets)}"
    value = entry.distance if unit == "m" else None
    return Input(CERTIFICATE, name, "B", unit, value, u, common="certificates of the distances")


def _priors(fitted: Estimate) -> Iterator[Propagated]:
    """The prior value of every unknown; the stated size of a board is a certificate."""
    model = fitted.model
    certified = certified_sizes(model.scene.dataset)
    sd = np.concatenate([model.sd, *(b.sd for b in model.states)])
    centre = np.concatenate([[p.centre for p in model.parameters], *(0.0 * b.sd for b in model.states)])
    for k, name in enumerate(model.names):
        group, words = (CERTIFICATE, "certificate") if name in certified else (PRIOR, "prior value")
        stated = Input(
            group, f"{words} of {name}", "B", model.units[k], float(centre[k]), float(sd[k]),
            common="certificates of the distances" if name in certified else "other prior values",
        )  # fmt: skip
        yield Propagated(stated, fitted.covariance[:, [k]])


def _functions(stated: Stated) -> Iterator[Propagated]:
    """The functions of every family, then masses, with the biases of the parameters that they cause."""
    extra = np.setdiff1d(np.arange(len(stated.wide.z)), stated.index)
    for name in stated.families:
        count = stated.slopes[name].shape[1]
        columns, extra = extra[:count], extra[count:]
        # of normals f: the parameters are off by -A f, the function itself by f
        by = stated.wide.covariance[:, columns]
        p, words = stated.wide.model.parameters[columns[0]], f"model discrepancy: {name}"
        yield Propagated(Input(DISCREPANCY, words, "A", p.unit, 0.0, p.sd, stated.dof[name]), by)
    if len(extra):
        yield Propagated(Input(MASSES, MASSES, "B", "1", None, None), stated.wide.covariance[:, extra])


@dataclass(frozen=True)
class Centre:
    """A centre (3,), m, in F0: its slopes (3, D') by the unknowns of a fit, and errors of its own."""

    position: np.ndarray
    by_z: np.ndarray
    errors: tuple[Contribution, ...]


def centre(basis: Basis, name: str) -> Centre:
    """The centre of a target that was fitted or is located from validation measurements.

    Raises
    ------
    BayescalError
        If the session has no such target, or it has no centre, or no rows.
    """
    wide = basis.stated.wide
    model, scene = wide.model, wide.model.scene
    centred = [t.name for t in scene.dataset.targets if scene.declared_of(t.name).centred]
    if name not in centred:
        there = f"those with a centre: {', '.join(centred)}" if centred else "this session has none"
        raise BayescalError(f"there is no target `{name}` with a centre", "--distance", there)
    if name in model.block_of:
        block, z = model.block_of[name], wide.z[model.slices[name]]
        by_z = np.zeros((3, model.size))
        by_z[:, model.slices[name]] = block.by_z(np.eye(3, len(block.kind.sd)))  # its first components
        return Centre(centre_of(block, block.state(z)), by_z, ())
    located = basis.prepared.located
    if name not in located:
        what = f"{name} has no measurements that are fitted or validate"
        raise BayescalError(what, "--distance", "name targets that were measured")
    t = located[name]
    by_z = np.zeros((3, model.size))
    by_z[:, model.slices[ARM]] = t.to_state[:3] @ t.by_arm
    return Centre(t.centre, by_z, tuple(location_errors(basis, t, t.to_state[:3])))


def reading_errors(
    basis: Basis, block: Block, z: np.ndarray, noise: np.ndarray, by: np.ndarray, names: Sequence[str],
    common: Sequence[str] = ("", ""),
) -> Iterator[Contribution]:  # fmt: skip
    """Errors of rows that were not fitted: their own noise, and the part of the joint readings in it.

    Parameters
    ----------
    basis : Basis
    block : Block
        The rows.
    z : np.ndarray, shape (size,)
        Of their target.
    noise : np.ndarray, shape (R,)
        Of their residuals, m, by the scale of the fit.
    by : np.ndarray, shape (K, R)
        Slopes of quantities by the residuals.
    names, common : sequence of str
        Of both inputs, and of the components of several such inputs.
    """
    wide, group = basis.stated.wide, block.group
    fitted = group in wide.weights.scale
    factor = float(np.sqrt(basis.stated.white)) if fitted else 1.0
    dof = wide.dof[group] + STATED_WORTH if fitted else np.inf
    share = np.tile(reading_shares(wide, block, z), block.kind.rows)
    joint = factor * wide.model.scene.dataset.reading_noise[0] * wide.weights.scale.get(group, 1.0)
    u_noise = float(np.sqrt(np.mean((factor * noise) ** 2 * (1.0 - share))))
    parts = ((1.0 - share, "m", u_noise), (share, _of_reading(wide.model.scene), joint))
    for (part, unit, u), name, several in zip(parts, names, common, strict=True):
        if unit == "m" or np.any(part):
            source = Input(PROBING, name, "A" if fitted else "B", unit, 0.0, u, dof, several, group)
            yield source, by * (factor * noise * np.sqrt(part))


def location_errors(basis: Basis, t: LocatedTarget, by: np.ndarray) -> Iterator[Contribution]:
    """Errors of locating a target, for quantities with slopes `by` (K, m) by its unknowns."""
    name, scene = t.block.target, basis.stated.wide.model.scene
    names = f"location of {name} ({len(t.block.rows)} measurements)", f"joint readings at {name}"
    common = "location of the measured targets", "joint readings at the measured targets"
    yield from reading_errors(basis, t.block, t.z, t.noise, by @ t.gain, names, common)
    yield from _located_priors(t, by, name in certified_diameters(scene))
    if basis.excess:
        of_rows = scene.declared_of(name).of_instrument
        yield basis.unexplained(), basis.excess * by @ (t.gain if of_rows else t.by_shift)


def _located_priors(t: LocatedTarget, by: np.ndarray, certified: bool) -> Iterator[Contribution]:
    """What was stated of a target: its certified diameter, its position, the centre of its tool."""
    name, parts = t.block.target, t.block.kind.parts
    for k, component in enumerate(t.block.free):
        part, unit = parts[component]
        prior = Input(
            PROBING, f"stated {part} of {name}", "B", unit, 0.0, float(t.block.sd[k]),
            common="stated positions of the measured targets",
        )  # fmt: skip
        if part == "diameter":
            nominal = float(t.block.kind.describe(np.zeros(len(parts)))["diameter"])
            what = f"{'certificate' if certified else 'stated'}: diameter {name}"
            common = "diameters of the measured targets"
            prior = replace(prior, group=CERTIFICATE, name=what, value=nominal, common=common)
        yield prior, by @ t.by_prior[:, [k]]
    for k in range(len(t.block.free), len(t.by_prior)):
        what = f"stated tool of {name}, {'xyz'[k - len(t.block.free)]}"
        yield Input(PROBING, what, "B", "m", 0.0, t.tool_sd, common="stated tools"), by @ t.by_prior[:, [k]]
