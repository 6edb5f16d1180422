"""Cells of what measures: what they find of an instrument that reads wrong."""

from dataclasses import replace

import numpy as np
import pytest
from camera_sessions import camera_session
from sessions import circumstances, tracker

from bayescal.arm import chain as reference
from bayescal.effects.location import BASE, Driver
from bayescal.gap.search.cell_kinds import beams, region


@pytest.fixture(scope="module")
def session():
    return tracker(count=200).dataset


@pytest.fixture(scope="module")
def away(session):
    """Nominal points from the place of the instrument, (N, 3), m."""
    c = circumstances(session)
    (target,) = session.targets
    return reference.points(c.chain, c.q, c.tool_centres[c.tool]) - target.values["xyz"]


def left_by(cell, wanted, base):
    """Least share of displacements (N, 3) in F0 that no set of a cell represents."""
    shares = []
    for parameters in cell.sets:
        columns = np.zeros((len(parameters), *wanted.shape))
        for column, p in zip(columns, parameters, strict=True):
            for t in p.terms:
                column[:, "xyz".index(t.axis[1])] += np.broadcast_to(t.driver, len(wanted))
        x = (columns @ base.T).reshape(len(parameters), -1).T
        rest = wanted.ravel() - x @ np.linalg.lstsq(x, wanted.ravel(), rcond=None)[0]
        shares.append(np.sum(rest**2) / np.sum(wanted**2))
    return min(shares)


def cell_of(c, form):
    return next(x for x in beams(c) if x.driver == Driver("beam", form=form))


@pytest.mark.parametrize("turned", [False, True])
def test_an_instrument_reads_wrong_by_its_distance_and_its_angles(session, away, turned):
    """A cyclic error of the distance, a scale, and warm air in one direction, whatever axes the base has."""
    c = circumstances(session)
    base = np.eye(4)
    if turned:
        base[:3, :3] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        c = replace(c, chain=replace(c.chain, base=base @ c.chain.base))
        points = reference.points(c.chain, c.q, c.tool_centres[c.tool])
        ((name, rows, place),) = c.instruments
        c = replace(c, instruments=((name, rows, base[:3, :3] @ place),))
        away = points - base[:3, :3] @ place
    distance = np.linalg.norm(away, axis=1)
    beam = away / distance[:, None]
    azimuth = np.arctan2(away[:, 1], away[:, 0])
    azimuth = (azimuth - np.median(azimuth) + np.pi) % (2 * np.pi) - np.pi
    aside = np.stack([-away[:, 1], away[:, 0], np.zeros(len(away))], axis=1)
    cyclic = np.sin(2 * np.pi * 8.0 / np.ptp(distance) * distance + 0.7)[:, None] * beam
    scale = ((distance - distance.min()) / np.ptp(distance) - 0.5)[:, None] * beam
    plume = np.exp(-0.5 * ((azimuth / (0.15 * np.ptp(azimuth))) ** 2))[:, None] * aside
    turn = c.chain.base[:3, :3]
    assert left_by(cell_of(c, "to and fro"), cyclic, turn) < 0.01
    assert left_by(cell_of(c, ""), scale, turn) < 0.05
    assert left_by(cell_of(c, "one place"), plume, turn) < 0.1


def test_only_an_instrument_has_a_beam(cube):
    sessions = cube(seed=7, count=60).dataset, camera_session(images=8, seed=1)
    contacts, images = map(circumstances, sessions)
    assert [*beams(contacts), *beams(images), *region(images)] == []
    assert {cell.site.kind for cell in region(contacts)} == {"probe"}


def test_points_of_an_instrument_are_off_in_one_region(session, away):
    """What a probe has by its normal, an instrument has along three axes."""
    c = circumstances(session)
    (cell,) = region(c)
    assert cell.site == BASE
    size = np.linalg.norm((away - away.mean(axis=0) - 0.5 * away.std(axis=0)) / np.ptp(away, axis=0), axis=1)
    bump = np.exp(-((size / 0.3) ** 2))
    assert left_by(cell, bump[:, None] * [0.3, -0.5, 0.8], c.chain.base[:3, :3]) < 0.25
