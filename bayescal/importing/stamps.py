"""Time stamps of logs, as seconds: dates, times of day, seconds and milliseconds since 1970."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone

import numpy as np

DAY = 86400.0
"""s."""

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

LONG = 1e8
"""s: a session clock does not count three years; such a number is a time since 1970."""

CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d+))?)?\s*([AaPp][Mm])?")
ZONE = re.compile(r"\s*(Z|UTC|GMT|[+-]\d{2}:?\d{2}|[+-]\d{2})$")
DATES = {
    "iso": (r"(\d{4})-(\d{1,2})-(\d{1,2})", (0, 1, 2)),
    "ymd": (r"(\d{4})[-./](\d{1,2})[-./](\d{1,2})", (0, 1, 2)),
    "dmy": (r"(\d{1,2})[-./](\d{1,2})[-./](\d{4})", (2, 1, 0)),
    "mdy": (r"(\d{1,2})[-./](\d{1,2})[-./](\d{4})", (2, 0, 1)),
}
"""Patterns of dates, and where year, month and day are in them."""


@dataclass(frozen=True)
class Stamps:
    """Seconds (N,), nan where the cell is empty, and on which clock: UTC, local (no zone), day or counter."""

    seconds: np.ndarray
    clock: str


class NoStampError(ValueError):
    """A cell that is no time stamp of the kind: `row`, and why in words."""

    def __init__(self, row: int, why: str) -> None:
        self.row = row
        super().__init__(why)


def _dated(kind: str) -> Callable[[Sequence[str]], Stamps]:
    def read(cells: Sequence[str]) -> Stamps:
        out, zones = np.full(len(cells), np.nan), set()
        for row, cell in enumerate(cells):
            if cell:
                moment, zoned = _moment(kind, cell, row)
                out[row] = (moment - EPOCH) / timedelta(seconds=1)
                zones.add(zoned)
                if len(zones) > 1:
                    raise NoStampError(row, "some time stamps state their time zone, others do not")
        return Stamps(out, "UTC" if zones == {True} else "local")

    return read


def _moment(kind: str, cell: str, row: int) -> tuple[datetime, bool]:
    """The moment of a cell with date and time, and whether it states its time zone; else as if in UTC."""
    pattern, order = DATES[kind]
    found = re.match(pattern + r"(?:T|\s+|$)", cell)
    rest = cell[found.end() :] if found else ""
    zone = ZONE.search(rest)
    try:
        if found is None:
            raise ValueError
        parts = [int(part) for part in found.groups()]
        seconds = _seconds(rest[: zone.start()] if zone else rest) if rest else 0.0
        year, month, date = (parts[i] for i in order)
        day = datetime(year, month, date, tzinfo=_zone(zone[1]) if zone else UTC)
    except ValueError:
        raise NoStampError(row, f"'{cell}' is not a date and time ({kind})") from None
    return day + timedelta(seconds=seconds), zone is not None


def _zone(text: str) -> timezone:
    if text in ("Z", "UTC", "GMT"):
        return UTC
    minutes = int(text[1:3]) * 60 + int(text[3:].replace(":", "") or 0)
    return timezone(timedelta(minutes=-minutes if text[0] == "-" else minutes))


def _seconds(text: str) -> float:
    """Seconds of a time of day, ``15:04:05.25``, ``3:04:05 PM``."""
    found = CLOCK.fullmatch(text.strip())
    if found is None:
        raise ValueError
    hour, minute, second = int(found[1]), int(found[2]), int(found[3] or 0)
    if found[5]:
        if not 1 <= hour <= 12:
            raise ValueError
        hour = hour % 12 + 12 * (found[5].lower() == "pm")
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError
    return 3600.0 * hour + 60.0 * minute + second + (float(f"0.{found[4]}") if found[4] else 0.0)


def _of_day(cells: Sequence[str]) -> Stamps:
    """Times of day; a step back by more than half a day is midnight, a smaller one is refused."""
    out, days, before = np.full(len(cells), np.nan), 0, -math.inf
    for row, cell in enumerate(cells):
        if not cell:
            continue
        try:
            now = _seconds(cell)
        except ValueError:
            raise NoStampError(row, f"'{cell}' is not a time of day, HH:MM:SS") from None
        if before - now > DAY / 2:
            days += 1
        elif now < before:
            raise NoStampError(row, f"the time of day '{cell}' is before that of the row above")
        before = now
        out[row] = days * DAY + now
    return Stamps(out, "day")


def _counted(cells: Sequence[str]) -> Stamps:
    """Seconds of a counter, such as the time since a controller was started."""
    out = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        try:
            out[row] = float(cell.replace(",", ".")) if cell else np.nan
        except ValueError:
            raise NoStampError(row, f"'{cell}' is not a number") from None
    return Stamps(out, "counter")


def _since_1970(per_second: float) -> Callable[[Sequence[str]], Stamps]:
    def read(cells: Sequence[str]) -> Stamps:
        out = np.full(len(cells), np.nan)
        for row, cell in enumerate(cells):
            try:
                out[row] = float(cell.replace(",", ".")) / per_second if cell else np.nan
            except ValueError:
                raise NoStampError(row, f"'{cell}' is not a number") from None
            if not LONG < out[row] < 100 * LONG and cell:
                raise NoStampError(row, f"{cell} is not a time since 1970 in this unit")
        return Stamps(out, "UTC")

    return read


STAMPS: dict[str, Callable[[Sequence[str]], Stamps]] = {
    **{kind: _dated(kind) for kind in DATES},
    "clock": _of_day,
    "counter_s": _counted,
    "epoch_s": _since_1970(1.0),
    "epoch_ms": _since_1970(1e3),
    "epoch_us": _since_1970(1e6),
}
"""Kinds of time stamps by the word that states them."""
