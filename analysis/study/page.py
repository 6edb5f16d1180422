"""The study's table as Markdown, and a page that holds it between two marks."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from analysis.pages import between
from analysis.pages import table as markdown
from analysis.study.pictures import NAMES
from analysis.study.session import LEVELS

BEGIN, END = "<!-- study: begin -->", "<!-- study: end -->"
FOLDER = "pictures"


def _span(pair: Sequence[float], digits: int = 3) -> str:
    return f"{pair[0]:.{digits}f} to {pair[1]:.{digits}f}"


def _percent(pair: Sequence[float]) -> str:
    return f"{100 * pair[0]:.1f} to {100 * pair[1]:.1f} %"


def table(found: dict[str, Any]) -> str:
    """The figures as Markdown tables."""
    z = found["z_scores"]
    free = z["independent"]
    sds = [q["sd"] for q in z["by_quantity"].values()]
    rows = [
        ("z-scores, pooled: mean", f"{z['mean']:+.3f}", _span(z["mean_band95"]), "0"),
        ("z-scores, pooled: standard deviation", f"{z['sd']:.3f}", _span(z["sd_band95"]), "1"),
        (
            f"minimum and maximum standard deviation of {len(sds)} quantities",
            f"{min(sds):.2f}, {max(sds):.2f}",
            "",
            f"each within {_span(z['expected_sd_of_one95'], 2)}, one in twenty beyond",
        ),
        ("Kolmogorov-Smirnov, decorrelated scores", f"p = {free['ks_p_value']:.2f}", "", "uniform p"),
        (
            "Kolmogorov-Smirnov by quantity, minimum p times their number",
            f"{z['least_ks_p_value_times_quantities']:.2f}",
            "",
            "not small",
        ),
    ]
    for name, c in found["coverage"].items():
        expected = f"95 %; {_percent(c['binomial95_if_independent'])} of {c['count']} independent ones"
        inside = f"{100 * c['inside']:.1f} %"
        rows.append((f"coverage of 95 % intervals: {name}", inside, _percent(c["band95"]), expected))
    figures = markdown(("", "result", "95 % band over sessions", "expected"), rows)
    return "\n\n".join((figures, _errors(found), _remarks(found)))


def _errors(found: dict[str, Any]) -> str:
    rows = []
    for level in LEVELS:
        s, published = found["maximum_distance_mm"][level], found["published_maximum_distance_mm"].get(level)
        said = "" if published is None else f"{published:.3f}"
        rows.append((level, *(f"{s[key]:.3f}" for key in ("median", "least", "most")), said))
    heads = ("maximum distance error of a session, mm", f"median of {found['sessions']}")
    return markdown((*heads, "minimum", "maximum", "arm of Joubair and Bonev"), rows)


def _remarks(found: dict[str, Any]) -> str:
    sd, rejected = found["predicted_sd_um"]["distance"], found["rejected_of_fitted"][LEVELS[-1]]
    least = min(found["identified"], key=found["identified"].get)
    said = [
        f"{found['sessions']} sessions of {found['contacts']} plane contacts each.",
        f"All {len(found['identified'])} quantities are identifiable: "
        f"for the least identifiable, {least}, at most "
        f"{100 * (1 - found['identified'][least]):.1f} % of the prior variance remains in any session.",
        f"Predicted standard deviation of a sphere distance: {sd['median']:.1f} µm "
        f"({sd['least']:.1f} to {sd['most']:.1f}).",
        f"Contacts rejected without being outliers: {rejected} of {found['sessions'] * found['contacts']}.",
        f"Sessions with a false alarm: {found['false_alarms']['uneven_face']} for an uneven face, "
        f"{found['false_alarms']['unexplained_error']} for an unexplained error.",
    ]
    if found["refused"]:
        said.append(f"Seeds whose session could not be laid out: {found['refused']}.")
    if found["emcee"]:
        every = found["emcee"]
        shift = max(e["largest_shift_over_sd"] for e in every)
        low, high = (f(r for e in every for r in e["sd_ratio"]) for f in (min, max))
        d_low, d_high = (f(r for e in every for r in e["distance_sd_ratio"]) for f in (min, max))
        said.append(
            f"emcee on {len(every)} of them: means within {shift:.2f} standard "
            f"deviations of the Gaussian approximation, standard "
            f"deviations {low:.2f} to {high:.2f} times those of the "
            f"approximation (of a predicted distance {d_low:.2f} to "
            f"{d_high:.2f}), at least {min(e['least_ess'] for e in every):.0f} effective draws, R-hat up to "
            f"{max(e['largest_rhat'] for e in every):.4f}."
        )
    return "\n".join(f"- {line}" for line in said)


def update(path: Path, found: dict[str, Any], drawn: Path) -> None:
    """Renew the table of a page between its marks, and the pictures in the folder beside it."""
    between(path, (BEGIN, END), table(found))
    (path.parent / FOLDER).mkdir(exist_ok=True)
    for name in NAMES:
        shutil.copyfile(drawn / name, path.parent / FOLDER / name)
