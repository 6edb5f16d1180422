"""Tables of a diagnosis and next.csv, of the entries of its record, and how these are written as text."""

from collections.abc import Sequence

from bayescal.dataset.table import csv_text, joint_columns
from bayescal.effects.location import Site, of_sign
from bayescal.gap.result import VALIDATION_POINTS
from bayescal.reporting import text
from bayescal.reporting.fit import level_sheet
from bayescal.reporting.origin import scaled
from bayescal.reporting.sheet import Bar, Column, Sheet, as_is, bar_of, of_key
from bayescal.reporting.text import p_value
from bayescal.storage.reading import Json

UNMODELLED = ("unknown", "named+unexplained")
"""Verdicts that state an unmodelled effect."""
NULL, OTHER = "null", "unknown"


def marked(place: Json) -> bool:
    """Whether a location of a record is significant."""
    return text.significant(place["family_p_value"])


def amplitudes_of(record: Json, effect: str) -> list[Json]:
    """The amplitudes of an effect: the significant ones, or one where none is."""
    return [a for a in record["amplitudes"] if a["effect"] == effect]


def location_of(record: Json, effect: str) -> str:
    """The sites of a named effect, each once, and where it would look the same; "" of any other."""
    named = next((n for n in record["named"] if n["effect"] == effect), None)
    if named is None:
        return ""
    sites = dict.fromkeys(site_of(a["site"]) for a in amplitudes_of(record, effect))
    here = ", ".join(sites) or site_of(named["site"])
    return " or ".join((here, *map(site_of, named["neighbours"])))


def unexplained(record: Json) -> Json | None:
    """The largest location that no named effect explains: of an unmodelled effect, or of a sudden change."""
    first = next((w for w in record["where"] if not w["explained_by"]), None)
    return first if first and (record["verdict"] in UNMODELLED or "event" in first) else None


def per_vector(what: str, components: int) -> float:
    """Factor from the RMS of the residuals of a kind of measurement to the RMS of the lengths of its errors.

    The residuals of a point are its coordinates, `components` of them: three, two of a corner in an image.
    That of a contact or a distance is a length.
    """
    return components**0.5 if what in ("points", VALIDATION_POINTS) else 1.0


def exceeds(record: Json) -> bool:
    """Whether the validation errors alone exceed the noise; an effect may show in the fitted ones only."""
    return bool(record["gap"]["excess_um"]["interval95"][0])


def rms_of(record: Json) -> str:
    """What RMS values of groups and locations are: for points they are per coordinate."""
    return f"RMS{text.per_residual(record)}"


def size_of(record: Json, place: Json) -> str:
    """Size of the error at a location."""
    return f"{text.length(place['rms_um'])} µm {rms_of(record)}"


def amplitude_of(a: Json) -> str:
    """An amplitude with u and unit."""
    what, value = of_sign(a["what"], a["value"])
    size = f"{what} {text.measured(value, a['u'], a['unit'])}"
    return size if a["significant"] else f"{size}, not significant alone"


def sizes_of(some: Sequence[Json]) -> str:
    """Amplitudes of an effect; by location and parameter, where there are several."""
    several, out = len({a["site"] for a in some}) > 1, []
    for a in some:
        alike = [o for o in some if all(o[key] == a[key] for key in ("site", "driver", "what"))]
        names = ", ".join(name.removeprefix(f"{a['effect']} ") for name in a["parameters"])
        which = f" ({names})" if len(alike) > 1 else ""
        out.append((f"{site_of(a['site'])}: " if several else "") + amplitude_of(a) + which)
    return "; ".join(out)


def site_of(site: str) -> str:
    """One or several sites of a record in words."""
    return " and ".join(Site.read(part).text for part in site.split(" and "))


def share_of(record: Json, effect: str) -> str:
    """Share of the excess variance at the largest location that an effect explains, named among several."""
    places = [w for w in record["where"] if w["explained_by"] and effect in w["explained_by"].split(", ")]
    if not places or places[0]["share"] is None:
        return text.MISSING
    several = len({w["site"] for w in places}) > 1
    return text.share(places[0]["share"]) + (f" at {site_of(places[0]['site'])}" if several else "")


