"""`bayescal plan`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.options import AllowXacro, Out, Seed
from bayescal.cli.output import run_folder, show
from bayescal.cli.progress import progress
from bayescal.cli.root import app, ending


@app.command(
    **ending(
        "bayescal plan cell --contacts 100 --to urscript",
        "bayescal plan cell --after runs/cell-gap --for gap --contacts 60",
    )
)
def plan(
    setup: Annotated[
        Path,
        typer.Argument(
            metavar="SETUP",
            help="Dataset folder; its dataset.yaml states robot, tools, targets and noise. Rows are ignored.",
        ),
    ],
    contacts: Annotated[int, typer.Option(help="Contacts to calibrate with, repeats included.")] = 200,
    purpose: Annotated[
        str, typer.Option("--for", help="distances, gap (effects that the model lacks), or both.")
    ] = "both",
    after: Annotated[
        Path | None,
        typer.Option(
            help="Continue a measured session: its dataset folder, or the run folder of its bayescal gap "
            "(SETUP is then the session), whose open questions the contacts decide."
        ),
    ] = None,
    levers: Annotated[
        str,
        typer.Option(
            help="What may be varied beside the pose, separated by commas: payload (the masses that "
            "`plan: {payload_kg}` of dataset.yaml lists), approach."
        ),
    ] = "payload,approach",
    model: Annotated[
        str,
        typer.Option(
            help="Effects of the model, separated by commas [default: geometry,compliance, or the model of "
            "the diagnosis]."
        ),
    ] = "",
    validation: Annotated[
        bool, typer.Option(help="Add contacts that validate spheres of certified distances.")
    ] = True,
    order: Annotated[
        str, typer.Option(help="sweeps (each visits all targets), shortest, or random.")
    ] = "sweeps",
    candidates: Annotated[int, typer.Option(help="Possible contacts among which is chosen.")] = 5000,
    seed: Seed = 0,
    to: Annotated[
        list[str] | None,
        typer.Option(
            help="For the controller: a probing program (urscript, fanuc, kuka, abb; none has been run on a "
            "controller) or a table (csv, robodk, poses); repeatable."
        ),
    ] = None,
    probe_input: Annotated[
        str,
        typer.Option(
            help="Digital input that the probe switches, as the controller names it: 0, tool:0 (UR, FANUC), "
            "measure:1 (KUKA), a signal (ABB) [default: 0, 1, 1, diProbe]."
        ),
    ] = "",
    probe_force_n: Annotated[
        float | None,
        typer.Option(
            help="Change of the force at the tool, N, that is a contact, in place of an input (UR)."
        ),
    ] = None,
    probe_beyond_mm: Annotated[
        float,
        typer.Option(help="How far beyond the expected surface a program searches before it stops."),
    ] = 5.0,
    out: Out = None,
    allow_xacro: AllowXacro = False,
) -> None:
    """Choose the contacts to measure, and predict the uncertainty that they give."""
    from bayescal.programs.probing import Probe, formats_of
    from bayescal.public.planning import plan as work

    formats = formats_of(to or [], Probe(probe_input, probe_force_n, 1e-3 * probe_beyond_mm))
    with run_folder(out, [setup], "plan") as folder, progress("candidates") as notify:
        result = work(
            setup,
            contacts,
            purpose,
            model,
            after=after,
            levers=levers,
            order=order,
            validation=validation,
            candidates=candidates,
            seed=seed,
            allow_xacro=allow_xacro,
            progress=notify,
        )
        notify("write", 0.0)
        written = result.save(
            folder,
            [form.name for form in formats],
            probe_input=probe_input,
            probe_force_n=probe_force_n,
            probe_beyond_mm=probe_beyond_mm,
        )
    show(result.report(), folder, written)
