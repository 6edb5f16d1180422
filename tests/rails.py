"""A session of an arm on a rail before a tracker, by the independent simulator: files, and as a dataset."""

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from analysis.world import rail
from bayescal.dataset import read_dataset


def folder_of(made, folder):
    """The folder, with the files of a session."""
    for name, text in made.texts.items():
        (folder / name).write_text(text)
    return folder


@cache
def rail_session(count=150):
    """A session of few rows."""
    with tempfile.TemporaryDirectory() as folder:
        return read_dataset(folder_of(rail.make(3, count), Path(folder)))


@cache
def moving_session(count=150):
    """The same with all that effects ask for: speeds, times, a payload in some rows, motor turns."""
    dataset, rng = rail_session(count), np.random.default_rng(0)
    m, n = dataset.measurements, len(dataset.measurements.ids)
    velocity = rng.choice([-1.0, 1.0], m.readings.shape) * np.where(dataset.robot.slides, 0.1, 0.05)
    time, payload = np.arange(n, dtype=float), 2.0 * (np.arange(n) % 2)
    rows = replace(m, velocity=velocity, time=time, payload=payload, line=m.line)
    robot = replace(dataset.robot, reductions=np.array([53.0, 120, 121, 100, 100, 50, 50]))
    return replace(dataset, measurements=rows, robot=robot)
