"""The one exception that a user is meant to read."""

from __future__ import annotations


class BayescalError(Exception):
    """Bad input or an answer that the data cannot give, told in one line.

    The command line prints the message and exits with code 1; every other exception is a defect
    of ours and keeps its traceback.

    Parameters
    ----------
    what : str
        What is wrong, in the user's words.
    where : str, optional
        File, line or item, for example ``measurements.csv:17``.
    remedy : str, optional
        How to correct it.
    """

    def __init__(self, what: str, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, where, remedy
        parts = (f"{where}: {what}" if where else what, remedy)
        super().__init__("; ".join(" ".join(p.split()) for p in parts if p))
