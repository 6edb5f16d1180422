"""The linear problem of a diagnosis: residuals, columns of the model, columns of the candidates.

Everything is linear at one estimate: linear and refitted chi-squares agree to 0.15 %. Contacts are whitened
by their stated noise. `state` then computes noise scale, outliers and evidence of any hypothesis with small
matrices.

Derivatives of every residual by every axis of every frame, of which all columns are made.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from bayescal.arm.motion import CERTIFICATE, CONTACT, IMAGE, TURN, Term
from bayescal.arm.transforms import AXES
from bayescal.effects import Parameter
from bayescal.estimate import Estimate, linearise
from bayescal.estimate.correlated import Decorrelation, Shared
from bayescal.estimate.moments import of_equal_size
from bayescal.estimate.outliers import limit
from bayescal.model import ARM, with_parameters
from bayescal.model.model import length_blocks, main_group


@dataclass(frozen=True)
class Problem:
    """Residuals (R,), Jacobian (R, D) and pool of candidate columns (R, K), contacts first, then constraints.

    Contacts are whitened by their stated noise, and corners by what those of their image share (`images`, see
    `estimate.correlated`); columns are scaled by their prior standard deviations. `z` (D,)
    is where the problem was linearised; the prior mean is 0. `contact` (C,) numbers the contact of each of
    the first C rows; the three rows of a point are used or excluded together. `worth` (C,) is the number of
    independent residuals that each is worth; 1 if not given. `sharing` (contacts,) are those that are no
    outliers of any hypothesis, because they share a cause. `stop` (contacts,) numbers the stop of each, from
    0; without it each is alone. The first L of these rows are lengths, the others orientations, each with its
    own contact number. Columns and evidence use both;
    results in metres are of lengths only.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    pool: np.ndarray
    z: np.ndarray
    contact: np.ndarray
    rows: np.ndarray  # (contacts,) row of the session of each contact
    sigma: np.ndarray  # (L,) m, stated noise of each of the first L rows
    worth: np.ndarray | None = None
    sharing: np.ndarray | None = None
    stop: np.ndarray | None = None
    images: Decorrelation | None = None  # of the first C rows

    def metres(self, x: np.ndarray) -> np.ndarray:
        """Whitened values (R, ...) or (C, ...) of the lengths, m, (L, ...)."""
        x = x[: self.count] if self.images is None else self.images.coloured(x[: self.count])
        return np.asarray((x[: self.lengths].T * self.sigma).T)

    @cached_property
    def base(self) -> np.ndarray:
        """Weights (R,) of rows that are not excluded; constraints 1."""
        out = np.ones(len(self.residual))
        if self.worth is not None:
            out[: self.count] = self.worth
        return out

    @property
    def count(self) -> int:
        """Number C of residuals of contacts."""
        return len(self.contact)

    @property
    def lengths(self) -> int:
        """Number L of residuals that are lengths."""
        return len(self.sigma)

    @cached_property
    def by_size(self) -> list[np.ndarray]:
        """Residuals (C, k) of the contacts of k rows, for every k."""
        return list(of_equal_size(self.contact, self.count))

    @cached_property
    def gross(self) -> np.ndarray:
        """Log density (contacts,) of an outlier: that of a good contact at the limit of rejection."""
        size = np.bincount(self.contact)
        return -0.5 * limit(size) * np.bincount(self.contact, self.base[: self.count]) / size

    @cached_property
    def gross_stops(self) -> np.ndarray:
        """Log density (stops,) of a stop that is wrong as a whole: one measurement of all its rows."""
        assert self.stop is not None
        rows = np.bincount(self.stop[self.contact])
        out = np.empty(len(rows))
        out[self.stop] = -0.5 * limit(rows[self.stop])  # at the level of as many as there are contacts
        return out

    def excluded(self, lost: np.ndarray) -> float:
        """Log density of excluded contacts (K,): each by itself, or those of a stop together.

        Where `worth` is given, all contacts of a stop are worth about one measurement as they are.
        """
        if self.stop is None or self.worth is not None:
            return float(np.sum(self.gross[lost]))
        alone = np.bincount(self.stop[lost], self.gross[lost], len(self.gross_stops))
        return float(np.sum(np.maximum(alone, self.gross_stops)[np.unique(self.stop[lost])]))


def without_nuisance(p: Problem, size: int) -> Problem:
    """The same problem with the first `size` columns of its Jacobian: the model's own parameters."""
    return replace(p, jacobian=p.jacobian[:, :size], z=p.z[:size])


BESIDE = ((TURN, "rx"), (TURN, "ry"), (TURN, "rz"), (IMAGE, "u"), (IMAGE, "v"))
"""Frames and axes that follow those of the chain: turns of the tool, shifts in an image."""


