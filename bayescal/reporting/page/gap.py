"""The page of a diagnosis, `gap.html`: its sections, each a function of the run."""

import shlex
from collections.abc import Callable, Iterator, Sequence

from bayescal.effects import EFFECTS
from bayescal.effects.location import Site
from bayescal.gap.result import MARGINS, OTHER, VALIDATION_POINTS
from bayescal.gap.settings import VERDICT
from bayescal.reporting import gap as sheets
from bayescal.reporting import text
from bayescal.reporting.body import DRAWN
from bayescal.reporting.gap.causes import ALIKE
from bayescal.reporting.gap.phrases import LIKELY, NOWHERE
from bayescal.reporting.origin import images_keys, images_sheet
from bayescal.reporting.page import Fault, FirstScreen, Run, Section, blocks, common, texts
from bayescal.reporting.page.svg import draw_arm, marked_sites
from bayescal.reporting.sheet import Sheet
from bayescal.storage.reading import Json

FIRST = "Measure more before a part is replaced."
REPAIR = "Repair the machine as described above and measure again; or keep the effects in the model:"
VERDICTS = {
    "null": ("good", "✓", "No effect above noise"),
    "named": ("bad", "✗", "Effect found"),
    "named+unexplained": ("bad", "✗", "Effect found, and a further one"),
    "class": ("warn", "?", "Class of causes"),
    "unknown": ("bad", "✗", "Unmodelled effect"),
    "ambiguous": ("warn", "?", "Ambiguous: several explanations"),
}
"""Tone, sign and word of each verdict."""
BESIDE = ("bad", "✗", "Effect found, and others possible")
"""The same of an ambiguous one beside an effect that is found."""
UNKNOWN = (
    "No known effect explains the error. Inspect the location first: bolts, cables and hoses "
    "that pull, covers that touch, the mounting. Then measure what is proposed."
)
DOUBTFUL = ("No effect found", "Possible effect", "Probable effect")
"""First words of a headline that are less certain than its verdict."""
LINES = 3
"""Lines of the verdict that are seen at once; the effects of all follow with their sizes."""
DISTANCES = "sphere distances"
FACTS = ("location", "size", "probability", "share of the excess", "what happens")
"""What may be stated of a fault."""


def verdict_of(record: Json) -> tuple[str, str, str]:
    """Tone, sign and word of a diagnosis, no more certain than its headline."""
    doubtful = (word for word in DOUBTFUL if record["words"][0].startswith(word))
    beside = record["verdict"] == "ambiguous" and bool(record["named"])
    return next((("warn", "?", word) for word in doubtful), BESIDE if beside else VERDICTS[record["verdict"]])


def first(run: Run) -> Section:
    """Verdict, distance error before and after, effects with size and location, remedies, next commands."""
    record = run.record
    tone, sign, word = verdict_of(record)
    sites = [s for s in marked_sites(run) if s.kind in DRAWN]
    return FirstScreen(
        word, tone, sign, _lines(word, record["words"]), LINES, [*_keys(record), *images_keys(record)],
        "What is wrong, and what to look at", faults(record), draw_arm(run) if sites else None,
        "Marked: " + ", ".join(s.text for s in sites), _next(run), record["warnings"],
    ).section()  # fmt: skip


def _lines(word: str, words: Sequence[str]) -> list[str]:
    """The verdict without what its word says already: ``Effect found: joint 3 has ...`` after the first."""
    verdict = word.partition(",")[0].partition(":")[0]
    line = words[0].removeprefix(f"{verdict}: ").removeprefix(f"{verdict} ")
    return [line[:1].upper() + line[1:], *words[1:]]


