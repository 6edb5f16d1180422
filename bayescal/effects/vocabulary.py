"""The nouns that an effect is told in: circumstances, parameters, and the effect itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypedDict

import numpy as np

from bayescal.arm.chain import Chain
from bayescal.arm.motion import CERTIFICATE, Term
from bayescal.arm.robot import Robot
from bayescal.effects.location import ARM, CONSTANT, Driver, Site
from bayescal.errors import BayescalError

UNITS = {
    "m": ("mm", 1e3),
    "rad": ("deg", 180.0 / np.pi),
    "rad/(N m)": ("urad/(N m)", 1e6),
    "rad/(N m)^2": ("urad/(N m)^2", 1e6),
    "m/(N m)": ("um/(N m)", 1e6),
    "kg": ("kg", 1.0),
    "s": ("ms", 1e3),
    "1": ("1", 1.0),
}
"""SI unit in memory -> unit in files and factor to it."""


@dataclass(frozen=True)
class Face:
    """A fitted plane, and where on it each row stands: `place` (N, 2) in -1 to 1 over its contacts."""

    name: str
    rows: np.ndarray  # (N,) 1 for the rows that touch it, else 0
    place: np.ndarray  # (N, 2), 0 for the others
    u_form: float | None  # m, standard uncertainty of its form where stated or estimated


@dataclass(frozen=True)
class CertifiedValue:
    """One value that a certificate between fitted targets states, with standard uncertainty u."""

    name: str
    unit: str  # "rad" or "m", that of u
    u: float
    certificate: int  # of the session
    rows: np.ndarray  # (values that the certificate states,) 1 for this one, else 0


@dataclass(frozen=True)
class Session:
    """One of several sessions fitted together."""

    name: str
    rows: np.ndarray  # (N,) bool, those of the session
    tied_base: bool  # see `Circumstances`


@dataclass(frozen=True)
class Circumstances:
    """All that a driver may vary with, one value a row of the session (N rows).

    `tied_base` says that a target's place in F0 is stated, `tied_tool` that a tool's centre is: only
    then can the base, and the last row's theta and d, be told from the targets and the tool.
    `moments` are the gravity moments of `statics.gravity_moments`, None where the robot has no masses.
    `approach` is the unit direction, in the flange frame at nominal geometry, in which the ball meets the
    surface (its inward normal), and `speed` the ball's in that direction: nan where the target is none.
    """

    robot: Robot
    chain: Chain
    q: np.ndarray  # (N, n) nominal link angles, rad
    moments: np.ndarray | None  # (N, n + 1, 3) N m
    tool: np.ndarray  # (N,) index into tool_names
    tool_names: tuple[str, ...]
    tool_centres: np.ndarray  # (tools, 3) m, nominal
    tool_u: tuple[float | None, ...]  # m, stated uncertainty of each tool's centre
    fitted_tools: tuple[int, ...]  # those used by the rows that are fitted
    fitted: np.ndarray  # indices of the rows that are fitted, in the order of time
    tied_base: bool
    tied_tool: bool
    readings: np.ndarray  # (N, n) rad
    gravity: np.ndarray  # (3,) m/s2, in F0
    load_mass: np.ndarray  # (N,) kg, of tool and payload
    load_centre: np.ndarray  # (N, 3) m, centre of mass of tool and payload in the flange frame
    approach: np.ndarray  # (N, 3)
    tool_radii: tuple[float | None, ...]  # m, of each tool's ball
    velocity: np.ndarray | None = None  # (N, n) rad/s, of the readings
    speed: np.ndarray | None = None  # (N,) m/s, None without velocities
    time: np.ndarray | None = None  # (N,) s
    temperature: np.ndarray | None = None  # (N,) degC, of the arm or the air; None if of the artefact
    faces: tuple[Face, ...] = ()
    compliance: np.ndarray | None = None  # (n,) rad/(N m), where a fit has found them
    certified_values: tuple[CertifiedValue, ...] = ()
    sessions: tuple[Session, ...] = ()  # where several are fitted together
    turned_tools: tuple[int, ...] = ()  # those whose orientation fitted rows read
    tool_u_angle: tuple[float | None, ...] = ()  # rad, stated uncertainty of each tool's orientation
    yields: Mapping[str, float] = field(default_factory=dict)
    """Values of bearings, links and stand that a fit has found, by the names of their parameters, SI."""

    @property
    def touching(self) -> np.ndarray:
        """Which rows touch a surface, (N,)."""
        return ~np.isnan(self.approach[:, 0])


class Where(TypedDict):
    """Site and driver of a parameter, to be given by keyword."""

    site: Site  # where it acts
    driver: Driver  # what it varies with


@dataclass(frozen=True)
class Parameter:
    """One unknown number: value = mean + sd z, with z ~ N(0, 1) a priori.

    The terms are driven by value - nominal, so that the drawing displaces nothing. The prior's mean
    is the drawing's value where none is given. A value that physics keeps positive is still told by a
    normal prior, which keeps the model linear in it; where it comes out negative, that is said.
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

    @property
    def centre(self) -> float:
        """The prior's mean."""
        return self.nominal if self.mean is None else self.mean

    def fault(self, rows: int) -> str:
        """What forbids it in a model of a session of so many rows, or ""."""
        if self.unit not in UNITS:
            return f"the unit '{self.unit}' is unknown; known: {', '.join(UNITS)}"
        if not 0 < self.sd < np.inf or not np.isfinite(self.centre):
            return f"its prior, {self.centre:g} with standard deviation {self.sd:g}, is not normal"
        if not isinstance(self.site, Site) or not isinstance(self.driver, Driver):
            return "its site is no Site, or its driver no Driver"
        for term in self.terms:
            shape = np.shape(term.driver)
            if term.frame != CERTIFICATE and shape not in ((), (rows,)):
                return f"a driver is a number or one value per row, ({rows},), not {shape}"
            if not np.all(np.isfinite(term.driver)):
                return "a driver has values that are not finite"
        return ""

    def widened(self, factor: float) -> Parameter:
        """The same parameter with a prior `factor` times as wide."""
        return replace(self, sd=self.sd * factor)


