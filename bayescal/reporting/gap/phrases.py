"""The verdict of a diagnosis as text: location (site and dependence) first, then the effect."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayescal.assess.acceptance import not_physical
from bayescal.dataset import Dataset
from bayescal.effects import EFFECTS
from bayescal.effects.location import BASE, CONSTANT, Site
from bayescal.estimate.unexplained import unexplained as left_by
from bayescal.fitted import gate
from bayescal.gap.result import MOVES, OTHER, VALIDATION_POINTS, CauseClass, Gap, Named, Place, Verdict
from bayescal.gap.settings import OUTCOME, VERDICT
from bayescal.model.block import posed
from bayescal.model.model import length_blocks
from bayescal.reporting.gap import per_vector
from bayescal.reporting.gap.causes import PLAIN, beside_base, gains, sentence, site_text, sites, when, who_of
from bayescal.reporting.text import SURE, listed, probability, rival, um
from bayescal.statistics import grouped

UNNAMED = "Largest location without a name"
NOWHERE = "no location that is significant"
COLUMN = re.compile(r"\b(?:j1_\w+(?: \.\.\.)?|time_s|temperature_c)")
"""A column of a session in the reason why an effect was not assessed."""
MOST = 0.5
"""Share of the parameters that is not identifiable from which on a null verdict means only: too few poses."""


def place(where: Place, dataset: Dataset) -> str:
    """A location as text: site and dependence."""
    return f"{site_text(where, dataset)}, {where.driver.text}"


def named(effect: Named, gap: Gap) -> str:
    """A named effect: ``joint 3 has lost motion on reversal (backlash, probability 0.97)``.

    With several significant sites: ``backlash in joints 1 and 3 (each has lost motion ...)``.
    """
    who, does = EFFECTS[effect.effect].phrase
    clear, everywhere = sites(gap, effect.effect)
    named_sites: tuple[Site, ...] = ()
    if effect.sites or (who.startswith("every ") and not everywhere):
        named_sites = tuple(dict.fromkeys(effect.sites)) or clear
        who = together(named_sites) if named_sites else who.replace("every", "at least one")
    drivers = [w.driver.kind for w in gap.where if w.explained_by == effect.effect]
    if who == BASE.text and drivers and MOVES.issuperset(drivers):
        named_sites = (BASE,)
    if len(named_sites) < 2:
        who = who_of(who, named_sites, effect.neighbours, drivers, gap.dataset)
    elif BASE in named_sites and (also := beside_base(gap.dataset, drivers)):
        who = who.replace(BASE.text, f"{BASE.text} or the {also}")
        who += f" (these data do not distinguish the base and the {also})"
    setting = effect.setting
    if effect.events:  # in the order of time; of several sites, each with its own
        several = len(set(effect.sites)) > 1 and len(effect.sites) == len(effect.events)
        each = [f"{site.text} " for site in effect.sites] if several else [""] * len(effect.events)
        ordered = sorted(zip(effect.events, each, strict=True), key=lambda pair: pair[0].row)
        setting = listed(f"{site}from {when(event, gap.dataset)} on" for event, site in ordered)
    words = f"{does}, {setting}" if setting else does
    p = f"probability {probability(effect.probability)}"
    if len(named_sites) > 1:
        return f"{effect.effect} in {who} (each {words}; {p})"
    return f"{who} {words} ({effect.effect}, {p})"


def together(each: Sequence[Site]) -> str:
    """Sites as text: ``joint 3``; ``joints 1, 3 and 6``; ``cube.+x and cube.-y``."""
    kinds = {site.kind for site in each}
    if len(each) > 1 and len(kinds) == 1 and each[0].number:
        return f"{kinds.pop()}s {listed(str(site.number) for site in each)}"
    return listed(site.text for site in each)


def unexplained(gap: Gap) -> Place | None:
    """The location of the largest error that no named effect explains."""
    return next((w for w in gap.where if not w.explained_by), None)


GAIN = 3.0
"""Standard errors of a gain of validation measurements from which on it confirms a name (convention)."""


def possible(gap: Gap, named: Named) -> str:
    """Why a named effect is only possible: by validation, its form, or its amplitudes; else ""."""
    if named.terms_with:
        return f"with {listed(named.terms_with)} it fits any function of its coordinate"
    nats, se = gains(gap).get(named.effect, (np.nan, np.nan))
    clear = [a.significant for a in gap.amplitudes if a.effect == named.effect]
    if not named.confirmed:
        return "the validation measurements do not confirm it"
    if nats <= se and (little := _little(nats, se, gap)):
        return little
    # of several amplitudes none may be significant alone, and all together are
    seen = any(clear or [True]) or (nats > GAIN * se and _times_u(gap, named) > SEEN_U)
    return "" if seen else "no amplitude of it is significant"


SEEN_U = 2.0
"""Amplitude over its u below which a log density that rises is of wider predictions (convention)."""
PROVEN, TIMES_U = 0.99, 4.0
"""Probability of a name, and amplitude over its u, from which on the calibration rows establish it alone
(assumed)."""


def established(gap: Gap, named: Named) -> str:
    """What establishes a named effect where few validation rows show no change of RMS; "" if nothing."""
    if not named.confirmed or named.terms_with:
        return ""
    nats, se = gains(gap).get(named.effect, (np.nan, np.nan))
    times = _times_u(gap, named)
    if nats > GAIN * se and times > SEEN_U:
        return f"log density {nats:+.0f} ± {se:.0f} nats"
    if named.probability >= PROVEN and TIMES_U < times < np.inf:
        return f"amplitude {times:.0f} u"
    return ""


def _times_u(gap: Gap, named: Named) -> float:
    """Largest amplitude of a named effect, over its u; infinite if it has none."""
    amplitudes = [a for a in gap.amplitudes if a.effect == named.effect]
    return max((abs(a.value) / a.u for a in amplitudes if a.u), default=np.inf)


def _little(nats: float, se: float, gap: Gap) -> str:
    """That a gain of validation data is within its standard error; "" where a single name improves them."""
    fall = [s.what for s in gap.shrinkage if s.claimed and s.removed_interval95[0] > 0]
    if fall and len(gap.verdict.named) == 1:
        return ""
    errors = [{"planes": "contacts"}.get(what, what) for what in fall]
    also = f", although errors of {listed(errors)} fall significantly by all named effects" if fall else ""
    size = f"{nats:+.1f} ± {se:.1f} nats"
    return f"the gain of single validation measurements by it is not significant ({size}){also}"


def headline(gap: Gap) -> list[str]:
    """The verdict: a line for each effect, or the alternatives, or that there is none."""
    verdict = gap.verdict
    where = unexplained(gap)
    there = f"at {place(where, gap.dataset) if where and where.family_p_value < PLAIN else NOWHERE}"
    likely = [
        f"More likely than not, but not named: {rival(n)} (probability {probability(verdict.probability[n])})"
        for n in unnamed(verdict)
    ]
    if verdict.kind == "null":
        change = _event(where, "Largest location, not established", gap)
        return [_nothing(gap), *_unphysical(gap), *_noisy(gap), *change, *likely]
    members = verdict.causes.members if verdict.causes else {}
    sure = [n for n in verdict.named if n.effect not in members]
    lines = []
    if verdict.causes:  # the largest part of the error
        several = sum(p >= LIKELY for p in verdict.causes.members.values()) > 1
        lines += [
            _class(verdict.causes, gap),
            f"To {'distinguish them' if several else 'find it'}: {_separates(gap)}",
        ]
    for n in sure:
        word = "Probable effect" if n.probability < SURE else f"{'Also' if lines else 'Effect'} found"
        doubt = possible(gap, n)
        if doubt:
            proof = established(gap, n)
            word = "Effect found by the calibration rows alone" if proof else "Possible effect"
            lines.append(f"{word}: {named(n, gap)}{f'; {proof}' if proof else ''}, but {doubt}")
        else:
            lines.append(f"{word}: {named(n, gap)}")
    if verdict.kind == "unknown":
        p = probability(verdict.probability["unknown"])
        lines += [
            f"Unmodelled effect not in the list of known effects, {there} (probability {p})",
            *_cause(where, gap),
        ]
    if verdict.kind == "ambiguous":
        beside = "Beside it, these data do not distinguish the further effects of the 90 % set"
        lines.append(
            beside if sure else "Ambiguous: these data do not distinguish the effects of the 90 % set"
        )
        if where and where.family_p_value < PLAIN:
            lines += _event(where, UNNAMED, gap) or [f"{UNNAMED}: {place(where, gap.dataset)}"]
    if verdict.kind == "named+unexplained":
        lines += [f"Also: a further effect, {there}", *_cause(where, gap)]
    if verdict.kind in ("named", "class"):
        lines += _event(where, UNNAMED, gap)
    if verdict.kind == "named":
        lines += _beyond(gap)
    lacking = [f"{listed(effects)} (no {columns})" for columns, effects in unshown(verdict).items()]
    if lacking:
        lines.append(f"Not excluded, because the session lacks a column: {', '.join(lacking)}")
    return [*lines, *likely]


def unshown(verdict: Verdict) -> dict[str, list[str]]:
    """Effects that were not assessed because the session lacks a column, by the column."""
    reasons = ((COLUMN.findall(reason), effect) for effect, reason in verdict.missing.items())
    return grouped((" or ".join(columns), effect) for columns, effect in reasons if columns)


CHANGED = {
    "mass": "another known mass on the flange",
    "time": "a temperature that rises and falls, and is recorded",
}
"""What is changed to distinguish causes that vary with a quantity, by its kind; else this quantity."""
LIKELY = 0.05
"""Probability from which on a member of a class is listed (convention)."""


def _class(causes: CauseClass, gap: Gap) -> str:
    """A class as text: ``Class of causes: an error at joint 3 that varies with ...``."""
    kinds = [driver.kind for driver in causes.drivers]
    located = (w for w in gap.where if (w.site,) == causes.sites and w.driver.course in causes.drivers)
    alike = next((w.neighbours for w in located), ())
    site = who_of(together(causes.sites), causes.sites, alike, kinds, gap.dataset)
    by = listed(driver.text for driver in causes.drivers if driver != CONSTANT)
    varies = f" that varies with {by}" if by else ""
    each = [
        f"{'a cause not in the list of known effects' if n == OTHER else n} (probability {probability(p)})"
        for n, p in causes.members.items()
        if p >= LIKELY
    ]
    what = "Class of causes" if len(each) > 1 else "Cause"
    events = [e for n in gap.verdict.named if n.effect in causes.members for e in n.events]
    since = f", from {listed(when(e, gap.dataset) for e in events)} on" if events else ""
    return f"{what}: an error at {site}{varies}{since}: {' or '.join(each)}"


def _separates(gap: Gap) -> str:
    """What would distinguish the causes of a class: the first advice, else rows in which they differ.

    An advice tells known causes apart.
    """
    causes = gap.verdict.causes
    assert causes is not None
    drivers = [d for d in causes.drivers if d != CONSTANT]
    leading = sorted(causes.members, key=lambda n: -causes.members[n])[:2]
    between = [a for a in gap.advice if OTHER in leading or set(leading) <= set(a.separates)]
    if between and not (OTHER in leading and any(d.kind in CHANGED for d in drivers)):
        return between[0].what
    others = listed(CHANGED.get(d.kind, f"other values of {d.text}") for d in drivers)
    same = "at the same poses " * all(d.kind in CHANGED for d in drivers)
    return f"measurements {same}with {others}" if others else "measurements at other poses"


def class_record(gap: Gap) -> dict[str, Any] | None:
    """The entry `class` of gap.json: site, arguments, members with probabilities; None without a class."""
    causes = gap.verdict.causes
    if causes is None:
        return None
    return {
        "site": " and ".join(map(str, causes.sites)),
        "arguments": list(map(str, causes.drivers)),
        "members": dict(causes.members),
        "separates": _separates(gap),
    }


def unnamed(verdict: Verdict) -> tuple[str, ...]:
    """What is as likely as not, without what the verdict, its names and its footnotes state already.

    With these the headline and its footnotes have every effect of such a probability, and no other.
    """
    stated = {"null", *(n.effect for n in verdict.named)}
    stated |= {"unknown"} if verdict.kind in ("unknown", "named+unexplained", "class") else set()
    stated |= set(verdict.causes.members if verdict.causes else ())
    stated |= {note.partition(" ")[0].rstrip(":") for note in verdict.footnotes}
    return tuple(n for n, p in verdict.probability.items() if p >= VERDICT.sure and n not in stated)


def _nothing(gap: Gap) -> str:
    """The headline of a diagnosis that names no effect and sees no unmodelled one."""
    verdict = gap.verdict
    null = verdict.probability["null"]
    conclusion, likeliest = "No effect found", null >= max(verdict.probability.values())
    if not likeliest:
        conclusion += f": noise only has probability {probability(null)}, and nothing else is established"
    size = gap.magnitude.measured[:1]
    loose = bool(size) and size[0].predicted_rms > OUTCOME.loose * gap.magnitude.noise
    odd = [x.what for x in gap.magnitude.measured if x.rms > x.predicted_interval95[1]]
    if gap.masses:
        beyond = f"; errors of {listed(odd)} are larger than the model predicts" if odd else ""
        return f"{conclusion}, but errors of the stated masses explain residuals (see the warning){beyond}"
    if odd:
        why = "; these measurements do not show why" if loose else ""
        return f"{conclusion}, but errors of {listed(odd)} are larger than the model predicts{why}"
    if loose:
        return f"{conclusion}: with these measurements the model is too uncertain to show any"
    unknown = sum(u.combinations for u in gap.undetermined if u.matters)
    if gap.arm is not None and unknown > MOST * len(gap.arm.model.parameters):
        of = f"{unknown} of {len(gap.arm.model.parameters)} combinations of parameters"
        return f"{conclusion}, but {of} are not identifiable: these measurements show little of the arm"
    explains = likeliest and not unexplained_of(gap) and gap.scatter is None and not _unphysical(gap)
    return "No effect above noise: the model explains these data" if explains else conclusion


def _unphysical(gap: Gap) -> list[str]:
    """That positive parameters of the arm are negative, as a sentence: no model explains data by these."""
    if gap.arm is None or gap.covariance is None:
        return []
    faults = not_physical(gap.arm, gap.covariance)
    return [f"But values of the model are {fault.words.partition(': run')[0]}" for fault in faults]


def unexplained_of(gap: Gap) -> str:
    """Residuals of the baseline that its noise does not explain, as a fit states them; "" where it does."""
    misfit = left_by(gap.calibrated) if gap.calibrated else None
    return misfit.words if misfit and misfit.excess else ""


def components(gap: Gap) -> int:
    """Coordinates of the points of a diagnosis by its fitted rows: two of corners in images, else three."""
    blocks = length_blocks(gap.calibrated.model) if gap.calibrated else ()
    most = max((b.kind.rows for b in blocks), default=1)
    return most if most > 1 else 3  # points that validate contacts are those of an instrument


def _beyond(gap: Gap) -> list[str]:
    """Errors, or residuals, that stay larger than the model with the named effects predicts, as a sentence.

    The interval of errors is that of the baseline, in proportion to what both predict.
    """
    out = []
    for s in gap.shrinkage:
        kind = "contacts" if s.what == "planes" else s.what
        for x in (x for x in gap.magnitude.measured if x.what.endswith(kind)):
            high = x.predicted_interval95[1]
            if x.rms > high and s.after > s.predicted * high / x.predicted_rms:
                factor = per_vector(x.what, components(gap))  # as the tables state them
                out.append(f"{x.what} ({um(factor * s.after)} µm RMS, {um(factor * s.predicted)} expected)")
    more = "larger than predicted with the named effects: another form of one, or a further cause"
    if out:
        return [f"But errors of {listed(out)} stay {more}"]
    residuals = left_by(gap.arm) if gap.arm else None
    if residuals is None or not residuals.excess:
        return []
    return [f"But the arm of this diagnosis leaves {residuals.words}: noise above that, or a further cause"]


def _noisy(gap: Gap) -> list[str]:
    """Noise that is larger than stated, as a sentence: an error without any pattern is called noise."""
    if gap.scatter is not None:
        causes = "poses that do not repeat, a trigger that varies or an image stabiliser"
        return [f"But {gap.scatter.words}: {causes}; it counts as scatter, not as an effect"]
    if misfit := unexplained_of(gap):
        return [f"But the fit leaves {misfit}: noise above that, or a cause without a pattern"]
    m, stated = gap.magnitude, gap.dataset.noise
    points = [x.what for x in m.measured[:1]] == [VALIDATION_POINTS]
    expected = stated.point if points else stated.contact
    if expected is None or m.noise_interval95[0] <= OUTCOME.noisy * expected:
        return []
    low, high = (um(value) for value in m.noise_interval95)
    size = f"{um(m.noise)} µm (95 %: {low} to {high}) against {um(expected)} µm"
    return [f"But the noise is larger than stated, {size}: an error without any pattern is part of it"]


def _cause(where: Place | None, gap: Gap) -> list[str]:
    """What a significant unmodelled location shows, as a sentence; none if it shows nothing."""
    text = sentence(where, gap.dataset) if where else ""
    return [text[:1].upper() + text[1:]] if text else []


def _event(where: Place | None, what: str, gap: Gap) -> list[str]:
    """The sudden change at a location, as a sentence; none if there is none."""
    text = sentence(where, gap.dataset) if where and where.event else ""
    return [f"{what}: {text}"] if text else []


def warnings(gap: Gap) -> tuple[str, ...]:
    """What limits the results and the use of the arm, and which rows the lengths leave out."""
    out = gap.warnings
    if gap.arm is not None:
        out = (*replace(gate.of_gap(gap), warnings=()).remarks, *out)  # the headline has the verdict
    turns = int(np.sum(posed(gap.dataset)))
    if not turns:
        return out
    used = "the diagnosis uses it, but figures in µm are of the points alone"
    return (*out, f"{turns} measurements are also of an orientation: {used}")
