"""Tables of a joint log, of the entries of its record."""

from __future__ import annotations

from bayescal.reporting.shared.sheet import Column, Sheet
from bayescal.reporting.shared.text import probability, rival, share
from bayescal.storage.reading import Json

LEAST = 0.01
"""Least probability of a cause that is listed."""


def newton_metres(value: float | None) -> str:
    """A torque, N m, three significant digits."""
    return "-" if value is None else f"{value:.3g}"


def torque_sheet(record: Json) -> Sheet:
    """RMS of the torque residuals on validation motions, joint by joint."""
    s, names = record["shrinkage"]["torque"], record["joints"]
    keys = ("before_rms_Nm", "after_rms_Nm", "floor_Nm")
    items = [
        dict(zip(("joint", *keys), (n, *x), strict=True))
        for n, *x in zip(names, *(s[k] for k in keys), strict=True)
    ]
    return Sheet(
        (
            Column("torque residual, withheld motions (N m RMS)", "joint"),
            Column("model", "before_rms_Nm", newton_metres),
            Column("with the effects", "after_rms_Nm", newton_metres),
            Column("noise", "floor_Nm", newton_metres),
        ),
        items,
    )


def probability_sheet(record: Json) -> Sheet:
    """Causes by probability."""
    ranked = sorted(record["probability"].items(), key=lambda item: -item[1])
    return Sheet(
        (Column("cause", 0, rival), Column("probability", 1, probability)),
        [item for item in ranked if item[1] >= LEAST],
    )


def where_sheet(record: Json) -> Sheet:
    """Places, the largest first."""
    return Sheet(
        (
            Column("place", "text"),
            Column("N m RMS", "rms_Nm", newton_metres),
            Column("in joint", "of_joint"),
            Column("evidence (nats)", "log_evidence", lambda x: f"{x:.1f}"),
            Column("explained by", "explained_by"),
        ),
        record["where"],
    )


def amplitude_sheet(record: Json) -> Sheet:
    """Amplitudes of the named effects."""
    return Sheet(
        (
            Column("effect", "effect"),
            Column("place", "site", words=True),
            Column("size", "text"),
            Column("setting", "setting", words=True),
            Column("withheld error removed", "removed_share", share),
            Column("relevant", "relevant", lambda x: "yes" if x else "no"),
        ),
        record["amplitudes"],
    )
