"""Generic model discrepancy: smooth functions of one coordinate at one site, in families.

A family has one kind of site and one kind of driver ("torque of joints"), and one unknown variance. Half
period k of a function has 1/k of the amplitude of the first (assumed: smooth errors are mostly of long
period). The functions are displacements of frames, as those of effects are.

Clusters of rows that share an error: one stop of the arm, repeats of one contact, equal joint readings.

Circumstances of a fitted model: added loads act through the compliances that the fit found.

An estimate linearised with further parameters of the arm, which are zero at it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.arm.motion import CONTACT, Term
from bayescal.dataset import Measurements
from bayescal.effects import Circumstances, Parameter, compliances, location
from bayescal.effects.common import alone, base_terms, by_reading, tilts, within
from bayescal.effects.compliance import COMPLIANCE
from bayescal.effects.location import BASE, PROBE, TOOL, Driver, Site, joint, link
from bayescal.effects.probe import shapes
from bayescal.estimate.estimate import Estimate
from bayescal.estimate.solver import Linear, linearise
from bayescal.model import ARM, Model, with_parameters
from bayescal.model.scene import Scene

EFFECT = "discrepancy"
"""Effect of the parameters of a discrepancy; no model or vocabulary has one of this name."""
ANGLE, LENGTH = 1e-4, 1e-5
"""Unit amplitudes of rotations, rad, and displacements, m; a family's variance is relative to them."""
WAVES, COURSES = 4, 3
"""Half periods over the range of an angle or torque, and over a session (assumed)."""
STILL = 1e-3
"""Range of a torque, N m, below which it is constant."""


@dataclass(frozen=True)
class Family:
    """Functions of one kind of driver at one kind of site, with one variance."""

    name: str
    parameters: tuple[Parameter, ...]


def unit_range(x: np.ndarray, fitted: np.ndarray) -> np.ndarray | None:
    """A coordinate x (N,) from 0 to 1 over its fitted range; None where it does not vary."""
    low, high = float(np.min(x[fitted])), float(np.max(x[fitted]))
    return np.clip((x - low) / (high - low), 0.0, 1.0) if high > low else None


def cosines(x: np.ndarray, fitted: np.ndarray, count: int) -> list[np.ndarray]:
    """Cosines (N,) of 1 to `count` half periods over the fitted range of a coordinate x (N,)."""
    u = unit_range(x, fitted)
    return [] if u is None else [np.cos(np.pi * k * u) for k in range(1, count + 1)]


def waves(x: np.ndarray, fitted: np.ndarray, count: int = WAVES) -> list[np.ndarray]:
    """`cosines` of size 1/k."""
    return [wave / k for k, wave in enumerate(cosines(x, fitted, count), start=1)]


def families(c: Circumstances) -> list[Family]:
    """All families with a function that varies in the session."""
    joints = range(1, c.robot.n + 1)
    every = {
        "angle of joints": [p for j in joints for p in _turns(c, j, waves(c.q[:, j - 1], c.fitted), j)],
        "angle of other joints": [
            p
            for j in joints
            for k in joints
            if j != k
            for p in _turns(c, j, waves(c.q[:, k - 1], c.fitted), k)
        ],
        "torque of joints": list(_torques(c)),
        "angle of links": [
            p for j in joints for p in _bends(c, j, waves(c.q[:, j - 1], c.fitted), by_reading(c.robot, j))
        ],
        "moment of links": list(_moments(c)),
        "moment of the base": list(_leans(c)),
        **_courses(c),
        "contact direction": [
            _at_contact(PROBE, Driver("contact direction"), c.touching * d)
            for d in (lobes(c) if np.any(c.touching) else ())
        ],
        "form of faces": [
            _at_contact(location.face(f.name), Driver("face"), share * values)
            for f in c.faces
            for _, share, values in shapes(f)
        ],
    }
    return [Family(name, tuple(parameters)) for name, parameters in every.items() if parameters]


def _parameter(site: Site, driver: Driver, terms: tuple[Term, ...], sd: float) -> Parameter:
    unit = "m" if sd == LENGTH else "rad"
    return Parameter("", unit, terms, sd, site=site, driver=driver, effect=EFFECT)


def _turns(
    c: Circumstances, j: int, drivers: list[np.ndarray], by: int, kind: str = "angle"
) -> Iterator[Parameter]:
    axis = c.robot.axes[j - 1]
    driver = by_reading(c.robot, by) if kind == "angle" else Driver(kind, by)
    for d in drivers:
        yield _parameter(joint(j), driver, (Term(j, axis, d),), ANGLE if axis == "rz" else LENGTH)


