"""Joint logs as they are read, and what is refused with its line."""

import gzip
import re
import shutil

import numpy as np
import pytest
from cases import ROOT, cases, refused
from motion.made import write

from bayescal.errors import BayescalError
from bayescal.logs import is_log, read_log

FOREIGN = ROOT.parent / "shared" / "data" / "motion-dev"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("logs") / "log")


@pytest.fixture
def changed(log, tmp_path):
    """A copy of a log whose files are changed: `changed(file, old, new)`."""

    def change(file, old, new, count=1):
        folder = tmp_path / "log"
        if not folder.exists():
            shutil.copytree(log, folder)
        path = folder / file
        text = gzip.decompress(path.read_bytes()).decode() if file.endswith(".gz") else path.read_text()
        text, found = re.subn(old, new, text, count=count)
        assert found
        path.write_bytes(gzip.compress(text.encode()) if file.endswith(".gz") else text.encode())
        return folder

    return change


def test_units_and_roles(log):
    assert is_log(log)
    made = read_log(log)
    assert [m.role for m in made.motions] == ["calibrate"] * 6 + ["validate"] * 2
    assert made.motions[1].same_as == "1"
    assert made.mechanism.centre[1] == pytest.approx([0.15, 0, 0.04])
    assert made.mechanism.transition == pytest.approx(np.deg2rad(1.719))
    assert np.abs(made.motions[0].position).max() < 4.0
    assert made.gravity == pytest.approx([0, 0, -9.81])
    assert made.motions[4].loaded
    assert not made.motions[0].loaded


@pytest.mark.parametrize(("file", "old", "new", "message"), cases("motion_refusals"))
def test_what_is_wrong_is_refused_with_its_place(changed, file, old, new, message):
    refused(message, lambda: read_log(changed(file, old, new)))


def test_further_keys_and_columns_are_noted(changed):
    changed("motion.csv.gz", "payload_kg", "note")
    folder = changed("dataset.yaml", "noise: {", "weather: fine\nnoise: {link_deg: 0.1, ")
    notes = " ".join(read_log(folder).notes)
    assert "weather" in notes
    assert "noise: link_deg" in notes
    assert "columns that are not known were not read: note" in notes


def test_motions_need_two_and_a_table(changed, log, tmp_path):
    folder = changed("dataset.yaml", "name: made", "name: one")
    (folder / "motion.csv").write_text("t_s,motion,q1_deg\n")
    refused("several tables", lambda: read_log(folder))
    (folder / "motion.csv").unlink()
    (folder / "motion.csv.gz").unlink()
    refused("no table of motions", lambda: read_log(folder))
    (folder / "motion.csv.gz").write_bytes(b"no gzip")
    refused("not a gzip file", lambda: read_log(folder))


def test_unsigned_torques_are_not_torques(changed):
    made = read_log(changed("dataset.yaml", "noise: {", "torque: {sign: none}\nnoise: {"))
    assert made.motions[0].torque is None
    assert not made.signed


def test_currents_are_torques_by_their_constants(changed, log):
    changed("motion.csv.gz", r"torque(\d)_Nm", r"current\1_A", 3)
    folder = changed("dataset.yaml", "noise: {", "torque: {constant_Nm_per_A: [2, 4, 8]}\nnoise: {")
    made, before = read_log(folder), read_log(log)
    assert made.torque_kind == "current"
    assert made.u_constant == pytest.approx(0.1)
    assert made.motions[0].torque == pytest.approx(before.motions[0].torque * [2, 4, 8])
    with pytest.raises(BayescalError, match="currents without `constant_Nm_per_A`"):
        read_log(changed("dataset.yaml", r"torque: \{.*\}", "torque: {kind: current}"))


def test_torques_of_motors_are_referred_to_the_joints(changed, log):
    folder = changed("dataset.yaml", "noise: {", "torque: {referred_to: motor}\nnoise: {")
    made, before = read_log(folder), read_log(log)
    assert made.motions[0].torque == pytest.approx(before.motions[0].torque * [100, 100, 80])


@pytest.mark.foreign(FOREIGN)
def test_logs_of_another_author_are_read():
    made = read_log(FOREIGN / "013")
    assert (made.n, len(made.motions)) == (6, 9)
    assert made.mechanism.payload_centre == pytest.approx([0, 0.02, 0.07])
    assert made.notes == ()
