"""All settings of a diagnosis, by topic: meaning, unit and origin.

*Convention* marks a level that is usual in statistics, *assumed* a value set by judgement, *tuned* a value
chosen on simulated sessions with known ground truth (`worlds-dev`, `worlds-dev-2` and sessions of
`bayescal.simulation`), *cost* a limit that bounds the work. What belongs to one effect is a field of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final


@dataclass(frozen=True)
class LinearSettings:
    """The linear problem: outliers, noise, evidence of columns."""

    rounds: int = 30
    """Reweightings at most (cost)."""
    scales: tuple[float, ...] = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
    """Factors on the prior standard deviations of effects over which evidence is averaged (cost)."""
    scale_spread: float = 3.0
    """Factor by which these prior standard deviations may be wrong, one sigma of its logarithm (assumed)."""
    noise_nodes: int = 9
    """Nodes of the Gauss-Hermite quadrature over the noise scale (cost)."""
    shared: float = 0.01
    """Level of the test for an error that the measurements of one pose share (convention)."""
    shared_rounds: int = 2
    """Further searches at most, each with the shared error that the last one left (cost)."""
    settled: float = 0.3
    """Decrease of the shared variance from which on the search is repeated (cost)."""
    independent: float = 0.9
    """Mean worth of a residual from which on a shared error is not considered (cost)."""
    uneven: float = 5.0
    """Nats for a noise of each target from which on the search is repeated with these (cost)."""
    dependent: float = 0.05
    """Share of the largest singular value below which directions of one pose are dependent (assumed)."""


@dataclass(frozen=True)
class SearchSettings:
    """Prior probabilities of hypotheses, and the beam that looks for them."""

    null: float = 0.15
    """Prior probability of the noise-only model (assumed)."""
    single: float = 0.55
    """Prior probability of one known effect, shared among its effects (assumed)."""
    unknown: float = 0.3
    """Prior probability of an effect that is not known (a third of those in sessions of other authors)."""
    further: float = 0.2
    """Prior odds of each further effect, shared among the vocabulary (assumed)."""
    other_forms: float = 0.3
    """Share of the prior of an effect for all of its other forms together, where they differ (tuned)."""
    first_gain: float = -5.0
    """Gain, nats, from which on a single effect is fitted (cost)."""
    further_gain: float = 2.0
    """Gain, nats, from which on a further effect is fitted (cost)."""
    large: float = 15.0
    """Gain, nats, from which on the leading variants of an effect are fitted each (assumed)."""
    fitted: int = 4
    """Such variants beside the best (cost)."""
    width: int = 5
    """Hypotheses of one size that are extended (cost)."""
    largest: int = 6
    """Effects in a hypothesis at most (cost)."""
    below_null: float = 3.0
    """Nats below the noise-only model from which on a hypothesis is not extended (cost)."""
    below_best: float = 12.0
    """Nats below the best hypothesis from which on a hypothesis is not extended (cost)."""
    detectable: float = 9.0
    """Detectability lambda that an effect must reach at its largest size to be a candidate: 3 sigma."""
    aliased: float = 0.1
    """Share of the mean square of a ripple, 1/2, that low harmonics must leave unexplained (assumed)."""
    whole_scan: int = 64
    """Settings up to which all of a scan are candidates (cost)."""
    screened: int = 12
    """Settings of a wider scan that become candidates; the others are negligible (cost)."""
    screened_again: int = 4
    """Further ones, by what they explain beside the other effects of the leading hypothesis (cost)."""
    chunk: int = 24
    """Settings whose columns are in memory at a time (cost)."""


@dataclass(frozen=True)
class CellSettings:
    """Generic cells: functions that represent an effect not in the list of known effects."""

    waves: int = 4
    """Half periods of a smooth function over the range of its coordinate (assumed)."""
    # prior standard deviations of the shape of a cell (assumed; averaged over `LINEAR.scales`):
    length: float = 1e-5  # m
    point: float = 1e-4  # of a point of a board from its place, m
    angle: float = 1e-4  # rad
    pixels: float = 1.0  # of a displacement in an image or an error of a lens, px
    late: float = 2e-3  # of a clock, s
    image_waves: int = 2
    """Half periods of a displacement over each side of an image (assumed)."""
    bump_widths: tuple[float, ...] = (0.04, 0.1)
    """Standard widths of a defect at one angle of a joint, rad (assumed)."""
    moments: int = 16
    """Rows at which a sudden change is tried, per site (cost)."""
    swings: tuple[float, float, float] = (2.0, 60.0, 0.75)
    """Periods per session of what goes to and fro: least, most (cost), step (assumed)."""
    rows_a_swing: float = 5.0  # rows of a period at least (assumed)
    jumps: int = 15  # angles of a joint at which its error may jump (cost)
    region_grid: tuple[float, ...] = (-1.0, -0.5, 0.0, 0.5, 1.0)
    """Centres of regions of the workspace along each base axis, half extents (cost)."""
    region_size: float = 0.5
    """Radius of such a region, half extents (assumed)."""
    beam_widths: tuple[float, ...] = (0.05, 0.15)
    """Standard widths of an error of an instrument at one of its angles, shares of their range (assumed)."""
    beam_waves: tuple[float, float, float] = (3.0, 30.0, 0.5)
    """Periods over the range of its distances or directions: least, most, step (assumed)."""
    face_spots: tuple[tuple[float, float, int], ...] = ((0.2, 0.9, 13), (0.4, 0.8, 5))
    """Spots on a face: standard width and largest centre (half extents), centres along an axis (assumed)."""
    fewest_on_spot: int = 3
    """Contacts that must lie on a spot of a face (assumed)."""
    bends: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8)
    """Quantiles of the joint angles at which an error may begin (cost)."""
    memory: tuple[float, ...] = (50.0, 150.0)
    """Time constants of a joint that creeps, s (assumed)."""
    own_orders: tuple[int, ...] = (1, 2)
    """Periods per revolution of a stiffness that depends on the angle of its own joint (assumed)."""
    factor_waves: int = 3
    """Half periods of a function of an angle that multiplies a torque (assumed)."""
    surface_waves: int = 5
    """Half periods of a joint function of torque and angle, with a prior falling as their order (assumed)."""
    pair_waves: int = 2
    """Half periods of each of two angles whose functions are multiplied (cost: 4 columns per pair)."""
    orders: tuple[float, float] = (3.0, 20.0)
    """Periods per revolution between the harmonics of a joint and its gear mesh (assumed)."""
    order_steps: tuple[float, float] = (0.25, 1.0)
    """Smallest (cost) and largest distance of these orders; between them 2 / range, which resolves them."""
    least_turn: float = 0.3
    """Range of a joint, rad, from which on such orders are distinguishable (assumed)."""
    forgotten: tuple[float, ...] = (10.0, 30.0, 80.0)
    """Travel after which a joint has forgotten where it came from, degrees (assumed)."""
    slack: tuple[float, ...] = (0.05, 0.5, 3.0, 15.0)
    """Width of lost motion that persists from contact to contact, degrees (assumed)."""
    knees: tuple[float, ...] = (0.02, 0.1, 0.3)
    """Width of a base's transition between two positions, as a share of its usual moment (assumed)."""
    settled: tuple[float, ...] = (0.05, 0.15, 0.4)
    """Time constants of a lens that warms up, as shares of a session (assumed)."""
    warm: tuple[float, ...] = (300.0, 1500.0)
    """Time constants after which a motion is forgotten by what it warms, s (assumed)."""
    flip: float = 0.1  # width, as a share of gravity, of a transition between two positions (assumed)
    paired: float = 3.0
    """Weight, in other cells, of a cell of a joint that averages over all quantities; at another site it is
    shared by the cells of each quantity (tuned)."""
    rough_waves: int = 12  # half periods of a rough function of the order of the rows (assumed)
    blocks: tuple[int, ...] = (5, 12)  # consecutive rows in which an error keeps its value (assumed)
    clearance: tuple[float, ...] = (0.3, 0.7, 1.4, 2.5)
    """Width of the clearance of a base, in standard deviations of its gravity moment (assumed)."""
    seated: tuple[float, ...] = (0.05, 0.15, 0.3, 0.5)
    """Share of its weight, along an axis of the flange, at which a loose tool changes its seat (assumed)."""
    kept: tuple[float, ...] = (0.0, 0.5, 0.8)
    """Share of a tool's displacement that remains after each contact (assumed)."""
    fewest: int = 12  # contacts that a defect or a sudden change must move (assumed)
    few: int = 3  # contacts of its site that must be before a sudden change, and after it (assumed)


