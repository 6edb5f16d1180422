"""Which known effects may be the further one of a verdict `named+unexplained`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

APART = ("null", "unknown")
LEAST = 0.05
"""Least probability of an effect that is worth an inspection of the machine."""


def possible(
    probability: Mapping[str, float | None], credible: Sequence[str], named: Collection[str]
) -> tuple[str, ...]:
    """Effects of the credible set that are not named, where they exceed an unmodelled effect; otherwise ().

    It is their sum of probabilities that exceeds that of an unmodelled effect. Improbable ones are left out.
    """
    rest = tuple(n for n in credible if n not in named and n not in APART)
    together = sum(probability.get(n) or 0.0 for n in rest)
    if together <= (probability.get("unknown") or 0.0):
        return ()
    return tuple(n for n in rest if (probability.get(n) or 0.0) >= LEAST) or rest
