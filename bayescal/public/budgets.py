"""Uncertainty budgets, and the Digital Calibration Certificate with their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from math import inf
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import RenderableType

from bayescal.assess import budget as work
from bayescal.assess import measurand as measurands
from bayescal.assess.budget import Budget
from bayescal.assess.inputs import Basis
from bayescal.calibration import basis_of
from bayescal.errors import BayescalError
from bayescal.exporting.dcc import check_valid, dcc, read_entries
from bayescal.fitted import gate
from bayescal.fitted.arm import FittedArm, of_fit
from bayescal.fitted.file import check_restored, restored
from bayescal.public import FitResult, GapResult, Printed, table
from bayescal.public.positions import arm_of
from bayescal.reporting.fit.files import budget_csv, budget_record, budget_table
from bayescal.reporting.sheet import screen
from bayescal.storage.files import write_together
from bayescal.storage.reading import read_json

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, repr=False)
class BudgetResult(Printed):
    """An uncertainty budget; `print` shows its table. `data` is the complete result, in SI."""

    data: Budget
    basis: Basis
    seed: int = 0
    warnings: tuple[str, ...] = ()
    """What the verdict says against the model: u of a parameter has no part of what the model leaves."""

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
        """The content of a budget.json with this budget alone, and `warnings`."""
        return budget_record((self.data,), self.basis, self.seed) | {"warnings": list(self.warnings)}

    @property
    def components(self) -> DataFrame:
        """The components by name: type, value, u, sensitivity, contribution."""
        return table(self.record["components"], "name").drop(columns="by_target")

    @property
    def csv(self) -> str:
        """The components and their sum, as CSV."""
        return budget_csv((self.data,))

    def report(self) -> RenderableType:
        """The table, to be printed by a `rich.console.Console`."""
        return screen(budget_table(self.data), *([("warning", w, "yellow")] for w in self.warnings))

    def __repr__(self) -> str:
        return f"<budget of {self.data.measurand.name}: {self.record['text']}>"

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


def budget(
    run: FitResult | GapResult | str | PathLike[str], *, distance: Sequence[str] | None = None,
    parameter: str = "", point: Sequence[float] | None = None, tool: str | None = None,
    payload_kg: float = 0.0,
) -> BudgetResult:  # fmt: skip
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
        deg (mm of prismatic joints), joint readings at which the TCP is stated.
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
    if (distance is not None) + bool(parameter) + (point is not None) > 1:
        what = "more than one measurand is asked for"
        raise BayescalError(what, "budget", "give one of a distance, a parameter and a point")
    if point is None and (tool is not None or payload_kg):
        option = "--payload-kg" if tool is None else "--tool"
        what = "it belongs to a point, and none is given"
        raise BayescalError(what, option, "give --point-deg, or leave it out")
    arm, basis, seed = stated(run)
    if distance is not None:
        if len(distance) != 2:
            raise BayescalError(f"{len(distance)} targets", "--distance", "name two targets")
        measurand = measurands.distance(basis, (distance[0], distance[1]))
    elif parameter:
        measurand = measurands.parameter(basis, parameter)
    elif point is not None:
        from bayescal.compensating.position import point as pointed

        shown = np.asarray(point, float)
        n = arm.dataset.robot.n
        readings = arm.dataset.robot.read(shown) if len(shown) == n else np.radians(shown)
        measurand = pointed(arm, basis, readings, tool=tool, payload_kg=payload_kg)
    else:
        measurand = work.headline(basis)
    limit = "u of a parameter has no part of the errors that the model leaves"
    warnings = tuple(f"{words}; {limit}" for words in arm.use.warnings) if parameter else ()
    return BudgetResult(work.budget(basis, measurand), basis, seed, warnings)


def stated(run: FitResult | GapResult | str | PathLike[str]) -> tuple[FittedArm, Basis, int]:
    """The arm of a run, and what was stated of it."""
    if isinstance(run, FitResult) and run.data is not None:
        return of_fit(run.data), run.data.basis, run.data.options.seed
    arm = arm_of(run)
    seed = arm.origin.options.seed
    if isinstance(run, GapResult) and run.data is not None:
        assert run.data.arm is not None, "a diagnosis has its refit"
        return arm, basis_of(run.data.arm, seed), seed
    basis = basis_of(restored(arm), seed)
    check_restored(arm, basis.stated.limited)
    folder = run.folder if isinstance(run, FitResult | GapResult) else run
    return arm, _as_written(basis, Path(folder or "")), seed


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


@dataclass(frozen=True, repr=False)
class CertificateResult(Printed):
    """A Digital Calibration Certificate; `content` is its XML."""

    content: str
    name: str
    validated: str = ""

    def report(self) -> RenderableType:
        """What was written, to be printed by a `rich.console.Console`."""
        checked = (
            f"valid by {self.validated}" if self.validated else "not validated: --schema names a dcc.xsd"
        )
        return f"Digital Calibration Certificate 3.3.0, {checked}"

    def save(self, path: str | PathLike[str] | None = None) -> tuple[Path, ...]:
        """Write the certificate; return its path. A file that exists is not replaced."""
        file = Path(path or self.name)
        if file.exists():
            raise BayescalError("exists", str(file), "give another --out: certificates are not replaced")
        write_together({file: self.content})
        return (file,)

    def __repr__(self) -> str:
        return f"<certificate {self.name}>"


def certificate(
    run: FitResult | GapResult | str | PathLike[str], entries: str | PathLike[str], *,
    schema: str | PathLike[str] = "", force: bool = False,
) -> CertificateResult:  # fmt: skip
    """A Digital Calibration Certificate (DCC 3.3.0) of a calibration, with the numbers of its budgets.

    Parameters
    ----------
    run : FitResult, GapResult or path
    entries : path
        YAML file with the administrative data; see docs/budget.md.
    schema : path, optional
        A copy of dcc.xsd, with SI_Format.xsd beside it, by which the certificate is validated.
    force : bool
        In spite of reasons against the arm, which the certificate then states.

    Raises
    ------
    BayescalError
        With the entries that are missing, reasons against the arm, or what is not valid.
    """
    if not str(entries):
        what = "a certificate needs its administrative data"
        raise BayescalError(what, "--certificate", "name a YAML file: see docs/budget.md")
    given = read_entries(Path(entries))
    arm, basis, _ = stated(run)
    gate.check(arm.use, force, "certified")
    notes = (*arm.use.notes, *(f"Issued in spite of: {reason}" for reason in arm.use.against))
    content = dcc(given, basis, notes)
    validated = str(schema)
    if validated and (faults := check_valid(content, Path(schema))):
        validated += f", of which {faults} faulty or missing parts were not checked"
    return CertificateResult(content, f"{arm.dataset.robot.name}-dcc.xml", validated)
