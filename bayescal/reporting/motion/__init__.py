"""A joint log in tables, of the entries of its record, for the terminal and for the sections of its pages.

Pages are `gap.html` and `report.html`; a section is a function of the run.
"""

import shlex
from collections.abc import Sequence

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from bayescal.effects.vocabulary import UNITS, unit_label
from bayescal.reporting import page, sheet
from bayescal.reporting.gap.summary import STYLES
from bayescal.reporting.page import svg
from bayescal.reporting.page.common import CLIP
from bayescal.reporting.page.gap import FIRST, doubt_of, verdict_of
from bayescal.reporting.sheet import Column, Sheet, below, screen, terminal
from bayescal.reporting.text import LEAST, Facts, by_reason, probability, rival, share, under, with_u
from bayescal.storage.reading import Json

DISPLAYED = {
    "rad": ("deg", 180.0 / np.pi), "m": ("mm", 1e3), "s": ("ms", 1e3), "rad/s": ("deg/s", 180.0 / np.pi),
    "1": ("%", 100.0), "1/K": ("%/K", 100.0), "": ("", 1.0),
}  # fmt: skip
"""Unit in memory -> unit in print and factor to it; others are printed as they are."""

EXPECTED = "by the residual of fitted motions, what is faster in withheld ones, and u of the parameters"
"""What the column `expected` of withheld motions is."""


def title(record: Json) -> Text:
    """The log, the robot, and how many motions are fitted and withheld."""
    roles = [m["role"] for m in record["motions"]]
    counts = f"{roles.count('calibrate')} motions fitted, {roles.count('validate')} withheld"
    return headed(record["dataset"]["name"], record["robot"], counts)


def headed(name: str, robot: str, what: str) -> Text:
    """A heading of a log: its name, the robot where it has another one, and what follows."""
    return sheet.headed(name, robot if robot != name else "", what)


def by_joint(record: Json, values: Json, keys: Sequence[str]) -> list[Json]:
    """An entry for each joint, of lists of values by key."""
    rows = zip(record["joints"], *(values[k] for k in keys), strict=True)
    return [dict(zip(("joint", *keys), row, strict=True)) for row in rows]


def size_text(value: float, u: float, unit: str) -> str:
    """A value with its standard uncertainty, SI, in the unit of print."""
    shown, factor = DISPLAYED.get(unit, (unit, 1.0))
    return f"{with_u(factor * value, factor * u)} {shown}".rstrip()


def shrinkage_of(record: Json) -> tuple[tuple[str, ...], list[Json]]:
    """Keys of residuals of withheld motions, before, after, as expected, with 95 %; and these by joint."""
    unit = record["unit"]
    keys = (f"before_rms_{unit}", f"after_rms_{unit}", f"floor_{unit}", f"expected_interval95_{unit}")
    return keys, by_joint(record, record["shrinkage"]["tracking" if unit == "deg" else "torque"], keys)


TIMES = 2.0
"""Residual of fitted motions over the stated noise, from which on the model lacks something (assumed)."""


def beyond_stated(record: Json) -> list[str]:
    """Joints whose residuals are far beyond the stated noise of their torques, with both."""
    stated = record["noise"].get("stated_Nm") or ()
    each = zip(record["joints"], record["noise"].get("floor_Nm", ()), stated, strict=False)
    return [f"{name} {x:.3g} for {sd:.3g}" for name, x, sd in each if x > TIMES * sd]


def newton_metres(value: float | None) -> str:
    """A torque, N m, three significant digits."""
    return "-" if value is None else f"{value:.3g}"


def residual_of(record: Json) -> str:
    """What residuals of withheld motions are, with their unit."""
    return f"{RESIDUALS[record['unit']]}, withheld motions ({WORDS[record['unit']]} RMS)"


RESIDUALS = {"Nm": "torque residual", "deg": "servo error, model less log"}
WORDS = {"Nm": "N m", "deg": "deg"}
"""Units in keys, and in print."""


