"""The one exception that a user is meant to read, and the only form in which text of a user is repeated.

Results that others do not need: where they fail, a sentence says so.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

LONGEST = 80
"""Characters of a name, key or cell that a message repeats."""
LONGEST_PATH = 160
"""Characters of a path that a message repeats."""
LONGEST_PART = 220
"""Characters of each part of a message: what is wrong, and its remedy."""
FAR = 20
"""Times its bound from which on the middle of a text is not looked at."""
FEW = 6
"""Entries of a list that a message names."""
QUOTED = re.compile(rf"([`'\"])([^`'\"]{{{LONGEST},}})\1")
UNBROKEN = re.compile(rf"[^\s`'\"]{{{LONGEST_PATH},}}")


def shown(text: object, longest: int = LONGEST) -> str:
    """Text of a user on one line of printable characters, with its middle left out beyond a length.

    Control characters, among them the escape sequences of terminals and the marks that reverse the direction
    of writing, become escapes as `repr` writes them.

    Examples
    --------
    >>> shown("a\\x1b[31mb")
    'a\\\\x1b[31mb'
    >>> shown("x" * 100, 9)
    'xxx...xxx'
    """
    out = " ".join(_ends(str(text), longest).split())
    if not out.isprintable():
        out = "".join(c if c.isprintable() or c == "\N{NO-BREAK SPACE}" else _escape(c) for c in out)
    if len(out) <= longest:
        return out
    half = (longest - 3) // 2
    return f"{out[: longest - 3 - half]}...{out[len(out) - half :]}"


def listed(names: Iterable[object], few: int = FEW) -> str:
    """The first names of a sequence, and how many more there are.

    Examples
    --------
    >>> listed(["a", "b", "c"], 2)
    'a, b and 1 more'
    """
    every = [shown(name, LONGEST // 2) for name in names]
    more = len(every) - few
    return ", ".join(every) if more <= 0 else f"{', '.join(every[:few])} and {more} more"


def _ends(text: str, longest: int) -> str:
    """Beginning and end of a text that is far too long."""
    far = FAR * longest
    return text if len(text) <= 2 * far else text[:far] + text[-far:]


def _escape(character: str) -> str:
    return character.encode("unicode_escape", "backslashreplace").decode("ascii")


def _part(text: str, longest: int = LONGEST_PART) -> str:
    """One part of a message: quoted texts and words within `LONGEST`, the whole within `longest`."""
    line = " ".join(_ends(text, longest).split())
    line = QUOTED.sub(lambda match: match[1] + shown(match[2]) + match[1], line)
    return shown(UNBROKEN.sub(lambda match: shown(match[0], LONGEST_PATH), line), longest)


class BayescalError(Exception):
    """Bad input or an answer that the data cannot give, told in one line.

    The command line prints the message and exits with code 1; every other exception is a defect
    of ours and keeps its traceback. Whatever the message repeats of the input is bounded and printable.

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
        self.what, self.where, self.remedy = _part(what), shown(where, LONGEST_PATH), _part(remedy)
        parts = (f"{self.where}: {self.what}" if self.where else self.what, self.remedy)
        super().__init__("; ".join(p for p in parts if p))


@contextmanager
def refused_as(what: str, where: str, remedy: str, *kinds: type[Exception]) -> Iterator[None]:
    """Tell of an exception of another library, of some kinds, as a `BayescalError` with its reason.

    Examples
    --------
    >>> with refused_as("not a number", "a.txt:3", "correct it", ValueError):
    ...     float("x")
    Traceback (most recent call last):
    bayescal.errors.BayescalError: a.txt:3: not a number: could not convert string to float: 'x'; correct it
    """
    try:
        yield
    except BayescalError:
        raise
    except kinds as error:
        raise BayescalError(f"{what}: {error}", where, remedy) from None


FAILURES = (BayescalError, ArithmeticError, LookupError, RuntimeError, ValueError)
"""What a computation raises that its input does not permit; `numpy.linalg.LinAlgError` is a `ValueError`."""
T = TypeVar("T")
Otherwise = TypeVar("Otherwise")


def attempted(what: str, compute: Callable[[], T], otherwise: Otherwise, lost: list[str]) -> T | Otherwise:
    """A result that others do not need; where it fails, `otherwise`, and a sentence is added to `lost`."""
    try:
        return compute()
    except FAILURES as error:
        lost.append(f"left out, because it failed: {what} ({reason(error)})")
        return otherwise


def reason(error: Exception) -> str:
    """Why a computation failed, on one line."""
    return shown(str(error) or type(error).__name__, LONGEST_PART)