def faults(record: Json) -> list[Fault]:
    """Named effects with location, amplitude, probability and share; an unmodelled effect; or the rivals."""
    out, may_be, of_class = [], further(record), record["class"]
    for named in record["named"]:
        effect, doubt = named["effect"], doubt_of(named)
        name = effect + ("" if named["confirmed"] else " (validation data do not confirm it)")
        advice = FIRST if doubt or of_class else _remedy(effect)
        if neighbours := [Site.read(site).text for site in named["neighbours"]]:
            advice = f"Check {text.listed(neighbours)} too: {ALIKE}. {advice}"
        size = sheets.sizes_of(sheets.amplitudes_of(record, effect))
        place, share = sheets.location_of(record, effect), sheets.share_of(record, effect)
        out.append(_fault(f"{doubt}{name}", advice, named["probability"], place, size, share))
    where, unmodelled = sheets.unexplained(record), record["verdict"] in sheets.UNMODELLED
    if (unmodelled and not may_be) or (where and "event" in where):
        name = f"{'' if unmodelled else 'possibly '}{text.rival(sheets.OTHER)}"
        p = record["probability"].get(sheets.OTHER)
        fault = _fault(name, UNKNOWN, p, NOWHERE)
        if where:
            size, share = sheets.size_of(record, where), text.share(where["share"])
            remedy, happens = where.get("remedy") or UNKNOWN, where.get("words", "")
            fault = _fault(name, remedy, p, where["text"], size, share, happens)
        out.append(fault)
    if record["verdict"] == "ambiguous":
        said = (sheets.NULL, *record["effects"], *([sheets.OTHER] if where else []))
        may_be = tuple(n for n in record["credible_set90"] if n not in said)
    if of_class:
        likely = (n for n, p in of_class["members"].items() if p >= LIKELY)
        may_be = tuple(sheets.OTHER if n == OTHER else n for n in likely if n not in record["effects"])
    for name in may_be:
        p = record["probability"].get(name) or 0.0
        sure, other = p >= text.SURE, name == sheets.OTHER
        remedy = UNKNOWN if other else _remedy(name) if sure and not of_class else FIRST
        site = of_class["site"] if of_class and other else ""
        fault = _fault(f"{'' if sure else 'possibly '}{text.rival(name)}", remedy, p, site)
        out.insert(0 if sure else len(out), fault)
    return out


def _fault(
    name: str, remedy: str, p: float | None, location: str, size: str = "", share: str = "", happens: str = ""
) -> Fault:
    """A fault with the facts that are stated of it."""
    probability = "" if p is None else text.probability(p)
    facts = zip(FACTS, (location, size, probability, share, happens), strict=True)
    return Fault(name, tuple(fact for fact in facts if fact[1] not in ("", text.MISSING)), remedy)


def doubt_of(named: Json) -> str:
    """Word before a name that is not certain; "" of one that is."""
    if named.get("possible"):
        return "possibly "
    return "probably " if named["probability"] < text.SURE else ""


def further(record: Json) -> tuple[str, ...]:
    """Known effects beside the named ones that together exceed an unmodelled effect, the probable ones.

    None beside an unmodelled effect that is more likely than not: they may be there as well as it.
    """
    stated, p = (sheets.NULL, sheets.OTHER, *record["effects"]), record["probability"]
    others = tuple(n for n in record["credible_set90"] if n not in stated)
    together, unmodelled = sum(p.get(n) or 0.0 for n in others), p.get(sheets.OTHER) or 0.0
    if record["verdict"] != "named+unexplained" or together <= unmodelled or unmodelled >= VERDICT.sure:
        return ()
    return tuple(n for n in others if (p.get(n) or 0.0) >= LIKELY) or others


def _remedy(effect: str) -> str:
    """What to inspect; "" for an effect of the user that is not registered here."""
    return EFFECTS[effect].remedy if effect in EFFECTS else ""


def _keys(record: Json) -> Iterator[tuple[str, str, str]]:
    now = next((m for m in record["gap"]["measured"] if m["what"] == DISTANCES), None)
    better = record["shrinkage"].get("distances")
    if better and record["named"]:
        before, after = text.length(better["before_rms_um"]), text.length(better["after_rms_um"])
        value = f"{before} → {after} µm RMS" if better["claimed"] else f"{before} µm RMS"
        detail = (
            f"{better['count']} certified distances, before and after the refit with the named effects, "
            f"which expects {text.length(better['predicted_rms_um'])} µm"
        )
        yield "Distance error", value, detail + ("" if better["claimed"] else "; no improvement is claimed")
    elif now:
        expected = f"the model expects {text.length(now['predicted_rms_um'])} µm"
        detail = f"{now['count']} certified distances; {expected}"
        yield "Distance error", f"{text.length(now['rms_um'])} µm RMS", detail
    else:
        yield "Distance error", "not measured", "no certified distances in the validation data"
    of, ends = record["lengths"], record["gap"]["excess_um"]["interval95"]
    kind = "point (length)" if of["of"] == VALIDATION_POINTS else "contact"
    excess = f"{text.length(of['excess_um'])} µm" if sheets.exceeds(record) else "not significant by RMS"
    factor = sheets.per_vector(of["of"], of["components"])
    detail = (
        f"95 %: {text.interval(ends, factor)} µm per {kind}; validation RMS "
        f"{text.length(of['validation_rms_um'])} µm, noise {text.length(of['noise_um'])} µm"
    )
    yield "Excess above noise", excess, detail
    null = record["probability"].get(sheets.NULL)
    if null is not None:
        yield "Probability of noise only", text.probability(null), f"from {record['gap']['heldout']}"


