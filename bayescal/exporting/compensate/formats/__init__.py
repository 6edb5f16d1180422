"""Formats of robot programs: one file each, and its entry here."""

from __future__ import annotations

from bayescal.exporting.compensate.formats.abb import ABB
from bayescal.exporting.compensate.formats.fanuc import FANUC
from bayescal.exporting.compensate.formats.kuka import KUKA
from bayescal.exporting.compensate.formats.program import Format
from bayescal.exporting.compensate.formats.robodk import ROBODK
from bayescal.exporting.compensate.formats.urscript import URSCRIPT

PROGRAMS: dict[str, Format] = {f.name: f for f in (URSCRIPT, FANUC, KUKA, ABB, ROBODK)}
"""Formats by their names."""
