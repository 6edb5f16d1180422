"""Types that define an effect: circumstances, parameters, and the effect itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypedDict

import numpy as np

from bayescal.arm.chain import Chain, Robot
from bayescal.arm.motion import CERTIFICATE, Term
from bayescal.arm.statics import Loads, Stance
from bayescal.effects.location import ARM, CONSTANT, Driver, Site, Size
from bayescal.errors import BayescalError

UNITS = {
    "m": ("mm", 1e3),
    "rad": ("deg", 180.0 / np.pi),
    "rad/(N m)": ("urad/(N m)", 1e6),
    "rad/(N m)^2": ("urad/(N m)^2", 1e6),
    "m/(N m)": ("um/(N m)", 1e6),
    "m/N": ("um/N", 1e6),
    "rad/(N m^2)": ("urad/(N m^2)", 1e6),
    "kg": ("kg", 1.0),
    "kg m": ("kg mm", 1e3),
    "s": ("ms", 1e3),
    "px": ("px", 1.0),
    "1": ("1", 1.0),
}
"""SI unit in memory -> unit in files and factor to it."""


def unit_label(unit: str) -> str:
    """A unit of the files in print: µ for u, nothing for a pure number."""
    text = "" if unit == "1" else unit
    return ("µ" + text[1:] if text.startswith(("um", "urad")) else text).replace("^2", "²")


@dataclass(frozen=True)
class Face:
    """A fitted plane, and the position of each row on it: `place` (N, 2) from -1 to 1 over its contacts."""

    name: str
    rows: np.ndarray  # (N,) 1 for the rows that touch it, else 0
    place: np.ndarray  # (N, 2), 0 for the others
    u_form: float | None  # m, standard uncertainty of its form, if stated or estimated
    certified: bool = True  # whether any certificate names it: an artefact, and not a table or a wall


@dataclass(frozen=True)
class CertifiedValue:
    """One value that certificates between fitted targets state, with standard uncertainty u."""

    name: str
    unit: str  # "rad" or "m", that of u
    u: float
    certificates: tuple[int, ...]  # of the session: one, or those of the same length at several placements
    rows: np.ndarray  # (values that each of them states,) 1 for this one, else 0


@dataclass(frozen=True)
class ImageErrors:
    """K quantities of a camera or its board that may be in error."""

    names: tuple[str, ...]
    unit: str
    by: np.ndarray  # (N, 2, K) change of the view's residuals, m, by a unit of each; 0 elsewhere
    u: np.ndarray  # (K,) standard uncertainties
    nominal: np.ndarray | None = None  # (K,); None: 0
    of_board: bool = False


@dataclass(frozen=True)
class View:
    """What a fitted camera sees: its rows, and what may be in error of its lens and its board."""

    name: str
    rows: np.ndarray  # (N,) 1 for its rows, else 0
    focal: ImageErrors  # focal lengths along both axes of the image, px
    centre: ImageErrors  # the optical axis in the image, px
    distortion: ImageErrors  # deviations of the coefficients of the lens
    scale: ImageErrors  # relative errors of the size of the board along both of its axes
    bow: ImageErrors  # height of the middle of the board over its edges, of a bend along each axis; twist, m
    point: np.ndarray  # (N,) number of the point of the board
    shift: np.ndarray  # (N, 2, 3) lengths, m/m, by a shift of the point along the axes of the board
    several: bool = False  # there are other views


@dataclass(frozen=True)
class Session:
    """One of several sessions fitted together."""

    name: str
    rows: np.ndarray  # (N,) bool, those of the session
    tied_base: bool  # see `Circumstances`


@dataclass(frozen=True)
class Circumstances:
    """All quantities that a driver may depend on, one value per row of the session (N rows).

    `tied_base`: a target's position in F0 is stated. `tied_tool`: a tool's centre is stated. Only then are
    the base, and theta and d of the last row, distinguishable from the targets and the tool. `loads` are
    those of `statics.gravity_loads`, None if the robot has no masses. `approach` is the inward normal of the
    surface, in the flange frame at nominal geometry, and `speed` that along it; nan if there is no surface.
    """

    robot: Robot
    chain: Chain
    q: np.ndarray  # (N, n) nominal link angles, rad
    loads: Loads | None
    tool: np.ndarray  # (N,) index into tool_names
    tool_names: tuple[str, ...]
    tool_centres: np.ndarray  # (tools, 3) m, nominal
    tool_u: tuple[float | None, ...]  # m, stated uncertainty of each tool's centre
    fitted_tools: tuple[int, ...]  # tools of the fitted measurements
    fitted: np.ndarray  # indices of the fitted measurements, in the order of time
    tied_base: bool
    tied_tool: bool
    readings: np.ndarray  # (N, n) rad
    gravity: np.ndarray  # (3,) m/s2, in F0
    load_mass: np.ndarray  # (N,) kg, of tool and payload
    load_centre: np.ndarray  # (N, 3) m, centre of mass of tool and payload in the flange frame
    approach: np.ndarray  # (N, 3)
    tool_radii: tuple[float | None, ...]  # m, of each tool's ball
    predicted_tools: tuple[int, ...] = ()  # further ones, of validation rows of fitted targets
    velocity: np.ndarray | None = None  # (N, n) rad/s, of the readings
    command: np.ndarray | None = None  # (N, n) rad, commanded joint angles
    repeat: np.ndarray | None = None  # (N,) labels of repeated contacts, "" for others
    speed: np.ndarray | None = None  # (N,) m/s, None without velocities
    time: np.ndarray | None = None  # (N,) s
    temperature: np.ndarray | None = None  # (N,) degC, of the arm or the air; None if of the artefact
    faces: tuple[Face, ...] = ()
    certified_values: tuple[CertifiedValue, ...] = ()
    sessions: tuple[Session, ...] = ()  # if several are fitted together
    instruments: tuple[tuple[str, np.ndarray, np.ndarray], ...] = ()  # name, rows (N,), place in F0 (3,)
    artefacts: tuple[tuple[str, np.ndarray, np.ndarray], ...] = ()  # the same of bodies of other targets
    pieces: tuple[tuple[str, np.ndarray, np.ndarray], ...] = ()  # and of their pieces, in all placements
    views: tuple[View, ...] = ()  # of fitted cameras
    turned_tools: tuple[int, ...] = ()  # tools whose orientation fitted measurements read
    tool_u_angle: tuple[float | None, ...] = ()  # rad, stated uncertainty of each tool's orientation
    stance: Stance | None = None  # where the arm stands relative to nominal, if known
    compliances: Mapping[str, float] = field(default_factory=dict)
    """Known compliances of joints, bearings, links and the base, by the names of their parameters, SI."""
    measured_torques: np.ndarray | None = None  # (N, n) N m, on the links, in place of computed ones

    @property
    def moments(self) -> np.ndarray | None:
        """Gravity moments (N, n + 1, 3) on frames 0 to n, N m; None if the robot has no masses."""
        return None if self.loads is None else self.loads.moments

    @property
    def torques(self) -> np.ndarray | None:
        """Torques (N, n), N m (forces, N), of the joints' links; None if neither measured nor computed."""
        if self.measured_torques is not None:
            return self.measured_torques
        return None if self.loads is None else self.loads.torques(self.robot.slides)

    @property
    def touching(self) -> np.ndarray:
        """Which rows touch a surface, (N,)."""
        return ~np.isnan(self.approach[:, 0])

    @property
    def may_change(self) -> np.ndarray:
        """Rows before which something may have shifted, (N,): of an image only the first."""
        same = np.append(False, np.all(self.readings[1:] == self.readings[:-1], axis=1))
        return ~(same & np.any([v.rows > 0 for v in self.views] or [np.zeros(len(same), bool)], axis=0))


