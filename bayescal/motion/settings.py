"""Settings of the estimate and diagnosis of joint logs: meaning, unit and origin.

*Convention*, *assumed*, *tuned* and *cost* as in `bayescal.gap.settings`; tuned values were chosen on logs of
simulators with known ground truth.
"""

from dataclasses import dataclass
from typing import Final

from bayescal.gap.settings import VERDICT as GAP_VERDICT


@dataclass(frozen=True)
class SignalSettings:
    """From rows of a log to uniform, low-passed samples."""

    band: float = 10.0
    """Hz, cut-off of the low-pass, at most: control bandwidth and arm modes lie above (tuned)."""
    narrow: float = 2.5
    """Hz, the least (assumed: `margin` holds most of a period of it)."""
    small: float = 0.25
    """Noise of torques by that of accelerations, over that of torques, up to which a band is kept (tuned:
    with 0.4 to 0.7, logs without an effect had 12 nats of an oscillation and 33 of a ripple)."""
    unsure: float = 2.0
    """Power of what is beyond it in the narrowest band, by which noise counts as larger (tuned: with 1.0,
    logs of 20 to 30 Hz with 4096 counts a turn and without an effect were `unknown`)."""
    blurred: float = 1e-3
    """rad/s, noise of speeds from which on rows about reversals do not count: when the direction of friction
    changes is not known (assumed; a tenth of a usual transition speed)."""
    step: float = 0.9
    """A narrower band over the one before, at most (cost)."""
    poses: int = 8
    """Of each motion, at which inertias are computed for it (cost)."""
    wide: float = 20.0
    """Hz, cut-off for positions before they are differentiated, beside `band` (assumed: twice it)."""
    over: tuple[float, ...] = (4.0, 3.0, 2.0)
    """Cut-offs of the speeds by which friction reverses, over that of rows; the first that is not `blurred`,
    and the last for all else (tuned: with 2, friction reversed 0.1 to 0.3 ms late in logs of four
    simulators, whose joints leave a reversal more slowly than they came; joints seemed to have delays)."""
    order: int = 4
    """Of the low-pass (convention)."""
    nyquist: float = 0.8
    """Cut-off over half the sampling rate at most (assumed)."""
    rate: float = 2.4
    """Rows kept per second, over the cut-off (assumed: little of an empty band)."""
    margin: float = 0.3
    """s on both sides of a row that the low-pass needs; of its ends a motion loses as much (assumed)."""
    even: float = 0.02
    """Spread of the steps, over their median, up to which samples are taken as uniform (assumed)."""
    fastest: float = 1000.0
    """Hz, highest rate that is kept (cost)."""
    alike: float = 1e-8
    """rad, within which two readings are the same value, written with other digits (assumed)."""
    held: tuple[float, float] = (0.01, 0.03)
    """rad/s, speed of a joint up to which rows do not count, and from which on they count fully (assumed)."""
    stuck: float = 0.05
    """s, before and after such a speed, in which rows count as little, where stiction is strong: speeds are
    smooth, and a joint that sticks for a moment seems to reverse at once (half a period of `band`)."""
    resting: float = 0.9
    """Share of the samples of a row at rest in a row that is one (assumed)."""
    still: tuple[float, float] = (2.0, 4.0)
    """RMS of the speeds of a joint over `stuck`, over their noise, up to which it rests, and from which on it
    moves (assumed)."""
    rest_range: float = 2e-3
    """rad, of a motion, up to which a joint is taken to rest: what holds it is not its friction (assumed)."""
    long: int = 60_000
    """Samples of a log from which on torques are computed again instead of being kept (cost: 3 kB each)."""
    cold_rows: int = 50
    """Rows at the beginning whose median temperature is the reference (assumed)."""


@dataclass(frozen=True)
class BaselineSettings:
    """Priors of what every model has, where the robot states none."""

    friction: float = 0.5
    """Prior standard deviation of Coulomb friction, and of viscous friction per rad/s, over the scale of the
    torque: its RMS, or the rated torque if smaller (assumed)."""
    offset: float = 0.3
    """Of an offset, over the scale of the torque (assumed)."""
    acceleration: float = 10.0
    """rad/s2, of a rotor that is not stated, at the scale of torques (assumed)."""
    transition: float = 0.15
    """Of the speed scale of the reversal of friction of one joint beside a common one, relative (assumed)."""
    reversal: float = 0.1
    """Of the form of that reversal of one joint beside a common one (assumed)."""
    reversals: float = 0.5
    """Of the common form: one that is linear up to a speed has 0.6 (assumed)."""
    angle: float = 0.01
    """Of an offset of tracking or of a second encoder, rad (assumed)."""
    lag: float = 0.01
    """Of a lag of tracking or of a second encoder, s (assumed)."""
    servo: float = 1.5
    """Hz, bandwidth within which any position servo answers by its stiffness (assumed)."""
    answer: float = 0.05
    """Of the time within which it answers, s (assumed)."""
    least_inertia: float = 0.03
    """Of a principal inertia over the trace, for the prior of its uncertainty (assumed)."""


