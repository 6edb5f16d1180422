"""`python -m analysis.world.motion`: simulate joint logs and their ground truth."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Annotated

import typer


def main(
    out: Annotated[Path, typer.Argument(help="Folder to write: OUT/NNN and OUT/truth/NNN.json.")],
    logs: Annotated[int, typer.Option(min=1, help="Number of logs.")] = 48,
    seed: Annotated[int, typer.Option(min=0, help="Random seed: the same seed gives the same logs.")] = 1,
    kinds: Annotated[str, typer.Option(help="Kinds of logs, with commas.")] = "null,single,pair,outside",
    held_out: Annotated[bool, typer.Option("--held-out", help="With the reserved forms and causes.")] = False,
    causes: Annotated[str, typer.Option(help="Causes outside the list: development, reserved, third.")] = "",
    outside: Annotated[float, typer.Option(min=0, max=0.9, help="Share of logs with such a cause.")] = 0.25,
    first: Annotated[int, typer.Option(min=0, help="Number of the first log.")] = 0,
) -> None:
    """Simulate joint logs: files in the format of joint logs, and the ground truth beside them."""
    from analysis.world.motion.build import make
    from analysis.world.motion.mix import CAUSES, KINDS, block_of

    chosen = kinds.split(",")
    if unknown := [kind for kind in chosen if kind not in KINDS]:
        raise typer.BadParameter(f"{unknown[0]}: use {', '.join(KINDS)}", param_hint="--kinds")
    if causes not in ("", *CAUSES):
        raise typer.BadParameter(f"{causes}: use {', '.join(CAUSES)}", param_hint="--causes")
    if not block_of(chosen, outside):
        raise typer.BadParameter("no log is of these kinds: raise the share", param_hint="--outside")
    (out / "truth").mkdir(parents=True, exist_ok=True)
    for number in range(first, first + logs):
        made = make(seed, number, chosen, held_out, causes=causes, outside=outside)
        folder = out / f"{number:03d}"
        folder.mkdir(exist_ok=True)
        (folder / "dataset.yaml").write_text(made.texts["dataset.yaml"], encoding="utf-8")
        table = gzip.compress(made.texts["motion.csv"].encode(), 5, mtime=0)
        (folder / "motion.csv.gz").write_bytes(table)
        text = json.dumps(made.truth, allow_nan=False, indent=1) + "\n"
        (out / "truth" / f"{number:03d}.json").write_text(text, encoding="utf-8")
    typer.echo(f"{logs} logs in {out}")


if __name__ == "__main__":
    typer.run(main)
