"""Sources of error of a calibration, and how each changes its unknowns.

The error of the unknowns z of a fit is linear in independent errors: of the poses, of the certificates, of
the prior values, of the stated masses, and of the functions of the model discrepancy
(`estimate.discrepancy.Stated`). With a factor
B_i for each source, the covariance that the fit states is the sum of B_i B_i', without a remainder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np

from bayescal.dataset import Certificate
from bayescal.estimate import STATED_WORTH, Estimate
from bayescal.estimate.clusters import poses
from bayescal.estimate.discrepancy import Stated
from bayescal.model import ARM, ORIENTATION, Block, Constraint, Scene
from bayescal.model.scene import u_of
from bayescal.predict.rows import Prepared, prepared

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


Own = tuple[Input, np.ndarray]
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
    known : Prepared, optional
        Validation measurements and located targets of `stated.wide`, where they are known.
    """

    stated: Stated
    excess: float = 0.0
    excess_dof: float = inf
    known: Prepared | None = None

    @cached_property
    def propagated(self) -> tuple[Propagated, ...]:
        """All inputs of the fit."""
        return propagated(self.stated)

    @cached_property
    def prepared(self) -> Prepared:
        """Validation measurements, and the targets that are located from them."""
        return self.known or prepared(self.stated.wide, strict=False)

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
        out[stated.own] = by
        return out

    plain = (*_noise(stated), *_certificates(stated.plain), *_priors(stated.plain))
    return (*(replace(p, by=wide(p.by)) for p in plain), *_functions(stated))


def reading_shares(found: Estimate, block: Block, z: np.ndarray) -> np.ndarray:
    """Share (C,) of the variance of a block's rows that noise of the joint readings has; z (size,)."""
    scene = found.model.scene
    joint = scene.dataset.noise.joint
    if joint <= 0:
        return np.zeros(len(block.rows))
    values = found.model.deviations(found.z[found.model.slices[ARM]])
    by = block.by_readings(values, z, scene.dataset.robot.link_from_reading)
    of_readings = joint**2 * np.sum(by**2, axis=1).reshape(block.kind.rows, -1)
    return np.asarray(np.mean(of_readings / (of_readings + block.sigma**2), axis=0))


def _noise(stated: Stated) -> Iterator[Propagated]:
    """Noise of the poses, by the groups of noise of their rows; with the share of the joint readings."""
    found = stated.plain
    model, scene = found.model, found.model.scene
    kept = {b.name: found.weights.row[b.name] > 0 for b in model.blocks}
    rows = np.unique(np.concatenate([b.rows[kept[b.name]] for b in model.blocks]))
    pose = poses(scene.dataset.measurements, rows)
    share, groups = np.zeros(len(rows)), [list[str]() for _ in range(pose.max() + 1)]
    for block in model.blocks:
        at = np.searchsorted(rows, block.rows[kept[block.name]])
        if block.group != ORIENTATION:  # read together with a point of the same row
            share[at] = reading_shares(found, block, found.z[model.slices[block.target]])[kept[block.name]]
        for p in np.unique(pose[at]):
            if block.group not in groups[p]:
                groups[p].append(block.group)
    label = np.array([" and ".join(sorted(own)) for own in groups])[pose]
    names = np.array([t.name for t in scene.dataset.targets])[scene.dataset.measurements.target]
    at = np.searchsorted(rows, stated.noise_rows)
    for name in dict.fromkeys(label.tolist()):
        own = np.flatnonzero(label[at] == name)
        dof = sum(found.dof[g] for g in name.split(" and ")) + STATED_WORTH
        u, u_reading = _sizes(stated, name.split(" and ")[0])
        part, targets, by = share[at[own]], names[stated.noise_rows[own]], stated.noise[:, own]
        unit = "rad" if name == ORIENTATION else "m"
        noise = Input(NOISE, f"noise of {_plural(name)}", "A", unit, 0.0, u, dof, scale=name)
        yield Propagated(noise, by * np.sqrt(1.0 - part), targets)
        if np.any(part):
            readings = Input(
                READINGS, f"noise of joint readings ({_plural(name)})", "A", "rad", 0.0, u_reading, dof,
                scale=name,
            )  # fmt: skip
            yield Propagated(readings, by * np.sqrt(part), targets)


