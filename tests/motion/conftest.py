from dataclasses import replace

import pytest
from motion.made import load_friction, write

import bayescal as bc
from bayescal.logs import read_log
from bayescal.motion import calibrate, possible
from bayescal.motion.estimate import estimated
from bayescal.motion.signals import all_signals


@pytest.fixture(autouse=True, scope="module")
def _few_steps():
    """Draws of a fit take a twentieth of the usual steps; tests of the sampler state their own."""
    with pytest.MonkeyPatch.context() as patch:
        few = replace(possible.CALIBRATION, steps=10_000, burned=1_000)
        for module in (calibrate, possible):
            patch.setattr(module, "CALIBRATION", few)
        yield


@pytest.fixture(scope="session")
def null_log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("motion") / "null")


@pytest.fixture(scope="session")
def rubbing(tmp_path_factory):
    """The diagnosis of a log with friction that grows with load."""
    return bc.diagnose(write(tmp_path_factory.mktemp("motion") / "rubbing", load_friction))


@pytest.fixture(scope="session")
def null_parts(null_log):
    return all_signals(read_log(null_log))


@pytest.fixture(scope="session")
def null_estimate(null_parts):
    return estimated(null_parts)