def _bends(c: Circumstances, j: int, drivers: list[np.ndarray], driver: Driver) -> Iterator[Parameter]:
    for axis in ("rx", "ry", *(("tx", "ty") if c.robot.slides[j - 1] else ())):
        for d in drivers:
            yield _parameter(link(j), driver, (Term(j, axis, d),), ANGLE if axis[0] == "r" else LENGTH)


def _torques(c: Circumstances) -> Iterator[Parameter]:
    if c.torques is not None:
        for j, torque in enumerate(c.torques.T, start=1):
            if np.ptp(torque[c.fitted]) > STILL:
                yield from _turns(c, j, waves(torque, c.fitted), j, "torque")


def _moments(c: Circumstances) -> Iterator[Parameter]:
    if c.moments is None:
        return
    for component in (0, 1):
        for j in range(1, c.robot.n + 1):
            moment = c.moments[:, j, component]
            if np.ptp(moment[c.fitted]) > STILL:
                yield from _bends(c, j, waves(moment, c.fitted), Driver("bending moment"))


def _leans(c: Circumstances) -> Iterator[Parameter]:
    for tilt in tilts(c):
        if np.ptp(tilt.moment[c.fitted]) > STILL:
            for d in waves(tilt.moment, c.fitted, COURSES):
                yield _parameter(BASE, Driver("base moment"), base_terms(c, "r", tilt.axis, d), ANGLE)


def _courses(c: Circumstances) -> dict[str, list[Parameter]]:
    """Families of what may change during a session, by time and by temperature; in each session by itself."""
    if not c.sessions:
        return {name: list(parts) for name, parts in _changes(c)}
    out: dict[str, list[Parameter]] = {}
    for session in c.sessions:
        one = alone(c, session)
        for name, parts in _changes(one) if len(one.fitted) else ():
            out.setdefault(name, []).extend(within(p, session) for p in parts)
    return out


def _changes(c: Circumstances) -> Iterator[tuple[str, Iterator[Parameter]]]:
    clocks = {"time": np.arange(len(c.q), dtype=float) if c.time is None else c.time}
    if c.temperature is not None:
        clocks["temperature"] = c.temperature
    for name, clock in clocks.items():
        drivers = waves(clock, c.fitted, COURSES)
        every = range(1, c.robot.n + 1)
        yield f"{name} of joints", (p for j in every for p in _turns(c, j, drivers, 0, name))
        yield f"{name} of the base", _frame(BASE, 0, Driver(name), drivers)
        for t in c.fitted_tools:
            with_tool = (c.tool == t).astype(float)
            tool = f"tool {c.tool_names[t]}" if len(c.fitted_tools) > 1 else "the tool"
            changes = _frame(TOOL, c.chain.n + 1, Driver(name), [with_tool * d for d in drivers], "t")
            yield f"{name} of {tool}", changes


def _frame(
    site: Site, frame: int, driver: Driver, drivers: list[np.ndarray], kinds: str = "tr"
) -> Iterator[Parameter]:
    for kind in kinds:
        for axis in "xyz":
            for d in drivers:
                sd = LENGTH if kind == "t" else ANGLE / 2
                yield _parameter(site, driver, (Term(frame, kind + axis, d),), sd)


def lobes(c: Circumstances) -> list[np.ndarray]:
    """Harmonics (N,) of second and third degree of the direction of contact."""
    x, y, z = np.where(c.touching[:, None], c.approach, 0.0).T
    second = [x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1.0]
    third = [x * (x * x - 3 * y * y), y * (3 * x * x - y * y), z * (x * x - y * y), x * y * z]
    third += [x * (5 * z * z - 1), y * (5 * z * z - 1), z * (5 * z * z - 3)]
    return second + third


def _at_contact(site: Site, driver: Driver, values: np.ndarray) -> Parameter:
    return _parameter(site, driver, (Term(CONTACT, "normal", values),), LENGTH)


def poses(m: Measurements, rows: np.ndarray) -> np.ndarray:
    """Number (R,) of the pose of each of `rows` (R,), from 0; rows of one pose are not independent.

    Two rows are of one pose if they have the same `stop`, repeat the same contact, or have equal readings.
    """
    from scipy.sparse import coo_array  # slow to import, and not every command needs it
    from scipy.sparse.csgraph import connected_components

    rows = np.asarray(rows, int)
    columns = list(_labels(m, rows))
    label = np.concatenate([number + len(rows) * k for k, (_, number) in enumerate(columns, start=1)])
    index = np.concatenate([member for member, _ in columns])
    size = len(rows) * (len(columns) + 1)
    joined = coo_array((np.ones(len(index)), (index, label)), shape=(size, size))
    component = connected_components(joined, directed=False)[1][: len(rows)]
    return np.unique(component, return_inverse=True)[1]