def torque_sheet(record: Json) -> Sheet:
    """RMS of the residuals on validation motions, joint by joint: of torques, or of servos."""
    (*keys, ends), items = shrinkage_of(record)
    heads = zip(("model", "with the effects", "expected"), keys, strict=True)
    sizes = (Column(head, key, newton_metres) for head, key in heads)
    return Sheet((Column(residual_of(record), "joint"), *sizes, Column("95 %", ends, interval)), items)


def interval(ends: list[float]) -> str:
    """An interval of torques, N m, or of angles."""
    return " .. ".join(map(newton_metres, ends))


def replay_of(record: Json) -> Json:
    """The replay of withheld motions of a record: errors by joint, or why there are none."""
    s = record["shrinkage"]["tracking"] or {}
    return dict(s.get("replay", s))


def tracking_sheet(record: Json) -> Sheet | None:
    """Errors of withheld motions that a simulator moves by the logged commands; None without a replay."""
    s = replay_of(record)
    if "nominal_rms_deg" not in s:
        return None
    arms = {"nominal": "nominal", "before": "model", "after": "with the effects"}
    units = {"rms_deg": "deg"} if record["unit"] == "deg" else {"rms_deg": "deg", "torque_rms_Nm": "N m"}
    heads = {f"{arm}_{unit}": f"{arms[arm]}, {units[unit]}" for unit in units for arm in arms}
    columns = (Column(head, key, newton_metres) for key, head in heads.items())
    first = Column("open-loop replay in MuJoCo (RMS)", "joint")
    return Sheet((first, *columns), by_joint(record, s, tuple(heads)))


def probability_sheet(record: Json) -> Sheet:
    """Causes by probability."""
    ranked = sorted(record["probability"].items(), key=lambda item: -item[1])
    return Sheet(
        (Column("cause", 0, rival), Column("probability", 1, probability)),
        [item for item in ranked if item[1] >= LEAST],
    )


def place_size(place: Json) -> str:
    """The size of a place with its unit."""
    sizes = ((place.get(f"rms_{unit}"), word) for unit, word in WORDS.items())
    return next((f"{size:.3g} {word}" for size, word in sizes if size is not None), "-")


def where_sheet(record: Json) -> Sheet:
    """Places, the largest first."""
    columns = (
        Column("place", "text"),
        Column("RMS", place_size),
        Column("in joint", "of_joint"),
        Column("evidence (nats)", "log_evidence", lambda x: f"{x:.1f}"),
        Column("explained by", "explained_by"),
    )
    return Sheet(columns, record["where"])


def amplitude_sheet(record: Json) -> Sheet:
    """Amplitudes of the named effects."""
    columns = (
        Column("effect", "effect"),
        Column("place", "site", words=True),
        Column("size", "text"),
        Column("setting", "setting", words=True),
        Column("withheld error removed", "removed_share", share),
        Column("relevant", "relevant", lambda x: "yes" if x else "no"),
    )
    return Sheet(columns, record["amplitudes"])


def withheld_sheet(record: Json) -> Sheet:
    """Errors of withheld motions."""
    unit = record["unit"]
    columns = (
        Column(residual_of(record), "joint"),
        Column("nominal", f"nominal_rms_{unit}", newton_metres),
        Column("fitted", f"rms_{unit}", newton_metres),
        Column("expected", f"expected_rms_{unit}", newton_metres),
        Column("95 %", f"expected_interval95_{unit}", interval),
    )
    return Sheet(columns, record["withheld"])


def parameter_sheet(record: Json, every: bool = True) -> Sheet:
    """Parameters with their uncertainty; without `every` those that the log determines."""

    def nominal(p: Json) -> str:
        return f"{DISPLAYED.get(p['unit'], ('', 1.0))[1] * p['nominal']:.4g}"

    items = [p for p in record["parameters"] if every or p["identifiable"] == "yes"]
    columns = (
        Column("parameter", "name"),
        Column("nominal", nominal),
        Column("estimate", lambda p: size_text(p["estimate"], p["u"], p["unit"])),
        Column("identifiable", "identifiable"),
    )
    return Sheet(columns, items)


CHANGED = 0.97
"""u by both over u alone, from which on a parameter is not listed without `every` (assumed)."""


