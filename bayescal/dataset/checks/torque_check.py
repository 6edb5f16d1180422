"""Measured joint torques: present where they are asked for, and with the sign of the load."""

from __future__ import annotations

import numpy as np

from bayescal.arm.chain import chain_of, link_angles
from bayescal.arm.statics import gravity_loads, torques_on_links
from bayescal.dataset.load import load_centre, load_mass
from bayescal.dataset.types import Dataset
from bayescal.errors import BayescalError
from bayescal.files import Document

FELT = 1.0
"""RMS, N m, from which on the computed torque of a joint states a sign (assumed)."""
OPPOSED = -0.8
"""Correlation about zero of measured and computed torques below which their signs differ (assumed)."""


def check_present(dataset: Dataset, document: Document) -> None:
    """Refuse a session that states measured torques and has none."""
    if dataset.torques == "measured" and dataset.measurements.torque is None:
        what = "`torques: measured`, but measurements.csv has no columns `j1_nm` ..."
        raise BayescalError(what, document.where(("torques",)), "add them, or leave `torques` out")


def check_sign(dataset: Dataset, document: Document) -> None:
    """Refuse torques with which the motors hold the arm, in place of those with which the load turns it."""
    robot, m = dataset.robot, dataset.measurements
    if dataset.torques != "measured" or m.torque is None or robot.masses is None:
        return
    q, chain = link_angles(robot, m.readings), chain_of(robot)
    loads = gravity_loads(robot, chain, q, dataset.gravity, load_mass(dataset), load_centre(dataset))
    computed, measured = loads.moments[:, 1:, 2], torques_on_links(robot, m.torque)
    size = np.sqrt(np.mean(computed**2, axis=0) * np.mean(measured**2, axis=0))
    alike = np.mean(computed * measured, axis=0) / np.maximum(size, 1e-12)
    wrong = (np.sqrt(np.mean(computed**2, axis=0)) > FELT) & (alike < OPPOSED)
    if np.any(wrong):
        columns = ", ".join(f"`j{j + 1}_nm`" for j in np.flatnonzero(wrong))
        what = f"{columns}: opposite in sign to the gravity torque of the load"
        remedy = "give the torque with which the load turns the joint, positive in the sense of its reading"
        raise BayescalError(what, document.where(("torques",)), remedy)