def effects_sheet(record: Json) -> Sheet:
    """All effects by probability, with amplitude, share, location, and what is detectable."""
    least, place, items = _detectable(record), unexplained(record), []
    for name, p in sorted(record["probability"].items(), key=lambda item: -(item[1] or 0.0)):
        some = amplitudes_of(record, name)
        size, location, part = sizes_of(some), location_of(record, name), share_of(record, name)
        if place and name == OTHER:
            size, location, part = size_of(record, place), place["text"], text.share(place["share"])
        stated = text.MISSING if p is None else text.probability(p)
        bar = Bar(p or 0.0, stated, name in record["credible_set90"])
        items.append(
            (text.rival(name), bar, size or text.MISSING, location or text.MISSING, part, least.get(name))
        )
    columns = (
        Column("effect", 0),
        Column("probability", 1, as_is),
        Column("size (u)", 2, words=True),
        Column("location", 3, words=True),
        Column("share of the excess", 4),
        Column("detectable from", 5),
    )
    with_ = ", with errors of its masses," if record.get("masses") else ""
    caption = (
        f"Coloured: the 90 % set. Effects may be present together. 'noise only': the model as it is{with_} "
        "explains the data; 'unmodelled effect': none of the known effects does"
    )
    likely = sum((p or 0.0) >= text.LEAST for p in record["probability"].values())
    return Sheet(columns, items, caption, max(likely, 5))


def _detectable(record: Json) -> dict[str, str]:
    """Smallest detectable amplitude of each effect that may be missed, with the location where it is."""
    spots = reversed(record["blind_spots"])  # of an effect the first counts
    return {b["effect"]: f"{_least(b)}, {site_of(b['site'])}" for b in spots}


def _least(spot: Json) -> str:
    least, usual = spot["smallest_nameable"], spot["plausible"]["value"]
    never = least["value"] is None or (usual is not None and least["value"] >= text.NEVER * usual)
    return "not detectable" if never else text.quantity(least["value"], least["unit"])


def likely(probability: float) -> Bar:
    """A bar of a probability."""
    return Bar(probability, text.probability(probability))


NOT_ASSESSED = (Column("not assessed", 0), Column("why", 1, words=True))
HYPOTHESES = (
    Column("set of effects", lambda h: " + ".join(map(text.rival, h["effects"])) or text.rival(NULL)),
    Column("probability", "probability", likely),
    Column("log evidence (nats)", "log_evidence", lambda nats: text.signed(nats, 1)),
)
ADVICE = (
    Column("separates", lambda a: " and ".join(map(text.rival, a["separates"]))),
    Column("measure", "what", words=True),
    Column("rows in next.csv", lambda a: len(a["contacts"]) or None),
    Column("detectability", lambda a: f"{a['lambda_before']:.0f} to {a['lambda_after']:.0f}"),
)
"""Of entries of a record: `hypotheses`, `next`."""


def places_of(record: Json) -> list[Json]:
    """Locations, each once: functions of one quantity about several axes are one location, by the largest."""
    first: dict[str, Json] = {}
    for w in record["where"]:
        first.setdefault(w["text"], w)
    return list(first.values())


def pair_of(record: Json, names: Sequence[str]) -> list[str]:
    """Hypotheses that an advice distinguishes; beside names, none of either is no further effect."""
    none = "no further effect" if record["named"] else text.rival(NULL)
    return [none if name in (NULL, text.rival(NULL)) else text.rival(name) for name in names]


def where_sheet(record: Json) -> Sheet:
    """Locations of the error, the largest first."""
    places = places_of(record)
    excess = any((w["share"] or 0.0) > 0.0 for w in places)
    excess = excess and record["verdict"] != NULL  # no share of nothing is stated
    columns = (
        Column("location and dependence", "text"),
        Column(f"{rms_of(record)} (µm)", bar_of(places, "rms_um", marked), as_is),
        Column("share of the excess", lambda w: w["share"] if excess and marked(w) else None, text.share),
        Column("p", "family_p_value", p_value),
        Column("explained by", lambda w: w["explained_by"] or None, words=True),
    )
    caption = (
        "Residuals explained by a location; coloured: significant (p below 0.01, corrected for their number)"
    )
    return Sheet(columns, places, caption, 8)


