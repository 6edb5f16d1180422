"""Designs of the sessions: contacts of the nominal arm, planned once and used with many true arms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bayescal.dataset import Dataset, Target
from bayescal.probing.scene import Scenery
from bayescal.robots import load_robot
from bayescal.simulation import Options
from bayescal.simulation.session import plan

READ_NOISE = 30e-6
"""m, of a coordinate that the instrument reads."""
TRACKER = Target(
    "tracker", "instrument", {"xyz": np.array([2.0, 0.5, 0.3]), "rpy": np.array([0.0, 0.0, np.pi])}
)


@dataclass(frozen=True)
class Design:
    """A kind of session: numbers of rows, share of gross contacts, whether the stated masses are in error."""

    name: str
    summary: str
    contacts: int  # on faces, for the fit
    later: int  # on the same faces, for validation
    repeats: int = 2  # groups of four of the contacts
    points: int = 0  # read by an instrument instead of `contacts`
    gross: float = 0.0  # share of the contacts
    masses: bool = False
    samples: int = 0  # effective draws of the sampler; 0: Gaussian approximation


DESIGNS: tuple[Design, ...] = (
    Design("many", "200 contacts", 200, 20),
    Design("many, outliers", "200 contacts, 5 % gross", 200, 20, gross=0.05),
    Design("few", "30 contacts", 30, 12),
    Design("few, outliers", "30 contacts, 7 % gross", 30, 12, gross=0.07),
    Design("sampled", "30 contacts, sampled by emcee", 30, 12, samples=400),
    Design("two groups", "16 contacts (5 µm) and 40 points of an instrument (30 µm)", 16, 12, 1, points=40),
    Design("masses", "200 contacts, uncertain masses as `gap` assumes", 200, 20, masses=True),
)


@lru_cache(maxsize=8)
def planned(design: Design) -> tuple[Dataset, Scenery]:
    """The session of a design as planned with the nominal arm; its readings do not touch the targets yet."""
    options = Options(
        name=design.name,
        seed=0,
        contacts=design.contacts + design.points,
        later=design.later,
        repeats=design.repeats,
        placements=1,
        sphere_contacts=8,
    )
    robot, _ = load_robot(options.robot)
    dataset, scenery = plan(options, robot)
    return (_read_by_instrument(dataset, design.points) if design.points else dataset), scenery


def _read_by_instrument(dataset: Dataset, count: int) -> Dataset:
    """The session with `count` of its fitted data read by an instrument, instead of touching a face."""
    m = dataset.measurements
    single = np.flatnonzero((m.role == "calibrate") & (m.repeat == ""))
    rows = single[np.linspace(0, len(single) - 1, count).astype(int)]
    target = m.target.copy()
    target[rows] = len(dataset.targets)
    return replace(
        dataset,
        targets=(*dataset.targets, TRACKER),
        noise=replace(dataset.noise, point=READ_NOISE),
        measurements=replace(m, target=target, xyz=np.full((len(target), 3), np.nan)),
    )