def problem(fitted: Estimate, extra: Sequence[Parameter], nuisance: Sequence[Parameter] = ()) -> Problem:
    """Linearise a fitted model with further parameters, all at zero, as a pool of candidates.

    `nuisance` parameters are added to those of the model in the Jacobian: every hypothesis may use them.
    """
    slopes = Slopes.of(fitted, [p for p in (*nuisance, *extra) if of_certificate(p)])
    return slopes.problem(fitted.z, extra, nuisance)


@dataclass(frozen=True)
class Slopes:
    """Derivatives of every whitened residual by a unit displacement of every axis of every frame.

    The column of any parameter is such a derivative times a driver, so that the chain is evaluated only once.
    """

    residual: np.ndarray  # (R,)
    jacobian: np.ndarray  # (R, D) of the model's own parameters
    axes: np.ndarray  # (C, 6 (n + 2) + 5): of every frame, then of `BESIDE`
    certified_values: Mapping[str, np.ndarray]  # columns (R,) of parameters of certificates, by name
    contact: np.ndarray  # (C,)
    rows: np.ndarray  # (contacts,)
    sigma: np.ndarray  # (L,) m
    worth: np.ndarray | None = None  # (C,) see `Problem`
    sharing: np.ndarray | None = None  # (contacts,)
    stop: np.ndarray | None = None  # (contacts,)
    images: Decorrelation | None = None  # of the C rows; `axes` are those before it
    image: np.ndarray | None = None  # (C,)

    @classmethod
    def of(cls, fitted: Estimate, certified_values: Sequence[Parameter] = ()) -> Slopes:
        """Linearise at an estimate, with full weight of every contact."""
        model = fitted.model
        frames = model.scene.chain.n + 2
        sites = [*((f, axis) for f in range(frames) for axis in AXES), *BESIDE]
        units = [Parameter("", "1", (Term(*site),), 1.0) for site in sites]
        wide = with_parameters(model.scene, model.effects, (*model.parameters, *units, *certified_values))
        arm_size, last = len(model.parameters), len(wide.parameters)
        shift = wide.shift[arm_size:] / wide.sd[arm_size:]
        z = np.concatenate([fitted.z[model.slices[ARM]], -shift, fitted.z[arm_size:]])
        scale = fitted.weights.scale
        main = scale[main_group(model)]
        whole = fitted.weights.full
        weights = replace(whole.apart, scale={g: s / main for g, s in scale.items()})
        linear, shared, images = linearise(wide, z, weights), None, None
        contact, rows, first = [], [], 0
        for b in model.blocks:
            contact.append(np.tile(first + np.arange(len(b.rows)), b.kind.rows))
            rows.append(b.rows)
            first += len(b.rows)
        count = sum(map(len, contact))
        residual, jacobian = linear.residual, linear.jacobian[:, np.r_[0:arm_size, last : wide.size]]
        if whole.shared:
            shared = Shared.joined([whole.shared.get(b.name, b.residuals) for b in model.blocks])
            images = shared.decorrelated()
            residual, jacobian = (
                np.concatenate([images.white(x[:count]), x[count:]]) for x in (residual, jacobian)
            )
        return cls(
            residual,
            jacobian,
            np.asfortranarray(linear.jacobian[:count, arm_size : arm_size + len(units)]),
            {p.name: linear.jacobian[:, arm_size + len(units) + k] for k, p in enumerate(certified_values)},
            np.concatenate(contact),
            np.concatenate(rows),
            np.concatenate([weights.sigma[b.name] * weights.scale[b.group] for b in length_blocks(model)]),
            images=images,
            image=None if shared is None else shared.image,
        )

    def with_noise(self, ratio: np.ndarray) -> Slopes:
        """The same with the noise of each contact times a ratio (contacts,)."""
        by = ratio[self.contact]
        rows = np.append(1.0 / by, np.ones(len(self.residual) - len(by)))
        return replace(
            self,
            residual=self.residual * rows,
            jacobian=self.jacobian * rows[:, None],
            axes=np.asfortranarray(self.axes / by[:, None]),
            certified_values={name: x * rows for name, x in self.certified_values.items()},
            sigma=self.sigma * by[: len(self.sigma)],
        )

    def problem(self, z: np.ndarray, extra: Sequence[Parameter], nuisance: Sequence[Parameter]) -> Problem:
        """The problem with a pool of candidates; see `problem`."""
        jacobian, pool = np.column_stack([self.jacobian, self.columns(nuisance)]), self.columns(extra)
        contacts = self.contact, self.rows, self.sigma, self.worth, self.sharing, self.stop
        z = np.append(z, np.zeros(len(nuisance)))
        return Problem(self.residual, jacobian, pool, z, *contacts, self.images)

    @property
    def gradient(self) -> np.ndarray:
        """Derivatives (L, 3) of the lengths by a displacement along the axes of the base."""
        by = self.axes[:, [AXES.index(axis) for axis in ("tx", "ty", "tz")]]
        return (by if self.images is None else self.images.white(by))[: len(self.sigma)]

    def shared(self, driver: np.ndarray) -> bool:
        """Whether the corners of each image have one value of a driver (contacts,)."""
        if self.image is None:
            return True
        first, image = self._images
        return np.array_equal(driver[first][image], driver)

    @cached_property
    def _images(self) -> tuple[np.ndarray, np.ndarray]:
        """The first contact of each image, and the image of each contact."""
        assert self.image is not None
        of_contact = self.image[np.unique(self.contact, return_index=True)[1]]
        first, image = np.unique(of_contact, return_index=True, return_inverse=True)[1:]
        return first, image

    def columns(self, parameters: Sequence[Parameter]) -> np.ndarray:
        """Columns (R, K) of parameters, each times its prior standard deviation."""
        out = Driven(self, np.arange(len(self.rows)), parameters)[:, :]
        for k, p in enumerate(parameters):
            if of_certificate(p):
                out[:, k] += self.certified_values[p.name]
        return out

    def along(self, frame: int, axis: str) -> np.ndarray:
        """Derivatives (C,) by a displacement of an axis of a frame, or along the directions of contacts."""
        if frame == CONTACT:
            return np.append(1.0 / self.sigma, np.zeros(len(self.contact) - len(self.sigma)))
        beside = (frame, axis) in BESIDE
        column = BESIDE.index((frame, axis)) - len(BESIDE) if beside else 6 * frame + AXES.index(axis)
        return self.axes[:, column]


