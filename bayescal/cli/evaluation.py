"""Commands that compute: `fit`, `gap`, `compare`, `plan`, `watch`, `fleet`, `changed`, `history`."""

import shlex
from functools import partial
from pathlib import Path
from typing import Any

import typer

from bayescal.cli.root import carried_out, command, progress, run_folder, said, show
from bayescal.errors import BayescalError
from bayescal.public import console, drawing_beside, functions, planning, watching
from bayescal.public.motions import MotionFitResult


@command(
    "bayescal fit cell",
    "bayescal fit monday tuesday --model geometry,compliance,backlash --tolerance-mm 0.1",
    calls=functions.fit,
)
def fit(
    datasets: list[Path] = typer.Argument(metavar="DATASET..."),
    samples: int = typer.Option(5000, min=0),
    out: Path | None = None,
    pictures: bool = True,
    verbose: bool = typer.Option(False, "--verbose", "-v"),
    **options: Any,
) -> None:
    """Calibrate an arm: its parameters with uncertainty, and the expected distance error in its workspace.

    Parameters
    ----------
    datasets
        Dataset folder with dataset.yaml, measurements.csv and the robot. Several sessions of the same arm are
        evaluated together; of `fit` one of them may be a joint log of it.
    model
        Effects of the calibrated model, separated by commas, each at all its sites or 'at joint 3' [default:
        geometry,compliance; geometry if the robot file states no masses].
    samples
        Effective draws of every parameter; 0: Gaussian approximation.
    without
        Parts of these effects that stay nominal, separated by commas: 'geometry at joint 4' (theta4, d4, and
        a4, alpha4, beta4 of the next link), 'geometry at link 4', or names of parameters: 'compliance J3'. A
        diagnosis takes them for candidates.
    seed
        Random seed.
    out
        Run folder to write [default: runs/<dataset>-<command>; several names are joined by +].
    robust
        Exclude outliers.
    prior_width
        Factor on the standard deviations of the arm's prior.
    latent_joints
        Estimate the errors of the joint readings as unknowns.
    remounted
        The tools were remounted between the sessions.
    allow_xacro
        Execute a robot's xacro file: it is a program.
    tolerance_mm
        Decide whether distance errors are within this tolerance (ISO 14253-1 with U = k u).
    pictures
        Write fit-levels.png, -distances, -residuals, -parameters and -posterior.
    verbose
        Print all distances, all parameters, weak directions and the sampler.
    """
    from bayescal.storage.locks import CHECKPOINT, checkpoint_of, remove

    with run_folder(out, datasets, "fit") as folder, drawing_beside(pictures), progress() as notify:
        kept = checkpoint_of(folder)
        options |= {"samples": samples, "progress": notify, "checkpoint": kept, "say": notify.say}
        result = functions.fit(datasets, **options)
        notify("write", 0.0)
        written = result.save(folder, pictures)
        if samples:
            remove(kept, CHECKPOINT)
    show(result.report(verbose), folder, written)
    if isinstance(result, MotionFitResult):
        said(console(), "next", f"bayescal gap {shlex.quote(str(datasets[0]))}")
    of_contacts = getattr(result, "contacts", result)
    draws = getattr(of_contacts.data, "draws", None) if of_contacts.record.get("unit") is None else None
    if draws is not None and not draws.converged:
        what = f"the sampler did not converge: {draws.complaint}"
        raise BayescalError(what, "--samples", "see fit.json")


@command(
    "bayescal gap cell", "bayescal gap cell --without 'compliance at joint 3' --out runs/cell-stiff-wrist"
)
def gap(
    datasets: list[Path] = typer.Argument(metavar="DATASET..."),
    out: Path | None = None,
    pictures: bool = True,
    **options: Any,
) -> None:
    """Diagnose the difference between model and machine: size, location, effect, improvement.

    Parameters
    ----------
    datasets, model, without, seed, out, robust, prior_width, remounted
        As of `fit`.
    pictures
        Write gap-where.png, -which, -levels and -residuals.
    allow_xacro
        As of `fit`.
    """
    work = partial(functions.diagnose, datasets, **options)
    result, folder = carried_out(work, out, datasets, "gap", pictures=pictures)
    if result.undecided and len(datasets) == 1:
        count = [] if result.record.get("images") else ["--contacts", "60"]
        words = shlex.join([str(datasets[0]), "--after", str(folder), "--for", "gap", *count])
        typer.echo(f"to discriminate  bayescal plan {words}")


