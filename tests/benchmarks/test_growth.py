"""Sessions of any size are what they claim to be, and costs are those of the process that was run."""

import sys
from pathlib import Path

import numpy as np
import pytest

from analysis.benchmarks import growth
from analysis.benchmarks.growth import Cost
from analysis.benchmarks.large import session
from bayescal.estimate import estimate
from bayescal.model import build
from bayescal.model.scene import Scene


def test_a_large_session_is_one_of_the_arm():
    """Residuals are the noise, in different poses; other rows are for validation."""
    dataset = session(200)
    m = dataset.measurements
    assert [int(np.sum(m.role == role)) for role in ("calibrate", "validate")] == [200, 20]
    assert len(np.unique(m.readings, axis=0)) == 220
    found = estimate(build(Scene(dataset), ("geometry",)))
    assert len(found.rejected) == 0
    assert found.weights.scale["contact"] == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(
    ("code", "done"), [("x = bytearray(300_000_000)", True), ("raise SystemExit(1)", False)]
)
def test_costs_of_a_process(monkeypatch, code, done):
    run = growth.subprocess.run

    def instead(line, **options):  # the program in place of `bayescal`
        return run([*line[:3], sys.executable, "-c", code], **options)

    monkeypatch.setattr(growth.subprocess, "run", instead)
    cost = growth.run("fit", ("fit",), Path("nowhere"), 7)
    assert cost.done is done
    assert cost.contacts == 7
    assert 0 < cost.cpu_s < 30
    assert (cost.peak_mb > 300) is done


def test_exponents_leave_out_small_and_failed():
    costs = [Cost("fit", n, 1.0, 1e-3 * n**1.5, 1.0, True) for n in (1000, 10_000)]
    costs += [Cost("fit", 10, 1.0, 50.0, 1.0, True), Cost("fit", 10**6, 1.0, 1.0, 1.0, False)]
    assert growth.exponents(costs) == pytest.approx({"fit": 1.5})
    assert growth.record(costs)["runs"][0]["contacts"] == 1000
