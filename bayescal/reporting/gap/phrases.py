"""A verdict in a metrologist's words: the place before the name."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayescal.effects import EFFECTS
from bayescal.gap.result import Gap, Named, Place
from bayescal.model.orientations import posed

NO_PLACE = "at no single place"
LOOSE = 4.0
"""Times the noise that a model must expect of held-out contacts for 'nothing' to mean: not to be seen."""
POSSIBLE, PLAIN = 0.05, 0.05
"""Probability from which on noise alone is told among the rivals; p-value below which a place is told."""

ONE_OF_A_KIND = ("base", "tool", "probe", "arm", "artefact")


def place(where: Place) -> str:
    """A place in words: site and driver."""
    return f"{where.site}, {'always' if where.driver == '1' else where.driver}"


def named(effect: Named) -> str:
    """A named effect as a sentence: ``joint 3 has lost motion on reversal: backlash (probability 0.99)``."""
    who, does = EFFECTS[effect.effect].phrase
    if effect.site:
        who = f"the {effect.site}" if effect.site in ONE_OF_A_KIND else effect.site
    setting = f", {effect.setting}" if effect.setting else ""
    return f"{who} {does}{setting}: {effect.effect} (probability {probability(effect.probability)})"


def probability(value: float) -> str:
    """A probability with two figures, never rounded to certainty."""
    if value > 0.995:
        return "above 0.99"
    return "below 0.01" if value < 0.005 else f"{value:.2f}"


def p_value(value: float) -> str:
    """A p-value with one figure."""
    if value < 1e-4:
        return "< 0.0001"
    return f"{value:.4f}" if value < 0.01 else f"{value:.2f}"


def listed(names: Iterable[str], last: str = "and") -> str:
    """Names as a sentence lists them."""
    *some, final = list(names)
    return f"{', '.join(some)} {last} {final}" if some else final


def unexplained(gap: Gap) -> Place | None:
    """Where the largest thing lies that no named effect explains."""
    return next((w for w in gap.where if not w.explained_by), None)


def headline(gap: Gap) -> list[str]:
    """The verdict in one line, or one line for each of several effects."""
    verdict = gap.verdict
    at = unexplained(gap)
    there = f"at {place(at)}" if at else NO_PLACE
    if verdict.kind == "null":
        size = gap.magnitude.measured[:1]
        if size and size[0].predicted_rms > LOOSE * gap.magnitude.noise:
            return ["Nothing shows above what the model itself leaves uncertain: too few contacts to tell"]
        return ["Nothing above noise: the model explains these data"]
    if verdict.kind == "unknown":
        sure = probability(verdict.probability.get("unknown", float("nan")))
        return [f"Something {there}, that no effect of the vocabulary explains (probability {sure})"]
    if verdict.kind == "ambiguous":
        largest = next((w for w in gap.where if w.family_p_value < PLAIN), None)
        noise = [n for n in ("null",) if verdict.probability.get(n, 0.0) > POSSIBLE]
        rivals = dict.fromkeys((*verdict.credible_set90, *noise))
        lines = [f"Cannot tell {listed(map(rival, rivals), 'from')} with these data"]
        return lines + ([f"Something at {place(largest)}"] if largest else [])
    lines = [f"The gap: {named(verdict.named[0])}"] if verdict.named else []
    lines += [f"and {named(n)}" for n in verdict.named[1:]]
    if verdict.kind == "named+unexplained":
        lines.append(f"and something more {there}, that no effect of the vocabulary explains")
    return lines


def rival(name: str) -> str:
    """A member of the 90 % set as a sentence names it."""
    return {"null": "noise alone", "unknown": "something unknown"}.get(name, name)


def warnings(gap: Gap) -> tuple[str, ...]:
    """What weakens the figures, and what of the session they leave aside."""
    turns = int(np.sum(posed(gap.dataset)))
    if not turns:
        return gap.warnings
    told = "it is weighed beside their points, but figures in um are of these alone"
    return (*gap.warnings, f"{turns} rows also read an orientation: {told}")
