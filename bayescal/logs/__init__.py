"""Joint logs: what an arm was commanded to do and did, read from a folder, in SI."""

from bayescal.logs.read import is_log, read_log
from bayescal.logs.schema import SCHEMA
from bayescal.logs.types import Log, Mechanism, Motion

__all__ = ["SCHEMA", "Log", "Mechanism", "Motion", "is_log", "read_log"]
