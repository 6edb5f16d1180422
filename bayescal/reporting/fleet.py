"""A fleet: fleet.json (sessions, arms, effects they share, learnt priors), its tables, sentences and page."""

from collections.abc import Callable, Mapping, Sequence
from itertools import starmap
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup
from rich.console import RenderableType
from rich.text import Text

from bayescal import __version__
from bayescal.effects import UNITS
from bayescal.effects.vocabulary import unit_label
from bayescal.fleets.compare import Difference, Model, priors
from bayescal.reporting import text
from bayescal.reporting.origin import LIBRARIES, entry, plain, software
from bayescal.reporting.page import FirstScreen, Section, blocks, page, texts
from bayescal.reporting.page import Text as Paragraph
from bayescal.reporting.sheet import Column, Sheet, as_is, below, screen
from bayescal.statistics import grouped
from bayescal.storage.reading import Json, read_record

FLEET, SCHEMA = "fleet.json", "bayescal-fleet/1"
REPEAT = "remove the folder, and repeat bayescal fleet"
PAGES = {"fit": "report.html", "gap": "gap.html"}
"""Page of each run folder of a session."""
UNKNOWN = "unknown"
LEARNT = ("stated_sd=parameter.sd", "deviation=mean", "u_deviation=u_mean", "usual_sd=usual", "sd")
"""Fields of a parameter of ``models``."""
MOST_ROWS = 20
"""Arms that the terminal lists."""
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


def session_entry(name: str, path: Path, below: str, status: str, error: str) -> dict[str, Any]:
    """A session without results: its name, its dataset, its folder below that of the fleet, what failed."""
    return {
        "session": name, "dataset": str(path), "folder": below, "status": status, "error": error or None,
        "name": None, "sha256": None, "robot": None, "serial": None, "date": None, "arm": None, "fit": None,
        "gap": None, "effects": [], "probability": {},
    }  # fmt: skip


def with_fit(session: Json, folder: Path) -> dict[str, Any]:
    """The session with what fit.json states."""
    record = read_record(folder / "fit.json", "bayescal-fit/1", REPEAT)
    expected = record["predicted_distance"]
    keys = ("over", "count", "predicted_rms_um", "expanded_U_um", "measured_rms_um")
    return {
        **session,
        **{key: record["dataset"][key] for key in ("name", "sha256")},
        "robot": record["arm"]["robot"],
        "serial": record["record"]["serials"]["arm"],
        "date": record["record"]["date"],
        "fit": {key: expected.get(key) for key in keys}
        | {"verdict": record["verdict"]["words"], "usable": record["verdict"]["explains"]},
    }


def with_gap(session: Json, folder: Path) -> dict[str, Any]:
    """The session with what gap.json states: an entry of ``effects`` for each named effect and site."""
    record = read_record(folder / "gap.json", "bayescal-gap/1", REPEAT)
    sizes = {(a["effect"], a["site"]): a for a in record["amplitudes"]}
    named = [
        _named(one["effect"], site, one["probability"], sizes.get((one["effect"], site), {}))
        for one in record["named"]
        for site in one["sites"] or [site for effect, site in sizes if effect == one["effect"]] or [""]
    ]
    if not named and record["verdict"] in (UNKNOWN, "class"):
        members = (record["class"] or {}).get("members") or [UNKNOWN]
        p = record["probability"].get(UNKNOWN) if list(members) == [UNKNOWN] else None
        named.append(_named(" or ".join(members), (record["class"] or {}).get("site") or "", p, {}))
    return {
        **session,
        "gap": {"verdict": record["verdict"], "words": record["words"]},
        "effects": named,
        "probability": record["probability"],
    }


def _named(effect: str, site: str, probability: float | None, size: Json) -> Json:
    amplitude = {key: size.get(key) for key in ("what", "value", "u", "unit")}
    return {"effect": effect, "site": site, "probability": probability, **amplitude}


def fleet_record(
    sessions: Sequence[Json], models: Sequence[Model], inputs: Json, files: Mapping[int, str]
) -> dict[str, Any]:
    """The content of fleet.json; `files` are the robot files of the models, by their index."""
    count = {status: sum(s["status"] == status for s in sessions) for status in ("fitted", "kept", "failed")}
    record = {
        "schema": SCHEMA, "software": software(LIBRARIES), "inputs": inputs,
        "count": {"sessions": len(sessions), **count}, "arms": _arms(sessions, models),
        "effects": _effects(sessions), "models": [_model(m, files.get(k)) for k, m in enumerate(models)],
        "sessions": list(sessions),
    }  # fmt: skip
    return plain(record)


def _arms(sessions: Sequence[Json], models: Sequence[Model]) -> list[dict[str, Any]]:
    """The arms in order: by what was found of them, then by the expanded uncertainty of distances."""
    return sorted((_arm(arm, m, sessions) for m in models for arm in m.arms), key=_order)


