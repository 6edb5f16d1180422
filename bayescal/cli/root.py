"""The command without its commands, which register with `app`; what they share: options, progress, output.

The progress of a long command is a bar on a terminal, and lines elsewhere.
"""

from __future__ import annotations

import inspect
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, get_type_hints

import typer
from typer.models import ParameterInfo

from bayescal import __version__
from bayescal.errors import BayescalError
from bayescal.public import console, drawing_beside

if TYPE_CHECKING:
    from rich.console import Console, RenderableType


def ending(*examples: str, **renamed: str) -> dict[str, Any]:
    """What every command states of itself: examples at the end of its help, and earlier names of options.

    Parameters
    ----------
    *examples : str
        Complete command lines; a test parses them.
    **renamed : str
        Present name of an option by its earlier one, which is understood and not shown.
    """
    out: dict[str, Any] = {"epilog": "\n".join(("Examples:", "", "\b", *examples))}
    if renamed:
        out["context_settings"] = {
            "token_normalize_func": lambda name: renamed.get(name.replace("-", "_"), name)
        }
    return out


app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Calibrate a robot arm from probed contacts, with uncertainties, and diagnose unmodelled effects.",
    **ending("bayescal fit data/lrmate200ic-cube --samples 0", "bayescal gap data/lrmate200ic-cube"),
)


PARAMETER = re.compile(r"^(\w+(?:, \w+)*)\n((?: +.*\n?)+)", re.MULTILINE)
"""Parameters in a docstring, and their description."""
AS_OF = re.compile(r"As of `(\w+)`\.")
"""The description of parameters that another command has too."""
KINDS: dict[Any, Any] = {"bool": bool, "int": int, "float": float}
KINDS |= {f"{name} | None": kind | None for name, kind in KINDS.items()}
KINDS |= {kind: kind for kind in KINDS.values()}
"""Types of options by the annotations of public functions, as text or evaluated; others are texts."""
_options: dict[str, dict[str, inspect.Parameter]] = {}
"""Options of each command, by the names of its function and its parameters."""


def command(
    *examples: str, calls: Callable[..., Any] | None = None, name: str | None = None, **renamed: str
) -> Callable[..., Callable[..., None]]:
    """Register a function as a command: its parameters are the options, its docstring has their help.

    A parameter is the option of its name. What its name, its type and its default do not state (that it is
    an argument, its metavar, limits) is stated by `typer.Argument` or `typer.Option` in place of the default.
    Options are in the order of the docstring. Those that the function does not declare it receives as
    ``**options``: of "As of `fit`." with type and default of `fit`, of others as of the public function; if
    none is stated, as texts that are empty by default.

    Parameters
    ----------
    *examples, **renamed
        As of `ending`.
    calls : callable, optional
        The public function that the command calls.
    name : str, optional
        Name of the command, if it is not that of the function.
    """

    def registered(function: Callable[..., None]) -> Callable[..., None]:
        summary, _, section = (inspect.getdoc(function) or "").partition("\n\nParameters\n----------\n")
        hints = get_type_hints(function)
        declared = {
            p.name: p.replace(kind=p.KEYWORD_ONLY, annotation=hints[p.name])
            for p in inspect.signature(function).parameters.values()
            if p.kind is not p.VAR_KEYWORD
        }
        free = calls is None and len(declared) < len(inspect.signature(function).parameters)
        public = inspect.signature(calls).parameters if calls else {}
        described: dict[str, inspect.Parameter] = {}
        for names, text in PARAMETER.findall(section):
            other = AS_OF.fullmatch(text.strip())
            for key in names.split(", "):
                if other:
                    first = _options[other[1]][key]
                    described[key] = _option(declared.get(key, first), first.default.help)
                else:
                    of_text = inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default="")
                    option = declared.get(key) or _of_public(of_text if free else public[key])
                    described[key] = _option(option, " ".join(text.split()))
        _options[function.__name__] = described
        others = [_option(p) for key, p in declared.items() if key not in described]
        signature = inspect.Signature([*others, *described.values()])
        function.__signature__ = signature  # type: ignore[attr-defined]
        function.__annotations__ = {key: p.annotation for key, p in signature.parameters.items()}
        return app.command(name, help=summary, **ending(*examples, **renamed))(function)

    return registered


def _option(parameter: inspect.Parameter, text: str = "") -> inspect.Parameter:
    """A parameter as an option: by its name and default, or what the default states of it, with its help."""
    option, flag = parameter.default, f"--{parameter.name.rstrip('_').replace('_', '-')}"
    if option is parameter.empty:  # typer's context
        return parameter
    if not isinstance(option, ParameterInfo):
        option = typer.Option(option, f"{flag}/--no-{flag[2:]}" if option is True else flag)
    option.help = text or option.help
    return parameter.replace(default=option)


