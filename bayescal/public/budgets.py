"""The public function for uncertainty budgets, and its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError
from bayescal.public.results import FitResult, GapResult, as_text
from bayescal.reading import read_json

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import RenderableType

    from bayescal.assess.budget import Basis, Budget
    from bayescal.exporting.fitted import FittedArm


@dataclass(frozen=True, repr=False)
class BudgetResult:
    """An uncertainty budget; `print` shows its table. `data` is the complete result, in SI."""

    data: Budget
    basis: Basis
    seed: int = 0

    @property
    def u(self) -> float:
        """Combined standard uncertainty, in the unit of the measurand (`record["unit"]`)."""
        return float(self.record["u"])

    @property
    def U(self) -> float:
        """Expanded uncertainty, in the unit of the measurand."""
        return float(self.record["U"])

    @property
    def k(self) -> float:
        """Coverage factor."""
        return self.data.k

    @cached_property
    def record(self) -> dict[str, Any]:
        """The content of a budget.json with this budget alone."""
        from bayescal.reporting.fit.budget import budget_record

        return budget_record((self.data,), self.basis, self.seed)

    @property
    def components(self) -> DataFrame:
        """The components by name: type, value, u, sensitivity, contribution."""
        from pandas import DataFrame

        table = DataFrame(self.record["components"]).set_index("name")
        return table.drop(columns="by_target")

    @property
    def csv(self) -> str:
        """The components and their sum, as CSV."""
        from bayescal.reporting.fit.budget import budget_csv

        return budget_csv((self.data,))

    def report(self) -> RenderableType:
        """The table, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.fit.budget import budget_table

        return budget_table(self.data)

    def __str__(self) -> str:
        return as_text(self.report())

    def __repr__(self) -> str:
        return f"<budget of {self.data.measurand.name}: {self.record['text']}>"

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(str(self))}</pre>"


def budget(
    run: FitResult | GapResult | str | PathLike[str],
    *,
    distance: Sequence[str] | None = None,
    parameter: str = "",
    point: Sequence[float] | None = None,
    tool: str | None = None,
    payload_kg: float = 0.0,
) -> BudgetResult:
    """Uncertainty budget of a distance, a parameter or a point (JCGM 100).

    Without distance, parameter and point: the distance that the fit reports first.

    Parameters
    ----------
    run : FitResult, GapResult or path
        A path is that of a run folder.
    distance : (str, str), optional
        Names of two targets with a centre.
    parameter : str, optional
        Name of a parameter.
    point : sequence of float, optional
        deg, joint readings at which the TCP is stated.
    tool, payload_kg
        Of the point: name of the tool, and additional payload, kg.

    Returns
    -------
    BudgetResult
        Prints as a table; `components` is a pandas table, `u`, `U` and `k` the result.

    Raises
    ------
    BayescalError
        If there is no such target or parameter, or more than one measurand is asked for.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=0, seed=1)
    >>> found = bc.budget(bc.fit(session, samples=0), parameter="a2")
    >>> sorted(set(found.components["type"]))
    ['A', 'B']
    >>> bool(abs((found.components["contribution"] ** 2).sum() ** 0.5 - found.u) < 1e-9)
    True
    """
    import numpy as np

    from bayescal.assess import budget as work

    if (distance is not None) + bool(parameter) + (point is not None) > 1:
        what = "more than one measurand is asked for"
        raise BayescalError(what, "budget", "give one of a distance, a parameter and a point")
    arm, basis, seed = stated(run)
    if distance is not None:
        if len(distance) != 2:
            raise BayescalError(f"{len(distance)} targets", "--distance", "name two targets")
        measurand = work.distance(basis, (distance[0], distance[1]))
    elif parameter:
        measurand = work.parameter(basis, parameter)
    elif point is not None:
        from bayescal.exporting.point import point as pointed

        readings = np.radians(np.asarray(point, float))
        measurand = pointed(arm, basis, readings, tool=tool, payload_kg=payload_kg)
    else:
        measurand = work.headline(basis)
    return BudgetResult(work.budget(basis, measurand), basis, seed)


def stated(run: FitResult | GapResult | str | PathLike[str]) -> tuple[FittedArm, Basis, int]:
    """The arm of a run, and what was stated of it."""
    from bayescal.calibration import basis_of
    from bayescal.exporting import of_fit
    from bayescal.exporting.restored import check_restored, restored
    from bayescal.public.exports import arm_of

    if isinstance(run, FitResult):
        return of_fit(run.data), run.data.basis, run.data.seed
    arm = arm_of(run)
    seed = arm.origin.seed
    if isinstance(run, GapResult):
        assert run.data.arm is not None, "a diagnosis has its refit"
        return arm, basis_of(run.data.arm, seed), seed
    basis = basis_of(restored(arm), seed)
    check_restored(arm, basis.stated.limited)
    return arm, _as_written(basis, Path(run)), seed


def _as_written(basis: Basis, folder: Path) -> Basis:
    """With the unexplained error of the folder's budget.json, which is from the sampled posterior."""
    path = folder / "budget.json"
    if not path.is_file():
        return basis  # the run folder of a diagnosis
    record = read_json(path, "repeat the command")
    try:
        dof = record["unexplained_dof"]
        return replace(basis, excess=1e-6 * record["unexplained_um"], excess_dof=inf if dof is None else dof)
    except (ValueError, KeyError, TypeError) as error:
        raise BayescalError(f"cannot be read: {error}", str(path), "repeat the command") from None
