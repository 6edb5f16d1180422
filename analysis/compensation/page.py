"""The page of the study: a table of sessions, pooled figures and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from analysis.compensation.session import COUNT, Level, Session
from analysis.pages import table
from bayescal.statistics import rms

PICTURE = "pictures/compensation.png"
UM = 1e6
HEADS = (
    "session", "hidden effects", "nominal RMS", "nominal max", "compensated max, baseline model",
    "compensated max, with effect", "predicted max: median (95 %)", "RMS over predicted",
)  # fmt: skip


def largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values)))


def usual(sessions: Sequence[Session]) -> list[Level]:
    """The model of each session that has what is hidden in it."""
    return [s.levels[-1] for s in sessions]


def draw(sessions: Sequence[Session], path: Path) -> None:
    """Maximum distance error of each session, nominal and compensated, over the predicted maximum."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.4), constrained_layout=True)
    levels = usual(sessions)
    predicted = UM * np.array([level.maximum[0] for level in levels])
    high = UM * np.array([level.maximum[1] for level in levels])
    left = UM * np.array([largest(level.left) for level in levels])
    nominal = UM * np.array([largest(level.nominal) for level in levels])
    hidden = np.array([bool(s.hidden) for s in sessions])
    axes.loglog(predicted, nominal, "s", color="0.6", label="nominal targets")
    axes.loglog(
        predicted[~hidden], left[~hidden], "o", color="C0", label="compensated, geometry + compliance"
    )
    axes.loglog(predicted[hidden], left[hidden], "^", color="C1", label="compensated, with the hidden effect")
    line = np.array([predicted.min() / 1.5, predicted.max() * 1.5])
    axes.plot(line, line, "-", color="0.3", lw=1, label="predicted (median)")
    axes.plot(
        line, line * float(np.median(high / predicted)), ":", color="0.3", lw=1, label="predicted (95 %)"
    )
    axes.set_xlabel("predicted maximum distance error, µm")
    axes.set_ylabel("maximum distance error on the true arm, µm")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def row(session: Session) -> tuple[object, ...]:
    """The cells of a row of the table."""
    first, last = session.levels[0], session.levels[-1]
    sizes = (rms(last.nominal), *map(largest, (last.nominal, first.left, last.left)))
    return (
        session.number, ", ".join(session.hidden) or "-", *(f"{UM * size:.0f}" for size in sizes),
        f"{UM * last.maximum[0]:.0f} ({UM * last.maximum[1]:.0f})", f"{rms(last.left) / rms(last.sd):.2f}",
    )  # fmt: skip


def pooled(levels: Sequence[Level]) -> str:
    """Pooled figures of some sessions as a sentence."""
    ratio = rms(np.concatenate([level.left / rms(level.sd) for level in levels]))
    inside = np.mean(np.concatenate([np.abs(level.left) <= 1.96 * level.sd for level in levels]))
    below = sum(largest(level.left) <= level.maximum[1] for level in levels)
    gone = np.median([largest(level.nominal) / largest(level.left) for level in levels])
    return (
        f"{len(levels)} sessions: the maximum distance error falls by a factor of {gone:.0f} (median); "
        f"distance errors are {ratio:.2f} times as large as predicted (RMS), {100 * inside:.0f} % are within "
        f"their 95 % interval, and the maximum is below the 95 % quantile of its prediction in {below} of "
        f"{len(levels)}"
    )


def write(sessions: Sequence[Session], seed: int, count: int, out: Path) -> None:
    """Write the page and its picture."""
    out.parent.joinpath("pictures").mkdir(parents=True, exist_ok=True)
    draw(sessions, out.parent / PICTURE)
    nothing = [s.levels[-1] for s in sessions if not s.hidden]
    named = [s.levels[-1] for s in sessions if s.hidden]
    without = [s.levels[0] for s in sessions if s.hidden and len(s.levels) > 1]
    lines = [
        "# Compensated targets on an independent simulator",
        "",
        "Sessions of the simulator of the blind check (`analysis.world`), which shares no code with the "
        "model: "
        "rigid bodies and gravity by Pinocchio, effects in forms of machines. Each session is fitted, "
        f"{COUNT} nominal joint targets beside rows of the session are compensated, and the true arm is "
        "brought to the nominal and to the compensated readings. Compared are the distances between all "
        "targets that are inside the probed region. Sessions whose hidden effect moves no pose (probe, "
        "artefact), depends on the time, or is not in the list of known effects are left out.",
        "",
        f"`python -m analysis.compensation --seed {seed} --count {count}`",
        "",
        f"![Maximum distance error over its prediction]({PICTURE})",
        "",
        f"- No hidden effect, model geometry + compliance. {pooled(nothing)}." if nothing else "",
        f"- A hidden effect, in the model. {pooled(named)}." if named else "",
        f"- The same without the effect in the model. {pooled(without)}." if without else "",
        "",
        table(HEADS, map(row, sessions)),
        "",
        "Distances in µm. Nominal errors contain that of the stated TCP, which is corrected as well.",
        "",
    ]
    out.write_text("\n".join(lines), encoding="utf-8")