def margin_sheet(record: Json, key: str) -> Sheet:
    """Residuals by target, joint, region, time or direction."""
    groups = record["where_marginal"][key]
    bars = bar_of(groups, "rms_um", lambda g: text.significant(g["p_value"] or None))
    columns = (
        Column(key, "label"),
        Column("rows", "count"),
        Column(f"{rms_of(record)} (µm)", bars, as_is),
        Column("mean (µm)", "mean_um", text.length),
        Column("p", "p_value", p_value),
    )
    before = ", before the refit" if record["named"] else ""
    before += ", corrected for their leverage in the fit"
    each = ": the largest groups of each joint" if key == "joint" else ""
    return Sheet(columns, groups, f"Residuals by {key}{before}{each}", 8)


LEVELS = (
    ("contacts RMS", "heldout_rms_um"),
    ("distances RMS", "distance_rms_um"),
    ("points RMS (length)", "point_length_rms_um"),
)


def levels_sheet(record: Json, shown: Sequence[tuple[str, str]] = (), missing: str | None = None) -> Sheet:
    """Validation errors by model level: headings and keys of those `shown`, and the text of no difference."""

    def gain(step: Json) -> str | None:
        spread = "" if step["delta_elpd_se"] is None else f" ± {step['delta_elpd_se']:.0f}"
        return f"{text.signed(step['delta_elpd'])}{spread}" if step["delta_elpd"] else missing

    shown = shown or (LEVELS[1:] if record["lengths"]["of"] == VALIDATION_POINTS else LEVELS)
    columns = Column("difference of log density (nats)", gain)
    return level_sheet(record["ladder"], shown, text.level_labels(record["ladder"]), columns)


MEASURED = {"planes": "contacts"}
"""Kinds of validation measurement in words: surfaces of any kind are touched, not planes alone."""


def improved(record: Json) -> list[Json]:
    """Entries of `shrinkage` by `what`, where errors of points are lengths."""
    count = record["lengths"]["components"]
    return [
        {"what": MEASURED.get(what, what)}
        | {
            key: scaled(value, per_vector(what, count)) if key.endswith("_um") else value
            for key, value in s.items()
        }
        for what, s in record["shrinkage"].items()
        if s
    ]


def worse(record: Json) -> list[str]:
    """Kinds of errors that are larger with the named effects, and outside the interval that these predict.

    The interval is that of the baseline, in proportion to what both predict.
    """
    limits = {
        m["what"]: m["predicted_interval95_um"][1] / m["predicted_rms_um"] for m in record["gap"]["measured"]
    }
    out = []
    for s in improved(record):
        limit = next((x for what, x in limits.items() if what.endswith(s["what"])), float("inf"))
        if s["after_rms_um"] > max(s["before_rms_um"], limit * s["predicted_rms_um"]):
            out.append(s["what"])
    return out


def improvements(record: Json) -> Sheet:
    """What the named effects improve."""
    columns = (
        Column("refit with the named effects", "what"),
        Column("number", "count"),
        Column("before (µm)", "before_rms_um", text.length),
        Column("after (µm)", lambda s: text.length(s["after_rms_um"]) if s["claimed"] else "not claimed"),
        Column("expected (µm)", "predicted_rms_um", text.length),
        Column("limit (µm)", "floor_um", text.length),
        *(Column(h, of_key(_reduction, k)) for k, h in enumerate(("removed", "95 %"))),
    )
    caption = (
        "RMS of validation errors; limit: expected RMS for a correct model; removed: share of the excess"
    )
    return Sheet(columns, improved(record), caption)


def _reduction(s: Json, part: int) -> str:
    return text.reduction(s["removed"], s["removed_interval95"], s["claimed"])[part]