@command(
    "bayescal compare data/lrmate200ic-cube",
    "bayescal compare cell --model geometry --out runs/cell-geometry",
)
def compare(dataset: Path = typer.Argument(), out: Path | None = None, **options: Any) -> None:
    """Calibrate by several published methods, and compare their errors on the same validation data.

    Parameters
    ----------
    dataset
        Dataset folder: dataset.yaml, measurements.csv and the robot.
    model, seed, out, allow_xacro
        As of `fit`.
    """
    carried_out(partial(functions.compare, dataset, **options), out, [dataset], "compare", "compare")


@command(
    "bayescal plan cell --contacts 100 --to urscript",
    "bayescal plan cell --after runs/cell-gap --for gap --contacts 60",
    calls=planning.plan,
)
def plan(
    setup: Path = typer.Argument(metavar="SETUP"),
    for_: str = "both",
    after: Path | None = None,
    to: list[str] | None = None,
    probe_input: str = "",
    probe_force_n: float | None = None,
    probe_beyond_mm: float = 5.0,
    out: Path | None = None,
    **options: Any,
) -> None:
    """Choose the contacts to measure, and predict the uncertainty that they give; of a joint log, motions.

    Parameters
    ----------
    setup
        Dataset folder; its dataset.yaml states robot, tools, targets and noise. Rows are ignored. Of a joint
        log the motions are planned that it lacks.
    contacts
        Contacts, or images, to calibrate with, repeats included [default: 200; of cameras 33 images].
    for_
        distances, gap (effects that the model lacks), or both.
    after
        Continue a measured session: its dataset folder, or the run folder of its bayescal gap (SETUP is then
        the session), whose open questions the contacts decide.
    levers
        What may be varied beside the pose, separated by commas: payload (the masses that
        `plan: {payload_kg}` of dataset.yaml lists), approach.
    model
        Effects of the model, separated by commas [default: geometry,compliance, or the model of the
        diagnosis].
    validation
        Add contacts that validate spheres of certified distances.
    order
        sweeps (each visits all targets), shortest, or random.
    candidates
        Possible contacts among which is chosen.
    seed
        As of `fit`.
    to
        For the controller: a probing program (urscript, fanuc, kuka, abb; none has been run on a controller)
        or a table (csv, robodk, poses); repeatable.
    probe_input
        Digital input that the probe switches, as the controller names it: 0, tool:0 (UR, FANUC), measure:1
        (KUKA), a signal (ABB) [default: 0, 1, 1, diProbe].
    probe_force_n
        Change of the force at the tool, N, that is a contact, in place of an input (UR).
    probe_beyond_mm
        How far beyond the expected surface a program searches before it stops.
    out, allow_xacro
        As of `fit`.
    """
    from bayescal.programs.probing import Probe, formats_of

    probe: dict[str, Any] = {"probe_input": probe_input, "probe_force_n": probe_force_n}
    probe["probe_beyond_mm"] = probe_beyond_mm
    formats = formats_of(to or [], Probe(probe_input, probe_force_n, 1e-3 * probe_beyond_mm))
    names = [form.name for form in formats]
    work = partial(planning.plan, setup, purpose=for_, after=after, to=names, **options)
    carried_out(work, out, [setup], "plan", "candidates", to=names, **probe)


