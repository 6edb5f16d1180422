"""What may be used of a fitted arm: the one rule that every command and report asks.

Reasons against it: the fit did not converge, rests on its priors, or is not physical; a named effect does not
make the validation data more probable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.assess.acceptance import not_physical
from bayescal.effects import UNITS, Parameter
from bayescal.errors import BayescalError, listed
from bayescal.estimate import Estimate
from bayescal.estimate.bounds import UNCHANGED, Negative, Rigid
from bayescal.model import ARM
from bayescal.predict.errors import lengths, slopes
from bayescal.storage.reading import table_beside

if TYPE_CHECKING:
    from bayescal.calibration import Fit
    from bayescal.gap.result import Gap

REDUCED = 0.5
"""Uncertainty of distances between TCPs, as a share of that of the prior, above which the fit is taken
for not identified (assumed)."""
WORDS = table_beside(__file__, "words.toml")
REMAINS, STEPS = WORDS["remains"], WORDS["steps"]
"""What a verdict says of the arm of a diagnosis, and what to do after a fit."""
MEASURE = ("directions", "prior", "no_length", "contrast", "not_identifiable")
"""Findings after which more is to be measured."""
PAIRS = 400
"""Pairs of poses whose distances are looked at."""


@dataclass(frozen=True)
class Use:
    """What may be used of a fit: the one rule that every command asks.

    Attributes
    ----------
    against : tuple of str
        Reasons not to use the arm: nothing is handed out without ``--force``.
    warnings : tuple of str
        What a user should know of an arm that may be used: a verdict that is not good.
    rigid : Rigid
        Parameters that the fit set to rigid, and what that changes.
    left_out : tuple of str
        Named effects that the arm is without, and why.
    next : str
        What to do after a fit: a key of `STEPS`; "" of a diagnosis, which advises by itself.
    """

    against: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    rigid: Rigid = UNCHANGED
    left_out: tuple[str, ...] = ()
    next: str = ""

    @property
    def allowed(self) -> bool:
        """Whether the arm may be used without ``--force``."""
        return not self.against

    @property
    def notes(self) -> tuple[str, ...]:
        """All that is said where the arm is used, without the reasons against it."""
        return (*self.warnings, *((self.rigid.words,) if self.rigid.words else ()), *self.left_out)

    @property
    def remarks(self) -> tuple[str, ...]:
        """All that is said, the reasons against it first."""
        return (*(f"not to be used: {reason}" for reason in self.against), *self.notes)

    def record(self) -> dict[str, Any]:
        """``use`` of fit.json, gap.json, arm.json, verify.json and the sidecar of an export."""
        return {
            "allowed": self.allowed,
            "against": list(self.against),
            "warnings": list(self.warnings),
            "rigid": [
                {
                    "parameter": n.parameter,
                    "unit": UNITS[n.unit][0],
                    "value_without_bound": n.value * UNITS[n.unit][1],
                    "u": n.u * UNITS[n.unit][1],
                }
                for n in self.rigid.parameters
            ],
            "rigid_distance_rms_um": 1e6 * self.rigid.distance_rms,
            "rigid_distance_max_um": 1e6 * self.rigid.distance_max,
            "left_out": list(self.left_out),
            "next": self.next,
        }

    @classmethod
    def read(cls, record: Mapping[str, Any], parameters: Sequence[Parameter]) -> Use:
        """From `record`; ``doubts`` and ``notes`` of arm.json of an earlier version."""
        if "use" not in record:
            return cls(tuple(record["doubts"]), tuple(record["notes"]))
        use, units = record["use"], {p.name: p.unit for p in parameters}
        held = []
        for entry in use["rigid"]:
            unit = units[entry["parameter"]]
            value, u = entry["value_without_bound"] / UNITS[unit][1], entry["u"] / UNITS[unit][1]
            held.append(Negative(entry["parameter"], value, u, unit))
        rigid = Rigid(tuple(held), 1e-6 * use["rigid_distance_rms_um"], 1e-6 * use["rigid_distance_max_um"])
        return cls(tuple(use["against"]), tuple(use["warnings"]), rigid, tuple(use["left_out"]), use["next"])


NOTHING = Use()
"""Nothing is known against an arm."""


def of_fit(fit: Fit) -> Use:
    """What may be used of a calibration."""
    sampler = () if fit.draws.converged else (f"the sampler did not converge: {fit.draws.complaint}",)
    estimate, covariance = fit.final.estimate, fit.stated.limited
    reasons = of_estimate(estimate, covariance)
    if not reasons and not fit.acceptance.determined:
        what = "of the variance of a predicted distance is that of priors, not of measurements"
        reasons = (f"{100 * fit.forecast.prior_share:.0f} % {what}",)
    tests = fit.acceptance
    reasons = (*((tests.unmade,) if tests.unmade else ()), *reasons)
    good = tests.explains and tests.validated and not tests.doubts
    verdict = () if good else (f"verdict of the fit: {tests.verdict}",)
    codes = {f.code for f in fit.findings if f.severity != "note"}
    step = next(
        key
        for key, here in (
            ("gap", not tests.explains or bool(tests.doubts)),
            ("samples", bool(sampler)),
            ("measure", bool(reasons)),
            ("scale", "one_scale" in codes),
            ("validate", not tests.validated),
            ("measure", not codes.isdisjoint(MEASURE)),
            ("use", True),
        )
        if here
    )
    scale = tuple(f.text for f in fit.findings if f.code == "one_scale")
    return Use((*sampler, *reasons), (*verdict, *scale), fit.rigid, next=step)


def of_gap(gap: Gap) -> Use:
    """What may be used of the refit of a diagnosis."""
    assert gap.arm is not None
    assert gap.covariance is not None
    remaining = REMAINS.get(gap.verdict.kind, "")
    without = [n.model for n in gap.verdict.named if not n.confirmed]
    undecided = [f"{listed(without)} would change {what}; the arm is without it" for what in gap.displaced]
    why = "is named, but the validation data do not confirm it: the arm is without it"
    return Use(
        (*of_estimate(gap.arm, gap.covariance), *undecided),
        (f"verdict of the diagnosis: {remaining}",) if remaining else (),
        gap.rigid,
        tuple(f"{model} {why}" for model in without),
    )


def not_gained(gains: Sequence[tuple[str, float]]) -> tuple[str, ...]:
    """Names whose gain of log predictive density of the validation measurements, nats, is not positive."""
    return tuple(
        f"{name} does not make the validation data more probable ({nats:+.1f} nats)"
        for name, nats in gains
        if not nats > 0
    )


def of_estimate(estimate: Estimate, covariance: np.ndarray) -> tuple[str, ...]:
    """Reasons against an estimate, by its stated covariance: size not known, priors decide, not physical."""
    below = tuple(fault.words for fault in not_physical(estimate, covariance))
    if not estimate.model.knows_length:
        return ("no certified length was fitted: the size of the arm rests on its tolerances", *below)
    share = _left_of_prior(estimate, covariance)
    if share > REDUCED:
        what = "the fit is not identified: distances between TCP positions keep"
        return (f"{what} {100 * share:.0f} % of the uncertainty of the priors", *below)
    return below


def _left_of_prior(estimate: Estimate, covariance: np.ndarray) -> float:
    """Uncertainty of distances between TCP positions of the fitted data, over that of the arm's prior."""
    model = estimate.model
    arm = model.slices[ARM]
    rows = np.concatenate([b.rows for b in model.states])
    if not len(model.parameters) or len(rows) < 2:
        return 0.0
    pairs = np.random.default_rng(0).integers(0, len(rows), (2, PAIRS)).T
    motion = model.motion(rows)
    pairs = pairs[lengths(motion.points(estimate.arm), pairs) > 0]
    by = slopes(model, motion, estimate.arm, pairs)
    variance = np.sum(by @ covariance[arm, arm] * by, axis=1)
    # rows of a single position have no distance: nothing is known of any
    return float(np.sqrt(np.sum(variance) / np.sum(by**2))) if np.any(by) else 1.0


def check(use: Use, force: bool, done: str = "exported") -> None:
    """Refuse an arm with reasons against it; `done` is what is refused, as text.

    Raises
    ------
    BayescalError
        With all reasons, unless `force`.
    """
    if use.against and not force:
        remedy = "--force ignores this; --without EFFECT (or 'compliance J3') fits the session again"
        raise BayescalError("; ".join(use.against), f"not {done}", remedy)
