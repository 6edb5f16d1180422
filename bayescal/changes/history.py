"""The runs of one arm over time: courses of its parameters, trends and steps, and when to calibrate again.

Of each run, what its measurements tell without its prior counts (`estimate.moments.likelihood`), so that
what all runs have from the same prior counts once. The values of all runs are one constant for each
parameter, plus trends and steps, whose evidence is that of `search`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from bayescal.changes.joint import distance_slopes, drawn
from bayescal.changes.linear import integrated
from bayescal.changes.search import FREE, NONE, SURE, averaged, gains
from bayescal.dataset.join import arm_difference
from bayescal.effects import Parameter
from bayescal.errors import BayescalError, listed
from bayescal.estimate.moments import likelihood
from bayescal.fitted.arm import FittedArm
from bayescal.fitted.file import ARM_FILE, read_arm
from bayescal.storage.stopping import Progress, silent

Likelihood = tuple[np.ndarray, np.ndarray]
"""Information (P, P) and score (P,) of parameters, in units of their priors."""
DAY, SESSION = "day", "session"
"""Units of time: of runs whose datasets state dates, and of others."""
TREND, STEP = "trend", "step"
FARTHEST = 3e5
"""Days from which on no date is stated."""
MOST = 8
"""Largest number of trends and steps."""
UNDATED = "not all datasets state a date (record: date): the runs are in the order of their folders"
"""Note where runs have no dates."""
QUANTILES = (0.05, 0.5, 0.95)
"""Probabilities with which the limit is reached by the times that are stated."""


@dataclass(frozen=True)
class Entry:
    """A run of the arm."""

    folder: str
    arm: FittedArm
    dates: str  # of the dataset; "" where it states none
    time: float = 0.0  # days since the first, or number of the session


@dataclass(frozen=True)
class Course:
    """A parameter over time; SI. A trend is per unit of time, a step from run `since` on."""

    parameter: Parameter
    values: tuple[tuple[float, float] | None, ...]  # value and u of each run
    kind: str  # "", trend or step
    size: float
    u: float
    probability: float  # of the trend or step; of a constant, of the most probable one
    since: int = 0


@dataclass(frozen=True)
class Limit:
    """When the error of distances by all trends reaches a limit; times since the last run."""

    limit: float  # m
    rate: float  # m RMS per unit of time
    u_rate: float
    times: tuple[float, ...]  # with the probabilities of `QUANTILES`; inf where it is not reached
    dates: tuple[str, ...]


@dataclass(frozen=True)
class History:
    """The history of an arm."""

    robot: str
    serial: str
    unit: str
    entries: tuple[Entry, ...]
    courses: tuple[Course, ...]
    limit: Limit | None
    notes: tuple[str, ...] = field(default=())


def history(
    folder: Path, order: Sequence[str] = (), limit: float | None = None, progress: Progress = silent
) -> History:
    """The history of the runs in a folder.

    Parameters
    ----------
    folder : Path
        With run folders of fit or gap of one arm.
    order : sequence of str
        Names of the run folders in the order of time; default: by the dates of their datasets, and without
        these by the names of the folders.
    limit : float, optional
        m, RMS error of distances at which the arm is calibrated again.
    progress : callable

    Raises
    ------
    BayescalError
        For fewer than two sessions, runs of different arms, or a name that is no run folder.
    """
    entries, unit, notes = _ordered(_read(folder, progress), order, folder)
    last = {p.name: p for e in entries for p in e.arm.model.parameters}
    names, time = list(last), np.array([e.time for e in entries])
    span, trends = float(np.ptp(time)), int(len(np.unique(time)) > 2)
    patterns = [(time - np.mean(time)) / span] if trends else []
    patterns += [(time >= time[k]).astype(float) for k in range(1, len(time)) if time[k] > time[k - 1]]
    likelihoods = [_information(e, names, last) for e in entries]
    information, score = _reduced(likelihoods, np.array(patterns).reshape(len(patterns), len(entries)))
    chosen, odds = _search(information, score, len(names), len(patterns))
    per = np.array([span if k // len(names) < trends else 1.0 for k in chosen])
    scale = np.array([last[names[k % len(names)]].sd for k in chosen]) / per
    covariance = np.linalg.inv(information[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / FREE**2)
    mean, covariance = scale * (covariance @ score[chosen]), covariance * np.outer(scale, scale)
    courses, place = [], {k % len(names): i for i, k in enumerate(chosen)}
    for j, name in enumerate(names):
        values = tuple(_value(e.arm, name) for e in entries)
        probability = float(1.0 / (1.0 + np.exp(-np.max(odds[j :: len(names)], initial=-50.0))))
        course = Course(last[name], values, "", 0.0, 0.0, probability)
        if (i := place.get(j)) is not None:
            pattern = chosen[i] // len(names)
            kind, since = (TREND, 0) if pattern < trends else (STEP, int(np.argmax(patterns[pattern] > 0)))
            u = float(np.sqrt(covariance[i, i]))
            course = replace(course, kind=kind, size=float(mean[i]), u=u, since=since)
        courses.append(course)
    drifts = [i for i, k in enumerate(chosen) if k // len(names) < trends]
    arm, when = entries[-1].arm, None
    in_last = {p.name for p in arm.model.parameters}
    of = {i: names[chosen[i] % len(names)] for i in drifts}
    at_end = [i for i in drifts if of[i] in in_last]
    if limit is not None and (lost := [of[i] for i in drifts if i not in at_end]):
        notes.append(f"the last run does not have {listed(lost)}: the limit is without this drift")
    if limit is not None and not drifts:
        notes.append("no parameter drifts: no time follows at which the limit is reached")
    if limit is not None and at_end:
        which, spread = [of[i] for i in at_end], covariance[np.ix_(at_end, at_end)]
        when = _limit(limit, entries[-1], which, mean[at_end], spread, unit)
    serial = arm.dataset.record.serials.get("arm") or ""
    return History(arm.dataset.robot.name, serial, unit, entries, tuple(courses), when, tuple(notes))


def _value(arm: FittedArm, name: str) -> tuple[float, float] | None:
    """Value and u of a parameter of a run, SI."""
    for k, p in enumerate(arm.model.parameters):
        if p.name == name:
            return p.nominal + float(arm.values[k]), float(np.sqrt(arm.covariance[k, k]))
    return None


def _limit(
    limit: float, last: Entry, names: Sequence[str], rates: np.ndarray, covariance: np.ndarray, unit: str
) -> Limit:
    """When the drift of some parameters since the last run reaches a limit."""
    arm = last.arm
    columns = [k for name in names for k, p in enumerate(arm.model.parameters) if p.name == name]
    poses = arm.at_rows(arm.model.scene.rows("calibrate"))
    by = distance_slopes(poses.points.T, np.transpose(poses.by_parameters[:, :, columns], (2, 1, 0)))
    rms = np.sqrt(np.mean((drawn(rates, covariance) @ by) ** 2, axis=1))
    times = tuple(float(np.quantile(limit / rms, q)) for q in QUANTILES)
    dates: tuple[str, ...] = ()
    if unit == DAY and max(times) < FARTHEST:
        dates = tuple((date.fromisoformat(last.dates) + timedelta(days=t)).isoformat() for t in times)
    return Limit(limit, float(np.sqrt(np.mean((rates @ by) ** 2))), float(np.std(rms)), times, dates)


def _read(folder: Path, progress: Progress) -> list[Entry]:
    """The runs of one arm in a folder."""
    folders = sorted({p.parent for p in folder.glob(f"*/{ARM_FILE}")})
    if not folders:
        remedy = "give a folder of runs of fit or gap"
        raise BayescalError("there are no run folders in it", str(folder), remedy)
    entries: list[Entry] = []
    for k, run in enumerate(folders):
        progress("read", k / len(folders))
        arm = read_arm(run)
        sessions = arm.dataset.sessions or (arm.dataset,)
        entries.append(Entry(run.name, arm, max((s.record.date or "" for s in sessions), default="")))
        if difference := arm_difference(entries[0].arm.dataset, arm.dataset):
            what = f"not the arm of {entries[0].folder}: {difference}"
            raise BayescalError(what, str(run), "keep the runs of each arm in a folder of their own")
    return entries


def _ordered(
    entries: list[Entry], order: Sequence[str], folder: Path
) -> tuple[tuple[Entry, ...], str, list[str]]:
    """The runs in the order of time, one for each dataset, the unit of time, and notes."""
    by_name = {e.folder: e for e in entries}
    if missing := [name for name in order if name not in by_name]:
        what = f"there is no run folder `{missing[0]}`"
        raise BayescalError(what, "--order", f"run folders of {folder}: {', '.join(by_name)}")
    notes: list[str] = []
    if order:
        chosen, unit = [by_name[name] for name in order], SESSION
        if out := [name for name in by_name if name not in order]:
            notes.append(f"--order does not name {', '.join(out)}: left out")
    elif all(e.dates for e in entries):
        chosen, unit = sorted(entries, key=lambda e: (e.dates, _natural(e.folder))), DAY
    else:
        chosen, unit = sorted(entries, key=lambda e: _natural(e.folder)), SESSION
        notes.append(UNDATED)
    best: dict[str, Entry] = {}
    for e in chosen:
        before = best.get(e.arm.dataset.sha256)
        if before is not None:
            both = f"{before.folder} and {e.folder}"
            notes.append(f"{both} are of one dataset: the one with more parameters counts")
        if before is None or len(e.arm.values) >= len(before.arm.values):
            best[e.arm.dataset.sha256] = e
    kept = [e for e in chosen if best[e.arm.dataset.sha256] is e]
    if len(kept) < 2:
        what = "a history needs the runs of two sessions"
        raise BayescalError(what, str(folder), "fit the other sessions too")
    times = list(range(len(kept)))
    if unit == DAY:
        times = [date.fromisoformat(e.dates).toordinal() for e in kept]
    return tuple(replace(e, time=float(t - times[0])) for e, t in zip(kept, times, strict=True)), unit, notes


def _natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts run-2 before run-10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def _information(entry: Entry, names: Sequence[str], last: Mapping[str, Parameter]) -> Likelihood:
    """What the measurements of a run tell: information (P, P) and score (P,), by the priors of `last`."""
    arm, model = entry.arm, entry.arm.model
    if arm.solved is None:
        remedy = "repeat the command with this version"
        raise BayescalError("written by an earlier version", entry.folder, remedy)
    z, units = (arm.values - model.shift) / model.sd, np.outer(model.sd, model.sd)
    precision, pull = likelihood(z, arm.solved / units, arm.covariance / units)
    index = np.array([names.index(p.name) for p in model.parameters], int)
    # of z = by x + off, where x is in units of the priors of `last`
    by = np.array([last[names[k]].sd for k in index]) / model.sd
    off = (np.array([last[names[k]].centre - last[names[k]].nominal for k in index]) - model.shift) / model.sd
    information, score = np.zeros((len(names), len(names))), np.zeros(len(names))
    information[np.ix_(index, index)] = 0.5 * (precision + precision.T) * np.outer(by, by)
    score[index] = by * (pull - precision @ off)
    return information, score


def _reduced(likelihoods: Sequence[Likelihood], patterns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information and score of amplitudes, pattern by pattern, with the constants integrated out.

    Parameters
    ----------
    likelihoods : sequence of Likelihood
        Of each of S runs.
    patterns : np.ndarray, shape (F, S)
    """
    each, scores = np.array([i for i, _ in likelihoods]), np.array([s for _, s in likelihoods])
    size = each.shape[1]
    inner = np.linalg.inv(np.sum(each, axis=0) + np.eye(size))
    across = np.einsum("fs,spq->fpq", patterns, each).reshape(-1, size)
    full = np.einsum("fs,gs,spq->fpgq", patterns, patterns, each).reshape(len(across), len(across))
    score = np.einsum("fs,sp->fp", patterns, scores).ravel()
    return full - across @ inner @ across.T, score - across @ (inner @ np.sum(scores, axis=0))


def _search(g: np.ndarray, s: np.ndarray, count: int, patterns: int) -> tuple[list[int], np.ndarray]:
    """Amplitudes that are added while the next is nearly certain; log odds of all, given the others."""
    chosen: list[int] = []
    prior = float(np.log((1.0 - NONE) / NONE / (count * max(patterns, 1))))

    def odds(of: list[int], beside: list[int]) -> list[float]:
        information, score, _ = integrated(g, s, FREE * np.eye(len(s))[:, beside])
        return [averaged(gains(information[k : k + 1, k : k + 1], score[k : k + 1])) + prior for k in of]

    while True:
        free = [k for k in range(len(s)) if k % count not in {c % count for c in chosen}]
        gain = np.full(len(s), -np.inf)
        gain[free] = odds(free, chosen)
        best = int(np.argmax(gain)) if free else -1
        if best < 0 or len(chosen) == MOST or gain[best] < np.log(SURE / (1.0 - SURE)):
            gain[chosen] = [odds([k], [c for c in chosen if c != k])[0] for k in chosen]
            return chosen, gain
        chosen.append(best)