@dataclass(frozen=True)
class NoiseSettings:
    """Autoregressive noise of the torque residuals."""

    order: int = 12
    """Of the autoregression: of noise with a part of 0.6 s it keeps 0.9 of the density at frequency 0, with 8
    it kept 0.8 (assumed)."""
    of_means: int = 2
    """Iterations of the noise of the means of motions (cost: in 11 logs without an effect the density at
    frequency 0 was 0.68 of the true one with none, 0.87 with two)."""
    ridge: float = 0.01
    """Share of the variance added as white noise: nothing is amplified in an empty band (tuned)."""
    tracking: float = 0.005
    """Least noise of a servo's error over that which its torques ask for: no servo is linear more exactly
    (assumed)."""
    repeats: int = 2
    """Searches after each of which noise is estimated again from what the best hypothesis leaves (cost)."""
    smaller: float = 1.5
    """Variance of residuals over that of repeats from which on repeats determine the noise (assumed)."""
    sure: float = 4.0
    """Standard uncertainties of the logarithm of that variance by which it must be smaller (assumed)."""
    rounds: int = 4
    """Iterations of noise and estimate (cost)."""
    held: int = 1
    """Iteration after which joints at rest are looked at (cost)."""
    stiction: tuple[float, float] = (1.5, 10.0)
    """Mean square of the residuals of joints at rest, over that of the noise, from which on they do not
    count, and from which on rows about reversals do not either, and noise is wider (tuned)."""
    stuck: float = 1.4
    """Factor on the noise of such a log, for what a model of stiction lacks in the rows that remain (tuned:
    of 22 causes in logs of another author 9 were told with 2, 16 with 1.4, and 17 with 1, but two of 14 logs
    without one were not `null` then)."""
    few: int = 30
    """Rows at rest that this takes at least (assumed)."""
    correlated: float = 5.0
    """Rows that are worth an independent one in this test (assumed)."""
    there: float = 0.5
    """Weight of a row below which it is a missing one (assumed)."""


@dataclass(frozen=True)
class FormSettings:
    """Sizes of effects: prior standard deviations, averaged over factors `SEARCH.scales`."""

    payload: float = 0.15
    """Of its mass, relative (assumed)."""
    unstated: float = 0.05
    """Of a payload that is not stated, over the mass of the links (arms carry 0.1 to 0.5 of it; assumed)."""
    reach: float = 0.15
    """m, of its centre from where that of a payload is stated (assumed)."""
    offset: float = 0.015
    """Of its centre of mass, m (assumed)."""
    armature: float = 0.4
    """Of a rotor's inertia, relative (assumed)."""
    acceleration: float = 10.0
    """rad/s2, of a rotor that is not stated, at the scale of torques (assumed)."""
    stribeck: float = 0.3
    """Of the rise at low speed, over the friction (assumed)."""
    stribeck_speeds: tuple[float, ...] = (0.03, 0.06, 0.12, 0.25)
    """rad/s (assumed)."""
    stribeck_powers: tuple[float, ...] = (1.0, 2.0)
    """Of the speed in its exponent (Armstrong-Helouvry, 1994: 0.5 to 2)."""
    load_friction: float = 0.05
    """Of friction per torque (assumed)."""
    asymmetric: float = 0.15
    """Of viscous friction, relative (assumed)."""
    saturation: float = 0.5
    """rad/s, speed above which viscous friction saturates (assumed)."""
    ripple: float = 0.1
    """Of a ripple, over the friction (assumed)."""
    harmonics: tuple[tuple[int, ...], ...] = ((1,), (1, 2))
    """Of the waves, in the forms of a ripple (assumed)."""
    constant: float = 0.1
    """Of a torque constant, relative (assumed)."""
    drift: float = 0.1
    """Of a drift of the torque over `kelvin`, over its RMS (assumed)."""
    kelvin: float = 10.0
    """K, warming of an arm (assumed)."""
    viscous_temperature: float = 0.3
    """Of the change of viscous friction over `kelvin`, relative (assumed)."""
    warm_up: tuple[float, ...] = (0.25, 1.0)
    """Time constants of a warming, over the length of the log (assumed)."""
    delay: float = 3e-3
    """s (assumed)."""
    tilt: float = 0.01
    """rad (assumed)."""
    servo: float = 0.1
    """Of the stiffness of a position servo, relative (assumed)."""
    deflection: float = 5e-4
    """rad, of a gear by its torque (RMS), and of its backlash (assumed)."""
    sides: tuple[float, ...] = (0.05, 0.2, 0.8)
    """Torque over its RMS over which a gear changes sides: a soft gear is like an elastic one (assumed)."""
    one_sided: tuple[float, float] = (0.02, 0.98)
    """Quantiles of the torque of a joint that keeps its sign if theirs is one (assumed)."""
    inertia: float = 2.0
    """Of inertial parameters, over their stated uncertainty (assumed)."""


