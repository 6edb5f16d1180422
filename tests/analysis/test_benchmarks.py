"""The benchmark's own sums: flops counted by hand, and peers that compute the same thing."""

import importlib.util
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cases import EXAMPLE

from analysis.benchmarks import (
    effective,
    flops,
    growth,
    package_worker,
    page,
    peer_packages,
    peer_scipy,
    problem,
)
from analysis.benchmarks.growth import Cost
from analysis.benchmarks.large import session
from analysis.benchmarks.mixed import EFFECTS, KINDS, mixed, over_parts, part
from bayescal.arm.chain import Chain
from bayescal.arm.motion import Motion, Term
from bayescal.dataset import read_dataset
from bayescal.estimate import estimate, linearise, solve, unit_weights
from bayescal.model import ARM, build
from bayescal.model.scene import Scene
from bayescal.posterior import Density
from bayescal.posterior.linearised import Linearised


@pytest.fixture(scope="module")
def small(cube) -> problem.Problem:
    return problem.of_dataset(cube(seed=3, count=72).dataset, most=48)


def test_faces_keep_their_share(small):
    assert small.contacts == 48
    assert [len(block.rows) for block in small.model.blocks] == [12, 12, 12, 12]


@pytest.mark.parametrize(
    ("terms", "more"),
    [
        ([], 0),
        ([Term(1, "rz"), Term(2, "tz"), Term(1, "rx"), Term(3, "tx")], 0),  # constants are folded
        ([Term(1, "rz", np.array([0.5, 1.0]))], 2 + 16),  # term; sine and cosine
        ([Term(1, "rz", np.array([0.5, 1.0])), Term(1, "rz", np.array([0.3, 1.0]))], 4 + 16),
        ([Term(0, "rx")], 6),  # a turn of the base
        ([Term(0, "ty", np.array([0.5, 1.0]))], 2),
        ([Term(2, "tx", np.array([0.5, 1.0]))], 2 + 2 + 1),  # term; slides along x, y; z on its own
    ],
)
def test_flops_by_hand(terms, more):
    chain = Chain(np.eye(4), np.tile(np.eye(4), (3, 1, 1)), np.zeros(2))
    motion = Motion(chain, np.zeros((2, 2)), np.zeros((2, 3)), list(enumerate(terms)), len(terms))
    # tool 3; two joints of 18 + 6 + 6; first link 18; slides of the base 3; base 18
    assert flops.kernel_flops(motion) == 3 + 2 * 30 + 18 + 3 + 18 + more


def test_residuals_of_the_reference(small):
    z = np.random.default_rng(0).normal(size=small.model.size)
    ours = linearise(small.model, z, small.weights).residual
    theirs = peer_scipy.residual_function(small)(z)
    np.testing.assert_allclose(theirs[:48], ours[:48], rtol=0, atol=1e-8)
    # the order of the certificates is theirs
    np.testing.assert_allclose(np.sort(theirs[48 : -len(z)]), np.sort(ours[48:]), rtol=1e-10)
    np.testing.assert_array_equal(theirs[-len(z) :], z)


def test_scipy_finds_our_optimum(small):
    found = peer_scipy.measure(small, rounds=1)
    assert abs(found["scipy_excess"]) < peer_scipy.NEAR
    assert found["ours_s"] < found["scipy_s"] <= found["scipy_whole_s"]


def test_race_knows_independent_draws():
    rng = np.random.default_rng(0)
    speed = effective.race({"white": lambda: lambda: rng.normal(size=(400, 20, 3))}, rounds=3)["white"]
    assert speed.draws == 24_000
    assert 0.9 < speed.tau < 1.1


def test_race_does_not_mind_thinning():
    rng = np.random.default_rng(0)
    walk = np.zeros((8000, 20, 1))
    for k in range(1, len(walk)):
        walk[k] = 0.98 * walk[k - 1] + rng.normal(size=(20, 1))  # autocorrelation time 99
    all_, some = (effective.race({"": lambda t=t: lambda: walk[::t]}, rounds=1)[""] for t in (1, 10))
    assert all_.taus == pytest.approx(some.taus, rel=0.05)
    assert all_.draws / all_.tau == pytest.approx(some.draws / some.tau, rel=0.05)


def test_the_time_before_the_first_draw_counts(monkeypatch):
    """By a clock that the sampler sets: 7 s of preparation, 2 s a turn."""
    rng = np.random.default_rng(0)
    now = 0.0
    monkeypatch.setattr(effective, "time", SimpleNamespace(perf_counter=lambda: now))

    def spent(seconds, found):
        nonlocal now
        now += seconds
        return found

    turn = lambda: spent(2.0, rng.normal(size=(400, 20, 3)))  # noqa: E731
    speed = effective.race({"slow": lambda: spent(7.0, turn)}, rounds=2)["slow"]
    assert (speed.ready, speed.seconds) == (7.0, 4.0)
    assert speed.whole == pytest.approx(7.0 + 5000 / speed.per_second)


def test_the_page_has_what_was_measured(renewed):
    cost = growth.Cost("fit", 10_000, 20.0, 15.1234, 900.4, True)
    record = {
        "contacts": 500,
        "parameters": 38,
        "ratios": {"a": 12.345, "b": None},
        "raw": {"a": "x", "b": "y"},
    }
    record |= {"seconds": {"c": 4.0}, "growth": growth.record([cost])}
    text = renewed(page, lambda path: page.update(path, record))
    for line in (
        "| `a` | 12.3 | x |",
        "| `b` | - | y |",
        "| `c`, s | 4 |  |",
        "| fit | 10,000 | 15.1 | 20 | 900 |",
    ):
        assert line in text