class Where(TypedDict):
    """Site and driver of a parameter, as keyword arguments."""

    site: Site
    driver: Driver


@dataclass(frozen=True)
class Parameter:
    """One unknown number: value = mean + sd z, with z ~ N(0, 1) a priori.

    The terms are driven by value - nominal, so that nominal values displace nothing. The prior's mean is the
    nominal value by default. A positive value has a normal prior too: a negative estimate is reported.
    A common factor of others, `stands_for`, displaces each by the factor times its prior mean.
    """

    name: str
    unit: str  # SI, a key of UNITS
    terms: tuple[Term, ...]
    sd: float  # prior standard deviation
    nominal: float = 0.0
    mean: float | None = None  # of the prior
    positive: bool = False
    site: Site = ARM
    driver: Driver = CONSTANT
    effect: str = field(default="", compare=False)
    stands_for: tuple[Parameter, ...] = field(default=(), compare=False)
    usual: tuple[float, float] | None = field(default=None, compare=False)
    """Mean and standard deviation of the prior that one of the robot file replaces."""

    @property
    def centre(self) -> float:
        """The prior's mean."""
        return self.nominal if self.mean is None else self.mean

    def fault(self, rows: int) -> str:
        """Why a model of a session with `rows` rows cannot have it, or ""."""
        if self.unit not in UNITS:
            return f"the unit `{self.unit}` is unknown; known: {', '.join(UNITS)}"
        if not 0 < self.sd < np.inf or not np.isfinite(self.centre):
            return f"its prior, {self.centre:g} with standard deviation {self.sd:g}, is not normal"
        if not isinstance(self.site, Site) or not isinstance(self.driver, Driver):
            return "its site is not a Site, or its driver is not a Driver"
        for term in self.terms:
            driver = np.asarray(term.driver)
            if term.frame != CERTIFICATE and driver.shape not in ((), (rows,)):
                return f"a driver is a number or one value per row, ({rows},), not {driver.shape}"
            if not np.isfinite(driver).all():
                return "a driver has values that are not finite"
        return ""

    def same(self, other: Parameter) -> bool:
        """Whether another parameter is equal, with equal drivers (arrays, which ``==`` does not compare)."""
        return replace(self, terms=()) == replace(other, terms=()) and same_terms(self.terms, other.terms)


