"""Poses whose rotations are quaternions."""

import numpy as np
import pytest
from cases import refused
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset.table import QUATERNION, RPY, table_of

UNITS = ("deg", "deg")
HEAD = ",".join(("id", "target", "j1_deg", "j2_deg", *QUATERNION))


def table(*rows, head=HEAD):
    lines = [f"p{k},mocap,1,2,{row}" for k, row in enumerate(rows)]
    return table_of("\n".join([head, *lines]).encode(), "measurements.csv", UNITS)


def test_a_quaternion_is_the_rotation_of_its_angles():
    turns = Rotation.random(20, random_state=3)
    rows = [",".join(f"{x:.12f}" for x in q[[3, 0, 1, 2]]) for q in turns.as_quat()]
    angles = table(*rows, ",,,").block(RPY, needed=False)
    for row, expected in zip(angles, turns.as_matrix(), strict=False):
        assert rpy_matrix(row) == pytest.approx(expected, abs=1e-10)
    assert np.isnan(angles[-1]).all()


@pytest.mark.parametrize(("row", "head", "said"), [
    ("0.5,0.5,0.5,", HEAD, "csv:2: the quaternion is not complete"),
    ("1,0.1,0,0", HEAD, "has the length 1.005, not 1; check the columns"),
    ("1,0,0,0,0,0,0", ",".join((HEAD, *RPY)), "both `qw` and `rx_deg` are given"),
    ("1,0,0", HEAD.removesuffix(",qz"), "column `qz` is missing"),
])  # fmt: skip
def test_what_is_no_rotation_is_refused(row, head, said):
    refused(said, lambda: table(row, head=head))
