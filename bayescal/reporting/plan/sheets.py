"""Tables of a plan as text, for the terminal and for the page.

A plan in sentences, for the terminal and for the page: cost, benefit, limits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from bayescal.effects.vocabulary import unit_label
from bayescal.planning.result import (
    BOTH,
    DISTANCES,
    GAP,
    REPEAT,
    VALIDATE,
    Confusable,
    Detectable,
    ExpectedDistances,
    Plan,
)
from bayescal.planning.separate import NO_LEVER
from bayescal.reporting.page.section import Sheet
from bayescal.reporting.plan.record import clearances, count, payloads
from bayescal.reporting.shared.text import NEVER, percent, size, um2

PURPOSES = {DISTANCES: "distances", GAP: "gap", REPEAT: "repeats", VALIDATE: "validation"}
"""Purposes of contacts, and their heading."""
SHARES = ("noise", "certificate", "probing", "prior")
"""Origins of the variance of a distance, in the order of the columns."""
COVERAGE = 2
"""Coverage factor k of U = k u."""
INDICES = {
    "O1": "geometric mean of the singular values",
    "O2": "inverse condition number",
    "O3": "smallest singular value",
    "O4": "noise amplification index",
    "O5": "A-optimality",
}
"""Observability indices, and what each is."""

OVER = {
    "volume of interest": "distances in the volume of interest",
    "region of the contacts": "distances in the region of the contacts",
    "given poses": "distances between the given poses",
}
"""Goals whose name is not that of their distances."""


def expected(plan: Plan) -> Sheet:
    """Expected U of distances beside that of random selections, and the shares of the variance."""
    origins = [*SHARES, *dict.fromkeys(o for e in plan.expected for o in e.shares if o not in SHARES)]
    origins = [o for o in origins if any(o in e.shares for e in plan.expected)]
    rows = tuple(
        (
            f"{e.count} {over(e)}",
            um2(COVERAGE * e.u),
            um2(COVERAGE * e.u_random),
            *(percent(e.shares[o]) if o in e.shares else "-" for o in origins),
        )
        for e in plan.expected
    )
    return Sheet("expected U (µm, k = 2)", ("plan", "random", *origins), rows)


def over(e: ExpectedDistances) -> str:
    """The distances of a goal."""
    return OVER.get(e.over, e.over)


def by_target(plan: Plan) -> Sheet:
    """Contacts by target, purpose and payload; validation targets contacts alone in one row."""
    m, names = plan.session.measurements, [t.name for t in plan.session.targets]
    purpose, payload = np.array(plan.purpose), payloads(plan.session)
    used = [p for p in PURPOSES if p in plan.purpose]
    masses = np.unique(payload)
    alone = [k for k in np.unique(m.target) if set(purpose[m.target == k]) == {VALIDATE}]
    groups = [([k], names[k]) for k in np.unique(m.target) if k not in alone]
    if alone:
        label = names[alone[0]] if len(alone) == 1 else f"{len(alone)} validation targets"
        groups.append((alone, label))
    rows = []
    for members, label in (*groups, (list(range(len(names))), "all")):
        mine = np.isin(m.target, members)
        counts = [np.sum(mine & (purpose == p)) for p in used]
        loaded = [np.sum(mine & (payload == x)) for x in masses] if len(masses) > 1 else []
        rows.append((label, *map(str, (np.sum(mine), *counts, *loaded))))
    loads = tuple(f"{x:g}\N{NO-BREAK SPACE}kg" for x in masses) if len(masses) > 1 else ()
    return Sheet("contacts", ("all", *(PURPOSES[p] for p in used), *loads), tuple(rows))


def detectable(plan: Plan, every_site: bool = False) -> Sheet:
    """Smallest detectable amplitudes beside those of a random selection.

    Of an effect at several sites the site with the largest in proportion to what is plausible, unless
    `every_site`.
    """
    shown = plan.detectable if every_site else least_favourable(plan)
    rows = tuple(
        (
            d.effect if str(d.site) == d.effect else f"{d.effect}, {d.site}",
            _amplitude(d.smallest, d),
            _amplitude(d.smallest_random, d),
            size(d.plausible, d.unit),
        )
        for d in shown
    )
    return Sheet("smallest detectable amplitude", ("plan", "random", "plausible"), rows)


def least_favourable(plan: Plan) -> tuple[Detectable, ...]:
    """Of each effect the site with the largest detectable amplitude in proportion to what is plausible."""
    out: dict[str, Detectable] = {}
    for d in plan.detectable:
        known = out.get(d.effect)
        if known is None or d.smallest / d.plausible > known.smallest / known.plausible:
            out[d.effect] = d
    return tuple(out.values())


def gain(plan: Plan) -> float:
    """Smallest detectable amplitudes over those of a random selection, geometric mean over effects and sites.

    Each effect counts once. nan where no effect has both.
    """
    logs: dict[str, list[float]] = {}
    for d in plan.detectable:
        if all(np.isfinite(x) and 0 < x < NEVER * d.plausible for x in (d.smallest, d.smallest_random)):
            logs.setdefault(d.effect, []).append(float(np.log(d.smallest / d.smallest_random)))
    return float(np.exp(np.mean([np.mean(own) for own in logs.values()]))) if logs else float("nan")


def _amplitude(value: float, d: Detectable) -> str:
    return size(value, d.unit) if value < NEVER * d.plausible else "not detectable"


def confusable(plan: Plan) -> Sheet:
    """Detectability of an effect beside another that is confusable with it."""
    rows = tuple(
        (" and ".join(c.pair), strength(c.before), strength(c.after), c.intervention or "-")
        for c in plan.confusable
    )
    return Sheet("detectability (noncentrality)", ("before", "plan", "would be separated by"), rows)


def strength(value: float) -> str:
    """A detectability as text."""
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"


def parameters(plan: Plan) -> Sheet:
    """Expected standard uncertainty of the parameters, beside that of their prior."""
    rows = tuple((p.name, f"{p.u:.2g}", f"{p.prior:.2g}", unit_label(p.unit)) for p in plan.parameters)
    return Sheet("parameter", ("expected u", "prior u", "unit"), rows)


def observability(plan: Plan) -> Sheet:
    """Observability indices of the plan and of a random selection."""
    rows = tuple(
        (f"{name}, {INDICES[name]}" if name in INDICES else name, f"{value:.3g}",
         f"{plan.observability_random[name]:.3g}" if name in plan.observability_random else "-")
        for name, value in plan.observability.items()
    )  # fmt: skip
    return Sheet("observability index", ("plan", "random"), rows)


def dropped(plan: Plan) -> tuple[tuple[str, int], ...]:
    """Reasons for which contacts were not candidates, the most frequent first."""
    return tuple(Counter(plan.pool.dropped).most_common())


def contacts(plan: Plan) -> Sheet:
    """All contacts in the order of probing; joints in degrees."""
    session, m = plan.session, plan.session.measurements
    several = len(session.tools) > 1
    rows = tuple(
        (
            name,
            PURPOSES.get(purpose, purpose),
            session.targets[m.target[k]].name,
            *([session.tools[m.tool[k]].name] if several else []),
            *(f"{v:.3f}" for v in np.degrees(m.readings[k])),
            f"{payload:g}",
            "" if m.repeat is None else str(m.repeat[k]),
            clear,
            plan.changes[k] if plan.changes else "",
        )
        for k, (name, purpose, payload, clear) in enumerate(
            zip(m.ids, plan.purpose, payloads(session), clearances(plan), strict=True)
        )
    )
    joints = tuple(f"J{k} (deg)" for k in range(1, session.robot.n + 1))
    headings = (
        "purpose",
        "target",
        *(["tool"] if several else []),
        *joints,
        "payload (kg)",
        "repeat",
        "clearance (mm)",
        "before",
    )
    return Sheet("id", headings, rows)


AIMS = {DISTANCES: "for distances", GAP: "for the gap", BOTH: "for distances and the gap"}
IF_RIGHT = "assuming the model is correct"
FURTHER = 20
"""Further contacts of `Plan.next_u`."""


def title(plan: Plan) -> str:
    """Contacts, purpose and model in a line."""
    aim = AIMS.get(plan.aim, plan.aim)
    return f"plan of {count(plan)} contacts {aim}; model: {', '.join(plan.effects) or 'nominal'}"


def headline(plan: Plan) -> Iterator[str]:
    """The expected U of the first goal, and the random contacts that give the same."""
    for e in plan.expected[:1]:
        yield f"Expected U = {um2(COVERAGE * e.u)} µm (k = 2) of {e.count} {over(e)}, {IF_RIGHT}"
        if np.isfinite(plan.equals_random):
            yield f"Equivalent to about {two_digits(plan.equals_random)} random contacts"
        else:
            yield "No number of the candidates, chosen at random, gives the same"


def further(plan: Plan) -> str:
    """What further contacts would gain, or ""."""
    if not plan.expected or not np.isfinite(plan.next_u):
        return ""
    now = plan.expected[0].u
    less = 100 * (1 - plan.next_u / now) if now > 0 else 0.0
    return f"{FURTHER} further contacts: U = {um2(COVERAGE * plan.next_u)} µm ({less:.1f} % less)"


def contacts_phrase(plan: Plan) -> str:
    """Contacts by purpose, and changes of the payload."""
    parts = [f"{n} {text}" for p, text in PURPOSES.items() if (n := plan.purpose.count(p))]
    changes = int(np.count_nonzero(np.diff(payloads(plan.session))))
    loads = f"; the payload changes {times(changes)}" if changes else ""
    return f"{', '.join(parts)}{loads}"


def travel(plan: Plan) -> str:
    """Time of the motions and the order of probing."""
    known = plan.clearance[np.isfinite(plan.clearance)]
    clear = f"; clearance {1e3 * known.min():.1f} mm or more" if len(known) else ""
    stops = sum(bool(text) for text in plan.changes[1:])
    stopped = f"; the arm waits {times(stops)} for a change" if stops else ""
    return f"{duration(plan.travel)} of motion between contacts{clear}{stopped}; order: {plan.order}"


def candidates(plan: Plan) -> str:
    """Candidates, and why other contacts were none."""
    reasons = "; ".join(f"{n} {why}" for why, n in dropped(plan) if n)
    every = f"{len(plan.pool.candidates)} candidates"
    return f"{every}; dropped: {reasons}" if reasons else every


def detectability(plan: Plan) -> str:
    """Detectable amplitudes beside those of a random selection in a sentence, or ""."""
    ratio = gain(plan)
    if not np.isfinite(ratio):
        return ""
    return f"amplitudes are {ratio:.2f} of those of a random selection (geometric mean over effects)"


def not_separated(plan: Plan) -> tuple[str, ...]:
    """Pairs of effects that the plan does not separate, each with what would."""
    return tuple(
        f"{pair(c)} (detectability {strength(c.after)}); "
        + (
            f"{NO_LEVER} separates them"
            if c.intervention == NO_LEVER
            else f"would be separated by {c.intervention}"
        )
        for c in plan.confusable
        if c.intervention
    )


def separated(plan: Plan) -> str:
    """How many pairs of confusable effects the plan separates, or ""."""
    if not plan.confusable:
        return ""
    done = sum(not c.intervention for c in plan.confusable)
    return f"{done} of {len(plan.confusable)} pairs of confusable effects"


def pair(c: Confusable) -> str:
    """The names of a pair."""
    return " from ".join(c.pair)


def duration(seconds: float) -> str:
    """A time in s, min or h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def two_digits(number: float) -> str:
    """A number of contacts with two significant digits."""
    return f"{float(f'{number:.2g}'):.0f}"


def times(number: int) -> str:
    """``once``, ``twice``, ``7 times``."""
    return {1: "once", 2: "twice"}.get(number, f"{number} times")
