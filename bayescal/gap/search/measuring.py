"""Cells of what measures: a probe, the faces that it touches, and instruments."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from bayescal.arm import chain as reference
from bayescal.arm.motion import Term
from bayescal.effects import EFFECTS, Circumstances, Parameter, location
from bayescal.effects.location import BASE, PROBE, Driver
from bayescal.effects.probe import shapes
from bayescal.estimate.families import lobes, unit_range
from bayescal.gap.search.makers import Cell, at_contact, movers, smooth
from bayescal.gap.settings import CELLS


def probe(c: Circumstances) -> Iterator[Cell]:
    """A probe by the direction and the speed of contact."""
    if not np.any(c.touching):
        return
    on = c.touching.astype(float)
    yield Cell(PROBE, Driver("contact direction"), (at_contact(on, lobes(c)),))
    if c.speed is not None:
        waves = smooth(np.where(c.touching, c.speed, 0.0), c.fitted, 2)
        yield Cell(PROBE, Driver("contact speed"), (at_contact(on, waves),) if waves else ())


def region(c: Circumstances) -> Iterator[Cell]:
    """A probe or an instrument by the position in the workspace: everywhere, or in one region."""
    place = _points(c)
    low, high = place[c.fitted].min(axis=0), place[c.fitted].max(axis=0)
    half = np.maximum(0.5 * (high - low), 1e-3)
    u = np.clip((place - 0.5 * (low + high)) / half, -1.2, 1.2)
    on = c.touching.astype(float)
    spots = [
        1.0 / (1.0 + (np.linalg.norm(u - centre, axis=1) / CELLS.region_size) ** 3)
        for centre in itertools.product(CELLS.region_grid, repeat=3)
    ]
    seen = [s for s in spots if np.sum(s[c.fitted] > 0.5) >= CELLS.fewest / 2]
    local = Driver("workspace", form="one region")
    if np.any(c.touching):
        products = [u[:, i] * u[:, j] for i in range(3) for j in range(i, 3)]
        yield Cell(PROBE, Driver("workspace"), (at_contact(on, [*u.T, *products]),))
        yield Cell(PROBE, local, tuple(at_contact(on, [s]) for s in seen))
    if instruments := _instruments(c):
        (base,), read = movers(c)[BASE], np.sum([rows for _, rows, _ in instruments], axis=0)
        yield Cell(BASE, local, tuple(tuple(p for p in base(read * s) if p.unit == "m") for s in seen))


def beams(c: Circumstances) -> Iterator[Cell]:
    """An instrument by its distance, azimuth and elevation: smoothly, at one place, or in waves.

    It reads these, as a joint reads its angle: warm air in one direction, a cyclic error of the distance,
    the eccentricity of an encoder.
    """
    for name, rows, place in _instruments(c):
        mine = c.fitted[rows[c.fitted] > 0]
        if len(mine) < CELLS.fewest:
            continue
        quantities, axes = _polar(_points(c) - place, mine)
        along = axes @ c.chain.base[:3, :3]  # as the base is displaced
        smoothly, local, waves = [], [], []
        for k, x in enumerate(quantities):
            share = unit_range(x, mine)
            if share is None:
                continue
            smoothly += [_shifted(rows, axis, smooth(x, mine)) for axis in along]
            for bump in _bumps(share, mine):
                local += [_shifted(rows, axis, bump) for axis in along]
            least, most, step = CELLS.beam_waves
            for turns in np.arange(least, min(most, len(mine) / 3), step):
                phase = 2 * np.pi * turns * share
                waves.append(_shifted(rows, along[k], [np.sin(phase), np.cos(phase)]))
        for form, sets in (("", smoothly), ("one place", local), ("to and fro", waves)):
            yield Cell(location.face(name), Driver("beam", form=form), tuple(sets))


def _instruments(c: Circumstances) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Instruments that are no cameras, as `Circumstances.instruments`: these have cells of their images."""
    views = {v.name for v in c.views}
    return [one for one in c.instruments if one[0] not in views]


def _points(c: Circumstances) -> np.ndarray:
    """TCP positions (N, 3) at nominal geometry, in F0, m."""
    return reference.points(c.chain, c.q, c.tool_centres[c.tool])


def _polar(away: np.ndarray, fitted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance, azimuth and elevation (3, N) of points (N, 3) from an instrument, and their axes (3, N, 3).

    The azimuth is zero where most of the fitted points are.
    """
    x, y, z = away.T
    middle = np.arctan2(np.mean(y[fitted]), np.mean(x[fitted]))
    distance, level = np.linalg.norm(away, axis=1), np.hypot(x, y)
    azimuth = (np.arctan2(y, x) - middle + np.pi) % (2 * np.pi) - np.pi
    beam = away / np.maximum(distance, 1e-9)[:, None]
    aside = np.cross([0.0, 0.0, 1.0], beam)
    quantities = np.stack([distance, azimuth, np.arctan2(z, level)])
    return quantities, np.stack([beam, aside, np.cross(beam, aside)])


def _shifted(rows: np.ndarray, axis: np.ndarray, drivers: Sequence[np.ndarray]) -> tuple[Parameter, ...]:
    """Displacements of points along an axis that varies with the row (N, 3), at rows (N,) where it is 1."""
    return tuple(
        Parameter("", "m", tuple(Term(0, f"t{a}", rows * u * d) for a, u in zip("xyz", axis.T, strict=True)),
                  CELLS.length)
        for d in drivers
    )  # fmt: skip


def _bumps(share: np.ndarray, fitted: np.ndarray) -> Iterator[list[np.ndarray]]:
    """Functions at one place of a range: what rises there, and what is to one side and the other."""
    for width in CELLS.beam_widths:
        for centre in np.arange(0.0, 1.0 + width, width):
            far = (share - centre) / width
            rise = np.exp(-0.5 * far**2)
            if np.sum(rise[fitted] > 0.5) >= CELLS.fewest / 2:
                yield [rise, far * rise]


def faces(c: Circumstances) -> Iterator[Cell]:
    """A face by the position on it: everywhere, or at one spot."""
    for face in c.faces:
        site = location.face(face.name)
        spots = []
        for width, end, count in CELLS.face_spots:
            centre = np.linspace(-end, end, count)[:, None, None]
            first, second = np.moveaxis(((face.place - centre) / width) ** 2, -1, 0)  # (count, N) each
            every = np.exp(-0.5 * (first[:, None] + second)).reshape(count**2, -1) * face.rows
            seen = np.sum(every[:, c.fitted] > 0.5, axis=1) >= CELLS.fewest_on_spot
            spots += [at_contact(face.rows, [spot]) for spot in every[seen]]
        yield Cell(site, Driver("face", form="one spot"), tuple(spots))
        form = at_contact(face.rows, [values for _, _, values in shapes(face)])
        yield Cell(site, Driver("face"), (form,), of_known_effect="plane-form" in EFFECTS)


MEASURING = (probe, region, beams, faces)
"""Functions that list the cells of what measures, in the order of the cells."""