def test_moves_sample_the_posterior(small):
    from analysis.benchmarks import peer_emcee

    density = Density(small.estimate)
    draws = peer_emcee.ours(density, steps=200)().reshape(-1, density.size)
    sd = small.estimate.sd
    assert np.max(np.abs(draws[:, :-1].mean(axis=0) - small.estimate.z) / sd) < 0.3


@pytest.mark.skipif(importlib.util.find_spec("numpyro") is None, reason="not in the extra `test`: numpyro")
def test_density_in_jax(small):
    from analysis.benchmarks import peer_numpyro

    density = Density(small.estimate)
    assert peer_numpyro.disagreement(small, density) < peer_numpyro.AGREEMENT


@pytest.mark.skipif(importlib.util.find_spec("numpyro") is None, reason="not in the extra `test`: numpyro")
@pytest.mark.parametrize("name", ["nuts", "nuts_given"])
def test_nuts_samples_the_posterior(small, name):
    from analysis.benchmarks import peer_numpyro

    density = Density(small.estimate)
    draws = getattr(peer_numpyro, name)(small, density, steps=500)()[:, 0]
    expected = Linearised.of(density).draw(4000, np.random.default_rng(0))
    sd = expected.std(axis=0)
    assert np.max(np.abs(draws.mean(axis=0) - expected.mean(axis=0)) / sd) < 0.5
    assert np.max(np.abs(np.log(draws.std(axis=0) / sd))) < 0.35


def test_export_to_packages(small):
    given = peer_packages.export(small)
    names = [small.model.parameters[k].name for k in given["index"]]
    assert not any(name.startswith(("beta", "compliance")) for name in names)
    assert given["entry"].size == len(names) == len(set(given["entry"].tolist()))
    assert {"a2", "alpha2", "d3", "theta4", "ball z"} <= set(names)


def _there(package: str) -> bool:
    try:
        return version(package).startswith({"pybotics": "3.", "figaroh": "1."}[package])
    except PackageNotFoundError:
        return False


@pytest.mark.parametrize("package", package_worker.PACKAGES)
def test_residuals_of_packages(small, package):
    if not _there(package):
        pytest.skip(f"not in the extra `test`: {package}")
    given = peer_packages.export(small)
    residuals, size = package_worker.residual_function(package, given)
    z = 1e-3 * np.random.default_rng(0).normal(size=size)  # products of errors have another order in FIGAROH
    whole = np.zeros(small.model.size)
    # what a package lacks stays as drawn
    whole[: small.motion.size] = -small.model.shift / small.model.sd
    whole[given["index"]] = z[: len(given["index"])]
    for block, own in zip(small.model.blocks, z[len(given["index"]) :].reshape(-1, 3), strict=True):
        whole[small.model.slices[block.target]] = own
    expected = peer_scipy.residual_function(small)(whole)[:48]
    np.testing.assert_allclose(residuals(z)[:48], expected, atol=1e-6)
    assert np.max(np.abs(expected - residuals(0.0 * z)[:48])) > 1e-2


def test_same_start_same_end(small):
    """The solver that is timed is the one whose optimum is compared."""
    z, covariance, _ = solve(small.model, small.weights, small.start)
    linear = linearise(small.model, z, small.weights)
    information = linear.jacobian.T @ linear.jacobian + np.eye(small.model.size)
    np.testing.assert_allclose(covariance() @ information, np.eye(small.model.size), atol=1e-5)


# --- The mixed session of the benchmark is its parts put together, and no more work than they are.


@pytest.fixture(scope="module")
def whole():
    return mixed(read_dataset(EXAMPLE))


def test_mixed_is_its_parts(whole):
    """Block by block the same residuals and slopes by the arm, and no further ones but constraints."""
    model = build(Scene(whole), EFFECTS)
    values = model.deviations(np.full(len(model.parameters), 0.1))
    blocks = 0
    for kind in KINDS.values():
        alone = build(Scene(part(whole, kind)), EFFECTS)
        names = {p.name: k for k, p in enumerate(model.parameters)}
        index = [names[p.name] for p in alone.parameters]
        for block in alone.blocks:
            z = np.zeros(block.size)
            r, by_arm, _ = block.linearise(values[index], z)
            same, by_same, _ = model.block_of[block.target].linearise(values, z)
            np.testing.assert_allclose(r, same, atol=1e-15)
            np.testing.assert_allclose(by_arm, by_same[:, index], atol=1e-13)
            blocks += 1
    assert blocks == len(model.blocks)
    z = np.zeros(model.size)
    linear = linearise(model, z, unit_weights(model, z))
    assert len(linear.residual) == sum(b.residuals for b in model.blocks) + sum(
        t.rows for t in model.constraints
    )
    assert model.slices[ARM].stop == len(model.parameters)


def test_over_parts():
    cost = {"planes": 1.0, "spheres": 2.0, "tracker": 3.0, "mixed": 9.0}
    assert over_parts({k: {"solve_s": v} for k, v in cost.items()}, "solve_s") == pytest.approx(1.5)


# --- Sessions of any size are what they claim to be, and costs are those of the process that was run.


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