def _plural(group: str) -> str:
    """``contacts``, ``points and orientations``, ``contacts of session 2``."""
    each = (part.partition(" of ") for part in group.split(" and "))
    return " and ".join(f"{noun}s{of}{session}" for noun, of, session in each)


def _sizes(stated: Stated, group: str) -> tuple[float, float]:
    """Standard uncertainty of one residual of a group without the readings' part, and of one reading; SI."""
    found = stated.plain
    scale = found.weights.scale[group] * float(np.sqrt(stated.white))
    own = np.concatenate([np.tile(b.sigma, b.kind.rows) for b in found.model.blocks if b.group == group])
    return scale * float(np.sqrt(np.mean(own**2))), scale * found.model.scene.dataset.noise.joint


def _certificates(found: Estimate) -> Iterator[Propagated]:
    """Every certificate that was fitted: its length and its angles."""
    model = found.model
    first = sum(b.residuals for b in model.blocks)
    for constraint, entry in zip(model.constraints, _entries(model.scene, model.constraints), strict=True):
        by = found.covariance @ found.linear.jacobian[first : first + constraint.rows].T
        first += constraint.rows
        if entry.points is not None:
            name = f"certificate: coordinates of {entry.points.artefact}"
            common = "certificates of the distances"
            yield Propagated(Input(CERTIFICATE, name, "B", "m", None, None, common=common), by)
            continue
        units = np.array([unit for _, unit in model.scene.stated(entry)])
        for unit in dict.fromkeys(units.tolist()):
            own = np.flatnonzero(units == unit)
            yield Propagated(certificate_input(entry, unit, float(constraint.u[own[0]])), by[:, own])


def certificate_input(entry: Certificate, unit: str, u: float) -> Input:
    """The component of the length, or of the angles, of a certificate."""
    what = {"m": "diameter" if entry.kind == "diameter" else "distance", "rad": entry.kind}[unit]
    name = f"certificate: {what} {' - '.join(entry.targets)}"
    value = entry.distance if unit == "m" else None
    return Input(CERTIFICATE, name, "B", unit, value, u, common="certificates of the distances")


def _entries(scene: Scene, constraints: Sequence[Constraint]) -> Iterator[Certificate]:
    """The certificate of each constraint; constraints have the order of the certificates."""
    entries = iter(scene.dataset.certificates)
    for constraint in constraints:
        for entry in entries:
            if entry.points is not None and constraint.kind == entry.kind:
                yield entry
                break
            if (entry.kind, entry.targets) == (constraint.kind, constraint.targets) and scene.stated(entry):
                assert np.array_equal(u_of(entry, scene.stated(entry)), constraint.u)
                yield entry
                break


def _priors(found: Estimate) -> Iterator[Propagated]:
    """The prior value of every unknown."""
    model = found.model
    sd = np.concatenate([model.sd, *(b.sd for b in model.states)])
    centre = np.concatenate([[p.centre for p in model.parameters], *(0.0 * b.sd for b in model.states)])
    for k, name in enumerate(model.names):
        stated = Input(
            PRIOR, f"prior value of {name}", "B", model.units[k], float(centre[k]), float(sd[k]),
            common="other prior values",
        )  # fmt: skip
        yield Propagated(stated, found.covariance[:, [k]])


def _functions(stated: Stated) -> Iterator[Propagated]:
    """The functions of every family, then masses, with the biases of the parameters that they cause."""
    extra = np.setdiff1d(np.arange(len(stated.wide.z)), stated.own)
    for name in stated.families:
        count = stated.slopes[name].shape[1]
        own, extra = extra[:count], extra[count:]
        # of normals f: the parameters are off by -A f, the function itself by f
        by = stated.wide.covariance[:, own]
        p = stated.wide.model.parameters[own[0]]
        yield Propagated(
            Input(DISCREPANCY, f"model discrepancy: {name}", "A", p.unit, 0.0, p.sd, stated.dof[name]), by
        )
    if len(extra):
        yield Propagated(Input(MASSES, MASSES, "B", "1", None, None), stated.wide.covariance[:, extra])
