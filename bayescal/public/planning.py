"""Plans of contacts, of the public API."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from bayescal.errors import BayescalError
from bayescal.public.exports import names
from bayescal.public.functions import MODEL, Progress, session_of, silent
from bayescal.public.results import GapResult, SimulatedSession, as_text
from bayescal.public.tables import PlanTables, plan_line
from bayescal.storage.reading import Json

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import RenderableType

    from bayescal.dataset import Dataset
    from bayescal.planning.plan import Continuation
    from bayescal.planning.pool import Setup
    from bayescal.planning.result import Plan

    Source = Dataset | SimulatedSession | str | PathLike[str]

GAP, SETTINGS = "gap.json", "dataset.yaml"
"""Files by which a path of `after` is known."""


@dataclass(frozen=True, repr=False)
class PlanResult(PlanTables):
    """Planned contacts; `print` shows the uncertainty they will achieve.

    Attributes
    ----------
    data : Plan
        The complete result, in SI.
    """

    data: Plan

    @cached_property
    def record(self) -> Json:
        """The content of plan.json."""
        from bayescal.reporting.plan.record import plan_record

        return plan_record(self.data)

    @cached_property
    def contacts(self) -> DataFrame:
        """The contacts in the order of probing, by id: the columns of plan.csv, and `purpose`."""
        from io import StringIO

        from bayescal.reporting.plan.record import table_of_plan

        return self.contacts_of(StringIO(table_of_plan(self.data)))

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.plan.sheets import plan_summary

        return plan_summary(self.data)

    def save(
        self,
        folder: str | PathLike[str],
        to: Sequence[str] | str = (),
        *,
        probe_input: str = "",
        probe_force_n: float | None = None,
        probe_beyond_mm: float = 5.0,
    ) -> tuple[str, ...]:
        """Write plan.csv, plan.json, the page, the figure and the setup; return their names.

        Parameters
        ----------
        folder : path
        to : sequence of str, or str
            Formats that are written too: 'csv', 'urscript', 'fanuc', 'kuka', 'abb', 'robodk', 'poses'.
        probe_input : str
            Digital input of the probe as the controller names it: '0', 'tool:0'; default: the first.
        probe_force_n : float, optional
            Change of the force at the tool that is a contact, in place of the input (UR).
        probe_beyond_mm : float
            How far beyond the expected surface a probing program searches for a contact.

        Raises
        ------
        BayescalError
            For an unknown format, or a probe that a format cannot use.
        """
        from bayescal.programs.probing import Probe
        from bayescal.reporting.plan.record import write_plan

        probe = Probe(probe_input, probe_force_n, 1e-3 * probe_beyond_mm)
        return write_plan(self.data, Path(folder), names(to), probe)

    def __str__(self) -> str:
        return as_text(self.report())

    def __repr__(self) -> str:
        return plan_line(self.record)


def plan(
    setup: Source,
    contacts: int = 200,
    purpose: str = "both",
    model: Sequence[str] | str = (),
    *,
    after: Source | GapResult | None = None,
    levers: Sequence[str] | str = ("payload", "approach"),
    order: str = "sweeps",
    validation: bool = True,
    candidates: int = 5000,
    seed: int = 0,
    allow_xacro: bool = False,
    progress: Progress = silent,
) -> PlanResult:
    """Choose the contacts to measure, and predict the uncertainty that they give.

    Parameters
    ----------
    setup : Dataset, SimulatedSession or path
        Robot, tools, targets, certificates and noise; rows are ignored. A path needs no measurements.csv.
    contacts : int
        Contacts to calibrate with, repeats included; those that validate spheres are added.
    purpose : str
        'distances', 'gap' (effects that the model lacks), or 'both'.
    model : sequence of str, or str
        As of `fit`; default: geometry and compliance, or the model of the diagnosis of `after`.
    after : Dataset, SimulatedSession, GapResult or path, optional
        Continue a measured session: the session, or its diagnosis (a path: the run folder of `diagnose`, and
        `setup` is the session). Then the contacts for the gap decide what the diagnosis could not.
    levers : sequence of str, or str
        What may be varied beside the pose: 'payload' (masses that `plan: {payload_kg}` of the setup lists),
        'approach'.
    order : str
        'sweeps', 'shortest' or 'random'.
    validation : bool
        Add contacts that validate spheres of certified distances.
    candidates : int
        Possible contacts among which is chosen.
    seed : int
        The same seed gives the same plan.
    allow_xacro : bool
        As of `read_dataset`.
    progress : callable
        Called with the stage and its completed fraction.

    Returns
    -------
    PlanResult
        Prints as a summary; `contacts`, `distances`, `parameters`, `detectable`, `curve` are tables.

    Raises
    ------
    BayescalError
        If nothing can be reached, too few contacts are asked for, or `after` is another session.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=40, later=8, repeats=2, spheres=0, seed=1)
    >>> planned = bc.plan(session, contacts=60, purpose="distances", candidates=300)
    >>> planned.contacts.shape[0], list(planned.contacts.columns[:4])
    (60, ['role', 'target', 'tool', 'j1_deg'])
    >>> bool((planned.distances["distance_sd_um"] > 0).all())
    True
    """
    from bayescal.model.options import parts_of
    from bayescal.planning.plan import plan as run

    where, open_ = _setup(setup, after, allow_xacro)
    effects = names(model) or (open_.effects if open_ else MODEL)
    found = run(
        where,
        contacts,
        purpose,
        effects,
        names(levers),
        order,
        candidates,
        seed,
        pairs=open_.pairs if open_ else (),
        without=parts_of(open_.without, effects) if open_ else (),
        probability=open_.probability if open_ else None,
        validation=validation,
        progress=progress,
    )
    return PlanResult(found)


def _setup(
    source: Source, after: Source | GapResult | None, allow_xacro: bool
) -> tuple[Setup, Continuation | None]:
    """The setup, and what a diagnosis leaves open."""
    from bayescal.dataset.read import no_rows
    from bayescal.planning.plan import continuation
    from bayescal.planning.plan import continued as left_open
    from bayescal.planning.setup import continued, read_setup

    if isinstance(after, GapResult):
        return continued(after.data.dataset), left_open(after.record, "the diagnosis")
    if isinstance(after, str | PathLike) and (Path(after) / GAP).is_file():
        measured = session_of(source, allow_xacro=allow_xacro)
        return continued(measured), continuation(measured, Path(after))
    if isinstance(after, str | PathLike) and not (Path(after) / SETTINGS).is_file():
        remedy = "give a measured dataset, or a run folder of bayescal gap"
        raise BayescalError(f"there is no {SETTINGS} and no {GAP}", str(after), remedy)
    if isinstance(source, str | PathLike):
        setup = read_setup(Path(source), allow_xacro)
    else:
        one = session_of(source, allow_xacro=allow_xacro)
        setup = continued(replace(one, measurements=no_rows(one.robot.n)))
    if after is None:
        return setup, None
    measured = session_of(after, allow_xacro=allow_xacro)
    _same(setup.dataset, measured)
    return continued(replace(measured, plan=setup.dataset.plan or measured.plan)), None


def _same(setup: Dataset, measured: Dataset) -> None:
    """Refuse a measured session of another robot or with other targets than the setup."""
    here = {t.name: t.kind for t in measured.targets}
    if setup.robot.name != measured.robot.name:
        what = f"its robot is {measured.robot.name}, that of the setup {setup.robot.name}"
        raise BayescalError(what, f"--after {measured.name}", "give a session of the same setup")
    other = [t.name for t in setup.targets if here.get(t.name) != t.kind]
    if other:
        what = f"it has no target `{other[0]}` of the setup"
        raise BayescalError(what, f"--after {measured.name}", "give a session of the same setup")