def _arm(arm: str, m: Model, sessions: Sequence[Json]) -> dict[str, Any]:
    of_arm = [s for s in sessions if s["arm"] == arm and s["robot"] == m.robot and s["fit"]]
    return {
        "arm": arm,
        "robot": m.robot,
        "sessions": [s["session"] for s in of_arm],
        **{key: of_arm[-1]["fit"][key] for key in ("expanded_U_um", "measured_rms_um")},
        "effects": list({(e["effect"], e["site"]): e for s in of_arm for e in s["effects"]}.values()),
        "differs": [_difference(d) for d in m.unlike if d.arm == arm],
        "changed": [_difference(d) for d in m.changed if d.arm == arm],
        "log_score_nats": m.gains.get(arm),
    }


def _order(arm: Json) -> tuple[Any, ...]:
    count = sum(len(stated(arm, key)) for key in ("changed", "differs"))
    return (-count, -len(arm["effects"]), -(arm["expanded_U_um"] or 0.0), arm["arm"])


def _difference(d: Difference) -> dict[str, Any]:
    of, sizes = d.parameter, entry(d, "value", "u", unit=d.parameter.unit)
    named = {"parameter": of.name, "unit": UNITS[of.unit][0]}
    return named | sizes | entry(d, "p_value=p", "p_all", "stated") | {"since": d.since or None}


def _effects(sessions: Sequence[Json]) -> list[Json]:
    """Effects by site: the arms of which a session has it named, and the number expected of all arms."""
    each = ((s, e) for s in sessions for e in s["effects"])
    by_site = grouped(((e["effect"], e["site"], s["robot"]), (s["arm"], e)) for s, e in each)
    every = (_effect(key, of_arms, sessions) for key, of_arms in by_site.items())
    return sorted(every, key=lambda e: -len(e["arms"]))


def _effect(key: tuple[str, str, str], each: Sequence[tuple[str, Json]], sessions: Sequence[Json]) -> Json:
    """An effect at a site of a robot: `each` is an arm, and the effect as a session of it has it."""
    effect, _, robot = key
    chances: dict[str, float] = {}
    for s in sessions:
        if s["robot"] == robot and s["gap"]:
            chances[s["arm"]] = max(chances.get(s["arm"], 0.0), s["probability"].get(effect) or 0.0)
    sizes = [e["value"] for _, e in each if e["value"] is not None]
    return dict(zip(("effect", "site", "robot"), key, strict=True)) | {
        "arms": list(dict.fromkeys(arm for arm, _ in each)),
        "of": len(chances),
        "expected_arms": sum(chances.values()),
        "unit": each[0][1]["unit"],
        "values": [min(sizes), max(sizes)] if sizes else None,
    }


def _model(m: Model, file: str | None) -> dict[str, Any]:
    entries = []
    for prior in priors(m):
        p = prior.parameter
        unit, factor = UNITS[p.unit]
        stated = {"name": p.name, "unit": unit, "stated_deviation": factor * (p.centre - p.nominal)}
        entries.append(stated | entry(prior, *LEARNT, unit=p.unit) | {"effective_arms": prior.arms})
    gains = list(m.gains.values())
    return {
        **entry(m, "robot", "arms", "comparisons", "comparisons_between_sessions=pairs"),
        "log_score_nats": sum(gains) / len(gains) if gains else None,
        "better": sum(g > 0 for g in gains),
        "widened": None if m.learnt is None else m.learnt.factor,
        "file": file,
        "parameters": entries,
    }


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


def arms(record: Json, links: Callable[[Json], Any] | None = None) -> Sheet:
    """The arms, those with findings first."""
    words = difference if links else lambda d: str(d["parameter"])
    columns = (
        Column("arm", "arm"),
        Column("sessions", lambda arm: len(arm["sessions"])),
        Column("U = k u (µm)", "expanded_U_um", text.uncertainty),
        Column("measured RMS (µm)", "measured_rms_um", text.length),
        Column("effects", lambda arm: list(map(at_site, arm["effects"])) or None, "; ".join, words=True),
        Column("differs in", lambda a: list(map(words, stated(a, "differs"))) or None, "; ".join, words=True),
        Column("changed", lambda a: list(map(words, stated(a, "changed"))) or None, "; ".join, words=True),
        Column("log score (nats)", "log_score_nats", text.signed),
        *((Column("runs", links, as_is, words=True),) if links else ()),
    )
    caption = "log score: of an arm, left out, under the distribution of the others, against the stated prior"
    return Sheet(columns, record["arms"], caption)


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


