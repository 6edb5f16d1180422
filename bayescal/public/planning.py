"""Plans of contacts; results read back from run folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError
from bayescal.public import FitResult, GapResult, Result, motions, table
from bayescal.public.arms import names
from bayescal.public.functions import MODEL, session_of
from bayescal.storage.reading import MOTION, TOGETHER, Json, run_record
from bayescal.storage.stopping import Progress, silent

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import RenderableType

    from bayescal.dataset import Dataset
    from bayescal.planning.plan import Continuation
    from bayescal.planning.pool import Setup
    from bayescal.planning.result import Plan
    from bayescal.public.functions import Source

GAP, SETTINGS = "gap.json", "dataset.yaml"
"""Files by which a path of `after` is known."""


@dataclass(frozen=True, repr=False)
class PlanResult(Result):
    """Planned contacts; `print` shows the uncertainty they will achieve. `record` is that of plan.json."""

    data: Plan | None = None

    def _contents(self) -> Json:
        from bayescal.reporting.page.plan import plan_record

        return plan_record(self._new())

    @cached_property
    def contacts(self) -> DataFrame:
        """The contacts in the order of probing, by id: the columns of plan.csv, and `purpose`."""
        from pandas import read_csv

        from bayescal.reporting.page.plan import table_of_plan

        file = self._file("plan.csv", "repeat the command") if self.data is None else None
        texts: Mapping[Any, Any] = dict.fromkeys(("id", "repeat", "target", "tool"), str)
        out = read_csv(file or StringIO(table_of_plan(self._new())), dtype=texts, keep_default_na=True)
        out["purpose"] = out["id"].map(self.record["purpose"])
        return out.set_index("id")

    @property
    def distances(self) -> DataFrame:
        """Expected standard uncertainty of distances, µm, of the plan and of a random selection; shares."""
        rows = [
            {key: value for key, value in d.items() if key != "shares"} | d["shares"]
            for d in self.record["expected"]["distances"]
        ]
        return table(rows, "over", "" if rows else "over")

    _overview = distances

    @property
    def parameters(self) -> DataFrame:
        """Expected standard uncertainty `u` of the parameters, by name, and that of their prior."""
        return table(self.record["expected"]["parameters"], "name", "name unit u prior_u")

    @property
    def detectable(self) -> DataFrame:
        """Smallest detectable amplitude of each effect and site, of the plan and of a random selection."""
        return table(self.record["detectable"])

    @property
    def confusable(self) -> DataFrame:
        """Pairs of effects: detectability before and with the plan, and what would separate them."""
        return table(self.record["confusable"])

    @property
    def curve(self) -> DataFrame:
        """Expected standard uncertainty of distances, µm, by number of contacts: `plan` and `random`."""
        from pandas import DataFrame

        curves = {
            name: {point["contacts"]: point["distance_sd_um"] for point in self.record[key]}
            for name, key in (("plan", "curve"), ("random", "curve_random"))
        }
        return DataFrame(curves).rename_axis("contacts")

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.plan_sheets import plan_summary

        return plan_summary(self._new())

    def save(
        self, folder: str | PathLike[str], to: Sequence[str] | str = (), *, probe_input: str = "",
        probe_force_n: float | None = None, probe_beyond_mm: float = 5.0,
    ) -> tuple[str, ...]:  # fmt: skip
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
        from bayescal.reporting.page.plan import write_plan

        probe = Probe(probe_input, probe_force_n, 1e-3 * probe_beyond_mm)
        return write_plan(self._new(), Path(folder), names(to), probe)

    def __repr__(self) -> str:
        expected, u = self.record["expected"], self.record["expected"]["distance_sd_um"]
        size = "" if u is None else f"; expected U {2 * u:.1f} µm (k = 2), {expected['over']}"
        return f"<plan of {self.record['dataset']['name']}: {self.record['contacts']} contacts{size}>"


OfLog = motions.MotionFitResult | motions.MotionGapResult | motions.MotionPlanResult
Loaded = FitResult | GapResult | PlanResult | OfLog | motions.TogetherResult
RESULTS: dict[str, tuple[type[Loaded], type[Loaded]]] = {
    "fit": (FitResult, motions.MotionFitResult),
    "gap": (GapResult, motions.MotionGapResult),
    "plan": (PlanResult, motions.MotionPlanResult),
}
"""Class of a result of contacts and of a log, by the command that wrote its run folder."""


def load(run: str | PathLike[str]) -> Loaded:
    """Read a run folder of `fit`, `diagnose` or `plan` back.

    Parameters
    ----------
    run : path
        Folder with fit.json (and posterior.nc), gap.json or plan.json.

    Returns
    -------
    FitResult, GapResult or PlanResult
        With the tables of the result that was saved.

    Raises
    ------
    BayescalError
        If the folder contains no such result, or a result of another version.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=0, seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     names = bc.fit(session, samples=0).save(f"{folder}/run")
    ...     saved = bc.load(f"{folder}/run")
    >>> float(saved.parameters.loc["a2", "nominal"])
    300.0
    """
    folder = Path(run)
    kind, content = run_record(folder, *RESULTS)
    of_contacts, of_log = RESULTS[kind]
    kinds: dict[Any, type[Loaded]] = dict.fromkeys(MOTION, of_log) | {TOGETHER: motions.TogetherResult}
    return kinds.get(content.get("unit"), of_contacts)(folder=folder, content=content)


def plan(
    setup: Source, contacts: int | None = None, purpose: str = "both", model: Sequence[str] | str = (), *,
    after: Source | GapResult | None = None, levers: Sequence[str] | str = ("payload", "approach"),
    order: str = "sweeps", validation: bool = True, candidates: int = 5000, seed: int = 0,
    to: Sequence[str] | str = (), allow_xacro: bool = False, progress: Progress = silent,
) -> PlanResult | motions.MotionPlanResult:  # fmt: skip
    """Choose the contacts to measure, and predict the uncertainty that they give; of a joint log, motions.

    Parameters
    ----------
    setup : Dataset, SimulatedSession or path
        Robot, tools, targets, certificates and noise; rows are ignored. A path needs no measurements.csv. Of
        a joint log the motions are planned that it lacks; it has none of the options.
    contacts : int, optional
        Contacts to calibrate with, repeats included; those that validate spheres are added. Default: 200; of
        cameras 33 images.
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
    to : sequence of str, or str
        Formats that `save` is to write: an arm that they do not know is refused before the plan is made.
    allow_xacro : bool
        As of `read_dataset`.
    progress : callable
        Called with the stage and its completed fraction.

    Returns
    -------
    PlanResult, or MotionPlanResult of a joint log
        Prints as a summary; `contacts`, `distances`, `parameters`, `detectable`, `curve` are tables.

    Raises
    ------
    BayescalError
        If nothing can be reached, too few contacts are asked for, `after` is another session, or a format
        does not know the arm.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=40, later=8, repeats=2, spheres=0, seed=1)
    >>> planned = bc.plan(session, contacts=60, purpose="distances", candidates=150)
    >>> planned.contacts.shape[0], list(planned.contacts.columns[:4])
    (60, ['role', 'target', 'tool', 'j1_deg'])
    >>> bool((planned.distances["distance_sd_um"] > 0).all())
    True
    """
    from bayescal.model.options import parts_of
    from bayescal.planning.candidates import usual_count
    from bayescal.planning.plan import PlanOptions
    from bayescal.planning.plan import plan as run
    from bayescal.programs.probing import formats_of

    if (folder := motions.log_of(setup)) is not None:
        motions.refuse("the plan of a joint log", plan, locals(), "setup", "to", "progress")
        return motions.plan_log(folder)
    where, open_ = _setup(setup, after, allow_xacro)
    for form in formats_of(names(to)):
        form.moves(where.dataset.robot)
    effects = names(model) or (open_.effects if open_ else MODEL)
    count, varied = usual_count(where) if contacts is None else contacts, names(levers)
    options = PlanOptions(count, purpose, effects, varied, order, candidates, seed, validation=validation)
    if open_:
        without = parts_of(open_.without, effects)
        options = replace(options, pairs=open_.pairs, without=without, probability=open_.probability)
        where = replace(where, noise_scale=open_.noise_scale)
    return PlanResult(run(where, options, progress))


def _setup(
    source: Source, after: Source | GapResult | None, allow_xacro: bool
) -> tuple[Setup, Continuation | None]:
    """The setup, and what a diagnosis leaves open."""
    from bayescal.dataset.read import expanded_robot, no_rows
    from bayescal.planning import plan as plans
    from bayescal.planning.setup import continued, read_setup, stated

    if isinstance(after, GapResult) and after.data is None:
        after = after.folder
    if isinstance(after, GapResult):
        assert after.data is not None
        return continued(after.data.dataset), plans.continued(after.record, "the diagnosis")
    if isinstance(after, str | PathLike) and (Path(after) / GAP).is_file():
        measured = session_of(source, allow_xacro=allow_xacro)
        return continued(measured), plans.continuation(measured, Path(after))
    if isinstance(after, str | PathLike) and not (Path(after) / SETTINGS).is_file():
        remedy = "give a measured dataset, or a run folder of bayescal gap"
        raise BayescalError(f"there is no {SETTINGS} and no {GAP}", str(after), remedy)
    folder = Path(source) if isinstance(source, str | PathLike) else None
    robot = expanded_robot(folder) if folder and allow_xacro else None
    if after is not None:  # the places of targets are those of the measured session
        asked = stated(folder, robot) if folder else session_of(source, allow_xacro=allow_xacro)
        measured = session_of(after, allow_xacro=allow_xacro)
        _same(asked, measured)
        return continued(replace(measured, plan=asked.plan or measured.plan)), None
    if folder:
        return read_setup(folder, robot), None
    one = session_of(source, allow_xacro=allow_xacro)
    return continued(replace(one, measurements=no_rows(one.robot.n))), None


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