def together_sheet(record: Json, every: bool = False) -> Sheet:
    """Parameters by a session or log alone, and by both; without `every` those that both tell of."""

    def size(p: Json, of: str) -> str:
        # compliances in the unit of the files of a session, masses and centres in those of a log
        unit, factor = (UNITS if p["source"] == "session" else DISPLAYED).get(p["unit"], (p["unit"], 1.0))
        return f"{with_u(factor * p[of]['estimate'], factor * p[of]['u'])} {unit_label(unit)}".rstrip()

    def ratio(p: Json) -> float:
        return float(p["both"]["u"] / p["alone"]["u"])

    items = [p for p in record["shared"] if every or p["source"] == "session" or ratio(p) < CHANGED]
    columns = (
        Column("parameter", "name"),
        Column("of the", "source"),
        Column("alone", lambda p: size(p, "alone")),
        Column("both", lambda p: size(p, "both")),
        Column("u ratio", lambda p: f"{ratio(p):.2f}"),
    )
    return Sheet(columns, items)


def motion_summary(record: Json) -> RenderableType:
    """Verdict, places, probabilities, torque error before and after, what was not assessed: one screen."""
    style = STYLES.get(record["verdict"], "bold red")
    torque, replayed = terminal(torque_sheet(record)), below(tracking_sheet(record))
    places = None if record["verdict"] == "null" else where_sheet(record)
    return screen(
        *(title(record), *(Text(line, style) for line in record["words"]), "", torque, *replayed),
        *("", places, amplitude_sheet(record), _facts(record)),
    )


def _facts(record: Json) -> Facts:
    ranked = sorted(record["probability"].items(), key=lambda item: -item[1])
    yield "probability", ", ".join(f"{rival(n)} {probability(p)}" for n, p in ranked if p >= LEAST), ""
    noise = ", ".join("-" if x is None else f"{x:.2g}" for x in record["noise"]["lag1"])
    yield "noise", f"correlation of neighbouring rows, joint by joint: {noise}", "dim"
    yield "expected", EXPECTED, "dim"
    if each := beyond_stated(record):
        yield "", f"more than {TIMES:g} times the stated noise: {', '.join(each)} N m", "yellow"
    for why, names in by_reason(record["missing"]).items():
        yield "not assessed", f"{', '.join(names)}: {why}", "dim"
    if reason := replay_of(record).get("not_assessed"):
        yield "not replayed", reason, "dim"
    yield from under("measure next", record["next"])
    yield from under("warning", record["warnings"], "yellow")


KINDS = (("before", "dot", "Blue: model"), ("after", "check", "orange: with the effects"))
"""Residuals that are drawn: key, class of the style sheet, words."""


def first(run: page.Run) -> page.Section:
    """Verdict, effects with size and place, what to measure next."""
    record = run.record
    tone, sign, word = verdict_of(record)
    mistaken = record.get("mistaken")

    def fault(named: Json) -> page.Fault:
        relevant = ("relevant", "yes" if named["relevant"] else "no")
        facts = (("probability", probability(named["probability"])), relevant)
        doubt = doubt_of(named)
        advice = FIRST if doubt or mistaken or record["verdict"] == "class" else named["remedy"]
        return page.Fault(f"{doubt}{named['text']}", facts, advice)

    steps = _simulator(run, "Write the arm with the effects, for a simulator:") if record["named"] else []
    if record["verdict"] == "null":
        steps = _simulator(run)
    if record.get("next_motions"):
        motions = "Run the motions of next-motions.csv, log them, and diagnose again with the log."
        steps = [*steps, (motions, "")] if record["verdict"] in ("null", "named") else [(motions, ""), *steps]
    if mistaken:
        steps = []
    return page.FirstScreen(
        word, tone, sign, record["words"], len(record["words"]), fault_title="What is wrong",
        faults=[fault(named) for named in record["named"]],
        next=steps, warnings=record["warnings"], notes=record["next"],
    ).section()  # fmt: skip


