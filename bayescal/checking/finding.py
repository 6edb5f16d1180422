"""Findings of a check: what, where, and how to correct it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from bayescal.errors import BayescalError

Kind = Literal["refused", "odd", "missing"]
KINDS: tuple[Kind, ...] = ("refused", "odd", "missing")
"""Refused by `fit` and `gap`; probably a mistake; absent, so that less can be said."""


@dataclass(frozen=True)
class Finding:
    """A finding.

    Attributes
    ----------
    code : str
        A name that does not change with the wording.
    kind : str
        Of `KINDS`.
    what, where, remedy : str
        As of `BayescalError`; `where` is a file, with a line and a row id where there are.
    """

    code: str
    kind: Kind
    what: str
    where: str
    remedy: str

    @classmethod
    def of(cls, error: BayescalError, code: str) -> Finding:
        """What a reader refuses."""
        return cls(code, "refused", error.what, error.where, error.remedy)
