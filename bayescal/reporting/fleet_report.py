"""A fleet, from its record: tables and sentences, for the terminal and for its page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any
from urllib.parse import quote

from markupsafe import Markup
from rich.console import RenderableType
from rich.text import Text

from bayescal import __version__
from bayescal.effects.vocabulary import unit_label
from bayescal.reporting import text
from bayescal.reporting.fleet_record import PAGES
from bayescal.reporting.page.section import FirstScreen, Section, blocks, page, texts
from bayescal.reporting.page.section import Text as Paragraph
from bayescal.reporting.sheet import Column, Sheet, as_is, below, screen
from bayescal.storage.reading import Json

Link = Callable[[Json], Any]


def at_site(effect: Json) -> str:
    """An effect with its site."""
    name = text.rival(effect["effect"])
    return f"{name} at {effect['site']}" if effect["site"] else name


def difference(d: Json) -> str:
    """A difference with its probability over all comparisons."""
    return f"{d['parameter']} by {text.measured(d['value'], d['u'], d['unit'])}, p {text.p_value(d['p_all'])}"


def stated(arm: Json, key: str) -> list[Json]:
    """The differences of an arm, or its changes, that are stated."""
    return [d for d in arm[key] if d["stated"]]


def _joined(texts: list[str]) -> str | None:
    return "; ".join(texts) or None


def arms(record: Json, links: Link | None = None) -> Sheet:
    """The arms, those with findings first."""
    words = difference if links else lambda d: str(d["parameter"])
    columns = (
        Column("arm", "arm"),
        Column("sessions", lambda arm: len(arm["sessions"])),
        Column("U = k u (µm)", "expanded_U_um", text.uncertainty),
        Column("measured RMS (µm)", "measured_rms_um", text.length),
        Column("effects", lambda arm: _joined([at_site(e) for e in arm["effects"]]), words=True),
        Column("differs in", lambda arm: _joined([words(d) for d in stated(arm, "differs")]), words=True),
        Column("changed", lambda arm: _joined([words(d) for d in stated(arm, "changed")]), words=True),
        Column("log score (nats)", "log_score_nats", text.signed),
        *_of_links(links),
    )
    caption = "log score: of an arm, left out, under the distribution of the others, against the stated prior"
    return Sheet(columns, record["arms"], caption)


def _of_links(links: Link | None) -> tuple[Column, ...]:
    """The column of links to pages, where there are any."""
    return (Column("runs", links, as_is, words=True),) if links else ()


def effects(record: Json) -> Sheet:
    """Effects by site, and the arms that share them."""
    columns = (
        Column("effect", at_site),
        Column("arms", lambda e: f"{len(e['arms'])} of {e['of']}"),
        Column("expected", "expected_arms", "{:.1f}".format),
        Column("values", _range, words=True),
        Column("named for", lambda e: ", ".join(e["arms"]), words=True),
    )
    caption = "expected: sum over all arms of the probability of the effect, at any site"
    return Sheet(columns, record["effects"], caption)


def _range(e: Json) -> str | None:
    if e["values"] is None:
        return None
    low, high = (text.quantity(v, "") for v in e["values"])
    return f"{low if low == high else f'{low} to {high}'} {unit_label(e['unit'])}".rstrip()


def sessions(record: Json, links: Link | None = None) -> Sheet:
    """Every session, those that failed first, with their reason."""
    columns = (
        Column("session", "session"),
        Column("arm", "arm", words=True),
        Column("status", "status", words=True),
        Column("U = k u (µm)", lambda s: s["fit"] and s["fit"]["expanded_U_um"], text.uncertainty),
        Column("diagnosis", lambda s: s["gap"] and "; ".join(s["gap"]["words"][:1]), words=True),
        Column("error", "error", words=True),
        *_of_links(links),
    )
    return Sheet(columns, sorted(record["sessions"], key=lambda s: s["status"] != "failed"), shown=40)


def parameters(model: Json) -> Sheet:
    """The learnt prior of each parameter beside the stated one; deviations from nominal."""
    columns = (
        Column("parameter", lambda p: text.with_unit(p["name"], p["unit"])),
        Column("stated mean", "stated_deviation", text.two_digits),
        Column("stated sd", "stated_sd", text.two_digits),
        Column("mean (u)", lambda p: text.with_u(p["deviation"], p["u_deviation"])),
        Column("sd of usual arms", "usual_sd", text.two_digits),
        Column("learnt sd", "sd", text.two_digits),
        Column("of stated", lambda p: p["sd"] / p["stated_sd"], percent_of),
        Column("effective arms", "effective_arms", "{:.1f}".format),
    )
    caption = (
        "deviations from nominal; learnt sd: of a further arm, with u of the mean and the arms that differ; "
        "effective arms: number that the sd of usual arms is worth"
    )
    return Sheet(columns, model["parameters"], caption)


def percent_of(ratio: float) -> str:
    """A ratio in per cent, also above 100."""
    return f"{100 * ratio:.0f} %" if ratio >= 0.01 else text.percent(ratio)


def findings(record: Json) -> list[tuple[str, list[str]]]:
    """What was found, in sentences below headings."""
    shared = [
        f"{at_site(e)}: {len(e['arms'])} of {e['of']} arms ({', '.join(e['arms'])})"
        + (f", {_range(e)}" if e["values"] else "")
        for e in record["effects"]
        if len(e["arms"]) > 1
    ]
    alone = [f"{e['arms'][0]}: {at_site(e)}" for e in record["effects"] if len(e["arms"]) == 1]
    of = {m["robot"]: m for m in record["models"]}
    unlike = [
        f"{a['arm']} differs from the others in {difference(d)} ({of[a['robot']]['comparisons']} comparisons)"
        for a in record["arms"]
        for d in stated(a, "differs")
    ]
    changed = [
        f"{a['arm']} changed before session {d['since']} in {difference(d)} "
        f"({of[a['robot']]['comparisons_between_sessions']} comparisons)"
        for a in record["arms"]
        for d in stated(a, "changed")
    ]
    failed = [f"{s['session']}: {s['error']}" for s in record["sessions"] if s["error"]]
    return [
        ("shared effects", shared), ("effects", alone), ("outliers", unlike), ("changed", changed),
        ("failed", failed),
    ]  # fmt: skip


def learnt(model: Json) -> str:
    """What the learnt prior of a model gains, in a sentence."""
    count = len(model["arms"])
    if not model["parameters"]:
        return f"{model['robot']}: not learnt of {count} {'arm' if count == 1 else 'arms'}, it needs three"
    ratio = sorted(p["sd"] / p["stated_sd"] for p in model["parameters"])[len(model["parameters"]) // 2]
    wide = f"; widened {model['widened']:.2g} times by arms left out" if model["widened"] > 1.005 else ""
    return (
        f"{model['robot']}: {len(model['parameters'])} parameters of {count} arms, sd {percent_of(ratio)} of "
        f"the stated one (median); arms left out: {model['log_score_nats']:+.0f} nats against the stated "
        f"prior in the mean, {model['better']} of {count} better{wide}"
    )


def counted(record: Json) -> str:
    """The number of sessions by status."""
    c = record["count"]
    return f"{c['sessions']} sessions: {c['fitted']} fitted, {c['kept']} kept, {c['failed']} failed"


def names(record: Json) -> str:
    """Robots and number of arms."""
    each = [f"{len(m['arms'])} {'arm' if len(m['arms']) == 1 else 'arms'} of {m['robot']}"
            for m in record["models"]]  # fmt: skip
    return text.listed(each) if each else text.MISSING


MOST_ROWS = 20
"""Arms that the terminal lists."""


def summary(record: Json) -> RenderableType:
    """What was found, the arms, those with findings first, and how many sessions were fitted."""
    lines = [row for heading, sentences in findings(record) for row in text.under(heading, sentences)]
    lines += text.under("learnt prior", map(learnt, record["models"]))
    table = arms(record)
    some = Sheet(table.columns, table.items[:MOST_ROWS], table.caption)
    words = f"the first {MOST_ROWS} of {len(table.items)} arms; all: fleet.html"
    more = Text(words, "dim") if len(table.items) > MOST_ROWS else None
    title, count = Text(names(record), "bold"), Text(counted(record))
    return screen(title, lines, *below(some), "", more, count)


def fleet_page(record: Json) -> str:
    """fleet.html: what was found first, then tables with links to the pages of the runs."""
    by_name = {s["session"]: s for s in record["sessions"]}

    def of_session(session: Json) -> Markup | None:
        some = [
            Markup('<a href="{}">{}</a>').format(quote(f"{session['folder']}/{kind}/{file}"), kind)
            for kind, file in PAGES.items()
            if session[kind]
        ]
        return Markup(" ").join(some) or None

    def of_arm(arm: Json) -> Markup:
        each = [(name, of_session(by_name[name])) for name in arm["sessions"]]
        return Markup("<br>").join(Markup("{}: {}").format(name, links or "") for name, links in each)

    groups = findings(record)
    sections: list[Section | None] = [
        _first(record, groups),
        blocks("arms", "Arms, those with findings first", arms(record, of_arm)),
        blocks("effects", "Effects", effects(record)),
    ]
    for k, model in enumerate(record["models"]):
        note = Paragraph(learnt(model))
        name = "" if len(record["models"]) == 1 else f" of {model['robot']}"
        sections.append(blocks(f"prior-{k}", f"Learnt prior{name}", note, parameters(model)))
    sections.append(blocks("sessions", "Sessions", sessions(record, of_session)))
    sections.append(blocks("meaning", "What the figures mean", *texts(MEANING)))
    title = f"Fleet of {len(record['arms'])} arms"
    subtitle = f"{names(record)}; model: {', '.join(record['inputs']['model'])}"
    return page(title, subtitle, sections, (f"bayescal {__version__}; {counted(record)}",))


MEANING = (
    "An arm differs if a parameter of it is improbable under the distribution of the other arms; p is for "
    "all arms and parameters together (Bonferroni), by Student's t distribution of the effective number of "
    "arms. At p below 0.05, less than one fleet in twenty of equal arms has any arm that differs.",
    "A change is a difference of a session from those of its arm before it, beyond the uncertainty of both; "
    "p is for all later sessions and parameters together. The distribution of the fleet has the last state.",
    "The likelihood of each diagnosis without its prior is used, with its full covariance and the model "
    "discrepancy; named effects are in the model of their sessions.",
    "The learnt prior replaces the stated one in `robot: fleet-robot.yaml` of a further dataset. A parameter "
    "that the data place far from it has its usual prior there, and fit and gap name it.",
)


def _first(record: Json, groups: Sequence[tuple[str, list[str]]]) -> Section:
    of = {heading: lines for heading, lines in groups if lines}
    count = record["count"]
    words = [line for heading, lines in of.items() for line in lines if heading != "failed"]
    clean = "No arm differs from the others, changed, or shares an effect with another"
    unusual = len({a["arm"] for a in record["arms"] if _found(a)})
    word = clean if not words else f"{unusual} of {len(record['arms'])} arms have findings"
    keys = [
        ("Sessions", str(count["sessions"]), counted(record).partition(": ")[2]),
        ("Shared effects", str(len(of.get("shared effects", ()))), "named for two arms or more"),
        ("Outliers", str(sum(bool(stated(a, "differs")) for a in record["arms"])), "arms that differ"),
        ("Changed", str(sum(bool(stated(a, "changed")) for a in record["arms"])), "between sessions"),
    ]
    robots = [m["file"] for m in record["models"] if m["file"]]
    steps = [(f"Use the learnt prior for the next arm: put {f} beside its dataset.yaml", f"robot: {f}")
             for f in robots]  # fmt: skip
    leading = next((a for a in record["arms"] if _found(a)), None)
    if leading is not None:
        steps.insert(0, (f"Inspect {leading['arm']}: its runs are linked below", ""))
    failed = [f"{line}" for line in of.get("failed", ())]
    tone = "bad" if unusual else "good"
    return FirstScreen(
        word, tone, lines=words, most=8, keys=keys, next=steps or [("Fit further arms", "")], warnings=failed
    ).section()


def _found(arm: Json) -> bool:
    return bool(arm["effects"] or stated(arm, "differs") or stated(arm, "changed"))
