"""A xacro file is a program: no command and no public function runs it unless its caller allows it.

The commands, functions and their arguments are those of the program. Whatever may name a dataset or a robot
is called with one whose robot is a xacro file that leaves a witness: not without the option, and with it.
"""

import inspect
import shutil
from contextlib import suppress
from types import SimpleNamespace

import pytest
from cases import EXAMPLE, cases
from click.testing import CliRunner
from test_documented_commands import commands

import bayescal as bc
from bayescal.public.fleet import Task, computed

PROGRAM = """<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro"><!-- xacro:eval-comments -->
<!-- ${(lambda:
 xacro.load_yaml.__globals__['os'].system('touch WITNESS'))()} --><link name="base"/></robot>"""
CASES = cases("xacro_commands")
"""A command for each argument that names a dataset or a robot."""
FUNCTIONS = {
    "changed datasets": lambda p, **allow: bc.changed([p.good, p.cell], **allow),
    "check folder": lambda p, **allow: bc.check(p.cell, **allow),
    "compare dataset": lambda p, **allow: bc.compare(p.cell, **allow),
    "diagnose dataset": lambda p, **allow: bc.diagnose([p.good, p.cell], **allow),
    "fit dataset": lambda p, **allow: bc.fit([p.good, p.cell], **allow),
    "init robot": lambda p, **allow: bc.init(p.new, str(p.arm), **allow),
    "plan after": lambda p, **allow: bc.plan(p.good, after=p.cell, **allow),
    "plan setup": lambda p, **allow: bc.plan(p.cell, **allow),
    "plan setup, of a session": lambda p, **allow: bc.plan(p.cell, after=p.good, **allow),
    "read_dataset folder": lambda p, **allow: bc.read_dataset(p.cell, **allow),
    "robots.load_robot reference": lambda p, **allow: bc.robots.load_robot(str(p.arm), **allow),
    "simulate robot": lambda p, **allow: bc.simulate(str(p.arm), **allow),
    "simulate setup": lambda p, **allow: bc.simulate(setup=p.cell, **allow),
}
OTHER = {
    *("changed at", "check calibration", "import calibration", "init folder", "import log", "import out"),
    *("import points", "robots.load_robot folder", "fleet out", "watch plan"),
    "fleet sessions",  # `test_sessions_of_a_fleet`: their errors are returned
    "watch dataset",  # without the option
}
"""Arguments that name a path, and no dataset or robot."""


def paths(parameters):
    """Names of the parameters of a function that can be a dataset, a robot or another path."""
    for p in parameters.values():
        text = str(p.annotation)
        if any(word in text for word in ("Path", "Source", "Datasets")) or p.name in ("robot", "reference"):
            yield p.name


@pytest.fixture
def places(tmp_path):
    """Paths of the words of the commands, and the witness."""
    cell = shutil.copytree(EXAMPLE, tmp_path / "cell")
    settings = (cell / "dataset.yaml").read_text(encoding="utf-8")
    (cell / "dataset.yaml").write_text(settings.replace("robot: fanuc-lrmate200ic", "robot: arm.xacro"))
    (cell / "arm.xacro").write_text(PROGRAM.replace("WITNESS", str(tmp_path / "witness")))
    shutil.copy(EXAMPLE / "measurements.csv", cell / "plan.csv")
    (tmp_path / "log.csv").write_text("A1,X,Y,Z\n0,1,2,3\n")
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "gap.json").write_text("{}")
    return SimpleNamespace(
        cell=cell, arm=cell / "arm.xacro", good=EXAMPLE, new=tmp_path / "new", log=tmp_path / "log.csv",
        gap=tmp_path / "gap", witness=tmp_path / "witness",
    )  # fmt: skip


@pytest.mark.parametrize("line", CASES.values(), ids=CASES)
def test_commands(line, places):
    for option in ([], ["--allow-xacro"]):
        done = CliRunner().invoke(commands()["bayescal"], [*line.format(**vars(places)).split(), *option])
        assert done.exit_code != 0
        assert places.witness.exists() == bool(option)
        assert bool(option) or "--allow-xacro" in str(done.exception)


@pytest.mark.parametrize("call", FUNCTIONS.values(), ids=FUNCTIONS)
def test_functions(call, places):
    for allow in ({}, {"allow_xacro": True}):
        with pytest.raises(bc.BayescalError, match="no joint moves" if allow else "is a program"):
            call(places, **allow)
        assert places.witness.exists() == bool(allow)


def test_sessions_of_a_fleet(places):
    for allow in (False, True):
        error = computed(Task(places.cell, places.new / "session", {}, allow))
        assert ("no joint moves" if allow else "--allow-xacro") in error
        assert places.witness.exists() == allow


def arguments():
    """Parameters of every command by its words."""
    for words, command in commands().items():
        if not hasattr(command, "commands"):
            yield words, inspect.signature(inspect.unwrap(command.callback)).parameters


def functions():
    """Public functions by their names."""
    for module, names in ((bc, bc.__all__), (bc.robots, ("load_robot",))):
        for name in names:
            if inspect.isfunction(own := getattr(module, name)):
                yield name if module is bc else f"robots.{name}", own


def test_no_argument_is_missing():
    known = {key.partition(",")[0] for key in CASES} | OTHER
    for words, own in arguments():
        for name in paths(own) if "allow_xacro" in own else ():
            assert f"{words.removeprefix('bayescal ')} {name}" in known | {f"{words.split()[-1]} out"}
    for name, own in functions():
        parameters = inspect.signature(own).parameters
        for argument in paths(parameters) if "allow_xacro" in parameters else ():
            assert f"{name} {argument}" in {key.partition(",")[0] for key in FUNCTIONS} | OTHER | {
                "fit checkpoint"
            }


def test_what_cannot_allow_it_does_not_run_it(places):
    """Commands and functions without the option, with the dataset and the file wherever they take a path."""
    for words, own in arguments():
        if "allow_xacro" not in own and "blind" not in words:
            for given in (places.cell, places.arm):
                values = [str(given)] * len(list(paths(own)))
                CliRunner().invoke(commands()["bayescal"], [*words.split()[1:], *values])
    for _, own in functions():
        parameters = inspect.signature(own).parameters
        for given in (places.cell, places.arm) if "allow_xacro" not in parameters else ():
            with suppress(Exception):
                own(*[given for p in parameters.values() if p.default is p.empty])
    assert not places.witness.exists()