def blind_sheet(record: Json) -> Sheet:
    """Effects that these data may miss."""
    spots = sorted(record["blind_spots"], key=lambda b: -(b["distance_error_um"] or 0.0))
    bar = bar_of(spots, "distance_error_um", unit=" µm")

    def error(spot: Json) -> Bar | None:
        return None if spot["distance_error_um"] is None else bar(spot)

    columns = (
        Column("may be missed", lambda b: f"{b['effect']}, {site_of(b['site'])}"),
        Column("plausible", lambda b: text.quantity(b["plausible"]["value"], b["plausible"]["unit"])),
        Column("detectable from", _least),
        Column("distance error if undetected", error, as_is),
    )
    caption = "Blind spots: effects whose plausible amplitude these measurements would not show"
    return Sheet(columns, spots, caption, 8)


FIRST = 3
"""Contacts in the summary."""
DECIMALS = 7
"""Of degrees in the file, as in recorded sessions."""


def _stated(contacts: Sequence[Json], key: str) -> bool:
    return any(c[key] is not None for c in contacts)


def _readings(contact: Json) -> list[float]:
    """Readings of a contact, deg; mm of prismatic joints."""
    return list(contact["j"] if "j" in contact else contact["j_deg"])


def _speed(contact: Json) -> list[float]:
    """Velocities of the joints, deg/s or mm/s; empty if none are stated."""
    return list(contact.get("j_per_s", contact.get("j_degps")) or [])


def _units(contact: Json) -> list[str]:
    return list(contact.get("units", ["deg"] * len(_readings(contact))))


def table_of_contacts(contacts: Sequence[Json]) -> str:
    """The content of next.csv: columns of measurements.csv without results, and what a row repeats.

    ``repeat_of`` is the contact of the session that a row repeats unchanged, or empty.
    """
    units = _units(contacts[0])
    moving, loaded = any(_speed(c) for c in contacts), _stated(contacts, "payload_kg")
    head = ["id", "role", "target", "tool", *joint_columns("deg", units)]
    head += joint_columns("degps", units) * moving + ("payload_kg",) * loaded + ("repeat_of",)
    rows = []
    for c in contacts:
        row = [c["id"], "calibrate", c["target"], c["tool"], *(f"{v:.{DECIMALS}f}" for v in _readings(c))]
        if moving:
            row += [f"{v:.{DECIMALS}f}" for v in _speed(c)] or [""] * len(units)
        if loaded:
            row.append("" if c["payload_kg"] is None else f"{c['payload_kg']:g}")
        rows.append([*row, c["repeat_of"]])
    return csv_text(head, rows)


def unshown(record: Json) -> dict[str, list[str]]:
    """Effects that may explain an error, by the columns that the session lacks for them."""
    return {} if record["verdict"] == "null" else record.get("not_excluded", {})


def measured_as(record: Json, contacts: Sequence[Json]) -> str:
    """Whether contacts that are advised are images of a camera, or contacts."""
    cameras = {camera["target"] for camera in record.get("images", ())}
    if not contacts:  # as those of the session
        return "image" if cameras else "contact"
    return "image" if all(c["target"] in cameras for c in contacts) else "contact"


def first_contacts(contacts: Sequence[Json], noun: str = "contact") -> Sheet:
    """The first of the contacts, or images, that are advised."""
    shown = contacts[:FIRST]
    columns = [Column(f"next {noun}s", "id"), Column("target", "target")]
    columns += [
        Column(f"J{k + 1} ({unit})", of_key(lambda c, k: _readings(c)[k], k), "{:.3f}".format)
        for k, unit in enumerate(_units(shown[0]))
    ]
    if any(_speed(c) for c in shown):
        columns.append(Column("direction of motion", _speed, _signs))
    if _stated(shown, "payload_kg"):
        columns.append(Column("payload (kg)", "payload_kg", "{:g}".format))
    return Sheet(tuple(columns), shown)


def _signs(velocity: Sequence[float]) -> str:
    """The side on which each joint arrives: ``+-+0+-`` from the first joint on."""
    return "".join("+" if v > 0 else "-" if v < 0 else "0" for v in velocity)
