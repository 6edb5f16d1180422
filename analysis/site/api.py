"""The page of the Python interface: every public name, by its docstring."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import ModuleType

import bayescal
import bayescal.public
from bayescal.dataset import Dataset
from bayescal.effects import Effect, Parameter, Scan, Term

PAGE = """# Python

`import bayescal as bc`. [Use from Python](../api.md) has examples. Arrays and numbers are in
SI (m, rad, kg, s) with their shapes in the docstrings; tables and files carry their units. An error of the
user is a `bc.BayescalError` of one line.

"""
TYPES = (Dataset, Effect, Parameter, Term, Scan)
"""Types that users read or write, beside the results."""


def entry(name: str, item: object) -> str:
    """The entry of a function or class, under the name by which users call it."""
    where = f"{item.__module__}.{item.__qualname__}"  # type: ignore[attr-defined]
    kind = "class" if inspect.isclass(item) else "function"
    members = "inherited_members: true, filters: ['!^_']" if kind == "class" else "members: false"
    options = f'{{show_root_heading: true, heading: "{name}", heading_level: 3, {members}}}'
    return f"::: {where}\n    options: {options}\n\n"


def functions(name: str, module: ModuleType) -> Iterator[str]:
    """Entries of the functions of a public package."""
    for member in module.__all__:
        item = getattr(module, member)
        if inspect.isroutine(item):
            yield entry(f"bc.{name}.{member}", item)


def results() -> list[type]:
    """Classes of results."""
    out: list[type] = []
    for found in pkgutil.iter_modules(bayescal.public.__path__):
        module = importlib.import_module(f"bayescal.public.{found.name}")
        classes = (c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__)
        out += [c for c in classes if not c.__name__.startswith("_") and not c.__name__.endswith("Tables")]
    return out


def page() -> str:
    """The page of all public names."""
    public = {name: getattr(bayescal, name) for name in bayescal.__all__ if not name.startswith("_")}
    packages = {name: item for name, item in public.items() if inspect.ismodule(item)}
    own = {name: item for name, item in public.items() if name not in packages}
    out = PAGE + "## Functions\n\n" + "".join(entry(f"bc.{name}", item) for name, item in own.items())
    for name, module in packages.items():
        out += f"## bc.{name}\n\n" + "".join(functions(name, module))
    out += "## Results\n\n" + "".join(entry(c.__name__, c) for c in results())
    return out + "## Data\n\n" + "".join(entry(c.__name__, c) for c in TYPES)