class Driven:
    """Columns (R, K) as derivatives by sites times drivers, which are computed where they are asked for.

    A driver that is equal in all contacts of a pose is kept once a pose. The columns of drivers that differ
    between the corners of an image are whitened where they are computed. As an array, it has parts
    ``[rows, columns]``, of rows in order and different columns, and products ``vectors @ columns``.

    Parameters
    ----------
    slopes : Slopes
    poses : np.ndarray, shape (contacts,)
        Number of the pose of each contact, from 0.
    parameters : iterable of Parameter
        Of the columns; each is asked for once.
    """

    __array_ufunc__ = None  # so that NumPy leaves products to this class

    def __init__(self, slopes: Slopes, poses: np.ndarray, parameters: Iterable[Parameter]) -> None:
        self._count, size, first = len(slopes.contact), 0, np.unique(poses, return_index=True)[1]
        groups: dict[tuple[Any, ...], tuple[list[int], bytearray]] = {}
        for size, p in enumerate(parameters, start=1):
            for k, t in enumerate(t for t in p.terms if t.frame != CERTIFICATE):
                values = np.asarray(t.driver, float)
                driver = p.sd * (values[slopes.rows] if values.ndim else np.full(len(poses), values))
                alike = np.array_equal(driver[first][poses], driver)
                group = alike, slopes.shared(driver), k, t.frame, t.axis
                numbers, drivers = groups.setdefault(group, ([], bytearray()))
                numbers.append(size - 1)
                drivers.extend(driver[first] if alike else driver)  # grows in place
        self.shape, self._parts = (len(slopes.residual), size), []
        for (alike, shared, _, *site), (numbers, drivers) in groups.items():
            slope, apart = slopes.along(*site), slopes.images
            if shared and apart is not None:
                slope, apart = apart.white(slope), None
            label = (poses if alike else np.arange(len(poses)))[slopes.contact]
            fold = csr_array((slope, (label, np.arange(self._count))), (np.max(label) + 1, self._count))
            every = np.frombuffer(drivers).reshape(len(numbers), -1)
            self._parts.append((np.array(numbers), every, label, slope, fold, apart))

    def __getitem__(self, part: tuple[Any, Any]) -> np.ndarray:
        """Some rows (R',) of some columns (K',), (R', K')."""
        rows, columns = (np.arange(size)[index] for size, index in zip(self.shape, part, strict=True))
        place, out = np.full(self.shape[1], -1), np.zeros((len(columns), len(rows)))
        place[columns], rows = np.arange(len(columns)), rows[rows < self._count]
        for numbers, drivers, label, slope, _, apart in self._parts:
            chosen = np.flatnonzero(place[numbers] >= 0)
            if len(chosen) and apart is not None:
                whole = apart.white((drivers[chosen][:, label] * slope).T)
                out[place[numbers[chosen]], : len(rows)] += whole[rows].T
            elif len(chosen):
                out[place[numbers[chosen]], : len(rows)] += drivers[chosen][:, label[rows]] * slope[rows]
        return out.T

    def __rmatmul__(self, vectors: np.ndarray) -> np.ndarray:
        """Products (..., K) with `vectors` (..., R)."""
        out = np.zeros((self.shape[1], *vectors.shape[:-1]))
        for numbers, drivers, _, _, fold, apart in self._parts:
            across = vectors.T[: self._count]
            out[numbers] += drivers @ (fold @ (across if apart is None else apart.turned(across)))
        return out.T


def of_certificate(p: Parameter) -> bool:
    """Whether a parameter is one of a certificate."""
    return any(term.frame == CERTIFICATE for term in p.terms)
