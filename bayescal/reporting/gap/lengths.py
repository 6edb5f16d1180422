"""Errors of points as reports state them: the length of the error vector, from the RMS of its coordinates."""

from __future__ import annotations

from dataclasses import replace

from bayescal.gap.result import VALIDATION_CONTACTS, VALIDATION_POINTS, Gap, Shrinkage

COORDINATES = 3
POINTS = ("points", VALIDATION_POINTS)


def length(what: str, rms: float) -> float:
    """RMS length of the errors of a kind of measurement, m, from the RMS of their residuals.

    The residuals of a point are its three coordinates, that of a contact or a distance is a length.
    """
    return rms * COORDINATES**0.5 if what in POINTS else rms


def main(gap: Gap) -> str:
    """The kind of measurement with which the gap is compared: contacts where there are any."""
    contacts = any(x.what == VALIDATION_CONTACTS for x in gap.magnitude.measured)
    return VALIDATION_CONTACTS if contacts or not gap.magnitude.measured else VALIDATION_POINTS


def per_residual(gap: Gap) -> str:
    """What a figure that is not a length of points is per, to be added to its label."""
    return "" if main(gap) == VALIDATION_CONTACTS else " per coordinate"


def as_lengths(s: Shrinkage) -> Shrinkage:
    """A reduction of errors whose errors of points are lengths."""
    return replace(
        s,
        before=length(s.what, s.before),
        after=length(s.what, s.after),
        floor=length(s.what, s.floor),
        predicted_before=length(s.what, s.predicted_before),
        predicted=length(s.what, s.predicted),
    )