@dataclass(frozen=True)
class UnknownSettings:
    """The hypothesis 'unknown': prior of its sites, and which cells are fitted."""

    sites: Mapping[str, float] = field(
        default_factory=lambda: {
            "joint": 0.35,
            "link": 0.1,
            "base": 0.15,
            "tool": 0.1,
            "probe": 0.2,
            "arm": 0.05,
            "camera": 0.1,
            "board": 0.1,
        }
    )
    """Prior probability of the site of an unknown effect, by the first word of the site (assumed)."""
    faces: float = 0.1
    """Prior probability of a site on a face, shared among the faces (assumed)."""
    tried: int = 3
    """Cells that are fitted with their own outliers (cost)."""
    forgiven: float = 0.03
    """Share of the nats of named effects that a cell with the site and driver of one of them must exceed to
    contradict it (tuned: forms are known to 10 or 20 %, whose square is 1 to 4 %)."""
    large: float = 50.0
    """Gain, nats, from which on a cell is fitted: it reduces the noise and the weight of priors (assumed)."""


@dataclass(frozen=True)
class RelativeSettings:
    """Relatives of a name: what it predicts, times a function of another quantity."""

    waves: int = 3
    """Half periods of a function of a quantity over its range (assumed)."""
    share: float = 0.3
    """Prior standard deviation of a modulation, over the prediction (assumed; times `LINEAR.scales`)."""
    forgiven: float = 0.05
    """Share of the nats of all names that a modulation must exceed (assumed: as `VerdictSettings.form`)."""
    least: float = 5.0
    """Nats that a name must gain to have relatives: it explains something (convention)."""
    modulated: float = 0.03
    """Prior odds of a modulated relative beside its name (tuned: errors of form have 4 nats at most)."""
    replaced: float = 0.3
    """Prior odds of a replaced relative beside its name (a third of the causes outside resembled a name)."""


