"""The result of a diagnosis as frozen records, from which terminal, gap.json and figures are made.

All values are in SI (m, rad), except the coordinates of curves. `Gap` contains all other records.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from bayescal.assess.undetermined import Undetermined
from bayescal.dataset import Dataset
from bayescal.effects.location import Driver, Site, words_of
from bayescal.effects.selection import Selection
from bayescal.estimate import Estimate
from bayescal.estimate.bounds import UNCHANGED, Rigid
from bayescal.estimate.scatter import Scatter
from bayescal.model.options import FitOptions, Part

VALIDATION_CONTACTS, VALIDATION_POINTS = "validation contacts", "validation points"
"""Kinds of validation measurement, as reports name them."""
OTHER = "other"
"""A cause that is not in the list of known effects, as a member of a class."""
MOVES = frozenset({"event", "time", "temperature", "count", "load", "activity", "wait"})
"""Kinds of drivers of errors that may be of any site."""
MARGINS = ("target", "joint", "region", "time", "direction")
"""Groups by which residuals are listed."""
VERDICTS = ("null", "named", "named+unexplained", "class", "unknown", "ambiguous")


@dataclass(frozen=True)
class Measured:
    """A measured RMS error and its prediction by sessions simulated with the calibrated model, m."""

    what: str  # "validation contacts", "sphere distances", "validation points"
    count: int
    rms: float
    predicted_rms: float  # root mean square over the posterior predictive
    predicted_interval95: tuple[float, float]


@dataclass(frozen=True)
class Magnitude:
    """Size of the gap, m."""

    validation: str  # how: "validation data", or "leave-one-out cross-validation" where there are too few
    validation_rms: float
    noise: float  # of a contact
    noise_interval95: tuple[float, float]
    noise_from: str  # "repeats", "fit" (of the last model) or "stated"
    excess: float  # root of the difference of squares, 0 where the noise is larger
    excess_interval95: tuple[float, float]
    measured: tuple[Measured, ...]


@dataclass(frozen=True)
class Curve:
    """Residual along the coordinate that explains it, and the fitted function, at the fitted contacts."""

    coordinate: str  # with its unit, e.g. "reading of joint 4 (deg)"; "" without a single coordinate
    x: np.ndarray  # (C,) in that unit
    residual: np.ndarray  # (C,) m, under the model without this cell
    fitted: np.ndarray  # (C,) m, the part that the cell explains
    rows: np.ndarray  # (C,) of the session
    lever: np.ndarray | None = None  # (C,) residual per unit of displacement, where the site has one axis
    unit: str = ""  # SI, of that displacement: "rad" or "m"


TOGETHER = "displacement of the TCP by all of its parts, RMS"
"""The amplitude of an effect of which no part is significant alone."""


@dataclass(frozen=True)
class Amplitude:
    """The amplitude of an effect at one site, SI: a named one from the refit, or an unmodelled one."""

    effect: str
    site: Site
    driver: Driver
    parameters: tuple[str, ...]  # their names
    what: str  # "half-width"
    value: float
    u: float  # standard uncertainty
    unit: str  # a key of effects.UNITS
    phase: tuple[float, float] | None  # of a wave, with u, rad
    significant: bool  # at OUTCOME.significant, corrected for all amplitudes of the effect


@dataclass(frozen=True)
class Event:
    """First row of the session after a sudden change, from 0, and its 95 % interval (first, last)."""

    row: int
    interval95: tuple[int, int]


@dataclass(frozen=True)
class Place:
    """A location (site and driver) and its part of the gap."""

    site: Site
    driver: Driver
    rms: float  # m, of the part that it explains at the fitted contacts and the model does not absorb
    share: float  # of the excess variance
    p_value: float
    family_p_value: float  # corrected for all cells
    log_evidence: float  # nats, relative to noise only
    explained_by: str  # the named effect that it belongs to, or ""
    curve: Curve
    event: Event | None = None  # of an unmodelled sudden change, which may explain most of another location
    amplitudes: tuple[Amplitude, ...] = ()  # of that change, or of a base that rocks
    neighbours: tuple[Site, ...] = ()  # where an error would look the same


@dataclass(frozen=True)
class Margin:
    """A bin of a margin: residuals of calibration and validation contacts, m."""

    label: str  # key in gap.json: "cube.+x", "joint 4: -90 to -30 deg", ...
    text: str  # the same for reports: "J4 from -90 to -30 deg", "direction of motion of J3, positive"
    count: int
    rms: float
    mean: float
    p_value: float  # of noise only, corrected for all bins of all margins


@dataclass(frozen=True)
class Named:
    """A named effect."""

    effect: str
    model: str  # in the form of --model: "backlash", "step@212"
    sites: tuple[Site, ...]  # () for all its sites
    setting: str  # as text, or ""
    probability: float
    log_evidence: float  # nats, relative to the same set without it
    confirmed: bool = True  # False where it makes the validation data less probable
    events: tuple[Event, ...] = ()  # of sudden changes
    neighbours: tuple[Site, ...] = ()  # where an error would look the same
    terms_with: tuple[str, ...] = ()  # named effects with which it fits any function of its coordinate

    @property
    def site(self) -> str:
        """Its sites as text, "" for all."""
        return words_of(self.sites)


@dataclass(frozen=True)
class Hypothetical:
    """A set of effects with its probability."""

    effects: tuple[str, ...]  # () is null; may end with "unknown"
    probability: float
    log_evidence: float  # nats, relative to noise only


@dataclass(frozen=True)
class CauseClass:
    """Causes that the data do not distinguish: an error at some sites, by some quantities of the session."""

    sites: tuple[Site, ...]
    drivers: tuple[Driver, ...]
    members: Mapping[str, float]  # probability of each effect, and of `OTHER`


@dataclass(frozen=True)
class Verdict:
    """The verdict and its probabilities."""

    kind: str  # one of VERDICTS
    named: tuple[Named, ...]
    probability: Mapping[str, float]  # of null, unknown and every effect that was assessed
    credible_set90: tuple[str, ...]
    hypotheses: tuple[Hypothetical, ...]  # the most probable first
    footnotes: tuple[str, ...]  # effects too small to be relevant, and results of the validation, as text
    missing: Mapping[str, str]  # effects that were not assessed, and the reason
    notes: tuple[str, ...]  # as text: backlash or delayed readings, limits of a probability
    causes: CauseClass | None = None  # of a verdict `class`


@dataclass(frozen=True)
class Shrinkage:
    """Reduction of the error of a kind of validation measurement, m."""

    what: str  # "planes", "distances" or "points"
    count: int
    before: float
    after: float
    floor: float  # expected RMS for a correct model
    removed: float  # share of the excess variance removed; nan without an excess
    removed_interval95: tuple[float, float]
    predicted_before: float  # RMS that the refitted model predicts for the baseline, from fitted data only
    predicted: float  # RMS that the refitted model predicts for itself
    claimed: bool  # False where no improvement is predicted, or where a named effect is not confirmed


@dataclass(frozen=True)
class Step:
    """A model level."""

    model: tuple[str, ...]
    validation_rms: float
    distance_rms: float  # nan without distances
    point_rms: float  # nan without points
    delta_elpd: float  # change in log predictive density of validation data from the level before, nats
    delta_elpd_se: float


@dataclass(frozen=True)
class NextContact:
    """A contact to be measured, SI."""

    target: str
    tool: str
    readings: tuple[float, ...]  # of the joints, rad, in the convention of the session
    velocity: tuple[float, ...] | None  # of the readings at the contact, rad/s, where the session records it
    payload: float | None  # kg
    repeat_of: str  # the contact of the session that it repeats unchanged, or ""


@dataclass(frozen=True)
class Advice:
    """Next measurements that distinguish two explanations."""

    separates: tuple[str, str]
    what: str
    poses: tuple[tuple[float, ...], ...]  # joint readings, rad, the best first
    lambda_before: float
    lambda_after: float
    contacts: tuple[NextContact, ...] = ()  # to be measured, the best first; () if they are measured already


@dataclass(frozen=True)
class Suspect:
    """An effect that may be true: in the form of --model, "bending at link 3", with its fitted parameters.

    `values` are deviations from nominal by the name of the parameter, SI, and `units` their SI units. Without
    values any plausible value may be true: a random draw of the prior.
    """

    model: str
    values: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def selection(self) -> Selection:
        """Effect, setting and sites."""
        return Selection.read(self.model)


Side = tuple[Suspect, ...]
"""Effects that are true together; () is noise only."""


@dataclass(frozen=True)
class Pair:
    """Two explanations between which the data do not decide, and the effects that both contain.

    Without effects in `b`, those of `a` are to be confirmed.
    """

    a: Side
    b: Side = ()
    common: Side = ()

    @property
    def reversed(self) -> Pair:
        """The same with exchanged sides."""
        return Pair(self.b, self.a, self.common)


@dataclass(frozen=True)
class BlindSpot:
    """An effect of plausible amplitude that these data would not detect."""

    effect: str
    site: Site
    smallest: float  # minimum detectable amplitude, SI
    plausible: float  # prior standard deviation, SI
    unit: str  # SI, a key of effects.UNITS
    distance_error: float  # RMS error of a sphere distance at the plausible amplitude, m; nan if unknown


@dataclass(frozen=True)
class Gap:
    """A diagnosis of the gap between model and machine."""

    dataset: Dataset
    baseline: tuple[str, ...]
    options: FitOptions  # with the parts that the baseline lacks
    magnitude: Magnitude
    where: tuple[Place, ...]
    margins: Mapping[str, tuple[Margin, ...]]  # target, joint, region, time, direction
    verdict: Verdict
    shrinkage: tuple[Shrinkage, ...]
    levels: tuple[Step, ...]
    advice: tuple[Advice, ...]
    blind_spots: tuple[BlindSpot, ...]
    residuals: tuple[
        np.ndarray, np.ndarray, np.ndarray
    ]  # rows of the session, before, after (m), fitted ones
    warnings: tuple[str, ...]
    excluded: tuple[np.ndarray, np.ndarray]  # rows of the session, by the fits before and after
    amplitudes: tuple[Amplitude, ...] = ()  # of all named effects
    refit: tuple[str, ...] = ()  # the refitted model, in the form of --model
    still_without: tuple[Part, ...] = ()  # parts that the refitted model lacks
    undecided: tuple[Pair, ...] = ()
    arm: Estimate | None = None  # with the named effects that are confirmed: what an export is made of
    calibrated: Estimate | None = None  # of the baseline, before any refit
    covariance: np.ndarray | None = None  # (D, D) of its z, with the model discrepancy and errors of masses
    displaced: tuple[str, ...] = ()  # parameters of `arm` that named effects which it is without displace
    rigid: Rigid = UNCHANGED  # parameters of `arm` that were set to rigid
    undetermined: tuple[Undetermined, ...] = ()  # of the fullest model
    scatter: Scatter | None = None  # errors that every image has anew, and that no effect explains
    unlocated: tuple[str, ...] = ()  # validation targets that cannot be located: left out
    masses: str = ""  # what errors of the stated masses explain, as a sentence
