"""Digital Calibration Certificate (DCC 3.3.0, PTB) of a calibrated arm."""

from bayescal.exporting.dcc.document import dcc
from bayescal.exporting.dcc.entries import Entries, read_entries
from bayescal.exporting.dcc.validity import check_valid

__all__ = ["Entries", "check_valid", "dcc", "read_entries"]
