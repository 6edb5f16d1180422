"""The withheld error that is expected: noise, and a share of what is faster than the rows."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.motion.expected import expected_of, widened
from bayescal.motion.linear import Part, Table
from bayescal.motion.noise import white_noise
from bayescal.motion.settings import OUTCOME

STEP = 0.03
TIME = np.arange(0.0, 20.0, STEP)
RNG = np.random.default_rng(0)


def motion(fast, role):
    """A motion of a servo, and the torque of its model: slow, with `fast` N m above the band."""
    log = SimpleNamespace(of_role=lambda role: [SimpleNamespace(position=TIME[:, None])], torque_kind="servo")
    above = fast * np.sqrt(2.0) * np.sin(2 * np.pi * 9.0 * TIME)[:, None]
    torque = 3.0 * np.sin(2 * np.pi * 0.4 * TIME)[:, None] + above
    return SimpleNamespace(
        time=TIME, step=STEP, band=4.0, log=log, role=role, torque=torque, above=above,
        unfiltered=lambda x: x, moves=np.ones((len(TIME), 1), bool),
    )  # fmt: skip


def error(s):
    return 0.2 * RNG.standard_normal((len(TIME), 1)) + OUTCOME.faster * s.above


@pytest.mark.parametrize("times", [1.0, 8.0, 0.1])
@pytest.mark.parametrize("u", [0.0, 0.3])
def test_faster_motions_have_a_larger_error(times, u):
    """Ten times as fast the error was 2 to 13 times what fitted motions left."""
    fitted = [motion(0.5, "calibrate") for _ in range(5)]
    held = [motion(0.5 * times, "validate") for _ in range(2)]
    model = SimpleNamespace(shown=lambda s: s.torque)
    table = SimpleNamespace(parts=[SimpleNamespace(signals=s) for s in held])
    fit = SimpleNamespace(followed=lambda table: [[np.full((9, 1), u)] for _ in held])
    found = expected_of(model, ((s, error(s)) for s in fitted), table, fit)
    assert found.floor == pytest.approx([np.hypot(0.2, 0.5 * OUTCOME.faster)], rel=0.05)
    true = np.sqrt(np.mean(np.concatenate([error(s) for s in held]) ** 2) + u**2)
    assert found.rms == pytest.approx([true], rel=0.06)
    low, high = found.interval95[:, 0] / found.rms
    assert low * high == pytest.approx(1.0)
    # the share is known within a factor of about three
    assert (high > 1.6) == (times > 1.0 or u > 0.0)


def test_faster_withheld_motions_have_more_noise():
    """With that of fitted ones a log without an effect was `unknown` with 22 nats."""
    rows = np.ones((len(TIME), 1))
    signals = motion(0.5, "calibrate"), motion(4.0, "validate")
    parts = tuple(Part(s, rows, rows, (np.zeros(0, int),), ((rows[:, :0],),)) for s in signals)
    noise = white_noise(np.array([0.2]))
    table = widened(SimpleNamespace(shown=lambda s: s.torque), Table((), parts), noise)
    first, last = (p.whitened(noise, p.residual[:, 0], 0) for p in table.parts)
    assert first == pytest.approx(np.full(len(TIME), 5.0))
    more = OUTCOME.faster**2 * (4.0**2 - 0.5**2)
    assert last == pytest.approx(np.full(len(TIME), 1.0 / np.sqrt(0.2**2 + more)), rel=0.01)