@dataclass(frozen=True)
class CellSettings:
    """General functions for causes that are not in the list."""

    size: float = 0.1
    """Prior standard deviation, over the friction of the joint (assumed; averaged over factors)."""
    waves: int = 6
    """Half periods of a function of an angle or speed over its range (assumed)."""
    load_waves: int = 4
    """Of a function of a torque (assumed)."""
    time_waves: int = 4
    """Of a function of the time (assumed)."""
    other_waves: int = 3
    """Of a function of another joint (assumed)."""
    pieces: int = 4
    """Parts of a motion in which an offset may differ, unless there are `groups` (assumed)."""
    groups: int = 24
    """Of motions with an offset of their own, at most (cost)."""
    presliding: tuple[float, ...] = (0.005, 0.02, 0.08)
    """rad, way after a reversal over which friction builds up (assumed)."""
    bumps: tuple[float, ...] = (0.06, 0.15)
    """rad, standard width of what happens at one angle (assumed)."""
    clock: float = 1e-3
    """s, drift of the clock over the log (assumed)."""
    force: float = 5.0
    """N (assumed)."""
    turning: float = 0.1
    """rad/s2, of the base (assumed)."""
    gravity: float = 9.81
    """m/s2, usual acceleration at the tool (assumed)."""


@dataclass(frozen=True)
class ProductSettings:
    """Products of responses of a joint and functions of any quantity of the log."""

    angles: int = 6
    """Half periods of a function of an angle over its range (assumed)."""
    waves: int = 2
    """Of a function of another quantity (assumed)."""
    times: int = 4
    """Of a function of the time (assumed)."""
    fading: tuple[float, ...] = (0.5, 2.0, 8.0)
    """s, time constants of what fades since a motion began (assumed)."""
    ways: tuple[float, ...] = (0.02, 0.1, 0.5)
    """rad, ways over which friction builds up (assumed)."""
    wide: float = 3.0
    """Range of a function of a speed, torque or acceleration, over its RMS, to both sides (assumed)."""
    shares: tuple[float, ...] = (0.1, 0.4)
    """Of the torque's RMS, changes over which a hysteresis of the torque builds up (assumed)."""
    lags: tuple[float, ...] = (0.1, 0.5, 2.0)
    """s, of earlier torques (assumed)."""
    short: float = 0.15
    """s, over which power counts (assumed)."""
    long: float = 30.0
    """s, over which heat counts (assumed)."""
    resonances: tuple[float, ...] = tuple(0.7 * 10.0 ** (k / 26.0) for k in range(30))
    """Hz, 0.7 to 9, as near as their width (assumed)."""
    damping: float = 0.05
    """Of a resonance (assumed)."""
    oscillation: float = -6.0
    """Nats, log prior of an oscillation (tuned: the noise of positions, differentiated twice, gave 6 nats to
    one in a log without any effect)."""
    with_memory: tuple[str, ...] = ("", "direction", "torque")
    """Responses that depend on what was before (cost)."""


@dataclass(frozen=True)
class EventSettings:
    """Causes that are no function of the motion."""

    constants: tuple[float, ...] = (0.1, 0.3, 1.0)
    """s, in which a torque comes back after an event (assumed)."""
    samples: float = 4.0
    """Rows of the log in a time constant, at least: a shorter pulse is like a wrong reading (assumed)."""
    length: float = 3.0
    """Length of a pulse, over its time constant (assumed)."""
    tails: tuple[float, ...] = (3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0, 40.0, 1000.0)
    """Degrees of freedom of noise with tails (assumed)."""
    most: int = 12
    """Events at a joint (cost)."""
    visible: float = 0.02
    """Share of a pulse at which it begins in low-passed rows (assumed)."""


@dataclass(frozen=True)
class RelativeSettings:
    """Relatives of names."""

    modulated: float = 0.15
    """Prior odds of a cause that varies with another quantity, over the name alone (assumed)."""
    replaced: float = 0.15
    """Of a cause in proportion to another quantity (assumed)."""
    free: float = 0.15
    """Of a cause that depends on other quantities of the same joint (assumed)."""
    share: float = 0.3
    """Prior standard deviation of a variation, over the prediction of the name (assumed)."""
    least: float = 1e-6
    """Share of the largest prediction of a channel, below which another is left out (cost)."""