def stops_of(scene: Scene, rows: np.ndarray) -> np.ndarray:
    """Number (R,) of the stop of each of `rows` (R,), from 0: that of its pose, of a contact its own.

    Repeated contacts come one after another: what they share is no error of one measurement.
    """
    m = scene.dataset.measurements
    touching = np.array([kind.touched for kind in scene.declared])[m.target[rows]]
    of_contact = len(rows) + np.arange(len(rows))
    return np.unique(np.where(touching, of_contact, poses(m, rows)), return_inverse=True)[1]


def _labels(m: Measurements, rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Places (K,) in `rows`, and numbers (K,) below R that are equal for rows of one pose."""
    yield np.arange(len(rows)), _numbers(m.readings[rows])
    for given in (m.stop, m.repeat):
        if given is not None:
            labels = given[rows].astype(str)
            has = np.flatnonzero(labels != "")
            # one label of a repeat is of one target and of one stop of the arm alike
            yield has, _numbers(labels[has])


def _numbers(values: np.ndarray) -> np.ndarray:
    return np.unique(values, axis=0, return_inverse=True)[1].ravel()


LEAST = 0.2
"""Least compliance of a joint through which a load acts, as a share of its prior mean (assumed).

With an estimate near zero, or below, a payload would not deflect the joint.
"""


def with_compliances(c: Circumstances, fitted: Estimate) -> Circumstances:
    """Circumstances with the fitted compliances."""
    return compliant(c, fitted.model, fitted.arm)


def compliant(c: Circumstances, model: Model, values: np.ndarray) -> Circumstances:
    """Circumstances with the compliances of a model for deviations (P,) of its arm, SI."""
    by_name = dict(compliances(model.parameters, values))
    for p in model.parameters:
        if p.effect == COMPLIANCE.name:
            by_name[p.name] = max(by_name[p.name], LEAST * p.centre)
    return replace(c, compliances=by_name)


MOST_VALUES = 1_500_000
"""Values of the columns of functions computed at a time: the model of all takes several times more memory."""


def linearised_with(
    fitted: Estimate, every: list[Parameter]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Whitened columns of the unknowns and of further parameters, residuals, rows; without outliers.

    `every` is empty afterwards: parameters are freed as soon as their columns are known.
    """
    model = fitted.model
    # all columns of the same pass: those of fewer parameters differ in rounding
    rows = np.concatenate([np.tile(b.rows, b.kind.rows) for b in model.blocks])
    used = _used(fitted)
    columns = np.empty((int(np.sum(used)), len(every)))
    at_once = max(MOST_VALUES // len(used), 1)
    for start in range(0, max(len(every), 1), at_once):
        some, every[:at_once] = every[:at_once], []
        linear, index, extra = widened(fitted, some)
        columns[:, start : start + at_once] = linear.jacobian[: len(used), extra][used]
    mine = linear.jacobian[: len(used)][used][:, index]
    return mine, columns, linear.residual[: len(used)][used], rows[used]


def scales_of(fitted: Estimate) -> np.ndarray:
    """Factor on the stated noise by which each residual of `linearised_with` is whitened."""
    scale = fitted.weights.scale
    return np.concatenate([np.full(b.residuals, scale[b.group]) for b in fitted.model.blocks])[_used(fitted)]


def _used(fitted: Estimate) -> np.ndarray:
    """Whether each residual of the blocks is one of a row that is no outlier."""
    row = fitted.weights.row
    return np.concatenate([np.tile(row[b.name], b.kind.rows) for b in fitted.model.blocks]) > 0


def widened(fitted: Estimate, some: Sequence[Parameter]) -> tuple[Linear, np.ndarray, np.ndarray]:
    """A fit with further parameters at zero, linearised; places of its own and of the further unknowns."""
    wide, index, extra = model_with(fitted.model, some)
    z = np.zeros(wide.size)
    z[index] = fitted.z
    return linearise(wide, z, fitted.weights), index, extra


def model_with(model: Model, further: Sequence[Parameter]) -> tuple[Model, np.ndarray, np.ndarray]:
    """A model with further parameters of the arm; places of its own unknowns, and of the further ones."""
    wide = with_parameters(model.scene, model.effects, (*model.parameters, *further))
    first = model.slices[ARM].stop
    extra = np.arange(first, first + len(further))
    return wide, np.setdiff1d(np.arange(wide.size), extra), extra
