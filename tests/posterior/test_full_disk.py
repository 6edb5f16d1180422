"""The record of the draws on a full disk: an error, no crash of the process."""

import subprocess
import sys

import numpy as np

from bayescal.posterior.inference import Record, read_draws, save


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
