"""What an unmodelled error shows and what to inspect, and amplitudes of named effects: text and entries."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.cameras import FIXED
from bayescal.dataset.target_kinds import KINDS
from bayescal.effects.location import ARTEFACT, BASE, DEVIATION, Site, of_sign
from bayescal.effects.vocabulary import unit_label
from bayescal.gap.result import MOVES, TOGETHER, Amplitude, Event, Gap, Place
from bayescal.reporting.origin import entry, sized
from bayescal.reporting.text import listed, measured, with_u
from bayescal.storage.reading import table_beside

PLAIN = 0.05
"""Largest p-value, corrected for all locations, of a location that is stated as a finding (convention)."""
MOSTLY = 0.5
"""Share of the square of an error in a region, above which the target that has it is named (convention)."""
MOST = "a sudden change alone explains most of it: "
ALIKE = "these data do not distinguish them"
TIGHT = "Check that it is tight and was not struck."
CAUSES = {
    (site, driver, cause.get("form", "")): (cause["what"], cause["inspect"])
    for cause in table_beside(__file__, "causes.toml")["cause"]
    for site in cause["sites"]
    for driver in cause["drivers"]
}
"""By kind of site, kind of driver and its form: what happens, with `{site}`, `{joint}`; what to inspect."""


def cause(where: Place) -> tuple[str, str] | None:
    """The cause that a significant unmodelled location shows, as of `CAUSES`, or None."""
    if where.explained_by or not where.family_p_value < PLAIN:
        return None
    driver = ("event", "") if where.event else (where.driver.kind, where.driver.form)
    return CAUSES.get((where.site.kind, *driver))


def either(sites: Sequence[Site], drivers: Sequence[str], dataset: Dataset) -> list[str]:
    """Sites in words, the base with what is not distinguishable from it by kinds of drivers."""
    out, kinds = [site.text for site in sites], [site.kind for site in sites]
    if BASE.kind in kinds and "face" not in kinds and (also := beside_base(dataset, drivers)):
        out.insert(kinds.index(BASE.kind) + 1, f"the {also}")
    return out


def who_of(
    who: str, here: Sequence[Site], neighbours: Sequence[Site], drivers: Sequence[str], dataset: Dataset
) -> str:
    """Who has an error at one site, or at others as text, or a neighbour at which it would look the same."""
    of_text = [] if len(here) == 1 else [who]
    each = of_text + either((*here, *neighbours) if not of_text else neighbours, drivers, dataset)
    return f"{listed(each, 'or')} ({ALIKE})" if len(each) > 1 else who


def site_text(where: Place, dataset: Dataset) -> str:
    """The sites of a location without articles: ``joint 6 or tool``."""
    each = either((where.site, *where.neighbours), [where.driver.kind], dataset)
    return listed((text.removeprefix("the ") for text in each), "or")


def beside_base(dataset: Dataset, drivers: Sequence[str]) -> str:
    """What is not distinguishable from the base, by kinds of drivers: an instrument, a board, an artefact.

    Of what is fixed (a camera, a board, all that the arm touches), the base is distinguishable only by errors
    that follow the arm.
    """
    used = [dataset.targets[k] for k in _fitted_targets(dataset)]
    moves = bool(drivers) and set(drivers) <= MOVES
    if moves and not any(KINDS[t.kind].of_instrument for t in used):
        return "artefact"
    if len(used) != 1:
        return ""
    if used[0].kind == "instrument":
        return "instrument"
    if used[0].kind == "camera" and moves:
        return "fixed camera" if used[0].texts.get("mount") == FIXED else "board"
    return ""


def _fitted_targets(dataset: Dataset) -> list[int]:
    return np.unique(dataset.measurements.target[dataset.measurements.role == "calibrate"]).tolist()


def mostly(where: Place, dataset: Dataset) -> str:
    """The target that has most of an error in one region of the workspace, or ""."""
    if where.driver.form != "one region" or len(_fitted_targets(dataset)) < 2:
        return ""
    square = np.bincount(dataset.measurements.target[where.curve.rows], where.curve.fitted**2)
    most = int(np.argmax(square))
    return dataset.targets[most].name if square[most] > MOSTLY * np.sum(square) else ""


def sentence(where: Place, dataset: Dataset) -> str:
    """What happens, when, and by how much: ``the tool shifted at row 212 by (10.0(4), ...) µm``; or ""."""
    if (happens := cause(where)) is None:
        return ""
    here = listed(either([where.site], [where.driver.kind], dataset), "or")
    text = happens[0].format(site=here, joint=f"J{where.driver.joint}")
    if where.driver.kind == "reading" and len(_fitted_targets(dataset)) > 1:
        text += "; or the noise differs between targets: compare their residuals"
    if target := mostly(where, dataset):
        text += f"; most of it is on {target}: its place or a certified value may be in error instead"
    if where.event is not None:
        text = f"{'' if where.driver.kind == 'event' else MOST}{text} at {when(where.event, dataset)}"
    shown = [a for a in where.amplitudes if any(b.significant for b in where.amplitudes if b.unit == a.unit)]
    text += "".join(f" {part}" for part in _sizes(shown))
    if not where.neighbours:
        return text
    others = [_beside(site, where, happens[0], dataset) for site in where.neighbours]
    return f"{text}, or {listed(others, 'or')} ({ALIKE})"


def _beside(site: Site, where: Place, happens: str, dataset: Dataset) -> str:
    """What happens instead at another site of a location, at which it would look the same."""
    there = cause(replace(where, site=site))
    if there is None or there[0] == happens:
        return f"the same at {listed(either([site], [where.driver.kind], dataset), 'or')}"
    return there[0].format(site=site.text, joint=f"J{where.driver.joint}")


def _inspect(where: Place, dataset: Dataset) -> str:
    """What to inspect at the sites of a location, those first that are not of the arm."""
    each = sorted((where.site, *where.neighbours), key=lambda site: bool(site.number))
    texts = {}
    for site in each:
        there = cause(replace(where, site=site))
        name = listed(either([site], [where.driver.kind], dataset), "or")
        texts[name] = there[1] if there else TIGHT
    if len(texts) == 1:
        return next(iter(texts.values()))
    parts = [f"{name[:1].upper()}{name[1:]}: {text}" for name, text in texts.items()]
    return " ".join((f"Look at {listed(texts)}: {ALIKE}.", *parts))


def when(event: Event, dataset: Dataset) -> str:
    """The row of an event as text: ``row 212 (c0211; rows 210 to 214 at 95 %)``; of images, the image."""
    first, last = event.interval95
    if image := image_of(event.row, dataset):
        ends = [image_of(k, dataset) for k in (first, last)]
        beside = f"; {ends[0]} to {ends[1]} at 95 %" if ends[0] != ends[1] else ""
        return f"image {image} (row {event.row + 1}{beside})"
    beside = f"; rows {first + 1} to {last + 1} at 95 %" if last > first else ""
    return f"row {event.row + 1} ({dataset.measurements.ids[event.row]}{beside})"


def image_of(row: int, dataset: Dataset) -> str:
    """The name of the image that a row is of; "" of others, and of images without names."""
    m = dataset.measurements
    of_image = m.stop is not None and m.pixel is not None and not np.isnan(m.pixel[row, 0])
    return str(m.stop[row]) if of_image and m.stop is not None else ""


def event_record(event: Event, dataset: Dataset) -> dict[str, Any]:
    """The row of an event, its id, and its 95 % interval, as an entry of gap.json; rows count from 1."""
    interval = [row + 1 for row in event.interval95]
    image = {"image": name} if (name := image_of(event.row, dataset)) else {}
    return {"row": event.row + 1, "id": dataset.measurements.ids[event.row], "interval95": interval} | image


def _sizes(amplitudes: list[Amplitude]) -> list[str]:
    """Amplitudes as text: three shifts as a vector, others by name."""
    out = []
    for unit in dict.fromkeys(a.unit for a in amplitudes):
        alike = [a for a in amplitudes if a.unit == unit]
        sizes = [sized(a, "value", "u") for a in alike]
        values, label = [with_u(s["value"], s["u"]) for s in sizes], unit_label(sizes[0]["unit"])
        if len(alike) > 1:
            axes = ", ".join(a.what.rpartition(" ")[2] for a in alike)
            out.append(f"by ({axes}) = ({', '.join(values)}) {label}")
        else:
            what = alike[0].what
            out.append(f"by {values[0]} {label}" if " " not in what else f"({what} {values[0]} {label})")
    return out


def records(where: Place, dataset: Dataset) -> dict:
    """Entries of gap.json for an unmodelled location: what happens, the row, amplitudes, what to inspect."""
    shown = cause(where)
    if shown is None:
        return {}
    target = mostly(where, dataset)
    remedy = _inspect(where, dataset)
    remedy = f"Check {target} and what is certified of it. {remedy}" if target else remedy
    out: dict = {"words": sentence(where, dataset), "remedy": remedy}
    if where.event is not None:
        out["event"] = event_record(where.event, dataset)
    sizes = [entry(a, "what") | sized(a, "value", "u") | entry(a, "significant") for a in where.amplitudes]
    return out | {"amplitudes": sizes}


def stated(gap: Gap, effect: str) -> tuple[Amplitude, ...]:
    """The significant amplitudes of an effect; one where none is significant alone.

    That is the amplitude at the largest location that the effect explains, else the clearest.
    """
    amplitudes = [a for a in gap.amplitudes if a.effect == effect]
    clear = tuple(a for a in amplitudes if a.significant)
    if clear:
        return clear
    largest = max((w for w in gap.where if w.explained_by == effect), key=lambda w: w.rms, default=None)
    there = [a for a in amplitudes if largest and (a.site, a.driver) == (largest.site, largest.driver)]
    return tuple(sorted(there or amplitudes, key=lambda a: -abs(a.value) / a.u if a.u > 0 else 0.0)[:1])


def sites(gap: Gap, effect: str) -> tuple[tuple[Site, ...], bool]:
    """Sites with a significant amplitude, and whether these are all sites of the effect in the refit."""
    amplitudes = [a for a in gap.amplitudes if a.effect == effect]
    clear = tuple(dict.fromkeys(a.site for a in amplitudes if a.significant and a.what != TOGETHER))
    return clear, len(clear) == len({a.site for a in amplitudes})


def short(site: Site) -> str:
    """A site in a table: ``J3``, ``link 3``, ``the base``."""
    return f"J{site.number}" if site.kind == "joint" else site.text


def line(a: Amplitude, others: Sequence[Amplitude]) -> str:
    """An amplitude in its unit and place: ``backlash of J3: half-width 0.0244(10) deg``.

    `others` are those stated of the same effect; the driver or the parameter is added where the site and the
    name of the amplitude do not identify it.
    """
    same = [o for o in others if (o.site, o.what) == (a.site, a.what)]
    by = ""
    if len({o.driver for o in same}) > 1:
        by = f" ({a.driver.text})"
    elif len(same) > 1 or a.what == DEVIATION.what or a.site == ARTEFACT:
        by = f" ({', '.join(p.removeprefix(f'{a.effect} ') for p in a.parameters)})"
    what, value = of_sign(a.what, a.value)
    size = measured(**sized(replace(a, value=value), "value", "u"))
    text = f"{a.effect} of {short(a.site)}: {what} {size}{by}"
    if a.phase is not None:
        text += f", phase {with_u(*np.degrees(a.phase))} deg"
    return text if a.significant else f"{text}, not significant alone"


def lines(gap: Gap) -> list[str]:
    """All amplitudes that are stated."""
    each = [stated(gap, effect) for effect in dict.fromkeys(a.effect for a in gap.amplitudes)]
    return [line(a, amplitudes) for amplitudes in each for a in amplitudes]


def amplitude_records(gap: Gap) -> list[dict[str, Any]]:
    """Entries of gap.json, with the validation gain of their effect."""
    gain = gains(gap)
    out = []
    for effect in dict.fromkeys(a.effect for a in gap.amplitudes):
        nats, se = gain.get(effect, (float("nan"), float("nan")))
        for a in stated(gap, effect):
            phase = (None, None) if a.phase is None else np.degrees(a.phase).tolist()
            out.append(
                entry(a, "effect", "site", "driver", "parameters", "what")
                | sized(a, "value", "u")
                | {"phase_deg": phase[0], "u_phase_deg": phase[1], "significant": a.significant}
                | {"validation_gain_nats": nats, "validation_gain_se": se}
            )
    return out


def gains(gap: Gap) -> dict[str, tuple[float, float]]:
    """Change of the log predictive density of validation data at the model level that adds each effect."""
    last = gap.levels[-len(gap.verdict.named) :] if gap.verdict.named else ()
    pairs = zip(gap.verdict.named, last, strict=False)
    return {n.effect: (step.delta_elpd, step.delta_elpd_se) for n, step in pairs}
