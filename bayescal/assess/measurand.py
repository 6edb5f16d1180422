"""Quantities whose uncertainty is stated: linear in the unknowns of a fit and in errors of their own.

Distances have errors of their own: the contacts that locate their ends, or the readings of an instrument; the
certificate that they are compared with; and what neither noise nor parameters explain.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.assess import inputs
from bayescal.dataset.contacts import errors_of_distances
from bayescal.errors import BayescalError
from bayescal.model import ARM
from bayescal.predict.errors import certified_pairs, slopes
from bayescal.predict.forecast import READINGS, read_pairs, workspace
from bayescal.predict.targets import RowPrediction
from bayescal.statistics import grouped, rms

DISTANCE, DISTANCES, POINT, PARAMETER = "distance", "distances", "point", "parameter"
"""Kinds of measurands."""


@dataclass(frozen=True)
class Measurand:
    """K quantities whose errors are linear in the unknowns of a fit, and in errors of their own.

    Attributes
    ----------
    kind, name, unit : str
        Unit in SI.
    value : float or None
        None where the measurand is any of several distances.
    by_z : np.ndarray, shape (K, D')
        Slopes by the unknowns of `Stated.wide`.
    errors : tuple of Contribution
    any_of : bool
        The measurand is any one of the K quantities (a distance in the volume); else all K together (the
        coordinates of a point): its error is then the length of their vector.
    position : np.ndarray, shape (3,), optional
        m in F0, of a point.
    values : tuple of float
        Of each of several distances, where they were measured.
    """

    kind: str
    name: str
    unit: str
    value: float | None
    by_z: np.ndarray
    errors: tuple[inputs.Contribution, ...] = ()
    any_of: bool = False
    position: np.ndarray | None = None
    values: tuple[float, ...] = ()

    @property
    def weight(self) -> float:
        """Factor of the sum of the K variances: their mean, or their sum."""
        return 1.0 / max(len(self.by_z), 1) if self.any_of else 1.0


def certified_distances(basis: inputs.Basis) -> tuple[tuple[str, str], ...]:
    """Certified distances of the session between centres that were not fitted."""
    pairs = certified_pairs(basis.stated.wide.model.scene, basis.prepared.located)
    return tuple((c.targets[0], c.targets[1]) for c, _, _ in pairs)


def distance(basis: inputs.Basis, between: tuple[str, str]) -> Measurand:
    """Error of the distance between two centres, as the arm measures it; its value is none if not certified.

    Raises
    ------
    BayescalError
        If a target has no centre or no rows.
    """
    (first, second) = between
    if first == second:
        raise BayescalError(f"both ends are {first}", "--distance", "name two targets")
    a, b = inputs.centre(basis, first), inputs.centre(basis, second)
    apart = a.position - b.position
    length = float(np.linalg.norm(apart))
    along = (apart / length)[None]
    ends = (a, along), (b, -along)
    errors: list[inputs.Contribution] = [(one, way @ by) for end, way in ends for one, by in end.errors]
    name, value = f"distance {first} - {second}", length
    model = basis.stated.wide.model
    for c in model.scene.dataset.certificates:
        fitted = set(c.targets) <= model.block_of.keys()  # then the certificate is an input of the fit
        if c.kind == "distance" and set(c.targets) == {first, second} and not fitted:
            u = c.u_distance or 0.0
            errors.append((inputs.certificate_input(c, "m", u), np.array([[u]])))
            name, value = f"error of the distance {first} - {second}", length - (c.distance or 0.0)
    return Measurand(DISTANCE, name, "m", value, along @ (a.by_z - b.by_z), _merged(errors))


def distances(basis: inputs.Basis, pairs: Sequence[tuple[str, str]], name: str) -> Measurand:
    """Error of any one of several distances; those of one artefact share the error of its certificate."""
    each = [distance(basis, pair) for pair in pairs]
    by_z, errors = _stacked([(m.by_z, m.errors) for m in each])
    every = [c for c, *_ in certified_pairs(basis.stated.wide.model.scene, basis.prepared.located)]
    certified = [(k, c) for c in every for k, pair in enumerate(pairs) if set(pair) == set(c.targets)]
    changes = np.zeros((len(pairs), len(certified)))
    changes[[k for k, _ in certified]] = errors_of_distances([c for _, c in certified])
    names = [inputs.certificate_input(c, "m", c.u_distance or 0.0).name for _, c in certified]
    shared = {name: changes[:, [j]] for j, name in enumerate(names)}
    errors = [(source, shared.get(source.name, by)) for source, by in errors]
    values = tuple(m.value or 0.0 for m in each)
    return Measurand(DISTANCES, name, "m", None, by_z, in_common(_merged(errors)), any_of=True, values=values)


def _stacked(
    parts: Sequence[tuple[np.ndarray, Sequence[inputs.Contribution]]],
) -> tuple[np.ndarray, list[inputs.Contribution]]:
    """Slopes (K, D') of the quantities of all parts, and the errors of each part, as changes of all K."""
    by_z, out, first = np.concatenate([by for by, _ in parts]), list[inputs.Contribution](), 0
    for by, errors in parts:
        for source, changes in errors:
            out.append((source, np.pad(changes, ((first, len(by_z) - first - len(by)), (0, 0)))))
        first += len(by)
    return by_z, out


def volume(basis: inputs.Basis) -> Measurand:
    """Error of a distance between two points of the probed volume, for the pairs that a fit predicts."""
    wide = basis.stated.wide
    space = workspace(wide)
    count = len(space.pairs)
    by_z = np.zeros((count, wide.model.size))
    if count:
        by_z[:, wide.model.slices[ARM]] = slopes(wide.model, space.motion, space.values, space.pairs)
    errors: tuple[inputs.Contribution, ...] = ()
    if basis.excess:
        # each of the two ends has its own error along the distance
        errors = ((basis.unexplained(), np.full((count, 1), np.sqrt(2.0) * basis.excess)),)
    name = f"error of a distance in the probed volume ({count} distances)"
    return Measurand(DISTANCES, name, "m", None, by_z, errors, any_of=True)


def parameter(basis: inputs.Basis, name: str) -> Measurand:
    """A parameter of the arm or a component of a target's position.

    Raises
    ------
    BayescalError
        If the model has no parameter of this name.
    """
    plain, wide = basis.stated.plain, basis.stated.wide
    names = plain.model.names
    if name not in names:
        what = f"the model has no parameter `{name}`"
        raise BayescalError(what, "--parameter", f"parameters: {', '.join(names)}")
    k = names.index(name)
    sd = np.concatenate([plain.model.sd, *(b.sd for b in plain.model.states)])
    by_z = np.zeros((1, wide.model.size))
    by_z[:, basis.stated.index] = sd[k] * basis.stated.limit[[k]]
    value = float(plain.model.physical(plain.z)[k])
    return Measurand(PARAMETER, f"parameter {name}", plain.model.units[k], value, by_z)


def _merged(errors: Sequence[inputs.Contribution]) -> tuple[inputs.Contribution, ...]:
    """Errors of the same input added; the unexplained ones, which are of different points, side by side."""
    out: dict[str, inputs.Contribution] = {}
    for source, by in errors:
        if source.name in out and source.group == inputs.UNEXPLAINED:
            by = np.concatenate([out[source.name][1], by], axis=1)
        elif source.name in out:
            by = out[source.name][1] + by
        out[source.name] = (source, by)
    return tuple(out.values())


def in_common(errors: Sequence[inputs.Contribution]) -> tuple[inputs.Contribution, ...]:
    """Independent inputs of many targets as a few components: by their common names."""
    out: list[inputs.Contribution] = []
    for name, each in grouped((source.common or source.name, (source, by)) for source, by in errors).items():
        first = each[0][0]
        sizes = {source.u for source, _ in each}
        stated = [u for u in sizes if u is not None]
        u = first.u if len(sizes) == 1 else rms(np.array(stated))
        alike = len({source.value for source, _ in each}) == 1
        both = replace(first, name=name, u=u, value=first.value if alike else None)
        out.append((both, np.concatenate([by for _, by in each], axis=1)))
    return tuple(out)


def readings(basis: inputs.Basis) -> Measurand | None:
    """Error of any distance between readings of one target, for the pairs that a fit predicts."""
    wide = basis.stated.wide
    parts = []
    for r in basis.prepared.rows:
        if (read := read_pairs(wide.model.scene, r.block.target, r.block.rows)) is not None:
            by = _by_residuals(*read, len(r.block.rows))
            parts.append((by @ _slopes(r), list(_errors(basis, r, by))))
    if not parts:
        return None
    by_z, errors = _stacked(parts)
    name = f"error of a distance between {READINGS} ({len(by_z)} distances)"
    return Measurand(DISTANCES, name, "m", None, by_z, in_common(errors), any_of=True)


def _by_residuals(pick: np.ndarray, points: np.ndarray, pairs: np.ndarray, count: int) -> np.ndarray:
    """Slopes (K, 3 C) of the distances of pairs of `points` (3, N) by the residuals of all C rows."""
    first, second = pairs.T
    apart = points[:, first] - points[:, second]
    along = apart / np.linalg.norm(apart, axis=0)
    out = np.zeros((len(pairs), 3, count))
    k = np.arange(len(pairs))
    for axis in range(3):
        out[k, axis, pick[first]] += along[axis]
        out[k, axis, pick[second]] -= along[axis]
    return out.reshape(len(pairs), 3 * count)


def _slopes(r: RowPrediction) -> np.ndarray:
    """Slopes (R, D') of the residuals by the unknowns of a fit, with the target located anew."""
    out = -r.by_z
    if r.target is not None:
        out[:, : r.target.by_arm.shape[1]] -= r.by_target @ r.target.by_arm
    return out


def _errors(basis: inputs.Basis, r: RowPrediction, by: np.ndarray) -> Iterator[inputs.Contribution]:
    """Errors of the readings themselves, and of locating their target; `by` (K, R)."""
    wide = basis.stated.wide
    z = wide.z[wide.model.slices[r.block.target]] if r.target is None else r.target.z
    # rows that locate their target: their errors change the target too
    each = by if not r.locates_target or r.target is None else by + by @ r.by_target @ r.target.gain
    names = "noise of the compared readings", "joint readings at the compared rows"
    yield from inputs.reading_errors(basis, r.block, z, r.noise, each, names)
    if basis.excess and r.target is not None:  # the noise scale of fitted targets includes it
        instrument = wide.model.scene.declared_of(r.block.target).of_instrument
        yield basis.unexplained(), basis.excess * (each if instrument else by @ r.by_point)
    if r.target is not None:
        of_target = inputs.location_errors(basis, r.target, -by @ r.by_target)
        yield from (error for error in of_target if not r.locates_target or error[0].evaluation == "B")