@dataclass(frozen=True)
class VerdictSettings:
    """The decision on the verdict."""

    leaders: int = 4
    """Hypotheses to which an unmodelled effect is added (cost)."""
    beside: float = 0.1
    """Prior odds of an unmodelled effect in addition to named ones (assumed)."""
    null_enough: float = 0.2
    """Probability of noise only from which on no effect is stated (tuned: 55 true nulls have .27 or more)."""
    unexplained: float = 0.25
    """Probability of a further effect, known or not, from which on a verdict is not `named` (tuned)."""
    sure: float = 0.5
    """Probability from which on an effect is named (convention: more likely than not)."""
    alone: float = 0.75
    """Probability of a leading effect below which, beside an unmodelled one, it is a class (3 to 1)."""
    odds: float = 1.5
    """Odds that a name must have over any other effect (convention)."""
    fewest: float = 0.05
    """Smallest probability of a member of a class (convention)."""
    same_form: float = 0.5
    """Odds of unknown causes against a name whose form they have (a third of all by other authors)."""
    credible: float = 0.9
    """Probability of the credible set (convention)."""
    certain: float = 0.99
    """Probability above which an effect is not dropped as small, or as not extrapolating (assumed)."""
    stated: float = 0.999
    """Largest probability that is stated, and complement of the smallest (no blind check supports more)."""
    form: float = 0.04
    """Discount on the nats of an unmodelled effect: a cell also fits errors of a named form (tuned)."""
    same_course: float = 0.06
    """The same where a leading hypothesis has an effect at that site along that coordinate (tuned)."""
    same_place: float = 0.15
    """The same where a leading hypothesis has an effect with the cell's site and driver (tuned)."""
    rival: float = 4.6
    """Nats below the leading hypothesis up to which another one counts for this (convention: 100 to 1)."""
    footnote: float = 0.05
    """Share of the named variance below which an effect is a footnote (assumed)."""
    structure: float = 5.0
    """Nats, not forgiven, of a cell at a name's site that contradict it (tuned: right names have 3.4)."""
    beside_unmodelled: float = 0.85
    """Largest probability of an effect beside an unmodelled one (assumed: with an effect not in the list of
    known effects, 0 of 14 names stated above 0.9 were true). It is no more than the share of the nats of both
    that the names explain."""
    not_admitted: float = 0.5
    """Largest probability of an effect that makes the validation data less probable (assumed)."""
    kept: float = 5.0
    """Nats that a named effect must gain over an unmodelled effect to remain named (assumed)."""
    far: float = 4.0
    """Softened nats between confusable effects from which on one leaves the credible set (assumed)."""
    soft: float = 0.6
    """Share of the nats between confusable effects that counts (tuned: forms are known to 10 or 20 %)."""
    promoted: float = 3.0
    """Gain of compliance, nats, from which on it is added to a model without it (assumed)."""
    alike: float = 1.1
    """Factor up to which two noise scales are regarded as equal (assumed)."""
    doubt: float = 0.05
    """Probability of an alternative from which on measurements are advised (convention)."""
    advised: int = 3
    """Maximum number of such alternatives (cost)."""
    listed: int = 12
    """Hypotheses that are reported (cost)."""