def _of_public(p: inspect.Parameter) -> inspect.Parameter:
    """A parameter of a public function as that of a command; a sequence of names is a text with commas."""
    default = ",".join(p.default) if isinstance(p.default, tuple) else p.default
    return p.replace(kind=p.KEYWORD_ONLY, annotation=KINDS.get(p.annotation, str), default=default)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bayescal {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    """Calibrate a robot arm from probed contacts, with uncertainties, and diagnose unmodelled effects."""


def check_format(to: str, formats: tuple[str, ...]) -> None:
    """Refuse a format that a command does not print."""
    if to not in formats:
        raise BayescalError(f"there is no format `{to}`", "--to", f"formats: {', '.join(formats)}")


def print_as(to: str, result: Any) -> None:
    """Print a result of the public API as json, csv or, else, as the table of its report."""
    if to == "json":
        from bayescal.storage.files import json_text

        sys.stdout.write(json_text(result.record))
    elif to == "csv":
        sys.stdout.write(result.csv)
    else:
        console().print(result.report())


@contextmanager
def run_folder(out: Path | None, datasets: Sequence[Path], command: str) -> Iterator[Path]:
    """The folder that a command will write, locked: `out`, or runs/<datasets>-<command>.

    Checked before a long computation, so that its result can be written.

    Raises
    ------
    BayescalError
        If the folder contains files other than an earlier run of the command, or another run writes to it.
    """
    from bayescal.storage.folders import claimed

    names = "+".join(folder.resolve().name for folder in datasets)
    folder = out or Path("runs") / f"{names}-{command}"
    with claimed(folder, f"{command}.json"):
        yield folder


def carried_out(
    work: Callable[..., Any], out: Path | None, datasets: Sequence[Path], command: str,
    first: str = "estimate", **saved: Any,
) -> tuple[Any, Path]:  # fmt: skip
    """Compute a result, whose progress is shown, save it in the folder of the command, and print it.

    Parameters
    ----------
    work : callable
        Computes it, given `progress`.
    out, datasets, command
        As of `run_folder`.
    first
        As of `progress`.
    **saved
        Options of its `save`; with `pictures` a second process draws them.

    Returns
    -------
    result : Result
    folder : Path
    """
    beside = drawing_beside(saved.get("pictures", False))
    with run_folder(out, datasets, command) as folder, beside, progress(first) as notify:
        result = work(progress=notify)
        notify("write", 0.0)
        written = result.save(folder, **saved)
    show(result.report(), folder, written)
    return result, folder


def show(report: RenderableType, folder: Path, written: Sequence[str]) -> None:
    """Print a result, and the names of the files that were written to its run folder."""
    terminal = console()
    terminal.print(report)
    said(terminal, "written", f"{folder}/{', '.join(written)}")


def said(terminal: Console, heading: str, text: str, width: int = 17) -> None:
    """Print a line with its heading, however long it is."""
    from rich.text import Text

    terminal.print(Text.assemble((f"{heading:<{width}}", "dim"), text), soft_wrap=True)


EVERY = 5.0
"""Seconds between two lines, at least; a shorter command writes none."""
GROWTH = 0.1
"""Smallest time between two lines, as a fraction of the elapsed time: a run of an hour writes some dozens."""


@contextmanager
def progress(first: str = "estimate") -> Iterator[_Bar | _Lines]:
    """The progress of a command on the error stream.

    It is called with a stage (or '12 of 200') and the completed fraction; `say` prints a line beside it.

    Parameters
    ----------
    first : str
        The stage shown first.
    """
    if sys.stderr.isatty():
        bar = _Bar(first)
        with bar.shown:
            yield bar
        return
    lines = _Lines(first)
    thread = Thread(target=lines.watch, daemon=True)
    thread.start()
    try:
        yield lines
    finally:
        lines.ended.set()
        thread.join()


class _Bar:
    """A bar of rich, removed at the end."""

    def __init__(self, first: str) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self.terminal = console(stderr=True)
        columns = TextColumn("{task.description:>9}", markup=False), BarColumn(), TimeRemainingColumn()
        self.shown = Progress(*columns, console=self.terminal, transient=True)
        self.task = self.shown.add_task(first, total=1.0)

    def __call__(self, stage: str, fraction: float) -> None:
        self.shown.update(self.task, description=stage, completed=fraction)

    def say(self, text: str) -> None:
        """Print a line."""
        self.terminal.print(text, soft_wrap=True)


@dataclass
class _Lines:
    """Lines of text: stage, completed share, elapsed time."""

    stage: str
    fraction: float = 0.0
    begin: float = field(default_factory=time.monotonic)
    ended: Event = field(default_factory=Event)
    _lock: Lock = field(default_factory=Lock)

    def __call__(self, stage: str, fraction: float) -> None:
        self.stage, self.fraction = stage, fraction

    def say(self, text: str) -> None:
        """Print a line."""
        with self._lock:
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()

    def watch(self) -> None:
        """Print lines until the end, also while the command reports nothing."""
        while not self.ended.wait(max(EVERY, GROWTH * self.elapsed)):
            self.say(f"{self.stage} {100 * self.fraction:.0f} %, {self.elapsed:.0f} s")

    @property
    def elapsed(self) -> float:
        """Seconds since the begin."""
        return time.monotonic() - self.begin