WEIGH = "Weigh the tool, find its centre of mass, correct stated masses, and diagnose again."


def _next(run: Run) -> list[tuple[str, str]]:
    record, dataset, out = run.record, run.datasets, []
    if record["named"]:
        options = text.model_options(record["refit"]["model"].split(","), record["refit"]["without"])
        words = REPAIR
        if any(map(doubt_of, record["named"])):
            words = "Measure more, and diagnose again; to fit with the effects that are named:"
        elif record["class"]:
            words = "Fit with the effects that are found:"
        step = (words, f"bayescal fit {dataset}{options}")
        larger, against = sheets.worse(record), []
        if larger:
            against.append(f"with the effects that are named, errors of {text.listed(larger)} are larger")
        if not any(named["confirmed"] for named in record["named"]):
            against.append("the validation data do not confirm the effects that are named")
        out.append((f"Measure more, and diagnose again: {text.listed(against)}.", "") if against else step)
    if record["verdict"] in sheets.UNMODELLED and sheets.unexplained(record):
        out.append(("Inspect the location that is marked, correct it, and measure again.", ""))
    if _planned(record):
        advised = [c for advice in record["next"] for c in advice["contacts"]]
        images = sheets.measured_as(record, advised) == "image"
        what, count = ("Take the images", "") if images else ("Measure the contacts", " --contacts 60")
        command = f"bayescal plan {dataset} --after {shlex.quote(run.folder)} --for gap{count}"
        out.append((f"{what} that decide between the explanations.", command))
    if record["verdict"] == "null":
        options = text.model_options(record["baseline"], record["without"])
        as_it_is = ("Calibrate with the model as it is.", f"bayescal fit {dataset}{options}")
        first = ("Find what makes errors larger than the noise, and measure again.", "")
        if not record.get("masses"):
            out.insert(0, first if sheets.exceeds(record) else as_it_is)
    if record.get("masses"):
        out.insert(0, (WEIGH, ""))
    return out or [("Inspect the location that is marked, and measure again.", "")]


def _planned(record: Json) -> bool:
    """Whether `bayescal plan` can choose what decides between explanations."""
    open_ = record["verdict"] in ("ambiguous", "class", *sheets.UNMODELLED) or record["undecided"]
    return bool(open_ and record.get("plannable", True) and not record["dataset"].get("sessions"))


def effects(run: Run) -> Section | None:
    """All effects, sets of effects, and effects that were not assessed."""
    record = run.record
    caption = (
        "Sets of effects, the most probable first; log evidence relative to noise only; 1 nat is a factor "
        "of e = 2.7 in probability"
    )
    notes = texts([*record["footnotes"], *record["notes"]], "quiet")
    sets = Sheet(sheets.HYPOTHESES, record["hypotheses"], caption, 6)
    missing = tuple(text.not_assessed(record).items())
    lacking = Sheet(sheets.NOT_ASSESSED, missing, "Effects that these data cannot show")
    return blocks("effects", "Effects", sheets.effects_sheet(record), *notes, sets, lacking)


def levels(run: Run) -> Section | None:
    """Validation errors by model level, and what the named effects improve."""
    tables = sheets.levels_sheet(run.record), sheets.improvements(run.record), images_sheet(run.record)
    return blocks("levels", "Model levels and improvement", *tables)


def advice(run: Run) -> Section | None:
    """What to measure next."""
    caption = "Further measurements; detectability: noncentrality before and after"
    pairs = [a | {"separates": sheets.pair_of(run.record, a["separates"])} for a in run.record["next"]]
    table = Sheet(sheets.ADVICE, pairs, caption)
    columns = sheets.unshown(run.record).items()
    further = [f"To show {text.listed(effects, 'or')}: record {names}." for names, effects in columns]
    if not run.record["next"] and _planned(run.record):
        further.insert(0, "The measurements that decide between the explanations are those of bayescal plan.")
    nothing = () if run.record["next"] or further else ("No further measurements are proposed.",)
    return blocks("next", "What to measure next", table, *texts([*further, *nothing]))


SECTIONS: tuple[Callable[[Run], Section | None], ...] = (
    first, effects, lambda run: blocks("where", "Location of the error", sheets.where_sheet(run.record)),
    common.scene, lambda run: common.residuals(run, *(sheets.margin_sheet(run.record, k) for k in MARGINS)),
    levels, common.budget, lambda run: blocks("blind", "Blind spots", sheets.blind_sheet(run.record)), advice,
    common.inputs,
)  # fmt: skip
"""Sections of gap.html, in their order."""