def _simulator(run: page.Run, words: str = "Write the arm for a simulator:") -> list[tuple[str, str]]:
    """Steps to an arm in a simulator."""
    folder = shlex.quote(run.folder)
    return [
        (words, f"bayescal export {folder} --to mjcf --out arm.xml"),
        ("Load it in MuJoCo, against the withheld motions:", f"bayescal verify {folder} arm.xml"),
    ]


def torque(run: page.Run) -> page.Section | None:
    """Torque residuals of withheld motions."""
    record = run.record
    tables = torque_sheet(record), page.Text(f"expected: {EXPECTED}", "quiet"), *_course(record)
    return page.blocks("torque", "Withheld motions", *tables)


def _course(record: Json) -> tuple[page.Figures, page.Text]:
    """Drawings of the residuals in the withheld motion with most error, joint by joint."""
    w, unit, kinds = record["withheld"], record["unit"], KINDS if record["named"] else KINDS[:1]
    time, drawings = np.array(w["time_s"]), []
    for j, (name, floor) in enumerate(zip(record["joints"], record["noise"][f"floor_{unit}"], strict=True)):
        residuals = [np.array(w[f"{key}_{unit}"][j], float) for key, _, _ in kinds]
        there = np.isfinite(residuals[0])  # it is not at rest
        if not there.any():
            continue
        dots = [(style, time[there], x[there]) for (_, style, _), x in zip(kinds, residuals, strict=True)]
        edge = max(2.5 * floor, 1.05 * float(np.nanquantile(np.abs(residuals), CLIP)))
        labels = "time (s)", f"{name} ({WORDS[unit]})"
        drawings.append(("", svg.scatter(dots, labels, 2.0 * floor, f"Residuals of {name}", (-edge, edge))))
    words = "; ".join(text for _, _, text in kinds)
    legend = f"Motion {w['motion']}. {words}; triangles: off scale. Grey band: twice the expected residual."
    return page.Figures(tuple(drawings)), page.Text(legend, "quiet")


def replayed(run: page.Run) -> page.Section | None:
    """Withheld motions that a simulator moves by the logged commands, or why there are none."""
    why = replay_of(run.record).get("not_assessed")
    parts = tracking_sheet(run.record), page.Text(why) if why else None
    return page.blocks("replay", "Commands replayed in a simulator", *parts)


def places(run: page.Run) -> page.Section | None:
    """Places, amplitudes and probabilities."""
    r = run.record
    tables = (where_sheet(r), amplitude_sheet(r), probability_sheet(r))
    return page.blocks("places", "Where and what", *tables)


def not_assessed(run: page.Run) -> page.Section | None:
    """Effects of which the log does not tell."""
    reasons = tuple((", ".join(names), why) for why, names in by_reason(run.record["missing"]).items())
    return page.blocks("limits", "Not assessed", page.Facts(reasons) if reasons else None)


SECTIONS = (first, torque, replayed, places, not_assessed)


def fitted(run: page.Run) -> page.Section:
    """What is determined, and whether withheld torque errors are as expected."""
    record = run.record
    good, word = True, "Withheld motions have the errors of the fitted ones"
    if record["words"]:
        good, word = False, "The fit does not explain the withheld motions"
    if not record["withheld"]:
        good, word = False, "No motion was withheld"
    total = len(record["parameters"])
    line = f"{record['determined']} of {total} directions of the parameters are determined."
    tone, sign = ("good", "✓") if good else ("warn", "?")
    steps = _simulator(run)
    if record["withheld"] and not good:
        gap = f"bayescal gap {shlex.quote(run.folder)}/dataset"
        steps = [("Look for what the model does not explain:", gap), *steps]
    return page.FirstScreen(word, tone, sign, [line], next=steps, warnings=record["warnings"]).section()


def errors(run: page.Run) -> page.Section | None:
    """Torque errors of withheld motions."""
    return page.blocks("torque", "Withheld motions", withheld_sheet(run.record))


def parameters(run: page.Run) -> page.Section | None:
    """All parameters, and what is determined only together."""
    together = page.texts(run.record["combinations"], "quiet")
    return page.blocks("parameters", "Parameters", parameter_sheet(run.record), *together)


FIT_SECTIONS = (fitted, errors, parameters)
