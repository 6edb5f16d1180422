"""Whose error it is in images: ``images`` of the records, lines of the terminal, a table of the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bayescal.assess.images import images
from bayescal.estimate import Estimate
from bayescal.reporting.shared.origin import entry
from bayescal.reporting.shared.sheet import Column, Sheet
from bayescal.reporting.shared.text import Facts, with_u
from bayescal.storage.reading import Json

PART = ("side", "rms_px=rms", "u_px=u", "max_px=largest", "max_mm=length")
"""Fields of ``parts``."""


def images_record(estimate: Estimate | None) -> list[dict[str, Any]]:
    """``images``: of each fitted camera its noise, and what every side changes in its images."""
    return [
        entry(found, "target", "images", "corners", "noise_px=noise")
        | {"parts": [entry(part, *PART) for part in found.parts]}
        for found in (images(estimate) if estimate is not None else ())
    ]


def images_lines(record: Json) -> Facts:
    """A line for each camera: its sides, the largest first, and its noise."""
    for k, (target, *words) in enumerate(_words(record)):
        several = f"{target}: " if len(record["images"]) > 1 else ""
        yield "" if k else "in the images", several + "; ".join(words), ""


def images_keys(record: Json) -> Iterator[tuple[str, str, str]]:
    """The same as key figures of a page: a name, the largest part, and the others."""
    for target, first, *others in _words(record):
        yield f"In the images of {target}", first, "; ".join(others)


def _words(record: Json) -> Iterator[list[str]]:
    """Of each camera its target, its sides, the largest first, and its noise."""
    for found in record.get("images", ()):
        parts = [f"{p['side']} {_rms(p)} px" for p in found["parts"]]
        if parts:
            first = found["parts"][0]
            parts[0] += f" RMS, at most {first['max_px']:.2g} px or {first['max_mm']:.2g} mm"
        yield [found["target"], *parts, f"noise {found['noise_px']:.2g} px per coordinate"]


def images_sheet(record: Json) -> Sheet:
    """The same as a table."""
    columns = (
        Column("side", "side"),
        Column("camera", "target"),
        Column("RMS (px)", _rms),
        Column("largest (px)", lambda p: f"{p['max_px']:.2g}"),
        Column("largest across the line of sight (mm)", lambda p: f"{p['max_mm']:.2g}"),
    )
    caption = "What the estimate changes in the images, without the place of camera and board"
    cameras = record.get("images", ())
    parts = [part | {"target": found["target"]} for found in cameras for part in found["parts"]]
    return Sheet(columns, parts, caption)


def _rms(part: Json) -> str:
    return with_u(part["rms_px"], part["u_px"])
