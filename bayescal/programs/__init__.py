"""Formats of robot programs: one file each, and its entry here."""

from bayescal.programs.abb import ABB
from bayescal.programs.fanuc import FANUC
from bayescal.programs.kuka import KUKA
from bayescal.programs.text import ROBODK, Format
from bayescal.programs.urscript import URSCRIPT

PROGRAMS: dict[str, Format] = {f.name: f for f in (URSCRIPT, FANUC, KUKA, ABB, ROBODK)}
"""Formats by their names."""
