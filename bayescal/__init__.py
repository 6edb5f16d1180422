"""bayescal: Bayesian calibration of robot arms from probed planes, with its uncertainty.

>>> import bayescal as bc
>>> "backlash" in bc.effects.names()
True

Functions: `read_dataset`, `fit`, `diagnose`, `simulate`, `compare`, `export`, `verify`, `compensate`,
`changed`, `history`, `fleet`, `plan`, `watch`, `init`, `check`, `schema`, `load`; packages: `robots`,
`effects`, `plot` (figures). All are imported when first used.
"""

from importlib import import_module

TYPE_CHECKING = False  # `typing` is not imported: see `bayescal.cli`

if TYPE_CHECKING:
    from bayescal import effects, robots
    from bayescal.errors import BayescalError
    from bayescal.public import plot
    from bayescal.public.arms import compensate, export, verify
    from bayescal.public.budgets import budget
    from bayescal.public.changes import changed, history
    from bayescal.public.fleet import fleet
    from bayescal.public.functions import compare, diagnose, fit, read_dataset, simulate
    from bayescal.public.planning import load, plan
    from bayescal.public.starting import check, init, report, schema
    from bayescal.public.watching import watch

__version__ = "0.1.0"
__all__ = [
    "BayescalError",
    "__version__",
    "budget",
    "changed",
    "check",
    "compare",
    "compensate",
    "diagnose",
    "effects",
    "export",
    "fit",
    "fleet",
    "history",
    "init",
    "load",
    "plan",
    "plot",
    "read_dataset",
    "report",
    "robots",
    "schema",
    "simulate",
    "verify",
    "watch",
]

_PUBLIC = {
    "arms": "compensate export verify",
    "budgets": "budget",
    "changes": "changed history",
    "fleet": "fleet",
    "functions": "compare diagnose fit read_dataset simulate",
    "planning": "load plan",
    "starting": "check init report schema",
    "watching": "watch",
}
_FROM = {name: f"bayescal.public.{module}" for module, names in _PUBLIC.items() for name in names.split()}
_FROM["BayescalError"] = "bayescal.errors"
_MODULES = {"effects": "bayescal.effects", "plot": "bayescal.public.plot", "robots": "bayescal.robots"}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    if name in _MODULES:
        return import_module(_MODULES[name])
    if name not in _FROM:
        raise AttributeError(f"module 'bayescal' has no attribute '{name}'")
    value = getattr(import_module(_FROM[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
