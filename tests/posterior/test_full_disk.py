"""The record of the draws on a full disk: an error, no crash of the process."""

import errno
import resource
import subprocess
import sys

import numpy as np
import pytest

from bayescal.posterior import inference
from bayescal.posterior.inference import Patient, Record, read_draws, save


def record(draws: int) -> Record:
    values = np.arange(4.0 * draws).reshape(4, draws)
    return Record({"posterior": {"a2": ((), values)}}, {"chain": np.arange(4), "names": np.array(["x"])})


def test_what_is_written_is_read(tmp_path):
    path, draws = tmp_path / "posterior.nc", record(50)
    save(draws, path)
    assert np.array_equal(read_draws(path, ["a2"])["a2"], draws.groups["posterior"]["a2"][1])


LIMITED = """
import resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_full_disk import record
from bayescal.posterior.inference import save
for limit in (0, 3000, 100_000, 600_000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        save(record(20_000), Path(sys.argv[2]))
    except OSError as error:
        print(error.strerror)
"""


def test_a_full_disk_is_an_error_and_no_crash(tmp_path):
    """At every stage of the file; HDF5 itself ends the process (exit code 139) or prints its tracebacks."""
    line = [sys.executable, "-c", LIMITED, __file__.rpartition("/")[0], str(tmp_path / "posterior.nc")]
    done = subprocess.run(line, capture_output=True, text=True)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", 4 * "File too large\n")


@pytest.mark.parametrize("room", [0, 7, 20])
def test_the_content_continues_in_memory(tmp_path, monkeypatch, room):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        file = Patient(tmp_path / "x")
        assert file.write(b"0123456789") == 10
        file.seek(4)
        file.write(b"abc")
        file.seek(0)
        buffer = bytearray(20)
        assert buffer[: file.readinto(buffer)] == b"0123abc789"
        assert (file.error is None) == (room == 20)
        assert file.error is None or file.error.errno == errno.EFBIG
        file.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_an_error_of_the_close_is_raised(tmp_path, monkeypatch):
    class Late(inference.Patient):
        def close(self):
            super().close()
            self.error = OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(inference, "Patient", Late)
    with pytest.raises(OSError, match="No space left"):
        save(record(50), tmp_path / "posterior.nc")
