"""Every option of every command reaches the public function, with its unit: derived from the commands.

A recorder stands in place of the function that a command calls. Each option in turn is given a value that is
not its default; the function, or a method of its result, receives it, and all else is as without it.
"""

import inspect
import math
import re
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Annotated, Any, get_args, get_origin, get_type_hints
from unittest.mock import MagicMock

import pytest
from cases import cases
from click.testing import CliRunner
from test_documented_commands import commands

from bayescal.cli import root as module
from bayescal.cli.root import PARAMETER, progress

CALLED = cases("called_by_commands")
"""What each command calls: stand-ins record it."""
ELSEWHERE = {"import --allow-xacro": "expands the robot before the call: tests/cli/test_allow_xacro.py"}
"""Options that reach no called function, and where they are tested."""
VALUES: dict[tuple[str, str], tuple[str, Any]] = {
    ("budget", "--point-deg"): ("1,2,3", [1.0, 2.0, 3.0]),  # in deg, also in Python
    ("budget", "--to"): ("csv", None),
    ("check", "--to"): ("json", None),
    ("robots", "--to"): ("csv", None),
    ("compensate", "--tcp"): (
        "1,2,3,18,0,-36",
        pytest.approx([1e-3, 2e-3, 3e-3, math.pi / 10, 0.0, -math.pi / 5]),
    ),
    ("plan", "--to"): ("csv", "csv"),
    ("export", "--certificate"): ("given.yaml", "given.yaml"),
    ("export", "--schema"): ("given.xsd", "given.xsd"),
}
"""Values of options that a command interprets, and what arrives; None: only what is printed changes."""
WITH = {("export", "--certificate"): ("--to", "dcc"), ("export", "--schema"): ("--to", "dcc")}
"""Further options without which one is refused."""
ALONE = {("simulate", "--setup")}
"""Options with which others are no longer passed on."""
SI = {"um": 1e-6, "mm": 1e-3, "deg": math.pi / 180.0, "kg": 1.0, "s": 1.0, "n": 1.0}
"""Units at the end of an option's name; a parameter without a unit in its name is in SI."""


def annotated(command) -> dict[str, tuple[Any, Any]]:
    """Type and typer's description of every parameter of a command's function."""
    function = inspect.unwrap(command.callback)
    hints, out = get_type_hints(function, include_extras=True), {}
    for name, parameter in inspect.signature(function).parameters.items():
        hint, info = hints[name], parameter.default
        if get_origin(hint) is Annotated:
            hint, info = get_args(hint)
        kinds = [k for k in get_args(hint) if k is not type(None)] if type(None) in get_args(hint) else [hint]
        out[name] = kinds[0], info
    return out


def shown(option) -> str:
    """The long name of an option, or that of an argument."""
    return next((o for o in option.opts if o.startswith("--")), option.name)


def given(words: str, option, hint: Any, info: Any, default: Any) -> tuple[list[str], Any]:
    """The words that give an option another value than its default, and the value."""
    name = shown(option)
    if (words, name) in VALUES:
        text, value = VALUES[words, name]
        return [name, text], value
    if hint is bool:
        return [option.secondary_opts[0] if default else name], not default
    if get_origin(hint) is tuple:
        each = [f"{name[2:]}-{k}" for k in range(len(get_args(hint)))]
        return [name, *each], each
    base = get_args(hint)[0] if get_origin(hint) is list else hint
    if base in (int, float):
        value = base((default or 0) + (1 if base is int else 0.375))
        assert info.max is None or value <= info.max
    else:
        value = base(f"given-{name.lstrip('-')}")
    return ([name] if name.startswith("-") else []) + [str(value)], [value] if base is not hint else value


def leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The parts of an argument by name: options in a dictionary or a dataclass are arguments too."""
    if callable(value):
        return
    if is_dataclass(value):
        value = {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, dict):
        for key, own in value.items():
            yield from leaves(own, str(key))
    else:
        yield name.rstrip("_"), list(value) if isinstance(value, tuple) else value


@cache
def received(words: str, *arguments: str) -> tuple[dict[str, Any], str]:
    """What the stand-ins of a command receive, by parameter, and what is printed; of each line once."""
    got: dict[str, Any] = {}

    def stand_in(real):
        def called(*args, **kwargs):
            got[f"called {real.__name__}"] = real.__name__
            for key, value in inspect.signature(real).bind(*args, **kwargs).arguments.items():
                got.update(leaves(value, key))
            result = MagicMock(record={}, csv="as csv")
            for name, back in (("report", "as text"), ("save", ())):

                def method(*values, _name=name, _back=back, **named):
                    got.update({f"{_name} {k}": v for k, v in enumerate(values)} | named)
                    return _back

                setattr(result, name, method)
            return result

        return called

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayescal.cli.root.drawing_beside", lambda wanted: nullcontext())
        for path in CALLED[words]:
            module, name = path.rsplit(".", 1)
            patch.setattr(path, stand_in(getattr(import_module(module), name)))
        done = CliRunner().invoke(commands()["bayescal"], [*words.split(), *arguments])
    assert done.exit_code == 0, (done.output, done.exception)
    return got, done.output


def required(words: str, command, but: str = "") -> list[str]:
    """Words for all that a command requires, except one option."""
    out, hints = [], annotated(command)
    for option in command.params:
        if option.required and shown(option) != but:
            out += given(words, option, *hints[option.name], None)[0]
    return out


OPTIONS = [
    pytest.param(words, option.name, id=f"{words} {shown(option)}")
    for words, command in ((name.removeprefix("bayescal "), c) for name, c in commands().items())
    if words in CALLED
    for option in command.params
    if option.name != "help" and not option.hidden and f"{words} {shown(option)}" not in ELSEWHERE
]


@pytest.mark.parametrize(("words", "name"), OPTIONS)
def test_every_option_arrives(words, name, monkeypatch, tmp_path_factory):
    monkeypatch.chdir(tmp_path_factory.getbasetemp())
    command = commands()[f"bayescal {words}"]
    option = next(p for p in command.params if p.name == name)
    key, long = (words, shown(option)), shown(option).lstrip("-").replace("-", "_")
    default = None if option.required or callable(option.default) else option.default
    arguments, value = given(words, option, *annotated(command)[name], default)
    more = list(WITH.get(key, ()))
    usual = required(words, command, *more[:1]) + more
    after, text = received(words, *usual, *([] if option.required else arguments))
    if option.required:
        changed = after
    else:
        before, printed = received(words, *usual)
        if value is None:
            assert text != printed
            return
        changed = {k: v for k, v in after.items() if k not in before or before[k] != v}
    stem, _, unit = long.rpartition("_")
    if own := {long, name.rstrip("_")} & after.keys() - ({stem} if unit in SI else set()):
        assert all(changed[k] in (value, [value]) for k in own), (value, changed)
    elif stem in after and unit in SI:
        value = value if key in VALUES else pytest.approx(value * SI[unit])
        assert changed[stem] == value
    assert any(v in (value, [value]) for v in changed.values()), (value, changed)
    if not option.required and key not in ALONE:
        others = {k: v for k, v in changed.items() if v not in (value, [value]) and str(value) not in str(v)}
        assert not others, (value, others)


def test_every_option_has_its_help_and_every_help_its_option():
    for command in commands().values():
        function = inspect.unwrap(command.callback)
        described = {n for names, _ in PARAMETER.findall(inspect.getdoc(function)) for n in names.split(", ")}
        assert described <= inspect.signature(function).parameters.keys()
        assert all(option.help for option in command.params if not option.hidden)


@pytest.mark.parametrize("annotation", [int | None, "int | None"])
def test_types_of_options_are_those_of_annotations_as_text_or_evaluated(annotation):
    given = inspect.Parameter("seed", inspect.Parameter.KEYWORD_ONLY, annotation=annotation)
    assert module._of_public(given).annotation == int | None


def test_every_command_is_tested():
    ends = {n.removeprefix("bayescal ") for n, c in commands().items() if not hasattr(c, "commands")}
    assert ends == CALLED.keys()


@pytest.mark.parametrize(("line", "parameter", "value"), [
    (("budget", "RUN", "--point", "1,2"), "point", [1.0, 2.0]),
    (("compensate", "RUN", "T", "--out", "o", "--at-time", "3.5"), "at_time", 3.5),
    (("export", "RUN", "--to", "urdf", "--at-time", "3.5"), "at_time", 3.5),
    (("init", "DIR", "--robot", "ur5e", "--tool", "0 0 1 mm"), "tool", "0 0 1 mm"),
    (("import", "LOG", "--out", "o", "--tool", "0 0 1 mm"), "tool", "0 0 1 mm"),
    (("simulate", "--out", "o", "--payload", "1.5"), "payload", 1.5),
])  # fmt: skip
def test_earlier_names_of_options_are_understood(line, parameter, value, monkeypatch, tmp_path_factory):
    monkeypatch.chdir(tmp_path_factory.getbasetemp())
    got, _ = received(*line)
    assert got.get(parameter) == value


# --- The progress of a command where no terminal shows a bar: lines on the error stream.


def test_lines_state_stage_share_and_time_also_while_nothing_is_reported(monkeypatch, capsys):
    parts = []

    def until(pattern: str = "") -> str:
        for _ in range(12_000):
            parts.append(capsys.readouterr().err)
            if re.search(pattern, "".join(parts)):
                return "".join(parts)
            time.sleep(0.01)
        return pytest.fail(f"never written: {pattern}")

    monkeypatch.setattr(module, "EVERY", 0.02)
    with progress("worlds") as notify:
        until(r"(worlds 0 %, \d+ s\n){2}")
        notify("sample", 0.256)
        until(r"sample 26 %, \d+ s\n")
        notify.say("a note")
    lines = until().splitlines()
    kinds = [line if line == "a note" else re.fullmatch(r"(\w+ \d+ %), \d+ s", line)[1] for line in lines]
    assert list(dict.fromkeys(kinds)) == ["worlds 0 %", "sample 26 %", "a note"]
    assert kinds[-1] == "a note"


def test_a_short_command_writes_none(capsys):
    with progress() as notify:
        notify("estimate", 0.5)
    assert capsys.readouterr() == ("", "")


def test_a_long_command_writes_few(monkeypatch, capsys):
    """An hour in simulated time."""
    now = 0.0

    def wait(seconds: float) -> bool:
        nonlocal now
        now += seconds
        return now > 3600.0

    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now))
    module._Lines("sample", begin=0.0, ended=SimpleNamespace(wait=wait)).watch()
    out, err = capsys.readouterr()
    assert not out
    seconds = [int(re.fullmatch(r"sample 0 %, (\d+) s", line)[1]) for line in err.splitlines()]
    assert seconds[:10] == list(range(5, 55, 5))
    assert 3200 < seconds[-1] <= 3600
    assert 40 < len(seconds) < 60