def sessions(record: Json, links: Callable[[Json], Any] | None = None) -> Sheet:
    """Every session, those that failed first, with their reason."""
    columns = (
        Column("session", "session"),
        Column("arm", "arm", words=True),
        Column("status", "status", words=True),
        Column("U = k u (µm)", lambda s: s["fit"] and s["fit"]["expanded_U_um"], text.uncertainty),
        Column("diagnosis", lambda s: s["gap"] and "; ".join(s["gap"]["words"][:1]), words=True),
        Column("error", "error", words=True),
        *((Column("runs", links, as_is, words=True),) if links else ()),
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


def findings(record: Json) -> dict[str, list[str]]:
    """What was found, in sentences below headings."""
    of = {m["robot"]: m for m in record["models"]}
    return {
        "shared effects": [
            f"{at_site(e)}: {len(e['arms'])} of {e['of']} arms ({', '.join(e['arms'])})"
            + (f", {_range(e)}" if e["values"] else "")
            for e in record["effects"]
            if len(e["arms"]) > 1
        ],
        "effects": [f"{e['arms'][0]}: {at_site(e)}" for e in record["effects"] if len(e["arms"]) == 1],
        "outliers": [
            f"{a['arm']} differs from the others in {difference(d)} "
            f"({of[a['robot']]['comparisons']} comparisons)"
            for a in record["arms"]
            for d in stated(a, "differs")
        ],
        "changed": [
            f"{a['arm']} changed before session {d['since']} in {difference(d)} "
            f"({of[a['robot']]['comparisons_between_sessions']} comparisons)"
            for a in record["arms"]
            for d in stated(a, "changed")
        ],
        "failed": [f"{s['session']}: {s['error']}" for s in record["sessions"] if s["error"]],
    }


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
    counts = [(len(m["arms"]), m["robot"]) for m in record["models"]]
    each = [f"{count} {'arm' if count == 1 else 'arms'} of {robot}" for count, robot in counts]
    return text.listed(each) if each else text.MISSING


def summary(record: Json) -> RenderableType:
    """What was found, the arms, those with findings first, and how many sessions were fitted."""
    lines = [row for heading, sentences in findings(record).items() for row in text.under(heading, sentences)]
    lines += text.under("learnt prior", map(learnt, record["models"]))
    table = arms(record)
    some = Sheet(table.columns, table.items[:MOST_ROWS], table.caption)
    words = f"the first {MOST_ROWS} of {len(table.items)} arms; all: fleet.html"
    more = Text(words, "dim") if len(table.items) > MOST_ROWS else None
    return screen(Text(names(record), "bold"), lines, *below(some), "", more, Text(counted(record)))


def fleet_page(record: Json) -> str:
    """fleet.html: what was found first, then tables with links to the pages of the runs."""
    by_name = {s["session"]: s for s in record["sessions"]}

    def of_session(session: Json) -> Markup | None:
        pages = ((kind, f"{session['folder']}/{kind}/{PAGES[kind]}") for kind in PAGES if session[kind])
        some = (Markup('<a href="{}">{}</a>').format(quote(path), kind) for kind, path in pages)
        return Markup(" ").join(some) or None

    def of_arm(arm: Json) -> Markup:
        each = [(name, of_session(by_name[name])) for name in arm["sessions"]]
        return Markup("<br>").join(Markup("{}: {}").format(name, links or "") for name, links in each)

    def of_model(k: int, model: Json) -> Section | None:
        name = "" if len(record["models"]) == 1 else f" of {model['robot']}"
        return blocks(f"prior-{k}", f"Learnt prior{name}", Paragraph(learnt(model)), parameters(model))

    sections = [
        _first(record),
        blocks("arms", "Arms, those with findings first", arms(record, of_arm)),
        blocks("effects", "Effects", effects(record)),
        *starmap(of_model, enumerate(record["models"])),
        blocks("sessions", "Sessions", sessions(record, of_session)),
        blocks("meaning", "What the figures mean", *texts(MEANING)),
    ]
    title = f"Fleet of {len(record['arms'])} arms"
    subtitle = f"{names(record)}; model: {', '.join(record['inputs']['model'])}"
    return page(title, subtitle, sections, (f"bayescal {__version__}; {counted(record)}",))


def _first(record: Json) -> Section:
    of = findings(record)
    words = [line for heading, lines in of.items() for line in lines if heading != "failed"]
    clean = "No arm differs from the others, changed, or shares an effect with another"
    differ, change = ([a for a in record["arms"] if stated(a, key)] for key in ("differs", "changed"))
    leading = [a for a in record["arms"] if a["effects"] or a in differ or a in change]
    unusual = len({a["arm"] for a in leading})
    word = clean if not words else f"{unusual} of {len(record['arms'])} arms have findings"
    keys = [
        ("Sessions", str(record["count"]["sessions"]), counted(record).partition(": ")[2]),
        ("Shared effects", str(len(of["shared effects"])), "named for two arms or more"),
        ("Outliers", str(len(differ)), "arms that differ"),
        ("Changed", str(len(change)), "between sessions"),
    ]
    steps = [(f"Inspect {a['arm']}: its runs are linked below", "") for a in leading[:1]]
    for file in (m["file"] for m in record["models"] if m["file"]):
        put = f"Use the learnt prior for the next arm: put {file} beside its dataset.yaml"
        steps.append((put, f"robot: {file}"))
    steps, tone = steps or [("Fit further arms", "")], "bad" if unusual else "good"
    return FirstScreen(
        word, tone, lines=words, most=8, keys=keys, next=steps, warnings=of["failed"]
    ).section()
