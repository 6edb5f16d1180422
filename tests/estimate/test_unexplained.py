"""What a fit leaves beyond the noise: what is called noise, and from when on an excess is claimed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.estimate import Weights, estimate
from bayescal.estimate.unexplained import Unexplained, repeat_scatter, scatter, unexplained
from bayescal.model import build
from bayescal.model.scene import Scene

NOISE, VALIDATE = 6e-6, 60


def fit_that_leaves(ratio: float, dof: float, stated: float = 5e-6):
    """A fit of contacts without repeats whose residuals are `ratio` times as large as stated."""
    measurements = SimpleNamespace(repeat=None)
    scene = SimpleNamespace(dataset=SimpleNamespace(measurements=measurements))
    block = SimpleNamespace(name="face", group="contact")
    weights = Weights({"face": np.full(30, stated)}, {"face": np.ones(30)}, {"contact": ratio})
    model = SimpleNamespace(scene=scene, blocks=(block,))
    return SimpleNamespace(model=model, weights=weights, dof={"contact": dof})


@pytest.mark.parametrize(
    ("ratio", "dof", "excess"),
    [
        (1.3, 1e5, 0.0),  # a stated noise may be 1.4 times too small
        (2.0, 1e3, np.sqrt(3.0)),  # the difference of squares
        (1.45, 20.0, 0.0),  # noise leaves that much in every third such fit
        (1.8, 20.0, 0.0),  # and that much in 2 of 100
        (1.95, 20.0, np.sqrt(1.95**2 - 1)),  # and that in 3 of 1000
        (0.5, 1e3, 0.0),
    ],
)
def test_an_excess_is_what_no_noise_explains(ratio, dof, excess):
    found = unexplained(fit_that_leaves(ratio, dof))
    assert found.excess == pytest.approx(excess * 5e-6)
    assert found.fitted == pytest.approx(ratio * 5e-6)
    assert found.floor == 5e-6
    assert (found.fitted / found.stated > found.limit(1e-2)) == (excess > 0)


def test_degrees_of_freedom_of_an_excess_are_those_of_drawn_differences():
    """Of two estimated variances: the square of the mean over half the variance, of their difference."""
    rng = np.random.default_rng(0)
    for repeats, of in ((None, 1), (5e-6, 6)):
        own = Unexplained("contact", 5e-6, repeats, of, 8e-6, 0.0, 0.0, 20.0)
        square = own.fitted**2 * rng.chisquare(20.0, 20_000) / 20.0 - own.floor**2
        if repeats:
            square += own.floor**2 - own.floor**2 * rng.chisquare(of, 20_000) / of
        assert own.excess_dof == pytest.approx(2 * np.mean(square) ** 2 / np.var(square), rel=0.1)


@pytest.fixture(scope="module")
def fitted(cube):
    """300 contacts whose noise is twice as large as stated, the last kept back."""
    d = cube(seed=4, count=300, noise=NOISE, stated=NOISE / 2).dataset
    role = np.where(np.arange(300) < 300 - VALIDATE, "calibrate", "validate")
    return estimate(
        build(Scene(replace(d, measurements=replace(d.measurements, role=role))), ("geometry", "compliance"))
    )


def in_pairs(fitted, roles):
    """The session with contacts of the same face and role said to repeat each other, two and two."""
    d = fitted.model.scene.dataset
    m = d.measurements
    repeat, pairs = np.full(len(m.ids), "", dtype="<U20"), 0
    for role in roles:
        for target in range(4):
            rows = np.flatnonzero((m.role == role) & (m.target == target))
            rows = rows[: len(rows) // 2 * 2]
            repeat[rows] = [f"{role}{k // 2}" for k in range(len(rows))]
            pairs += len(rows) // 2
    return replace(d, measurements=replace(m, repeat=repeat)), pairs


def test_the_scatter_of_pairs_is_the_noise_of_one_contact(fitted):
    """A pair deviates from its own mean by 1 / sqrt(2) of it."""
    session, pairs = in_pairs(fitted, ("calibrate", "validate"))
    scatter, dof = repeat_scatter(Scene(session), fitted)
    assert dof == pairs
    assert pairs > 140
    assert scatter == pytest.approx(NOISE, rel=0.12)


def test_repeats_of_validation_rows_count_and_a_slip_does_not(fitted):
    session, pairs = in_pairs(fitted, ("validate",))
    m = session.measurements
    clean, dof = repeat_scatter(Scene(session), fitted)
    assert dof == pairs
    assert clean == pytest.approx(NOISE, rel=0.3)
    readings = m.readings.copy()
    readings[np.flatnonzero(m.repeat == "validate0")[0], :3] += 1e-3
    slipped, _ = repeat_scatter(Scene(replace(session, measurements=replace(m, readings=readings))), fitted)
    assert slipped == pytest.approx(clean, rel=0.1)


def test_few_repeats_of_normal_noise_lose_none():
    """Of 500 sessions with five pairs; a limit of four robust standard deviations lost some in 27 of them."""
    rng, lost = np.random.default_rng(0), 0
    for _ in range(500):
        groups = list(rng.standard_normal((5, 2)))
        size = np.sqrt(2.0 * np.mean([(g - g.mean()) ** 2 for g in groups]))
        lost += scatter(groups)[0] < size - 1e-9
    assert lost <= 5


def test_a_row_weight_divides_the_variance():
    block = SimpleNamespace(name="face", group="contact", kind=SimpleNamespace(rows=3))
    weights = Weights({"face": np.full(6, 2.0)}, {"face": np.array([1.0, 0.25])}, {"contact": 5.0})
    np.testing.assert_allclose(weights.whitening(block), np.tile([0.1, 0.05], 3))