def same_terms(a: Sequence[Term], b: Sequence[Term], equal: Callable[..., bool] = np.array_equal) -> bool:
    """Whether terms displace the same axes by drivers that are `equal`."""
    return len(a) == len(b) and all(
        (s.frame, s.axis) == (t.frame, t.axis) and equal(s.driver, t.driver)
        for s, t in zip(a, b, strict=True)
    )


@dataclass(frozen=True)
class Scan:
    """A setting in which an effect is not linear, and which must be scanned: a row, a ratio, a time constant.

    `values` are the plausible ones in a session, none if the setting is known; `parameters` are the effect's
    parameters at one of them. A model names a value as ``effect@value``. `beside` are further values near one
    of `values`, where those are a selection. `by_site`: each site may have its own, ``effect@value/value at
    site and site``, and a site as many as `several`. Any two, each a site and a value, are `apart`.
    """

    what: str  # of the setting, in words, with its unit
    words: str  # for a report, to be formatted with the setting: "from row {:.0f} on"
    values: Callable[[Circumstances], np.ndarray]
    parameters: Callable[[Circumstances, float], list[Parameter]]
    by_site: bool = False
    several: int = 1
    beside: Callable[[Circumstances, float], np.ndarray] = lambda circumstances, value: np.empty(0)
    apart: Callable[[Circumstances, tuple[Site, float], tuple[Site, float]], bool] = lambda *_: True


@dataclass(frozen=True)
class Form:
    """Another form of an effect, with the same cause; a model names a form as ``effect@name``.

    `odds` is its prior probability, relative to that of an equal share of the other forms.
    """

    name: str
    words: str  # for a report: "by the readings shown"
    parameters: Callable[[Circumstances], list[Parameter]]
    odds: float = 1.0


Setting = float | str | tuple[tuple[Site, float], ...] | None
"""A setting of an effect's scan, one for each of several sites, the name of a form, or None for the usual."""


