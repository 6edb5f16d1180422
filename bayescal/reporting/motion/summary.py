"""The terminal summary of the diagnosis of a joint log."""

from __future__ import annotations

from rich.console import RenderableType
from rich.text import Text

from bayescal.reporting.gap.summary import STYLES
from bayescal.reporting.motion import sheets
from bayescal.reporting.shared.sheet import below, screen, terminal
from bayescal.reporting.shared.text import Facts, by_reason, probability, rival, under
from bayescal.storage.reading import Json


def motion_summary(record: Json) -> RenderableType:
    """Verdict, places, probabilities, torque error before and after, what was not assessed: one screen."""
    style = STYLES.get(record["verdict"], "bold red")
    torque, replayed = terminal(sheets.torque_sheet(record)), below(sheets.tracking_sheet(record))
    places = None if record["verdict"] == "null" else sheets.where_sheet(record)
    return screen(
        *(sheets.title(record), *(Text(line, style) for line in record["words"]), "", torque, *replayed),
        *("", places, sheets.amplitude_sheet(record), _facts(record)),
    )


def _facts(record: Json) -> Facts:
    ranked = sorted(record["probability"].items(), key=lambda item: -item[1])
    yield "probability", ", ".join(f"{rival(n)} {probability(p)}" for n, p in ranked if p >= sheets.LEAST), ""
    noise = ", ".join(f"{x:.2g}" for x in record["noise"]["lag1"])
    yield "noise", f"correlation of neighbouring rows, joint by joint: {noise}", "dim"
    for why, names in by_reason(record["missing"]).items():
        yield "not assessed", f"{', '.join(names)}: {why}", "dim"
    if reason := sheets.replay_of(record).get("not_assessed"):
        yield "not replayed", reason, "dim"
    yield from under("measure next", record["next"])
    yield from under("warning", record["warnings"], "yellow")
