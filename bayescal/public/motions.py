"""Results of joint logs, also of those that were fitted together with a session of contacts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import signature
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bayescal.errors import BayescalError
from bayescal.public import Diagnosis, Draws, FitResult, Result, table
from bayescal.storage.reading import Json, read_record, run_record
from bayescal.storage.stopping import Progress, silent

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import RenderableType

    from bayescal.logs import Log
    from bayescal.motion.calibrate import MotionFit
    from bayescal.motion.diagnose import MotionGap
    from bayescal.motion.together import Together
    from bayescal.posterior.inference import Record
    from bayescal.preparing.next_motions import MotionPlan


@dataclass(frozen=True, repr=False)
class MotionGapResult(Diagnosis):
    """The diagnosis of a joint log; `print` shows its summary. `record` is the content of gap.json.

    `effects` has the largest first; `amplitudes` has `relevant` too: whether the withheld error changes.
    """

    data: MotionGap | None = None
    _OF: ClassVar[str] = "the log "
    plan: MotionPlan | None = None  # of the motions that are to be logged next

    def _contents(self) -> Json:
        from bayescal.reporting.motion.fit import advice_of, motions_of
        from bayescal.reporting.motion.record import motion_record

        record = motion_record(self._new())
        if self.plan is None:
            return record
        following = [*record["next"], *advice_of(self.plan)]
        return record | {"next": following, "next_motions": motions_of(self.plan)}

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.motion import motion_summary

        return motion_summary(self.record)

    def save(self, folder: str | PathLike[str], pictures: bool = True) -> tuple[str, ...]:
        """Write gap.json, gap.html and, if motions are to be logged, next-motions.csv and .yaml.

        Returns the names of what was written. The page draws its figures itself.
        """
        from bayescal.reporting.motion.fit import files_of
        from bayescal.reporting.motion.record import write_motion

        further = {} if self.plan is None else files_of(self.plan)
        return write_motion(self._new(), Path(folder), self.record, further)

    @property
    def probability(self) -> dict[str, float]:
        """Probability of each effect, of noise only (`null`) and of a cause outside the list (`unknown`)."""
        return dict(self.record["probability"])

    @property
    def undecided(self) -> bool:
        """Whether further contacts could decide: of a log, none can."""
        return False

    @property
    def shrinkage(self) -> DataFrame:
        """RMS of the residuals of withheld motions, N m or (servos without torques) deg, joint by joint."""
        from bayescal.reporting.motion import shrinkage_of

        keys, items = shrinkage_of(self.record)
        return table(items, "joint", " ".join(("joint", *keys[:3])))

    _overview = shrinkage


@dataclass(frozen=True, repr=False)
class MotionFitResult(Draws):
    """A calibration from a joint log; `print` shows its summary. `record` is the content of fit.json."""

    data: MotionFit | None = None

    def _contents(self) -> Json:
        from bayescal.reporting.motion.fit import fit_record

        return fit_record(self._new())

    def report(self, verbose: bool = False) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`; `verbose` adds all parameters."""
        from bayescal.reporting.motion.fit import fit_summary

        return fit_summary(self.record, verbose)

    def save(self, folder: str | PathLike[str], pictures: bool = True) -> tuple[str, ...]:
        """Write fit.json, report.html, posterior.nc and arm.yaml; return their names."""
        from bayescal.reporting.motion.fit import write_fit

        return write_fit(self._new(), Path(folder), self.record)

    def _posterior(self) -> Record:
        from bayescal.reporting.motion.fit import draws_of

        return draws_of(self._new())

    @property
    def parameters(self) -> DataFrame:
        """One row per parameter, by name: nominal, estimate, u, 95 % interval, prior_sd, SI."""
        return table(self.record["parameters"], "name")

    @property
    def withheld(self) -> DataFrame:
        """Torque errors of withheld motions, N m RMS, joint by joint."""
        return table(self.record["withheld"], "joint")

    _overview = withheld

    def __repr__(self) -> str:
        name, count = self.record["dataset"]["name"], len(self.record["parameters"])
        return f"<calibration from the log {name}: {count} parameters>"


def log_of(source: Any) -> Path | None:
    """The folder of a joint log that a source names; None for a session of contacts."""
    others, logs = divided(source)
    if not logs:
        return None
    if others or len(logs) > 1:
        what = "several folders, among them a joint log"
        remedy = (
            "give the log alone; only `fit` takes it beside a session"
            if others
            else "give one joint log at a time"
        )
        raise BayescalError(what, str(logs[0]), remedy)
    return logs[0]


def divided(source: Any) -> tuple[list[Any], list[Path]]:
    """Sources of sessions of contacts, and folders of joint logs."""
    from bayescal.logs import is_log

    each = source if isinstance(source, list | tuple) else [source]
    logs = [one for one in each if isinstance(one, str | PathLike) and is_log(Path(one))]
    return [one for one in each if not any(one is log for log in logs)], list(map(Path, logs))


def noted_log(folder: Path) -> Log:
    """A joint log; it states columns that are probably mistaken, also among its notes."""
    from bayescal.logs import read_log
    from bayescal.preparing.joint_log import mistaken

    log = read_log(folder)
    wrong = tuple(f"{f.what}; {f.remedy}" for f in mistaken(log))
    return replace(log, notes=(*log.notes, *wrong), mistaken=wrong)


