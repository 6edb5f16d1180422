"""A plan in tables and sentences, for the terminal and for the page: cost, benefit, limits."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from bayescal.dataset import Dataset
from bayescal.dataset.target_kinds import KINDS
from bayescal.effects.vocabulary import unit_label
from bayescal.planning import result
from bayescal.planning.result import DISTANCES, GAP, Plan
from bayescal.planning.separate import NO_LEVER
from bayescal.reporting.sheet import Column, Sheet, below, headed, of_key, screen, sheet_of_cells
from bayescal.reporting.text import NEVER, Facts, percent, size, um2, under


def payloads(session: Dataset) -> np.ndarray:
    """Payloads (N,), kg; 0 where the session states none."""
    m = session.measurements
    return np.zeros(len(m.ids)) if m.payload is None else m.payload


def count(plan: Plan) -> int:
    """Number of contacts that calibrate: all but those of validation."""
    return sum(p != result.VALIDATE for p in plan.purpose)


def clearances(plan: Plan) -> list[str]:
    """Clearance of the motions of each row, mm, rounded down; empty where it is not known."""
    clearance = plan.clearance if len(plan.clearance) else np.full(len(plan.purpose), np.nan)
    return [f"{np.floor(1e4 * value) / 10:.1f}" if np.isfinite(value) else "" for value in clearance]


PURPOSES = {DISTANCES: "distances", GAP: "gap", result.REPEAT: "repeats", result.VALIDATE: "validation"}
"""Purposes of contacts, and their heading."""
SHARES = ("noise", "certificate", "probing", "prior")
"""Origins of the variance of a distance, in the order of the columns."""
COVERAGE_FACTOR = 2
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
    "region of the contacts": "distances in the region of the {}",
    "given poses": "distances between the given poses",
}
"""Goals whose name is not that of their distances."""


def expected(plan: Plan) -> Sheet:
    """Expected U of distances beside that of random selections, and the shares of the variance."""
    stated = dict.fromkeys(origin for e in plan.expected for origin in e.shares)
    origins = [*(o for o in SHARES if o in stated), *(o for o in stated if o not in SHARES)]
    columns = (
        Column("expected U (µm, k = 2)", lambda e: f"{e.count} {over(plan, e)}"),
        Column("plan", lambda e: um2(COVERAGE_FACTOR * e.u)),
        Column("random", lambda e: um2(COVERAGE_FACTOR * e.u_random)),
        *(Column(origin, of_key(lambda e, name: e.shares.get(name), origin), percent) for origin in origins),
    )
    return Sheet(columns, plan.expected)


def over(plan: Plan, e: result.ExpectedDistances) -> str:
    """The distances of a goal."""
    return OVER.get(e.over, e.over).format({"images": "poses"}.get(noun(plan), noun(plan)))


def noun(plan: Plan) -> str:
    """What a plan has: contacts, or images where that is all."""
    d = plan.session
    kinds = [KINDS[d.targets[k].kind] for k in np.unique(d.measurements.target)]
    return "images" if kinds and all(kind.posed for kind in kinds) else "contacts"


def by_target(plan: Plan) -> Sheet:
    """Contacts by target, purpose and payload; validation targets contacts alone in one row."""
    m, names = plan.session.measurements, [t.name for t in plan.session.targets]
    purpose, payload = np.array(plan.purpose), payloads(plan.session)
    used = [p for p in PURPOSES if p in plan.purpose]
    masses = np.unique(payload)
    alone = [k for k in np.unique(m.target) if set(purpose[m.target == k]) == {result.VALIDATE}]
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
    loads = [f"{x:g}\N{NO-BREAK SPACE}kg" for x in masses] if len(masses) > 1 else []
    return sheet_of_cells((noun(plan), "all", *(PURPOSES[p] for p in used), *loads), rows)


def detectable(plan: Plan, every_site: bool = False) -> Sheet:
    """Smallest detectable amplitudes beside those of a random selection.

    Of an effect at several sites the site with the largest in proportion to what is plausible, unless
    `every_site`.
    """

    def name(d: result.Detectable) -> str:
        return d.effect if str(d.site) == d.effect else f"{d.effect}, {d.site}"

    columns = (
        Column("smallest detectable amplitude", name),
        Column("plan", lambda d: _amplitude(d.smallest, d)),
        Column("random", lambda d: _amplitude(d.smallest_random, d)),
        Column("plausible", lambda d: size(d.plausible, d.unit)),
    )
    return Sheet(columns, plan.detectable if every_site else least_favourable(plan))


def least_favourable(plan: Plan) -> tuple[result.Detectable, ...]:
    """Of each effect the site with the largest detectable amplitude in proportion to what is plausible."""
    out: dict[str, result.Detectable] = {}
    for d in plan.detectable:
        largest = out.get(d.effect)
        if largest is None or d.smallest / d.plausible > largest.smallest / largest.plausible:
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
    means = [np.mean(of_effect) for of_effect in logs.values()]
    return float(np.exp(np.mean(means))) if means else float("nan")


def _amplitude(value: float, d: result.Detectable) -> str:
    return size(value, d.unit) if value < NEVER * d.plausible else "not detectable"


def confusable(plan: Plan) -> Sheet:
    """Detectability of an effect beside another that is confusable with it."""
    columns = (
        Column("detectability (noncentrality)", "pair", " and ".join),
        Column("before", "before", strength),
        Column("plan", "after", strength),
        Column("would be separated by", lambda c: c.intervention or None, words=True),
    )
    return Sheet(columns, plan.confusable)


def strength(value: float) -> str:
    """A detectability as text."""
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"


PARAMETERS = (
    Column("parameter", "name"),
    Column("expected u", "u", "{:.2g}".format),
    Column("prior u", "prior", "{:.2g}".format),
    Column("unit", "unit", unit_label, words=True),
)
"""Of `Plan.parameters`: expected standard uncertainty beside that of the prior."""


def observability(plan: Plan) -> Sheet:
    """Observability indices of the plan and of a random selection."""
    columns = (
        Column("observability index", lambda name: f"{name}, {INDICES[name]}" if name in INDICES else name),
        Column("plan", plan.observability.get, "{:.3g}".format),
        Column("random", plan.observability_random.get, "{:.3g}".format),
    )
    return Sheet(columns, tuple(plan.observability))


def contacts(plan: Plan) -> Sheet:
    """All contacts in the order of probing; joints in degrees, prismatic ones in mm."""
    session, m = plan.session, plan.session.measurements
    angles, mass, clear = session.robot.shown(m.readings), payloads(session), clearances(plan)
    tool = Column("tool", lambda k: session.tools[m.tool[k]].name, words=True)
    columns = (
        Column("id", m.ids.__getitem__),
        Column("purpose", lambda k: PURPOSES.get(plan.purpose[k], plan.purpose[k]), words=True),
        Column("target", lambda k: session.targets[m.target[k]].name, words=True),
        *([tool] if len(session.tools) > 1 else []),
        *(
            Column(f"J{j + 1} ({unit})", of_key(lambda k, j: angles[k, j], j), "{:.3f}".format)
            for j, unit in enumerate(session.robot.units)
        ),
        Column("payload (kg)", lambda k: mass[k], "{:g}".format),
        Column("repeat", lambda k: "" if m.repeat is None else m.repeat[k]),
        Column("clearance (mm)", clear.__getitem__),
        Column("before", lambda k: plan.changes[k] if plan.changes else "", words=True),
    )
    caption = f"the table of plan.csv, and what is changed before one of the {noun(plan)}"
    return Sheet(columns, range(len(m.ids)), caption, 0)


AIMS = {DISTANCES: "for distances", GAP: "for the gap", result.BOTH: "for distances and the gap"}
FURTHER = 20
"""Further contacts of `Plan.next_u`."""


def title(plan: Plan) -> str:
    """Contacts, purpose and model in a line."""
    aim = AIMS.get(plan.aim, plan.aim)
    return f"plan of {count(plan)} {noun(plan)} {aim}; model: {', '.join(plan.effects) or 'nominal'}"


def if_right(plan: Plan) -> str:
    """On what the expected figures depend."""
    after = "the model and the noise of the diagnosis"
    return f"assuming that {after if plan.pool.setup.noise_scale else 'model and stated noise'} are correct"


def headline(plan: Plan) -> Iterator[str]:
    """The expected U of the first goal, and the random contacts that give the same."""
    for e in plan.expected[:1]:
        of = f"{e.count} {over(plan, e)}"
        yield f"Expected U = {um2(COVERAGE_FACTOR * e.u)} µm (k = 2) of {of}, {if_right(plan)}"
        if np.isfinite(plan.equals_random):
            yield f"Equivalent to about {two_digits(plan.equals_random)} random {noun(plan)}"
        else:
            yield "No number of the candidates, chosen at random, gives the same"


def further(plan: Plan) -> tuple[str, str] | None:
    """U with further contacts, and the difference that they make."""
    if not plan.expected or not np.isfinite(plan.next_u):
        return None
    now = plan.expected[0].u
    less = 100 * (1 - plan.next_u / now) if now > 0 else 0.0
    return f"U = {um2(COVERAGE_FACTOR * plan.next_u)} µm", f"{less:.1f} % less"


def contacts_phrase(plan: Plan) -> str:
    """Contacts by purpose, and changes of the payload."""
    parts = [f"{n} {text}" for p, text in PURPOSES.items() if (n := plan.purpose.count(p))]
    changes = int(np.count_nonzero(np.diff(payloads(plan.session))))
    loads = f"; the payload changes {times(changes)}" if changes else ""
    return f"{', '.join(parts)}{loads}"


def travel(plan: Plan) -> str:
    """Time of the motions and the order of probing."""
    clearance = plan.clearance[np.isfinite(plan.clearance)]
    clear = f"; clearance {1e3 * clearance.min():.1f} mm or more" if len(clearance) else ""
    stops = sum(bool(text) for text in plan.changes[1:])
    stopped = f"; the arm waits {times(stops)} for a change" if stops else ""
    return f"{duration(plan.travel)} of motion between {noun(plan)}{clear}{stopped}; order: {plan.order}"


def candidates(plan: Plan) -> str:
    """Candidates, and why other contacts were none, the most frequent reason first."""
    reasons = "; ".join(f"{n} {why}" for why, n in Counter(plan.pool.dropped).most_common() if n)
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

    def by(what: str) -> str:
        again = "nor do the same poses again, under any known condition"
        return again if what == NO_LEVER else f"would be separated by {what}"

    return tuple(
        f"{' from '.join(c.pair)} (detectability {strength(c.after)}); {by(c.intervention)}"
        for c in plan.confusable
        if c.intervention
    )


def separated(plan: Plan) -> str:
    """How many pairs of confusable effects the plan separates, or ""."""
    if not plan.confusable:
        return ""
    done = sum(not c.intervention for c in plan.confusable)
    return f"{done} of {len(plan.confusable)} pairs of confusable effects"


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


PAIRS = 4
"""Pairs that are not separated; the others are in plan.html."""


def plan_summary(plan: Plan) -> RenderableType:
    """Expected uncertainty, contacts, detectable amplitudes, pairs, warnings: one screen."""
    name = headed(plan.session.name, plan.session.robot.name, title(plan))
    costs = (
        (noun(plan), contacts_phrase(plan), ""),
        ("travel", travel(plan), ""),
        ("candidates", candidates(plan), "dim"),
    )
    lines = (Text(line, "" if k else "bold") for k, line in enumerate(headline(plan)))
    more, text = further(plan), detectability(plan) if plan.detectable else ""
    return screen(
        *(name, *lines, ""),
        expected(plan),
        [("further", f"{FURTHER} {noun(plan)} more: {more[0]} ({more[1]})", "")] if more else None,
        *("", by_target(plan), costs),
        *below(detectable(plan), [("detectable", text, "")] if text else None),
        _limits(plan),
    )


def _limits(plan: Plan) -> Facts:
    """Pairs of effects, and warnings."""
    if text := separated(plan):
        yield "separates", text, ""
    lines = not_separated(plan)
    more = [f"and {len(lines) - PAIRS} further pairs: see plan.html"] if len(lines) > PAIRS + 1 else []
    yield from under("not separated", [*lines[:PAIRS], *more] if more else lines, "yellow")
    yield from under("warning", plan.warnings, "yellow")