@dataclass(frozen=True)
class Scan:
    """A setting of an effect that it is not linear in, and that must be tried: when, how often, how fast.

    `values` are those worth trying in a session, none where nothing is open; `parameters` are the effect's
    at one of them. A model names one as ``effect@value``.
    """

    what: str  # of the setting, in words, with its unit
    words: str  # for a report, to be formatted with the setting: "from row {:.0f} on"
    values: Callable[[Circumstances], np.ndarray]
    parameters: Callable[[Circumstances, float], list[Parameter]]


@dataclass(frozen=True)
class Form:
    """Another form that an effect may take, of the same cause; a model names one as ``effect@name``."""

    name: str
    words: str  # for a report: "by the readings shown"
    parameters: Callable[[Circumstances], list[Parameter]]


Setting = float | str | None
"""A setting of an effect's scan, the name of one of its forms, or None for the effect as it usually is."""


@dataclass(frozen=True)
class Effect:
    """A cause of error: its name, the parameters that it brings to a session, and how it relates to others.

    Parameters
    ----------
    name : str
        As options and files name it: small letters, digits and hyphens.
    summary : str
        One line: what happens.
    parameters : callable
        The parameters that it brings to a session, given its circumstances.
    missing : callable
        What the session or the robot lacks for it, in words, or "".
    scan : Scan, optional
        A setting that it is not linear in.
    whole : bool
        It acts on the whole arm at once; at one site alone it would be another effect.
    phrase : (str, str)
        For a verdict in a sentence: who, where the verdict gives no site, and what it does.
    confusable_with : tuple of str
        Effects whose true form may look like that of this one.
    requires : tuple of str
        Effects that must be in the model before this one can be named: it acts through them.
    part_of : tuple of str
        Effects that hold the same parameters; a model has this one or them.
    forms : tuple of Form
        Forms that it may take beside the usual one, for a diagnosis to weigh where they differ from it.
    """

    name: str
    summary: str
    parameters: Callable[[Circumstances], list[Parameter]]
    missing: Callable[[Circumstances], str] = lambda circumstances: ""
    scan: Scan | None = None
    whole: bool = False
    phrase: tuple[str, str] = ("the arm", "errs")
    confusable_with: tuple[str, ...] = ()
    requires: tuple[str, ...] = ()
    part_of: tuple[str, ...] = ()
    forms: tuple[Form, ...] = ()

    def form(self, name: str) -> Form | None:
        """The form of a name, if there is one."""
        return next((form for form in self.forms if form.name == name), None)

    def at(self, circumstances: Circumstances, setting: Setting = None) -> list[Parameter]:
        """Its parameters in a session, at a setting, in a form or as usual, checked and marked as its own.

        Raises
        ------
        BayescalError
            For a parameter that no model can hold.
        """
        if isinstance(setting, str):
            form = self.form(setting)
            assert form is not None, f"{self.name} has no form {setting}"
            found = form.parameters(circumstances)
        elif setting is None or self.scan is None:
            found = self.parameters(circumstances)
        else:
            found = self.scan.parameters(circumstances, setting)
        for p in found:
            if fault := p.fault(len(circumstances.q)):
                raise BayescalError(fault, f"parameter '{p.name}' of {self.name}", "correct the effect")
        return [replace(p, effect=self.name) for p in found]

    def words(self, setting: Setting) -> str:
        """A setting or a form in words, for a report; "" for the effect as it usually is."""
        if isinstance(setting, str):
            form = self.form(setting)
            return "" if form is None else form.words
        return "" if setting is None or self.scan is None else self.scan.words.format(setting)
