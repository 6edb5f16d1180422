"""What the wheel contains: every module, the data that the program reads, and its metadata.

`make package-check` installs it; here the build backend lists the files.
"""

import ast
import re
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from cases import ROOT
from hatchling.builders import wheel

PACKAGES = ("bayescal", "factors")


@pytest.fixture(scope="module")
def builder():
    return wheel.WheelBuilder(str(ROOT))


@pytest.fixture(scope="module")
def files(builder):
    return {file.distribution_path for file in builder.recurse_included_files()}


def own() -> set[str]:
    """Files of the packages that are not made by running them."""
    return {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and path.suffix not in (".pyc", ".nbi", ".nbc") and path.name != ".DS_Store"
    }


def test_every_file_of_the_packages_is_in_the_wheel(files):
    assert files == own()


def test_data_that_the_program_reads(files):
    """Robots, templates, styles: whatever is not Python."""
    assert {".py", ".yaml", ".j2"} <= {Path(name).suffix for name in files}
    assert {"bayescal/py.typed", "factors/py.typed"} <= files
    assert not {name for name in files if name.endswith((".nbi", ".nbc", ".pyc"))}


def test_metadata(builder):
    core = builder.metadata.core
    assert core.readme_content_type == "text/markdown"
    assert core.license_expression == "MIT"
    assert "Typing :: Typed" in core.classifiers
    assert core.scripts == {"bayescal": "bayescal.cli:main"}
    import bayescal

    assert core.version == bayescal.__version__


def test_citation_has_the_version_of_the_package():
    import bayescal

    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", text, re.MULTILINE)[1] == bayescal.__version__


def test_every_requirement_is_pinned():
    """Constraints name every direct requirement of every extra, except a user's notebook server."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(r for e in project["optional-dependencies"].values() for r in e)]
    names = {plain(re.match(r"[\w.-]+", requirement)[0]) for requirement in wanted} - {"bayescal"}
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert names - {plain(line.partition("==")[0]) for line in lines if "==" in line} == {"jupyterlab"}


def plain(name: str) -> str:
    """The normalised name of a package."""
    return re.sub(r"[-_.]+", "-", name).lower()


def test_the_command_is_installed_or_importable():
    """The entry point names a function that exists."""
    from bayescal.cli import main

    found = [e for e in entry_points(group="console_scripts") if e.name == "bayescal"]
    assert all(entry.load() is main for entry in found)


IMPORTED_AS = {
    "urdfdom-py": "urdf_parser_py", "pyyaml": "yaml", "pin": "pinocchio", "opencv-python-headless": "cv2",
    "usd-core": "pxr",
}  # fmt: skip
"""Modules of distributions with another name."""
LOADERS = ("import_module", "files", "find_spec")


def imported() -> set[str]:
    """Modules of others that the packages name in an import, or by a text for `LOADERS`."""
    out = set()
    for path in (p for package in PACKAGES for p in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                out |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                out.add(node.module)
            elif isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in LOADERS:
                out |= {str(own.value) for own in node.args[:1] if isinstance(own, ast.Constant)}
    return {name.partition(".")[0] for name in out} - {*sys.stdlib_module_names, *PACKAGES}


def declared(entries: list[str]) -> set[str]:
    names = {re.match(r"[\w-]+", entry)[0].lower() for entry in entries}
    return {IMPORTED_AS.get(name, name) for name in names}


def test_what_is_imported_is_declared_and_what_is_declared_is_imported():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    base, extras = declared(project["dependencies"]), project["optional-dependencies"]
    names = ("interactive", "mujoco", "camera", "xlsx", "dcc", "pinocchio", "usd", "dask")
    optional = declared([e for name in names for e in extras[name]])
    used = imported()
    assert used <= base | optional
    assert base <= used