@dataclass(frozen=True)
class GateSettings:
    """The test by validation data: a named effect must not make them less probable."""

    loss: float = 3.0
    """Nats that validation data lose by an effect, from which on it is withheld (convention: 20 to 1)."""
    form: float = 0.2
    """Standard uncertainty of a predicted change, as a share (assumed: forms differ by 10 to 20 %)."""
    contradicted: float = 1e-6
    """Probability of the validation errors by the refit's own prediction, below which a name is not all
    (tuned: right names reach 5e-3 except drift after a pause, a wrong one 1e-108)."""
    half: float = 0.5
    """Share of a predicted change that validation contacts must show (convention)."""
    sure: float = 3.0
    """Standard uncertainties by which the share must be below 1 for a name to be withheld (convention)."""
    blocks: int = 10
    """Smallest number of blocks of validation data for an uncertainty from their scatter (assumed)."""
    visible: float = 4.0
    """Smallest predicted change that is compared, as a sum of squares in units of the noise (assumed)."""
    rounding: float = 1e-9
    """Smallest standard deviation of a distance in any direction, m (rounding)."""


@dataclass(frozen=True)
class OutcomeSettings:
    """What is reported of a verdict: levels, locations, margins, noise."""

    gross_share: float = 0.02
    """Share of gross validation contacts, the same for every model (assumed)."""
    gross_width: float = 1e-2
    """Width of the uniform distribution of their residuals, m (assumed)."""
    displaced: float = 6.0
    """Standard uncertainties by which a name that a usable arm lacks may displace a parameter (assumed)."""
    apart: float = 3.0
    """Nats from which on the data favour backlash over delayed readings, or the reverse (convention)."""
    plain: float = 8.0
    """Nats from which on a note reports an error that depends on the direction of motion (assumed)."""
    noisy: float = 1.2
    """Factor by which the noise, at the lower end of its 95 % interval, may exceed that stated (assumed)."""
    loose: float = 4.0
    """Ratio of expected validation error to noise from which on a warning is given (assumed)."""
    grown: float = 1.02
    """Factor of increase of validation errors from which on a warning is given (assumed)."""
    risen: float = 2.0
    """Standard errors of a change of log density from which on it is stated as a rise (convention)."""
    no_excess: float = 0.05
    """Level of the test for an excess over the noise, with one observation per block (convention)."""
    many: float = 1e6
    """Degrees of freedom of a known noise."""
    places: int = 6
    """Maximum number of listed locations."""
    places_left: int = 2
    """Minimum number of listed locations without a named effect."""
    places_named: int = 3
    """Maximum number of listed locations of each named effect."""
    significant: float = 0.01
    """Family p-value of a significant amplitude, or for a further location (convention)."""
    fewest_in_bin: int = 4
    """Minimum number of contacts in a bin of a margin (assumed)."""
    joint_bins: int = 4
    """Bins of a joint's reading."""
    joints_shown: int = 2
    """Bins of each joint that are shown, those with the smallest p-values."""
    time_bins: int = 8
    """Bins of a session's time."""
    smallest_span: float = 20e-3
    """Extent of the contacts along a base axis, m, below which the workspace is not halved (assumed)."""
    gathered: float = 0.25
    """Share of rejected contacts in a bin from which on they are not regarded as slips (assumed)."""
    free: float = 100.0
    """Scale of the prior of a generic cell that may be as large as the data want (assumed)."""
    absorbed: float = 0.05
    """Share of the mean of a bin that the fit must not absorb, for a test of the mean (assumed)."""
    fewest_dof: float = 5.0
    """Degrees of freedom of a fit from which on its residuals are used to estimate the noise (assumed)."""
    normals: int = 2_000_000
    """Maximum number of normal draws for a posterior predictive (cost)."""


