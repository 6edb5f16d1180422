"""The public functions. Each takes a dataset as it is read, its folder, or a simulated session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import BayescalError, attempted
from bayescal.public import ComparisonResult, FitResult, GapResult, SimulatedSession, motions
from bayescal.public.arms import names
from bayescal.storage.stopping import Progress, silent

if TYPE_CHECKING:
    from bayescal.dataset import Dataset

    Source = Dataset | SimulatedSession | str | PathLike[str]

MODEL = ("geometry", "compliance")  # `effects.BASELINE`, which takes long to import
OF_LOG = ("dataset", "progress", "checkpoint", "say")
"""Arguments that a joint log has as well, whatever it is used for."""
PRACTICE = ("name", "error_scale", "contacts", "later", "repeats", "arm_seed")
"""Options of a simulated session of a set-up, beside the effects and the seed."""


def read_dataset(folder: str | PathLike[str], allow_xacro: bool = False) -> Dataset:
    """Read a dataset folder.

    Parameters
    ----------
    folder : path
        With dataset.yaml, measurements.csv and, where it is not built in, the robot.
    allow_xacro : bool
        Expand a robot that is given as xacro, which can read files and run programs.

    Returns
    -------
    Dataset
        Frozen, in SI: m, rad, kg, s, degC.

    Raises
    ------
    BayescalError
        With the file, the line and the remedy, if the folder does not follow the contract.

    Examples
    --------
    >>> import tempfile
    >>> import bayescal as bc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     names = bc.simulate(contacts=40, later=4, repeats=2, spheres=0).save(f"{folder}/session")
    ...     dataset = bc.read_dataset(f"{folder}/session")
    >>> dataset.robot.name, dataset.measurements.readings.shape
    ('fanuc-lrmate200ic', (44, 6))
    """
    from bayescal.dataset import read_dataset as read
    from bayescal.dataset.read import expanded_robot

    return read(Path(folder), robot=expanded_robot(Path(folder)) if allow_xacro else None)


def fit(
    dataset: Source | Sequence[Source], model: Sequence[str] | str = (), samples: int = 5000, seed: int = 0,
    *, robust: bool = True, prior_width: float = 1.0, latent_joints: bool = False, remounted: bool = False,
    tolerance_mm: float | None = None, without: Sequence[str] | str = (), allow_xacro: bool = False,
    progress: Progress = silent, checkpoint: str | PathLike[str] | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> FitResult | motions.MotionFitResult | motions.TogetherResult:  # fmt: skip
    """Calibrate an arm: its parameters with their uncertainty, and the error to expect.

    Parameters
    ----------
    dataset : Dataset, SimulatedSession or path, or a sequence of them
        Several are sessions of one arm and are fitted together; one of them may be a joint log of it.
    model : sequence of str, or str
        Names of effects, comma separated if in one string; see `bayescal.effects.names`. A name may state a
        setting, sites and priors: 'backlash at joint 3', 'step@212', 'hysteresis at joint 2 x4'. By default
        'geometry,compliance', or 'geometry' if the session lacks what compliance needs.
    samples : int
        Effective posterior draws of every parameter; 0: Gaussian approximation.
    seed : int
        The same seed gives the same result.
    robust : bool
        Exclude outliers.
    prior_width : float
        Factor on the standard deviations of the arm's prior.
    latent_joints : bool
        Keep the joint readings as unknowns.
    remounted : bool
        Of several sessions: the tools were remounted in between.
    tolerance_mm : float, optional
        mm; decide whether distance errors are within it (ISO 14253-1).
    without : sequence of str, or str
        Parts of the effects that stay nominal: 'geometry at joint 4'; comma separated if in one string.
    allow_xacro : bool
        As of `read_dataset`, where `dataset` is a path.
    progress : callable
        Called with the stage and its completed fraction.
    checkpoint : path, optional
        File for the state of a long sampling. If the run is interrupted, the same call continues it, with
        the same draws. It may be removed when the result is saved.
    say : callable
        Called with a text, if a checkpoint is used or cannot be.

    Returns
    -------
    FitResult, MotionFitResult of a joint log, or TogetherResult of sessions and a log
        Prints as a summary; `parameters`, `levels` and `distances` are tables.

    Raises
    ------
    BayescalError
        If the session cannot be fitted, with the reason.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(contacts=80, later=8, repeats=5, spheres=0, seed=1)
    >>> result = bc.fit(session, samples=0)
    >>> list(result.parameters.columns[:6])
    ['effect', 'unit', 'nominal', 'estimate', 'u', 'prior_sd']
    >>> bool(result.parameters.loc["a2", "u"] < result.parameters.loc["a2", "prior_sd"])
    True
    """
    from bayescal import calibration
    from bayescal.assess.agreement import agreement
    from bayescal.model.options import FitOptions

    others, logs = motions.divided(dataset)
    if (folder := motions.log_of(logs)) is not None and not others:
        motions.refuse("the calibration from a joint log", fit, locals(), *OF_LOG, "samples", "seed")
        return motions.fit_log(folder, samples, seed, progress)
    session = session_of(others, remounted, True, allow_xacro)
    effects = names(model) or calibration.usual_model(session)
    tolerance = None if tolerance_mm is None else 1e-3 * tolerance_mm
    options = FitOptions((), robust, prior_width, seed, latent_joints, tolerance)
    kept = None
    if checkpoint is not None and samples:
        from bayescal.posterior.checkpoint import Checkpoint  # and emcee with it

        kept = Checkpoint(Path(checkpoint), say)
    if folder is not None:
        from bayescal.motion.together import fit_together

        return motions.TogetherResult(
            fit_together(
                session, motions.noted_log(folder), effects, options, without=names(without), samples=samples,
                progress=progress, checkpoint=kept,
            )
        )  # fmt: skip
    fitted = calibration.fit(
        session, effects, options, without=names(without), samples=samples, progress=progress, checkpoint=kept
    )
    if not session.sessions:
        return FitResult(fitted)
    progress("compare", 0.0)
    return FitResult(fitted, agreement(fitted.final.estimate, effects, fitted.options))


def diagnose(
    dataset: Source | Sequence[Source], model: Sequence[str] | str = (), seed: int = 0, *,
    without: Sequence[str] | str = (), robust: bool = True, prior_width: float = 1.0, remounted: bool = False,
    allow_xacro: bool = False, progress: Progress = silent,
) -> GapResult | motions.MotionGapResult:  # fmt: skip
    """Diagnose the difference between model and machine: size, location, effect, improvement.

    Parameters
    ----------
    dataset, model, seed, robust, prior_width, remounted, allow_xacro, progress
        As of `fit`; a joint log has neither model nor options.
    without : sequence of str, or str
        Parts of the effects that the model lacks and that are candidates: 'geometry at joint 4'; comma
        separated if in one string.

    Returns
    -------
    GapResult, or MotionGapResult of a joint log
        Prints as a summary; `probability`, `where` and `shrinkage` are tables.

    Raises
    ------
    BayescalError
        If the session cannot be fitted, or the model has no such part, with the reason.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(effects="geometry", contacts=60, later=8, repeats=5, spheres=0, seed=1)
    >>> gap = bc.diagnose(session, "geometry")
    >>> gap.verdict in ("null", "named", "named+unexplained", "class", "unknown", "ambiguous")
    True
    """
    from bayescal.assess.agreement import agreement
    from bayescal.calibration import usual_model
    from bayescal.estimate import calibrated
    from bayescal.gap.diagnose import diagnose as run
    from bayescal.model.options import FitOptions
    from bayescal.model.scene import Scene

    if (folder := motions.log_of(dataset)) is not None:
        motions.refuse("the diagnosis of a joint log", diagnose, locals(), *OF_LOG)
        return motions.diagnose_log(folder, progress)
    # the sessions share a noise scale, so that their residuals are comparable
    session = session_of(dataset, remounted, False, allow_xacro)
    effects = names(model) or usual_model(session)
    options = FitOptions(robust=robust, prior_width=prior_width, seed=seed)
    diagnosis = run(session, effects, options, without=names(without), progress=progress)
    if not session.sessions:
        return GapResult(diagnosis)
    progress("compare", 0.0)
    lost, of_all = list[str](), diagnosis.options
    compared = attempted(
        "the agreement of the sessions",
        lambda: agreement(calibrated(Scene(session), effects, of_all), effects, of_all),
        None,
        lost,
    )
    return GapResult(replace(diagnosis, warnings=(*diagnosis.warnings, *lost)), compared)


def simulate(
    robot: str = "fanuc-lrmate200ic", effects: Sequence[str] | str = MODEL, *, seed: int = 0,
    allow_xacro: bool = False, setup: str | PathLike[str] | None = None, **options: Any,
) -> SimulatedSession:  # fmt: skip
    """Simulate a session on a cube and spheres, or a practice session of a set-up, in memory.

    Parameters
    ----------
    robot : str
        A built-in name (`bayescal.robots.names`) or a unique part of it, or the path of a robot file.
    effects : sequence of str, or str
        Effects of the true arm.
    seed : int
        The same seed gives the same session.
    allow_xacro : bool
        Expand a robot that is given as xacro, which can read files and run programs.
    setup : path, optional
        Folder of a set-up, as `init` writes it: its robot, tools, targets and noise are simulated, with
        values that are not filled in as they stand. `PRACTICE` lists the options that apply; `robot` does
        not.
    **options
        Any other field of `bayescal.simulation.Options`: `contacts` to calibrate with, `later` to validate,
        `spheres`, `noise` (m), `joint_noise` (rad), `payload` (kg), ...

    Returns
    -------
    SimulatedSession
        Its `dataset` is the simulated measurement, `truth` the ground truth.

    Raises
    ------
    BayescalError
        For invalid options, or targets out of reach.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(effects="geometry, compliance, backlash", contacts=40, repeats=2, spheres=0)
    >>> session
    <simulated session simulated: 100 rows>
    """
    from bayescal import simulation
    from bayescal.dataset.read import expanded_robot
    from bayescal.robots import full_name, is_xacro, load_robot

    valid = [f.name for f in fields(simulation.Options)]
    if unknown := [name for name in options if name not in valid]:
        what = f"there is no option {', '.join(unknown)}"
        raise BayescalError(what, "simulate", f"known: {', '.join(valid)}")
    if setup is not None:
        from bayescal.planning.setup import read_setup
        from bayescal.preparing.practice import practice

        if excess := [name for name in options if name not in PRACTICE]:
            what = f"a set-up states {', '.join(excess)} itself"
            raise BayescalError(what, "simulate", f"options with a set-up: {', '.join(PRACTICE)}")
        asked = simulation.Options(effects=names(effects), seed=seed, **options)
        expanded = expanded_robot(Path(setup)) if allow_xacro else None
        return SimulatedSession(practice(read_setup(Path(setup), expanded), asked))
    asked = simulation.Options(robot=full_name(robot), effects=names(effects), seed=seed, **options)
    arm = load_robot(robot, allow_xacro=True)[0] if allow_xacro and is_xacro(robot) else None
    return SimulatedSession(simulation.simulate(asked, arm))


def compare(
    dataset: Source, model: Sequence[str] | str = (), seed: int = 0, *, allow_xacro: bool = False,
    progress: Progress = silent,
) -> ComparisonResult:  # fmt: skip
    """Calibrate a session by every method, and compare the results on the same validation measurements.

    Parameters
    ----------
    dataset, model, seed, allow_xacro, progress
        As of `fit`.

    Returns
    -------
    ComparisonResult
        Prints as a table.

    Raises
    ------
    BayescalError
        If the session cannot be fitted by any method.

    Examples
    --------
    >>> import bayescal as bc
    >>> session = bc.simulate(effects="geometry", contacts=60, later=8, repeats=5, spheres=0, seed=1)
    >>> len(bc.compare(session, "geometry").record["methods"]) > 3
    True
    """
    from bayescal.calibration import usual_model
    from bayescal.methods import compare as run

    session = session_of(dataset, allow_xacro=allow_xacro)
    return ComparisonResult(run(session, names(model) or usual_model(session), seed, progress=progress))


def session_of(
    source: Source | Sequence[Source], remounted: bool = False, own_noise: bool = True,
    allow_xacro: bool = False,
) -> Dataset:  # fmt: skip
    """A single session, or several sessions of the same arm joined (`dataset.join`)."""
    from bayescal.dataset import Dataset
    from bayescal.dataset.join import joined

    each = source if isinstance(source, list | tuple) else (source,)
    read: list[Dataset] = []
    for one in each:
        if isinstance(one, Dataset):
            read.append(one)
        elif isinstance(one, SimulatedSession):
            read.append(one.dataset)
        elif isinstance(one, str | PathLike):
            read.append(read_dataset(one, allow_xacro))
        else:
            what = f"{type(one).__name__} is no dataset"
            raise BayescalError(what, "dataset", "give a Dataset, a simulated session or a path")
    return joined(read, remounted, own_noise)
