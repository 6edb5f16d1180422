"""Settings of the posterior of a joint log, of servos and their replay: meaning, unit and origin.

As `bayescal.motion.settings`.
"""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class CalibrationSettings:
    """The posterior of a calibration, and what counts as determined."""

    chains: int = 4
    """Of draws (convention)."""
    fewest: int = 1000
    """Draws at least: intervals need them (assumed)."""
    steps: int = 200_000
    """Of the sampler in all, without the first of each chain (cost)."""
    further: int = 8
    """Times as many steps where chains disagree after the first (cost)."""
    least_thin: int = 10
    """Steps per draw, at least: many draws need more steps (cost)."""
    burned: int = 5_000
    """Steps at the beginning of a chain that are left out (assumed)."""
    at_once: int = 4_000
    """Steps that are prepared at once (cost: memory)."""
    r_hat: float = 1.1
    """Of the draws, from which on chains disagree, and the fit warns where they still do (convention)."""
    worse: float = 1.1
    """Withheld error over that of the nominal arm, from which on a fit is worse (assumed: of an arm that
    is nominal it is 1.02 at most)."""
    for_mean: int = 50_000
    """Steps of the sampler where their mean alone is needed (cost)."""
    few: int = 100
    """Draws of a chain where their mean alone is needed (cost)."""
    halvings: int = 20
    """Of the way from nominal to an estimate that no arm has (cost)."""
    determined: float = 0.5
    """Uncertainty over the prior's up to which a parameter is identifiable (as of contacts)."""
    weakly: float = 0.9
    """The same up to which it is weakly so (as of contacts)."""
    listed: int = 8
    """Combinations that are reported (cost)."""
    parts: int = 4
    """Parameters of a combination that are named (cost)."""


@dataclass(frozen=True)
class TogetherSettings:
    """A session of contacts and a log, fitted together."""

    rounds: int = 6
    """Fits of the session, at most; usual are two or three (cost)."""
    still: float = 0.05
    """Change of the masses over their uncertainty at which the fits end (cost)."""
    poses: int = 20
    """At which the links of both arms are compared (cost)."""
    off: float = 1e-3
    """m, by which a link may move against that of the other arm (assumed)."""
    turned: float = 2e-3
    """rad, by which it may turn (assumed)."""
    lightest: float = 0.05
    """Of a link, over its nominal mass, at which a session is linearised (assumed)."""
    least: float = 0.05
    """Share of its variance by the log that the session takes from a direction that counts (assumed)."""


@dataclass(frozen=True)
class ControllerSettings:
    """Estimate of a controller, and the replay of motions with it."""

    unexplained: float = 0.05
    """Share of the variance of withheld torques that a controller may leave unexplained (assumed)."""
    further: float = 0.2
    """The same share, median of the joints that move, above which a stated controller has a further part:
    servos of a finite bandwidth leave up to 0.13 in single joints (tuned)."""
    beside: float = 0.5
    """Share of the torques of links and rotors beside the gains, above which a controller has a further part:
    1.00 in two logs with feed-forward, up to 0.28 in six without (tuned)."""
    ahead: float = 0.5
    """Gain of the commanded speed over that of the speed, above which damping acts on errors of speed."""
    step: float = 1e-3
    """s, longest step of a simulation (cost)."""
    turn: float = 0.2
    """rad, of the fastest oscillation of a servo in one step (assumed)."""
    steps: int = 40
    """Steps between two rows at most (cost)."""
    passes: int = 4
    """Simulations in which the torque of effects follows the motion before (cost)."""
    settled: float = 0.02
    """Change of the motion by a further pass, over the tracking error, at which it has settled (assumed)."""
    seconds: float = 180.0
    """s of withheld motions after which no further one is simulated (cost)."""
    lost: float = 0.5
    """rad off the log, from which on a simulation does not follow (assumed)."""
    moved: float = 0.2
    """rad by which a joint or its command moves in all, from which on one follows the other (assumed: a joint
    that holds its command sags by less)."""
    follows: float = 0.7
    """Correlation of a position with its command, above which it follows (assumed)."""
    times: float = 3.0
    """Factor between the two, from which on a unit is wrong (assumed)."""
    coarse: float = 0.05
    """s between the rows that are compared (cost)."""
    latest: float = 2.0
    """s, delay of the positions at most (assumed)."""


@dataclass(frozen=True)
class ServoSettings:
    """Logs of position servos without torques."""

    band: float = 4.0
    """Hz, in which the error of a servo is that of its gain, and the noise of encoders little (assumed)."""
    delay: float = 0.03
    """s, standard uncertainty of the delay of commands about half a row (assumed)."""
    speed: float = 0.05
    """rad/s, of the reversal of friction where the stiffness is estimated (assumed)."""
    sag: float = 0.2
    """Error by gravity, over what the estimate of the stiffness leaves, at which it counts (assumed)."""
    loaded: float = 2.0
    """Load by gravity over its u, standard deviations along the log, at which it counts (assumed: the
    stiffness is then known within 50 %, as one of the others would be)."""
    noise: float = 2.0
    """Factor on the noise, for what a model of stiction lacks (tuned)."""
    gain: float = 0.05
    """Relative standard uncertainty of the stiffness of a servo (assumed)."""
    least: float = 0.02
    """The same where the others of a log differ less from what is stated (assumed)."""
    determined: float = 0.5
    """Share of it up to which a log determines a stiffness (as of parameters)."""
    few: int = 2
    """Others that a log must determine (assumed)."""
    rounds: int = 20
    """Iterations of noise and estimate: friction with memory is far from linear (cost)."""
    measured: int = 6
    """Rounds by measured motions before those by simulated ones, which need a good start (tuned)."""
    settled: float = 0.005
    """Relative change of the noise at which these end (cost)."""
    held: tuple[float, float] = (0.03, 0.08)
    """rad/s, speed of a joint up to which rows do not count, and from which on they count fully (assumed)."""
    sudden: float = 3.0
    """Prior standard deviations from which on a transition faster than stated is one that holds (tuned)."""
    poses: int = 20
    """Of a motion, in which inertias are computed (cost)."""
    transition: float = 1e-4
    """rad/s, of friction where none is stated: it holds a joint (assumed)."""
    narrow: float = 2e-4
    """rad, least error that friction holds (cost)."""


CALIBRATION: Final = CalibrationSettings()
TOGETHER: Final = TogetherSettings()
SERVOS: Final = ServoSettings()
CONTROLLER: Final = ControllerSettings()
