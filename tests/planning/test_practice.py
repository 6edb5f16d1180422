"""Practice sessions of set-ups: what `init` writes can be simulated, fitted, and compared with its truth."""

from functools import cache

import numpy as np
import pytest

import bayescal as bc
from bayescal.calibration import fit
from bayescal.dataset import read_dataset
from bayescal.effects import UNITS
from bayescal.errors import BayescalError

OPTIONS = {"contacts": 60, "later": 8, "repeats": 2, "seed": 1}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Maker of the set-up of an artefact, as `init` writes it, once for each."""

    @cache
    def made(artefact):
        path = tmp_path_factory.mktemp("setups") / artefact.replace(",", "-")
        bc.init(path, "lrmate200ic", artefact, tool="60 0 120 mm")
        return path

    return made


@pytest.mark.parametrize("artefact", ["cube", "bar", "tracker"])
def test_a_fit_finds_the_true_arm(folder, artefact, tmp_path):
    simulated = bc.simulate(setup=folder(artefact), **OPTIONS)
    simulated.save(tmp_path / "session")
    session = read_dataset(tmp_path / "session")
    assert not session.unfilled
    found = fit(session, samples=0)
    assert found.acceptance.explains
    left = found.final.unexplained
    assert 0.6 < left.fitted / left.stated < 1.5
    estimate = found.final.estimate
    values = dict(zip(estimate.model.names, estimate.model.physical(estimate.z), strict=True))
    off = []
    for k, p in enumerate(estimate.model.parameters):
        entry = next(t for t in simulated.truth["parameters"] if t["name"] == p.name)
        true = next(v for key, v in entry.items() if key.startswith("value")) / UNITS[p.unit][1]
        off.append((values[p.name] - true) / (estimate.sd[k] * p.sd))
    assert np.sqrt(np.mean(np.square(off))) < 1.5
    assert max(map(abs, off)) < 4.0


def test_the_same_seed_is_the_same_session(folder):
    path = folder("tracker")
    one, same = (bc.simulate(setup=path, **OPTIONS).dataset.measurements for _ in range(2))
    other = bc.simulate(setup=path, **OPTIONS | {"seed": 2}).dataset.measurements
    np.testing.assert_array_equal(one.xyz, same.xyz)
    assert not np.allclose(one.readings, other.readings)


def test_what_a_setup_states_is_refused_as_an_option(folder, tmp_path, command):
    path = folder("cube")
    with pytest.raises(BayescalError, match="a set-up states noise itself"):
        bc.simulate(setup=path, noise=1e-6)
    code, _, error = command("simulate", "--setup", path, "--spheres", 2, "--out", tmp_path / "x")
    assert code == 1
    assert error.startswith("bayescal: --spheres: a set-up states it itself")
    assert not (tmp_path / "x").exists()
    code, out, _ = command(
        "simulate", "--setup", path, "--contacts", 40, "--repeats", 0, "--later", 4, "--out", tmp_path / "y"
    )
    assert code == 0
    assert (tmp_path / "y" / "truth.json").is_file()
    assert "cube.+z: 10 contacts to calibrate, 1 to validate" in out