@dataclass(frozen=True)
class Effect:
    """A cause of error: its name, its parameters in a session, and its relations to other effects.

    Parameters
    ----------
    name : str
        Its name in options and files: small letters, digits and hyphens.
    summary : str
        A description of one line.
    parameters : callable
        Its parameters in a session, given the session's circumstances.
    missing : callable
        What the session or the robot lacks for it, as text, or "".
    scan : Scan, optional
        A setting in which it is not linear.
    whole : bool
        It usually acts on the whole arm at once: a single site is another form of it.
    alternatives : bool
        Its sites are alternatives: without a site, its name means the first one.
    phrase : (str, str)
        Parts of the sentence of a verdict: the subject, if the verdict has no site, and the predicate.
    remedy : str
        What to inspect on the machine and how to correct it, in a few sentences; "" if not known.
    confusable_with : tuple of str
        Effects with a similar form.
    shown_by : str
        Kind of quantity without which, at one site, causes that are not known have the same form.
    requires : tuple of str
        Effects that must be in the model before a diagnosis can name this one: it acts through them.
    part_of : tuple of str
        Effects with which it shares parameters; a model has each of these once.
    sizes : mapping from str to Size
        How its parameters read as an amplitude, by their SI unit; others are told as they are.
    forms : tuple of Form
        Other forms, which a diagnosis compares with the usual one if they differ from it.
    simpler : str
        A model level with a part of its parameters, which is fitted before a model that begins with it.
    dimensions : bool
        Its parameters are lengths and angles of the arm, which have a plausible range.
    in_robot_file : bool
        A robot file can hold it, or it is no part of the arm.
    directed : bool
        It depends on the direction of motion of a joint, or looks so.
    of_session : bool
        It differs between sessions of the same arm.
    beside_arm : bool
        An error of what measures the arm: widths of priors of the arm are told beside it.
    side : str
        Whose error it is in images, if not the arm's or its site's: mount or clock.
    linear_spring : bool
        Its parameters are compliances of linear springs, which any simulator has.
    simulated_within : float
        m: largest difference of TCP positions that it adds between arm and export in its simulator.
    """

    name: str
    summary: str
    parameters: Callable[[Circumstances], list[Parameter]]
    missing: Callable[[Circumstances], str] = lambda circumstances: ""
    scan: Scan | None = None
    whole: bool = False
    alternatives: bool = False
    phrase: tuple[str, str] = ("the arm", "has an error")
    remedy: str = ""
    confusable_with: tuple[str, ...] = ()
    shown_by: str = ""
    requires: tuple[str, ...] = ()
    part_of: tuple[str, ...] = ()
    sizes: Mapping[str, Size] = field(default_factory=dict)
    forms: tuple[Form, ...] = ()
    simpler: str = ""
    dimensions: bool = False
    in_robot_file: bool = False
    directed: bool = False
    of_session: bool = False
    beside_arm: bool = False
    side: str = ""
    linear_spring: bool = False
    simulated_within: float = 0.0

    def form(self, name: str) -> Form | None:
        """The form with a name, or None."""
        return next((form for form in self.forms if form.name == name), None)

    def at(self, circumstances: Circumstances, setting: Setting = None) -> list[Parameter]:
        """Its parameters in a session, for a setting or a form, checked and marked with its name.

        Raises
        ------
        BayescalError
            For an invalid parameter.
        """
        if isinstance(setting, str):
            form = self.form(setting)
            assert form is not None, f"{self.name} has no form {setting}"
            parameters = form.parameters(circumstances)
        elif setting is None or self.scan is None:
            parameters = self.parameters(circumstances)
        elif isinstance(setting, tuple):
            sites = [site for site, _ in setting]
            parameters = [
                replace(p, name=f"{p.name} @{value:g}") if sites.count(site) > 1 else p
                for site, value in setting
                for p in self.scan.parameters(circumstances, value)
                if site in p.site.also
            ]
        else:
            parameters = self.scan.parameters(circumstances, setting)
        for p in parameters:
            if fault := p.fault(len(circumstances.q)):
                raise BayescalError(fault, f"parameter `{p.name}` of {self.name}", "correct the effect")
        return [replace(p, effect=self.name) for p in parameters]

    def words(self, setting: Setting) -> str:
        """A setting or a form as text for a report; "" for the usual form."""
        if isinstance(setting, str):
            return form.words if (form := self.form(setting)) else ""
        if setting is None or self.scan is None:
            return ""
        if isinstance(setting, tuple):
            by_value: dict[float, list[str]] = {}
            for site, value in setting:
                by_value.setdefault(value, []).append(str(site))
            (first, *others) = by_value.items()
            words = [f"{self.scan.words.format(first[0])} at {' and '.join(first[1])}"]
            return ", ".join(words + [f"{value:g} at {' and '.join(names)}" for value, names in others])
        return self.scan.words.format(setting)
