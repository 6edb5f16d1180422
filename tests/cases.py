"""Tables of cases and texts of files that tests read: they are data, in `tests/data`, a file for each."""

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from rich.console import Console

from bayescal.errors import BayescalError
from bayescal.reporting import figures as process

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "data" / "lrmate200ic-cube"
"""The session that comes with the project."""
DATA = ROOT / "tests" / "data"


def file_text(name: str) -> str:
    """The text of a file."""
    return (DATA / name).read_text(encoding="utf-8")


def cases(name: str) -> Any:
    """The table of a file: a list of rows, or a mapping of names to rows."""
    return yaml.safe_load(file_text(f"{name}.yaml"))


def robot_file(name: str) -> str:
    """The path of a robot description."""
    return str(DATA / "robots" / f"{name}.yaml")


FIGURES_OF = process.figures_of


def undrawn(record: Any, draws: Any = None) -> dict[str, bytes]:
    """The figures of a record: their content is made, and none is drawn."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.reporting.figures.figures.sheet", lambda *_: None)
        patch.setattr("bayescal.reporting.figures.figures.png", lambda _: b"\x89PNG")
        return FIGURES_OF(record, draws)


@contextmanager
def without_draws() -> Iterator[None]:
    """Within, run folders of fits have an empty posterior.nc: to write one takes half of a save."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.reporting.fit.record.save", lambda _, path: path.touch())
        yield


@contextmanager
def drawn(really: bool = True) -> Iterator[None]:
    """Within, figures of a run are drawn."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process, "figures_of", FIGURES_OF if really else undrawn)
        yield


def refused(words: str, call: Callable[[], Any]) -> BayescalError:
    """Call what must be refused, in one line with words that a regular expression finds: the error."""
    with pytest.raises(BayescalError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
    return error.value


def terminal_text(what: Any, width: int = 100) -> str:
    """The text of what is printed on a terminal of a width."""
    console = Console(width=width, record=True, file=io.StringIO(), highlight=False)
    console.print(what)
    return console.export_text()
