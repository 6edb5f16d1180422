"""What a diagnosis of a log says of its size, from made fits."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.motion import diagnose as outcome
from bayescal.motion.effects import SATURATES, Form
from bayescal.motion.expected import Expected, expected_of, widened
from bayescal.motion.linear import Part, Table
from bayescal.motion.noise import white_noise
from bayescal.motion.search import NULL, UNKNOWN, Hypothesis, Verdict, _explained, confirmed
from bayescal.motion.settings import OUTCOME, SEARCH, VERDICT
from bayescal.motion.signals import Signals
from bayescal.reporting.motion import record, size_text

LEFT = {"null": 3.0, "named": 1.0}
"""N m, residuals while the arm moves, of the baseline and with the named effect."""


def test_the_gain_is_a_log_likelihood_ratio_and_errors_are_of_moving_rows(monkeypatch):
    """Slow rows, with a hundred times the residual, do not count."""
    moving = np.tile([True, False, True, True], 50)
    speed = np.where(moving, 1.01, -0.99)[:, None] * OUTCOME.moving
    turned = SimpleNamespace(position=np.arange(2.0)[:, None])
    log = SimpleNamespace(of_role=lambda role: [turned], torque_kind="torque")
    s = SimpleNamespace(dq=speed, unfiltered=lambda x: x, log=log, role="validate")
    s.name, s.time, s.step = "last", np.arange(200.0) + 7.0, OUTCOME.block / 10
    part = SimpleNamespace(moves=Signals.moves.fget(s))
    sign = np.where(np.arange(200) % 3, 1.0, -1.0)

    def unfiltered(name, role="validate"):
        return [(part, (np.where(moving, LEFT[name], 100.0) * sign)[:, None])]

    half = np.full(1, 0.5)
    monkeypatch.setattr(outcome, "expected_of", lambda *of: Expected(half, half, np.array([half, half])))

    fits = {
        (): SimpleNamespace(values="null", chi2=lambda held: 30.0),
        ("effect",): SimpleNamespace(values="named", chi2=lambda held: 10.0),
    }
    search = SimpleNamespace(fit=lambda members=(): fits[members])
    chosen = SimpleNamespace(members=("effect",))
    estimate = SimpleNamespace(parts=[s], model=None)
    pool = SimpleNamespace(unfiltered=unfiltered, estimate=estimate, table=Table((), ()))
    found = outcome.shrinkage(search, pool, SimpleNamespace(named=chosen, leading=chosen), None)
    assert found.gain == pytest.approx((30.0 - 10.0) / 2)
    assert [found.before, found.after] == pytest.approx([3.0, 1.0])
    assert found.removed == pytest.approx((9.0 - 1.0) / (9.0 - 0.25))
    assert found.removed_interval95 == pytest.approx([found.removed] * 2)
    assert (found.course.motion, found.course.time[1]) == ("last", 1.0)
    assert np.nanmax(np.abs(found.course.before), axis=0) == pytest.approx([3.0])
    assert np.isnan(found.course.after[~moving]).all()


def test_no_more_than_the_excess_is_removed():
    """What is left may by chance be below the noise."""
    before, after = np.full((4, 2), 3.0), np.full((4, 2), 0.5)
    assert outcome._removed(before, after) == 1.0
    assert outcome._removed(before, 2.0 * after) == pytest.approx(1.0)
    assert outcome._removed(before, 4.0 * after) == pytest.approx(0.5)
    assert np.isnan(outcome._removed(after, after))


def test_the_length_of_a_vector_has_its_u_along_it():
    """By Monte Carlo: two amplitudes, in the units of their priors, that are correlated."""
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    fit = SimpleNamespace(
        names=["x", "y"], sd=np.array([2.0, 4.0]), z=np.array([3.0, 2.0]), covariance=covariance
    )
    size, u = outcome._length(fit, ("x", "y"))
    draws = np.random.default_rng(0).multivariate_normal(fit.z, covariance, 20_000) * [2.0, 4.0]
    assert size == pytest.approx(10.0)
    assert u == pytest.approx(np.std(np.linalg.norm(draws, axis=1)), rel=0.05)


def test_a_headline_states_joints_whose_error_increases():
    def said(after):
        size = np.array([1.0, 0.0])
        parts = [SimpleNamespace(log=SimpleNamespace(mechanism=SimpleNamespace(joint_names=("hip", "knee"))))]
        shrinkage = SimpleNamespace(before=size, after=np.array(after))
        gap = SimpleNamespace(estimate=SimpleNamespace(parts=parts), shrinkage=shrinkage)
        return record._more(gap, record.UNIT, np.ones(2))

    assert said([1.09, 9.0]) == ""
    assert said([1.5, 0.0]) == "; that of some joints increases (hip from 1 to 1.5 N m)"


@pytest.mark.parametrize(
    ("removed", "interval", "wanted"),
    [
        (0.4, (0.3, 0.5), "remove 40 % (30 to 50 %) of the variance of the torque above noise"),
        (-0.11, (-0.36, -0.08), "the variance of the torque above noise increases by 11 % (8 to 36 %)"),
    ],
)
def test_a_share_that_is_negative_is_an_increase(removed, interval, wanted):
    words = record._change(SimpleNamespace(removed=removed, removed_interval95=interval), "torque")
    assert words.endswith(wanted)
    assert ("do not reduce" in words) is (removed < 0.0)


def test_names_explain_their_share_of_a_set_with_an_unknown_cause():
    def hypothesis(nats, *names):
        return SimpleNamespace(names=names, log_evidence=nats)

    best, alone = hypothesis(80.0, "backlash", UNKNOWN), hypothesis(20.0, "backlash")
    assert _explained(best, (best, hypothesis(70.0, UNKNOWN), alone)) == pytest.approx(0.25)
    assert _explained(best, (best,)) == 0.0
    assert _explained(alone, (best, alone)) == 1.0


@pytest.mark.parametrize("nats", [80.0, 0.0])
def test_a_name_stays_while_withheld_motions_gain_what_it_predicts(nats):
    """A change of chi-square 100 is a gain of 50 nats with a standard deviation of 10, were the name true."""
    least = SEARCH.shown * 50.0 - 2.0 * np.hypot(10.0, SEARCH.scatter)
    form = Form("backlash", "joint 1", "side of the torque")
    member = SimpleNamespace(form=form)
    named = Hypothesis((member,), nats, 0.0)
    stated = {"backlash": 0.95, UNKNOWN: 0.03, NULL: 0.02}
    v = Verdict("named", named, named, stated, ("backlash",), {}, 1.0)
    for gain in (least - 0.1, least + 0.1):
        fits = {
            1: SimpleNamespace(chi2=lambda held: 0.0, vector=np.array([6.0, 8.0])),
            0: SimpleNamespace(chi2=lambda held, gain=gain: 2.0 * gain, vector=np.zeros(2)),
        }
        seen = {form: True}
        search = SimpleNamespace(fit=lambda members, fits=fits: fits[len(members)], seen_forms=seen)
        found = confirmed(v, search, SimpleNamespace(gram=np.eye(2)))
        assert (found.named.members == (member,)) == (gain > least)
    small = [SimpleNamespace(chi2=lambda held, k=k: 0.6 * k, vector=np.zeros(2)) for k in (0, 1)]
    costs = SimpleNamespace(fit=lambda members: small[len(members)], seen_forms=seen)
    assert confirmed(v, costs, SimpleNamespace(gram=np.eye(2))) is v  # 0.3 nats where none are predicted
    lost = 0.95 - VERDICT.not_admitted
    takes = UNKNOWN if nats > VERDICT.structure else NULL
    assert found is v
    hidden = SimpleNamespace(fit=search.fit, seen_forms={form: False})
    assert confirmed(v, hidden, SimpleNamespace(gram=np.eye(2))).named.members == ()
    search = SimpleNamespace(fit=lambda members: fits[len(members)], seen_forms=seen)
    fits[0] = SimpleNamespace(chi2=lambda held: -2.0, vector=np.zeros(2))
    refused = confirmed(v, search, SimpleNamespace(gram=np.eye(2)))
    assert refused.probability == pytest.approx(
        stated | {"backlash": VERDICT.not_admitted, takes: stated[takes] + lost}
    )


@pytest.mark.parametrize(("setting", "torque"), [("", 0.4 * 2.0), (SATURATES, 0.4 * 2.0 / 5.0)])
def test_friction_by_speed_states_its_form_and_its_torque(setting, torque):
    """At the RMS speed of the joint while it moves, 2 rad/s; it saturates above 0.5 rad/s."""
    speed = np.tile([2.0, -2.0, 0.0], 20)[:, None]
    log = SimpleNamespace(of_role=lambda role: [], torque_kind="motor")
    s = SimpleNamespace(dq=speed, unfiltered=lambda x: x, moves=np.abs(speed) > OUTCOME.moving, log=log)
    gap = SimpleNamespace(estimate=SimpleNamespace(parts=[s]))
    form = Form("asymmetric-friction", "joint 1", "abs speed", setting)
    text = record._at_speed(gap, SimpleNamespace(form=form, value=0.4, u=0.01))
    assert text.startswith(f" {setting}: " if setting else ": ")
    # with the same relative u
    assert text.partition(": ")[2] == f"{size_text(torque, torque * 0.01 / 0.4, 'N m')} at 2 rad/s"
    other = SimpleNamespace(form=Form("payload", "tool", "mass"), value=1.0, u=0.1)
    assert record._at_speed(gap, other) == ""


def test_no_share_is_all():
    assert [record._per_cent(x) for x in (1.0, 0.996, 0.85)] == ["more than 99 %"] * 2 + ["85 %"]


@pytest.mark.parametrize(
    ("effect", "seen", "names", "why"),
    [
        (UNKNOWN, True, (UNKNOWN,), "no known effect explains it"),
        ("armature", False, ("armature",), "would, but fitted motions do not show it"),
        ("armature", True, ("armature",), "would, but withheld motions deny it"),
        # what is less probable beside a cause that is not known was not denied by any motion
        ("armature", True, ("armature", UNKNOWN), "would, but it is not established beside an unknown cause"),
    ],
)
def test_why_an_error_has_no_name(effect, seen, names, why):
    place = SimpleNamespace(form=Form(effect, "joint 1", "acceleration"))
    verdict = SimpleNamespace(leading=SimpleNamespace(names=names))
    gap = SimpleNamespace(unseen=() if seen else (place.form,), verdict=verdict)
    assert record._why_open(gap, place).endswith(why)


# --- The withheld error that is expected: noise, and a share of what is faster than the rows.

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
