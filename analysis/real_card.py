"""Card of the sessions of real arms: halves, transfer, and names found in halves, with target values.

``python -m analysis.real_card --real ../shared/data/real --out docs/real_card.md``

The records of `analysis.real_halves` and `analysis.real_names` are used, and made where they are missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from analysis import real_halves, real_names
from analysis.pages import published
from analysis.pages import table as markdown
from analysis.records import TOP, Record, real_arguments

MARKS = ("<!-- card: begin -->", "<!-- card: end -->")
NONE = "-"


class Figure(NamedTuple):
    """A line of the card: its value for some sessions' records, and whether it meets its target."""

    what: str
    wanted: str
    of: Callable[[Sequence[Record], Sequence[Record]], np.ndarray]  # of splits and of halves; values
    reached: Callable[[np.ndarray], bool]
    show: Callable[[np.ndarray], str]


def _chi2(*kinds: str) -> Callable[[Sequence[Record], Sequence[Record]], np.ndarray]:
    """Chi-squared per degree of freedom of the parameters, stated covariance, of each split of some kinds."""
    return lambda splits, halves: np.array([s["chi2"][1] for s in splits if s["kind"] in kinds])


def _inside(*kinds: str) -> Callable[[Sequence[Record], Sequence[Record]], np.ndarray]:
    """Share of the other half's residuals within their 95 % intervals, of each split of some kinds."""
    return lambda splits, halves: np.array([s["inside"][1] for s in splits if s["kind"] in kinds])


def _between(kind: str) -> Callable[[Sequence[Record], Sequence[Record]], np.ndarray]:
    """Share of the other half's residuals within their 95 % intervals with all names, of each half."""
    return lambda splits, halves: np.array(
        [h["inside"][1] for h in halves if real_names.kind_of(h) == kind and "inside" in h]
    )


def _better(splits: Sequence[Record], halves: Sequence[Record]) -> np.ndarray:
    """Whether each name above `SURE` improves the other half."""
    return np.array([real_names.improves(r, n) for r, n in real_names.sure(halves)], float)


def _again(splits: Sequence[Record], halves: Sequence[Record]) -> np.ndarray:
    """Whether the effect of each name above `SURE` is named in the other half too."""
    return np.array([bool(real_names.found_again(r, n, halves)) for r, n in real_names.sure(halves)], float)


def _mean(values: np.ndarray) -> str:
    return f"{np.mean(values):.3f} ({np.min(values):.2f} to {np.max(values):.2f})"


def _percent(values: np.ndarray) -> str:
    return f"{100 * np.mean(values):.1f} %"


def _share(values: np.ndarray) -> str:
    return f"{np.sum(values):.0f} of {len(values)}"


def _honest(values: np.ndarray) -> bool:
    """Whether a chi-square per degree of freedom is one in the mean."""
    return bool(0.7 <= np.mean(values) <= 1.3)


def _true(values: np.ndarray) -> bool:
    """Whether 95 % intervals hold what they state, in the mean."""
    return bool(0.92 <= np.mean(values) <= 0.98)


FIGURES = (
    Figure("random halves: chi2 / dof of parameters", "mean 0.7 to 1.3", _chi2("random"), _honest, _mean),
    Figure("halves in time: chi2 / dof", "mean 0.7 to 1.3", _chi2("time"), _honest, _mean),
    Figure("halves of the workspace: chi2 / dof", "mean 0.7 to 1.3", _chi2("workspace"), _honest, _mean),
    Figure("other random half within 95 % intervals", "92 to 98 %", _inside("random"), _true, _percent),
    Figure("other half in time within 95 % intervals", "92 to 98 %", _inside("time"), _true, _percent),
    Figure("other half of the workspace within 95 % intervals", "92 to 98 %", _inside("workspace"), _true,
           _percent),
    Figure("other random half within 95 % intervals, with all names", "92 to 98 %", _between("random"),
           _true, _percent),
    Figure("other half of the workspace within 95 % intervals, with all names", "92 to 98 %",
           _between("workspace"), _true, _percent),
    Figure("names with P > 0.95 that improve the other half", "at least 0.9", _better,
           lambda v: np.mean(v) >= 0.9, _share),
    Figure("names with P > 0.95 found in both halves", "", _again, lambda v: True, _share),
)  # fmt: skip


def card(sessions: Sequence[Record], halves: Sequence[Record]) -> str:
    """The card as a table, a column a session; a figure that is off target is bold.

    Parameters
    ----------
    sessions : sequence of Record
        Of `real_halves`.
    halves : sequence of Record
        Of `real_names`.
    """
    names = [s["session"] for s in sessions]
    parts = [(s["splits"], [h for h in halves if h["session"] == s["session"]]) for s in sessions]
    parts.append(([split for s in sessions for split in s["splits"]], list(halves)))
    rows = [(f.what, f.wanted or NONE, *(_cell(f, f.of(*part)) for part in parts)) for f in FIGURES]
    return markdown(("figure", "target", *names, "all"), rows)


def _cell(f: Figure, values: np.ndarray) -> str:
    if not len(values):
        return NONE
    return f.show(values) if f.reached(values) else f"**{f.show(values)}**"


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the records that are missing, and print the card."""
    parser = real_arguments("real_card", __doc__)
    parser.add_argument("--splits", type=int, default=1, help="random splits for names, at most 4")
    parser.add_argument("--workspace", action="store_true", help="names in halves of the workspace too")
    parser.set_defaults(runs=TOP / "runs")
    given = parser.parse_args(arguments)
    runs, workers, sessions = given.runs, given.workers, given.sessions
    splits = real_halves.found_in(given.real, runs / real_halves.RUNS.name, workers, sessions)
    in_names = runs / real_names.RUNS.name
    halves = real_names.found_in(given.real, given.splits, in_names, workers, sessions, given.workspace)
    published(card(splits, halves), given.out, MARKS, new=True)


if __name__ == "__main__":  # worker processes import this module too
    main()
