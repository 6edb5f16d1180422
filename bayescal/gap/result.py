"""What a diagnosis says, as frozen records: terminal, gap.json and pictures are made from these alone.

All values SI (m, rad) but for the coordinates of curves; `Gap` holds the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects.location import Driver, Site, words_of

VALIDATION_CONTACTS, VALIDATION_POINTS = "validation contacts", "validation points"
"""Kinds of validation measurement, as reports name them."""
VERDICTS = ("null", "named", "named+unexplained", "unknown", "ambiguous")


@dataclass(frozen=True)
class Measured:
    """Something measured beside what the calibrated model's own simulation of the session predicts, m."""

    what: str  # "validation contacts", "sphere distances", "validation points"
    count: int
    rms: float
    predicted_rms: float  # median over the posterior predictive
    predicted_interval95: tuple[float, float]


@dataclass(frozen=True)
class Magnitude:
    """How big the gap is, m."""

    validation: str  # how: "validation rows", or "leave-one-out cross-validation" where there are too few
    validation_rms: float
    noise: float  # of one contact
    noise_interval95: tuple[float, float]
    noise_from: str  # "repeats", "fit" (of the last model) or "stated"
    excess: float  # root of the difference of squares, 0 where the noise is no smaller
    excess_interval95: tuple[float, float]
    measured: tuple[Measured, ...]


@dataclass(frozen=True)
class Curve:
    """Residual along the coordinate that explains it, and the fitted function, at the fitted contacts."""

    coordinate: str  # with its unit, e.g. "reading of joint 4 (deg)"; "" where no single coordinate tells
    x: np.ndarray  # (C,) in that unit
    residual: np.ndarray  # (C,) m, under the model without this cell
    fitted: np.ndarray  # (C,) m, what the cell explains of it
    rows: np.ndarray  # (C,) of the session
    lever: np.ndarray | None = None  # (C,) residual a unit of displacement, where the site has one axis
    unit: str = ""  # SI, of that displacement: "rad" or "m"


@dataclass(frozen=True)
class Place:
    """A site and a driver, and what of the gap lies there."""

    site: Site
    driver: Driver
    rms: float  # m, of what it explains at the fitted contacts, freed of what the model absorbs
    share: float  # of the excess variance
    p_value: float
    family_p_value: float  # corrected for all cells that were looked at
    log_evidence: float  # nats over nothing
    explained_by: str  # the named effect that it belongs to, or ""
    curve: Curve


@dataclass(frozen=True)
class Margin:
    """One bin of a margin: residuals of calibration and validation contacts, m."""

    label: str  # "cube.+x", "joint 4: -90 to -30 deg", "0 to 9 min", ...
    count: int
    rms: float
    mean: float
    p_value: float  # that noise alone leaves so much, corrected for all bins of all margins


@dataclass(frozen=True)
class Named:
    """An effect that the verdict commits to."""

    effect: str
    model: str  # as --model takes it: "backlash", "step@212"
    sites: tuple[Site, ...]  # where; () for all its sites
    setting: str  # in words, or ""
    probability: float
    log_evidence: float  # nats that the data lose without it

    @property
    def site(self) -> str:
        """Its sites in words, "" for all."""
        return words_of(self.sites)


@dataclass(frozen=True)
class Hypothetical:
    """A set of effects that was weighed."""

    effects: tuple[str, ...]  # () is null; may end with "unknown"
    probability: float
    log_evidence: float  # over null


@dataclass(frozen=True)
class Verdict:
    """Which effect."""

    kind: str  # one of VERDICTS
    named: tuple[Named, ...]
    probability: Mapping[str, float]  # of null, unknown and every effect that was judged
    credible_set90: tuple[str, ...]
    hypotheses: tuple[Hypothetical, ...]  # the weightiest first
    footnotes: tuple[str, ...]  # effects too small to matter, in words
    missing: Mapping[str, str]  # effects that cannot be judged, and why
    notes: tuple[str, ...]  # as text: backlash or delayed readings, limits of a probability


@dataclass(frozen=True)
class Shrinkage:
    """Reduction of the error of a kind of validation measurement, m."""

    what: str  # "planes", "distances" or "points"
    count: int
    before: float
    after: float
    floor: float  # what noise alone leaves
    removed: float  # fraction of the excess variance; nan where there was no excess
    removed_interval95: tuple[float, float]
    predicted_before: float  # rms that the refitted model expects of the baseline, from fitted rows alone
    predicted: float  # rms that the refitted model expects of itself
    claimed: bool  # False where the refitted model expects no better than before


@dataclass(frozen=True)
class Step:
    """A model level."""

    model: tuple[str, ...]
    validation_rms: float
    distance_rms: float  # nan without distances
    point_rms: float  # nan without points
    delta_elpd: float  # change in log predictive density of validation rows from the level before, nats
    delta_elpd_se: float


@dataclass(frozen=True)
class Advice:
    """What to probe next to tell two effects apart."""

    separates: tuple[str, str]
    what: str
    poses: tuple[tuple[float, ...], ...]  # joint readings, rad, the best first
    lambda_before: float
    lambda_after: float


@dataclass(frozen=True)
class BlindSpot:
    """What could be there at a plausible size, unseen by these data."""

    effect: str
    site: Site
    smallest: float  # amplitude that would be named, SI
    plausible: float  # prior standard deviation, SI
    unit: str  # SI, a key of effects.UNITS
    distance_error: float  # m rms that the plausible size would do to a sphere distance; nan if unknown


@dataclass(frozen=True)
class Gap:
    """A diagnosis of the gap between model and machine."""

    dataset: Dataset
    baseline: tuple[str, ...]
    seed: int
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
    without: tuple[str, ...] = ()  # parts that the baseline lacks: "geometry at joint 4"
