"""A fleet in the terminal, and its page."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

from markupsafe import Markup
from rich.console import RenderableType
from rich.text import Text

from bayescal import __version__
from bayescal.reporting import fleet_sheets as sheets
from bayescal.reporting.fleet_record import PAGES
from bayescal.reporting.page.render import page
from bayescal.reporting.page.section import FirstScreen, Section, blocks, texts
from bayescal.reporting.page.section import Text as Paragraph
from bayescal.reporting.shared.sheet import Sheet, below, screen
from bayescal.reporting.shared.text import under
from bayescal.storage.reading import Json

MOST_ROWS = 20
"""Arms that the terminal lists."""


def summary(record: Json) -> RenderableType:
    """What was found, the arms, those with findings first, and how many sessions were fitted."""
    lines = [row for heading, found in sheets.findings(record) for row in under(heading, found)]
    lines += under("learnt prior", map(sheets.learnt, record["models"]))
    table = sheets.arms(record)
    some = Sheet(table.columns, table.items[:MOST_ROWS], table.caption)
    words = f"the first {MOST_ROWS} of {len(table.items)} arms; all: fleet.html"
    more = Text(words, "dim") if len(table.items) > MOST_ROWS else None
    title, count = Text(sheets.names(record), "bold"), Text(sheets.counted(record))
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

    found = sheets.findings(record)
    sections: list[Section | None] = [
        _first(record, found),
        blocks("arms", "Arms, those with findings first", sheets.arms(record, of_arm)),
        blocks("effects", "Effects", sheets.effects(record)),
    ]
    for k, model in enumerate(record["models"]):
        note = Paragraph(sheets.learnt(model))
        name = "" if len(record["models"]) == 1 else f" of {model['robot']}"
        sections.append(blocks(f"prior-{k}", f"Learnt prior{name}", note, sheets.parameters(model)))
    sections.append(blocks("sessions", "Sessions", sheets.sessions(record, of_session)))
    sections.append(blocks("meaning", "What the figures mean", *texts(MEANING)))
    title = f"Fleet of {len(record['arms'])} arms"
    subtitle = f"{sheets.names(record)}; model: {', '.join(record['inputs']['model'])}"
    return page(title, subtitle, sections, (f"bayescal {__version__}; {sheets.counted(record)}",))


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


def _first(record: Json, found: Sequence[tuple[str, list[str]]]) -> Section:
    of = {heading: lines for heading, lines in found if lines}
    count = record["count"]
    words = [line for heading, lines in of.items() for line in lines if heading != "failed"]
    clean = "No arm differs from the others, changed, or shares an effect with another"
    unusual = len({a["arm"] for a in record["arms"] if _found(a)})
    word = clean if not words else f"{unusual} of {len(record['arms'])} arms have findings"
    keys = [
        ("Sessions", str(count["sessions"]), sheets.counted(record).partition(": ")[2]),
        ("Shared effects", str(len(of.get("shared effects", ()))), "named for two arms or more"),
        ("Outliers", str(sum(bool(sheets.stated(a, "differs")) for a in record["arms"])), "arms that differ"),
        ("Changed", str(sum(bool(sheets.stated(a, "changed")) for a in record["arms"])), "between sessions"),
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
    return bool(arm["effects"] or sheets.stated(arm, "differs") or sheets.stated(arm, "changed"))