@dataclass(frozen=True)
class DesignSettings:
    """Advice and blind spots: candidate contacts and their detectability."""

    contacts: int = 40
    """Number of new contacts in an advice."""
    images: int = 12
    """The same of images."""
    better: float = 1.2
    """Factor of an intervention over the lambda of the repeated poses, required for advice (assumed)."""
    least: float = 2.0
    """Lambda that the best intervention must add to be advised (assumed)."""
    poses: int = 120
    """Maximum number of poses of the session from which new contacts are chosen (cost)."""
    payload: float = 2.0
    """Mass added by the intervention with a payload, kg."""
    faster: float = 4.0
    """Factor on the recorded velocities in the intervention with faster contacts."""
    turning: float = 4.0
    """Factor on the recorded velocities in the intervention that rotates about the stylus tip."""
    still: float = 1e-6
    """Share of a requested rotation below which an arm cannot rotate about its stylus tip (rounding)."""
    least_u: float = 1e-7
    """Smallest standard uncertainty of a certified distance, m (rounding)."""
    roughly: float = 1e-3
    """Prior standard deviation of a located centre, m: smaller than the dataset's, for rounding."""
    changed: float = 1e-9
    """Smallest relevant change of a whitened column (rounding)."""
    named: float = 50.0
    """Detectability lambda from which on an effect is nearly always named (assumed)."""
    rounding: float = 1e-11
    """Share of the square of a column below which its projection is rounding error."""
    pairs: int = 200
    """Pairs of points that replace certified distances (cost)."""
    apart: float = 50e-3
    """Least distance of such a pair, m (assumed)."""
    points: int = 64
    """Contacts among which such pairs are drawn (cost)."""


LINEAR: Final = LinearSettings()
SEARCH: Final = SearchSettings()
CELLS: Final = CellSettings()
UNKNOWN: Final = UnknownSettings()
RELATIVES: Final = RelativeSettings()
VERDICT: Final = VerdictSettings()
GATE: Final = GateSettings()
OUTCOME: Final = OutcomeSettings()
DESIGN: Final = DesignSettings()
