"""Print all tables and texts of the results of the Python API: ``python tables.py DATASET RUN TARGETS``."""

import sys

import numpy as np
from pandas import DataFrame

import bayescal as bc


def show(name: str, result: object) -> None:
    """The result as printed, then its tables in the order of their names."""
    print(f"## {name}\n{result}\n{result!r}")
    for attribute in sorted(a for a in dir(result) if not a.startswith("_")):
        value = getattr(result, attribute)
        if isinstance(value, DataFrame):
            print(f"# {name}.{attribute}\n{value.to_csv()}")
        elif isinstance(value, np.ndarray | float | int | str | tuple):
            print(f"# {name}.{attribute}\n{value.tolist() if isinstance(value, np.ndarray) else value}")


dataset, run, targets = sys.argv[1:]
show("check", bc.check(dataset))
fit = bc.fit(dataset, model=("geometry", "compliance"), samples=0)
show("fit", fit)
show("position", fit.position(np.zeros((2, len(fit.record["arm"]["joints"])))))
show("diagnose", bc.diagnose(dataset))
show("load", bc.load(run))
show("budget", bc.budget(run))
show("compensate", bc.compensate(run, targets))
show("plan", bc.plan(dataset, contacts=60, candidates=200))
print(bc.robots.table().to_csv())
print(bc.robots.names(), bc.effects.names(), *map(bc.effects.describe, bc.effects.names()), sep="\n")
