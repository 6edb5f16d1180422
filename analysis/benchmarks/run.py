"""Runs all comparisons on one problem, prints them and writes `bench.json`."""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from analysis.benchmarks import (
    effective,
    gap_speed,
    growth,
    kernel_speed,
    page,
    peer_emcee,
    peer_packages,
    peer_scipy,
    problem,
    whole,
)
from analysis.benchmarks.package_worker import PACKAGES
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


def _solver(given: problem.Problem, pythons: Mapping[str, Path]) -> list[Row]:
    s = peer_scipy.measure(given)
    ours = s["ours_s"]
    said = (
        f"{1e3 * s['scipy_s']:.0f} ms to the optimum ({1e3 * s['scipy_whole_s']:.0f} until it stops, "
        f"{s['scipy_steps']:.0f} steps) against {1e3 * ours:.2f} with covariance"
    )
    out: list[Row] = [("lm_vs_scipy_default", s["scipy_s"] / ours, said)]
    for name in PACKAGES:
        p = peer_packages.measure(given, name, pythons.get(name, peer_packages.python_of(name)))
        if p is None:
            out.append((f"lm_vs_{name}", None, f"no environment with {name}"))
            continue
        ours = min(s["ours_s"], peer_scipy.measure_ours(given))
        scaled = ", one Jacobian scaled by the steps" if p["scaled"] else ""
        said = f"{p['seconds']:.2f} s for {p['parameters']:.0f} parameters, {p['steps']:.0f} steps{scaled}"
        out.append((f"lm_vs_{name}", p["seconds"] / ours, f"{said}, against {1e3 * ours:.2f} ms"))
    return out


def _sampler(given: problem.Problem) -> tuple[list[Row], list[Row]]:
    """The ratios, and those that only explain them."""
    density = Density(given.estimate)
    begin = {"ours": partial(peer_emcee.ours, density), "stretch": partial(peer_emcee.stretch, density)}
    if importlib.util.find_spec("numpyro"):
        from analysis.benchmarks import peer_numpyro

        assert peer_numpyro.disagreement(given, density) < peer_numpyro.AGREEMENT, "not the same density"
        begin |= {
            "nuts": partial(peer_numpyro.nuts, given, density),
            "nuts_given": partial(peer_numpyro.nuts_given, given, density),
        }
    speed = effective.race(begin)

    def said(name: str) -> str:
        s = speed[name]
        return f"{s.per_second:.0f}/s (run of {s.taus:.0f} tau)"

    def row(ratio: str, name: str, note: str = "") -> Row:
        if name not in speed:
            return ratio, None, "NumPyro is not installed"
        value = speed["ours"].per_second / speed[name].per_second
        return ratio, value, f"{said('ours')} against {said(name)}{note}"

    def whole(ratio: str, name: str) -> Row:
        if name not in speed:
            return ratio, None, "NumPyro is not installed"
        ours, theirs = speed["ours"], speed[name]
        said = f"{ours.whole:.2f} s, of which {ours.ready:.2f} before the first draw"
        return ratio, theirs.whole / ours.whole, f"{said}, against {theirs.whole:.1f}, {theirs.ready:.1f}"

    rows = [
        row("ess_vs_stretch", "stretch"),
        whole("time_to_5000_vs_stretch", "stretch"),
        whole("time_to_5000_vs_numpyro_nuts", "nuts"),
        row("ess_vs_numpyro_nuts", "nuts", ", dense mass of its own warm-up, parameters over posterior sd"),
    ]
    return rows, [row("ess_vs_numpyro_nuts_given", "nuts_given", ", our linearised covariance as its mass")]


def measure(
    folder: Path, pythons: Mapping[str, Path], sizes: Sequence[int] = growth.CONTACTS
) -> tuple[dict[str, Any], list[Row]]:
    """The contents of `bench.json` and the rows of the table.

    Parameters
    ----------
    folder : Path
        The dataset of all ratios.
    pythons : mapping of str to Path
        A Python with each of `PACKAGES`; default: that of `.venv-NAME`.
    sizes : sequence of int
        Contacts of the sessions on which growth is measured.
    """
    given = problem.load(folder)
    rows = [*_kernel(given), *_solver(given, pythons)]
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
    costs = growth.measure(sizes)
    record["growth"] = growth.record(costs)
    for c in costs:
        name = f"{c.command}, {c.contacts} contacts, CPU s"
        rows.append((name, c.cpu_s if c.done else None, f"{c.peak_mb:.0f} MB at most"))
    rows += [
        (f"growth of {name}", value, f"exponent of CPU time from {growth.LEAST} contacts on")
        for name, value in growth.exponents(costs).items()
    ]
    rows.append(("fit_whole_process, s", fit, "second run of the whole command, 5000 samples"))
    rows.append(("gap_whole_process, s", gap, "second run of the whole command, pictures too"))
    rows.append(("gap_compute, s", g["compute_s"], f"{g['contacts']:.0f} contacts, after imports"))
    return record, rows


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m analysis.benchmarks", description=__doc__)
    parser.add_argument("--dataset", type=Path, default=TOP / DATASET)
    parser.add_argument("--out", type=Path, default=TOP / "bench.json")
    for name in PACKAGES:
        own = peer_packages.python_of(name)
        parser.add_argument(f"--{name}", type=Path, default=own, help=f"Python with {name}")
    parser.add_argument("--sizes", type=int, nargs="*", default=growth.CONTACTS, help="Contacts, for growth")
    parser.add_argument("--page", type=Path, default=TOP / "docs/benchmarks.md", help="The page to update")
    given = parser.parse_args()
    with threadpool_limits(1):
        record, rows = measure(given.dataset, {name: getattr(given, name) for name in PACKAGES}, given.sizes)
    title = f"{record['contacts']} contacts, {record['parameters']} parameters, one core"
    table = Table("ratio", "value", "raw numbers", title=title)
    for name, value, said in rows:
        table.add_row(name, "-" if value is None else f"{value:.3g}", said)
    Console(width=150).print(table)
    given.out.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    page.update(given.page, record)