@dataclass(frozen=True)
class SearchSettings:
    """Prior probabilities of hypotheses, and the beam that looks for them."""

    null: float = 0.5
    """Prior probability of no effect (assumed)."""
    tolerance: float = 3.0
    """Nats that a cause must gain more (tuned: noise that is not quite autoregressive gives up to 3 to one in
    logs of three authors without any; of 20 causes with a lambda from 70 on none gives less than 8)."""
    single: float = 0.3
    """Of one that is in the list (assumed)."""
    unknown: float = 0.2
    """Of one that is not in it (assumed)."""
    null_enough: float = 0.5
    """Probability of no effect from which on the verdict is null (convention: more likely than not)."""
    shown: float = 0.4
    """Share of the gain that a name predicts for withheld motions which these must show (assumed)."""
    scatter: float = 2.0
    """Nats, standard deviation of that gain by what the noise of withheld motions lacks (assumed)."""
    further: float = 0.2
    """Prior odds of each further effect (as for contacts)."""
    again: float = 0.3
    """Prior odds of an effect at a further joint (assumed)."""
    beside: float = 0.3
    """Prior odds of known effects beside an unknown one (assumed)."""
    detectable: float = 9.0
    """Squared size over noise that an effect must reach at its largest size to be a candidate: 3 sigma."""
    below_best: float = 12.0
    """Nats below the best hypothesis from which on one is not extended (cost)."""
    scales: tuple[float, ...] = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
    """Factors on prior standard deviations over which evidence is averaged (as for contacts)."""
    spread: float = 3.0
    """Factor of these, one sigma of its logarithm (as for contacts)."""
    width: int = 4
    """Hypotheses of one size that are extended (cost)."""
    largest: int = 4
    """Effects in a hypothesis at most (cost)."""
    gain: float = 2.0
    """Nats of evidence from which on a hypothesis is extended (cost)."""
    form: float = 0.03
    """Share of what names explain that a further effect must exceed: it may belong to their form (tuned)."""
    instead: float = 0.1
    """Share of what a name explains by which a general function in its place must explain more (tuned: names
    of effects far above the noise)."""
    waves: tuple[float, float, float] = (4.0, 130.0, 0.3)
    """Waves a turn that are tried for ripple: from, to, and step, over one wave in the range (assumed)."""
    of_motor: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 6.0)
    """Waves a turn of the motor that are tried beside (assumed)."""
    pieces: int = 3
    """Of each motion, in which the phase of a wave may differ (assumed)."""
    most_pieces: int = 60
    """Of all motions (cost)."""
    changing: int = 2
    """Waves of each joint whose phase may differ, that become general functions (cost)."""
    in_proportion: tuple[str, ...] = ("direction", "torque")
    """Responses to which a wave may be in proportion: the best wave of each is a general function (cost)."""
    ripples: int = 4
    """Of each joint that become candidates (cost)."""


@dataclass(frozen=True)
class OutcomeSettings:
    """Place, size and reduction of an error."""

    drawn: int = 400
    """Rows of a motion whose residuals are drawn (cost)."""
    places: int = 6
    """Further cells that are looked at for places (cost)."""
    moving: float = 0.005
    """rad/s of any joint, from which on the arm moves (assumed)."""
    relevant: float = 0.01
    """Share of the withheld RMS of a joint from which on an effect is relevant (format of gap.json)."""
    block: float = 1.0
    """s of residuals that are drawn together for an interval: long against their correlation (assumed)."""
    draws: int = 400
    """Of that bootstrap (cost)."""
    faster: float = 0.25
    """Share of the model's torque above the band of the rows that is an error (tuned: 0.1 to 0.5 of servos in
    20 simulated logs without an effect, withheld motions of which were up to ten times as fast)."""
    unsure: float = 1.0
    """Standard deviation of the logarithm of its square (of the same logs)."""
    slow: float = 0.05
    """rad/s, speed below which friction at low speed shows (assumed)."""
    slow_share: float = 0.02
    """Share of the rows of a joint that should be so slow (assumed)."""


OUTCOME: Final = OutcomeSettings()
VERDICT: Final = GAP_VERDICT
"""Levels of probability are those of a diagnosis of contacts."""
EVENTS: Final = EventSettings()
RELATIVES: Final = RelativeSettings()
PRODUCTS: Final = ProductSettings()
CELLS: Final = CellSettings()
FORMS: Final = FormSettings()
SEARCH: Final = SearchSettings()
BASELINE: Final = BaselineSettings()
NOISE: Final = NoiseSettings()
SIGNALS: Final = SignalSettings()
