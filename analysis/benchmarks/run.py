"""Runs all comparisons on one problem, prints them and writes `bench.json`."""

from __future__ import annotations

import argparse
import importlib.util
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from analysis.benchmarks import (
    effective,
    gap_speed,
    kernel_speed,
    peer_emcee,
    peer_pybotics,
    peer_scipy,
    problem,
    whole,
)
from bayescal.posterior import Density

TOP = Path(__file__).parents[2]
DATASET = "data/lrmate200ic-cube"
Row = tuple[str, float | None, str]


def _kernel(given: problem.Problem) -> list[Row]:
    k = kernel_speed.measure(given)
    rate = k["flops_a_contact"] / k["value_ns"]
    core = k["dgemm_flops_a_second"] * 1e-9
    value, columns, numpy = k["value_one_ns"], k["columns_ns"], k["numpy_ns"]
    return [
        (
            "kernel_value_vs_dgemm",
            rate / core,
            f"{k['flops_a_contact']:.0f} flop in {k['value_ns']:.1f} ns a contact = {rate:.1f} Gflop/s, "
            f"dgemm {core:.1f}",
        ),
        (
            "kernel_jacobian_vs_value",
            (value + columns) / value,
            f"value {value:.1f} ns a contact, its {given.motion.size} derivatives {columns:.1f} more",
        ),
        ("kernel_value_vs_numpy", numpy / value, f"{numpy:.0f} ns a contact against {value:.1f}"),
    ]


def _solver(given: problem.Problem, python: Path) -> list[Row]:
    s = peer_scipy.measure(given)
    ours = s["ours_s"]
    said = (
        f"{1e3 * s['scipy_s']:.0f} ms to the optimum ({1e3 * s['scipy_whole_s']:.0f} until it stops, "
        f"{s['scipy_steps']:.0f} steps) against {1e3 * ours:.2f} with covariance"
    )
    out: list[Row] = [("lm_vs_scipy_default", s["scipy_s"] / ours, said)]
    p = peer_pybotics.measure(given, python)
    if p is None:
        return [*out, ("lm_vs_pybotics", None, "no environment with pybotics 3")]
    ours = min(ours, peer_scipy.measure_ours(given))
    scaled = ", one Jacobian scaled by the steps" if p["scaled"] else ""
    said = f"{p['pybotics_s']:.2f} s for {p['parameters']:.0f} parameters, {p['steps']:.0f} steps{scaled}"
    return [*out, ("lm_vs_pybotics", p["pybotics_s"] / ours, f"{said}, against {1e3 * ours:.2f} ms")]


def _sampler(given: problem.Problem) -> tuple[list[Row], list[Row]]:
    """The ratios, and those that only explain them."""
    density = Density(given.estimate)
    turns = {"ours": peer_emcee.ours(density), "stretch": peer_emcee.stretch(density)}
    if importlib.util.find_spec("numpyro"):
        from analysis.benchmarks import peer_numpyro

        turns |= {
            "nuts": peer_numpyro.nuts(given, density),
            "nuts_given": peer_numpyro.nuts_given(given, density),
        }
    speed = effective.race(turns)

    def said(name: str) -> str:
        s = speed[name]
        return f"{s.per_second:.0f}/s (run of {s.taus:.0f} tau)"

    def row(ratio: str, name: str, note: str = "") -> Row:
        if name not in speed:
            return ratio, None, "NumPyro is not installed"
        value = speed["ours"].per_second / speed[name].per_second
        return ratio, value, f"{said('ours')} against {said(name)}{note}"

    rows = [
        row("ess_vs_stretch", "stretch"),
        row("ess_vs_numpyro_nuts", "nuts", ", dense mass of its own warm-up, parameters over posterior sd"),
    ]
    return rows, [row("ess_vs_numpyro_nuts_given", "nuts_given", ", our linearised covariance as its mass")]


def measure(folder: Path, python: Path) -> tuple[dict[str, Any], list[Row]]:
    """The contents of `bench.json` and the rows of the table; `python` has pybotics 3."""
    given = problem.load(folder)
    rows = [*_kernel(given), *_solver(given, python)]
    samplers, aside = _sampler(given)
    rows += samplers
    fit = whole.second_run(folder)
    gap, g = whole.second_run(folder, whole.GAP), gap_speed.measure(folder)
    seconds = {"fit_whole_process": fit, "gap_whole_process": gap, "gap_compute": g["compute_s"]}
    long = f"{g['many_s']:.2f} s of computing for {g['many_contacts']:.0f} contacts"
    said = f"{long} against {g['compute_s']:.2f} s for {g['contacts']:.0f}, a contact"
    aside.append(("gap_compute_a_contact_of_many", g["ratio_a_contact"], said))
    record = {
        "schema": "bayescal-bench/1",
        "contacts": given.contacts,
        "parameters": given.model.size,
        "ratios": {name: ratio for name, ratio, _ in rows},
        "seconds": seconds,
        "raw": {name: said for name, _, said in rows}
        | {name: said if value is None else f"{value:.3g}: {said}" for name, value, said in aside},
    }
    rows += aside
    rows.append(("fit_whole_process, s", fit, "second run of the whole command, 5000 samples"))
    rows.append(("gap_whole_process, s", gap, "second run of the whole command, pictures too"))
    rows.append(("gap_compute, s", g["compute_s"], f"{g['contacts']:.0f} contacts, after imports"))
    return record, rows


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m analysis.benchmarks", description=__doc__)
    parser.add_argument("--dataset", type=Path, default=TOP / DATASET)
    parser.add_argument("--out", type=Path, default=TOP / "bench.json")
    parser.add_argument("--pybotics", type=Path, default=peer_pybotics.PYTHON, help="Python with pybotics 3")
    given = parser.parse_args()
    with threadpool_limits(1):
        record, rows = measure(given.dataset, given.pybotics)
    title = f"{record['contacts']} contacts, {record['parameters']} parameters, one core"
    table = Table("ratio", "value", "raw numbers", title=title)
    for name, value, said in rows:
        table.add_row(name, "-" if value is None else f"{value:.3g}", said)
    Console(width=150).print(table)
    given.out.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