def diagnose_log(folder: Path, progress: Progress = silent) -> MotionGapResult:
    """Diagnose a joint log; see `bayescal.diagnose`."""
    from bayescal.motion.diagnose import diagnose
    from bayescal.preparing.next_motions import next_motions
    from bayescal.verifying.log import replay_gap

    log = noted_log(folder)
    gap = replay_gap(diagnose(log, progress))
    v = gap.verdict
    sites = (v.leading.members[-1].form.site,) if v.left_open else ()
    plan = None if log.mistaken else next_motions(log, gap.not_assessed, sites)
    return MotionGapResult(gap, plan=plan)


@dataclass(frozen=True, repr=False)
class MotionPlanResult(Result):
    """Motions that are to be logged next; `print` shows them. `record` is the content of plan.json."""

    data: MotionPlan | None = None

    def _contents(self) -> Json:
        from bayescal.reporting.motion.fit import plan_record

        return plan_record(self._new())

    def report(self) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`."""
        from bayescal.reporting.motion.fit import plan_summary

        return plan_summary(self.record)

    def save(
        self, folder: str | PathLike[str], to: Sequence[str] | str = (), *,
        probe_input: str = "", probe_force_n: float | None = None, probe_beyond_mm: float = 5.0,
    ) -> tuple[str, ...]:  # fmt: skip
        """Write plan.json, next-motions.csv and next-motions.yaml; return their names.

        Programs, and options of probing, are of plans of contacts and are refused.
        """
        from bayescal.reporting.motion.fit import write_plan

        refuse("a plan of motions", MotionPlanResult.save, locals(), "self", "folder")
        return write_plan(self._new(), Path(folder), self.record)

    @property
    def motions(self) -> DataFrame:
        """The motions, by `id`."""
        return table(self.record["motions"], "id")

    _overview = motions

    def __repr__(self) -> str:
        return f"<{len(self.record['motions'])} motions to log after {self.record['dataset']['name']}>"


def plan_log(folder: Path) -> MotionPlanResult:
    """Plan the motions that a joint log lacks; see `bayescal.plan`."""
    from bayescal.logs import read_log
    from bayescal.preparing.next_motions import next_motions

    return MotionPlanResult(next_motions(read_log(folder)))


def fit_log(folder: Path, samples: int, seed: int, progress: Progress = silent) -> MotionFitResult:
    """Calibrate an arm from a joint log; see `bayescal.fit`."""
    from bayescal.motion.calibrate import calibrate

    return MotionFitResult(calibrate(noted_log(folder), samples, seed, progress))


def refuse(what: str, of: Callable[..., Any], given: Mapping[str, Any], *but: str) -> None:
    """Refuse arguments of a function that a joint log lacks: all `but` some, unless they are defaults.

    Names may be given as a sequence, or as a text with commas.
    """
    for name, parameter in signature(of).parameters.items():
        value, usual = given[name], parameter.default
        if isinstance(usual, tuple):
            value = (value if isinstance(value, str) else ",".join(value)).replace(" ", "")
            usual = ",".join(usual)
        if name not in but and value not in (usual, ""):
            flag = "--for" if name == "purpose" else f"--{name.replace('_', '-')}"
            raise BayescalError(f"{what} has no {flag}", flag, "leave it out")


def fitted_log(run: Any) -> MotionFitResult | MotionGapResult | None:
    """The calibration or diagnosis of a joint log that a result or run folder is; None of others."""
    if isinstance(run, MotionFitResult | MotionGapResult):
        return run
    if not isinstance(run, str | PathLike):
        return None
    from bayescal.logs import is_log

    if not (Path(run) / "arm.yaml").is_file() and not is_log(Path(run) / "dataset"):
        return None
    kind, content = run_record(Path(run), "gap", "fit")
    return (MotionGapResult if kind == "gap" else MotionFitResult)(folder=Path(run), content=content)


@dataclass(frozen=True, repr=False)
class TogetherResult(Result):
    """A session of contacts and a joint log, fitted together; `print` shows what each gains by the other.

    `record` is the content of fit.json.
    """

    data: Together | None = None

    def _contents(self) -> Json:
        from bayescal.reporting.motion.fit import together_record

        return together_record(self._new())

    def report(self, verbose: bool = False) -> RenderableType:
        """The summary, to be printed by a `rich.console.Console`; `verbose` adds all masses and centres."""
        from bayescal.reporting.motion.fit import together_summary

        return together_summary(self.record, verbose)

    def save(self, folder: str | PathLike[str], pictures: bool = True) -> tuple[str, ...]:
        """Write fit.json, and the run folders `contacts` and `log`; return their names."""
        from bayescal.reporting.motion.fit import write_together

        return write_together(self._new(), Path(folder), self.record, pictures)

    @property
    def contacts(self) -> FitResult:
        """The calibration by the contacts, with the masses of both."""
        return FitResult(self.data.contacts) if self.data else FitResult(**self._part("contacts"))

    @property
    def log(self) -> MotionFitResult:
        """The calibration by the joint log, with the masses of both."""
        return MotionFitResult(self.data.log) if self.data else MotionFitResult(**self._part("log"))

    def _part(self, name: str) -> dict[str, Any]:
        path = self._file(f"{name}/fit.json", "repeat the fit")
        return {"folder": path.parent, "content": read_record(path, "bayescal-fit/1", "repeat the fit")}

    @property
    def shared(self) -> DataFrame:
        """Parameters, by name: estimate and u, SI, by one measurement alone and by both."""
        entries = (
            {"name": p["name"], "unit": p["unit"], "source": p["source"]}
            | {f"{key}_{of}": p[of][key] for of in ("alone", "both") for key in ("estimate", "u")}
            for p in self.record["shared"]
        )
        return table(entries, "name")

    _overview = shared

    def __repr__(self) -> str:
        return f"<{self.record['session']} and the log {self.record['log']['name']}, fitted together>"