@command(
    "bayescal watch cell --plan runs/cell-plan",
    "bayescal watch cell --enough-um 60 --idle-s 300",
    calls=watching.watch,
)
def watch(
    dataset: Path = typer.Argument(metavar="DATASET"),
    plan: Path | None = None,
    out: Path | None = None,
    pictures: bool = True,
    **options: Any,
) -> None:
    """Watch a session while it is measured: judge each contact, state U so far, and say when it is enough.

    The table of the session grows while it is probed. A contact that the others contradict is set aside at
    once, and should be measured again. The run folder is that of `bayescal fit --samples 0` of all rows.

    Parameters
    ----------
    dataset
        Dataset folder of the session; its measurements.csv may not exist yet.
    model
        As of `fit`.
    enough_um
        End when U of a distance in the probed workspace is not larger than this, µm.
    plan
        Run folder of bayescal plan: end when its contacts are measured, or when its U is reached.
    idle_s
        End after this time without a new row, s.
    seed
        As of `fit`.
    out
        Run folder to write [default: runs/<dataset>-fit].
    robust, prior_width
        As of `fit`.
    pictures
        Write watch.png and the figures of fit.
    """
    terminal = console()
    with run_folder(out, [dataset], "fit") as folder:
        options |= {"say": lambda event: terminal.print(watching.words(event), soft_wrap=True)}
        result = watching.watch(dataset, plan=plan, **options)
        written = result.save(folder, pictures)
    show(result.report(), folder, written)


@command(
    "bayescal fleet arms/* --workers 4 --out runs/line-3",
    "bayescal fleet arms/* --arm '^(r[0-9]+)-' --dask tcp://head:8786",
)
def fleet(
    sessions: list[Path] = typer.Argument(metavar="SESSIONS..."),
    workers: int | None = None,
    dask: str | None = None,
    out: Path = Path("runs/fleet"),
    **options: Any,
) -> None:
    """Fit and diagnose many sessions, compare their arms, and learn the prior of a further arm.

    Parameters
    ----------
    sessions
        Dataset folders, or folders of them. A session that fails does not stop the others.
    arm
        Which sessions are of one arm: a regular expression for the names of the folders (its first group, or
        all), or a CSV file with the columns session and arm [default: serial number of the arm, or else the
        name of the dataset].
    workers
        Processes on this machine [default: one for each processor].
    dask
        Use the workers of this Dask scheduler instead, tcp://HOST:PORT (bayescal[dask]); they must see the
        same folders.
    model, without, seed
        As of `fit`.
    out
        Folder of the fleet. The same command computes what is missing in it, and what has another dataset or
        other options.
    robust, prior_width, allow_xacro
        As of `fit`.
    """
    from bayescal.public.fleet import fleet as run

    with progress("fit") as notify:
        result = run(sessions, out, workers=workers, dask=dask, progress=notify, say=notify.say, **options)
    show(result.report(), out, result.written)


@command(
    "bayescal changed monday friday",
    "bayescal changed before-crash after-crash after-repair --at targets.csv --remounted",
)
def changed(
    datasets: list[Path] = typer.Argument(metavar="BEFORE AFTER [MORE]..."),
    model: str = "geometry,compliance",
    at: Path | None = typer.Option(None, metavar="TARGETS"),
    out: Path | None = None,
    **options: Any,
) -> None:
    """What changed between sessions of one arm: parameters and effects, by how much, and what it does.

    Parameters
    ----------
    datasets
        Dataset folders of one arm in the order of time. Targets of the same name and description are
        compared.
    model
        Effects that all sessions have, separated by commas.
    at
        Table of targets, as `compensate` reads it: the displacement of the TCP there.
    remounted, robust, out, allow_xacro
        As of `fit`.
    """
    from bayescal.public.changes import changed as run

    carried_out(partial(run, datasets, model, at=at, **options), out, datasets, "changed")


@command("bayescal history runs/arm-7", "bayescal history runs/arm-7 --limit-mm 0.1")
def history(
    folder: Path = typer.Argument(metavar="ARM"),
    limit_mm: float | None = typer.Option(None, min=0.0),
    out: Path | None = None,
    **options: Any,
) -> None:
    """The parameters of an arm over its sessions: trends, steps, and when to calibrate again.

    Parameters
    ----------
    folder
        Folder with run folders of fit or gap of one arm.
    order
        Names of the run folders in the order of time, separated by commas [default: by the dates that the
        datasets record, or by the names of the run folders].
    limit_mm
        RMS error of distances at which the arm is to be calibrated again: when the drift reaches it.
    out
        As of `fit`.
    """
    from bayescal.public.changes import history as run

    carried_out(partial(run, folder, limit_mm=limit_mm, **options), out, [folder], "history", "read")
