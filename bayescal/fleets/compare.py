"""The arms of a fleet beside each other: which differ from the others, and which changed between sessions.

Every arm is compared with the distribution of the others, and every session of an arm with those before it.
The p-value of a difference is that of one comparison; `p_all` is for all comparisons of its kind
(Bonferroni). A session tells of the parameters of its arm without the prior of its fit (`estimate.moments`):
parameters that are no property of the arm (base, tool) are integrated out with their stated priors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from bayescal.effects import UNITS, Parameter, Site
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.estimate.moments import Shift, likelihood, shifts
from bayescal.fitted.file import ARM_FILE, SCHEMA
from bayescal.fleets import FEWEST, Arms, Learnt, learn, left_out, widened
from bayescal.model.options import family
from bayescal.statistics import t_sf
from bayescal.storage.folders import check_unchanged
from bayescal.storage.reading import read_record

SI = {label: unit for unit, (label, _) in UNITS.items()}
"""SI unit of each unit of the files."""
REPEAT = "repeat the command with this version"


@dataclass(frozen=True)
class Likelihood:
    """Information and score of K parameters, in units of their stated priors: (value - mean) / sd."""

    parameters: tuple[Parameter, ...]  # (K,) with the stated priors, SI
    information: np.ndarray  # (K, K)
    score: np.ndarray  # (K,)

    def among(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Information (M, M) and score (M,) of other parameters: 0 of those that it does not have."""
        columns = [k for k, p in enumerate(self.parameters) if p.name in names]
        index = [names.index(self.parameters[k].name) for k in columns]
        information, score = np.zeros((len(names), len(names))), np.zeros(len(names))
        information[np.ix_(index, index)] = self.information[np.ix_(columns, columns)]
        score[index] = self.score[columns]
        return information, score


def read_likelihood(folder: Path, model: Sequence[str]) -> Likelihood:
    """What the arm of a run folder tells of the parameters of a model.

    Raises
    ------
    BayescalError
        If the folder has no arm of this version, or one that was changed.
    """
    record = read_record(folder / ARM_FILE, SCHEMA, REPEAT)
    check_unchanged(folder, (ARM_FILE,))
    if record.get("solver_covariance_si") is None:
        raise BayescalError("written by an earlier version", str(folder / ARM_FILE), REPEAT)
    return likelihood_of(record, model)


def likelihood_of(record: Mapping[str, Any], model: Sequence[str]) -> Likelihood:
    """The likelihood of the content of arm.json; parameters of effects beyond `model` are integrated out."""
    entries = record["parameters"]
    factor = np.array([UNITS[SI[e["unit"]]][1] for e in entries])
    mean, sd, value = (
        np.array([e[key] for e in entries]) / factor for key in ("prior_mean", "prior_sd", "value")
    )
    solved, stated = (np.array(record[f"{of}covariance_si"]) / np.outer(sd, sd) for of in ("solver_", ""))
    information, score = likelihood((value - mean) / sd, solved, stated)
    used = [
        Parameter(
            e["name"], SI[e["unit"]], (), float(s), e["nominal"] / f, float(m), site=Site.read(e["site"]),
            effect=e["effect"],
        )
        for e, f, m, s in zip(entries, factor, mean, sd, strict=True)
    ]  # fmt: skip
    effects = set(map(plain, model))
    in_model = np.array([bool(family(p)) and p.effect in effects for p in used])
    if not in_model.all():
        across = information[np.ix_(in_model, ~in_model)] @ np.linalg.inv(
            information[np.ix_(~in_model, ~in_model)] + np.eye(int(np.sum(~in_model)))
        )
        score = score[in_model] - across @ score[~in_model]
        information = (
            information[np.ix_(in_model, in_model)] - across @ information[np.ix_(~in_model, in_model)]
        )
    # the widths that data told are no part of the stated prior
    widths = record.get("prior_widths", {})
    width = np.array([record["prior_width"] * widths.get(family(p), 1.0) for p in used])[in_model]
    kept = [p for p, mine in zip(used, in_model, strict=True) if mine]
    parameters = tuple(replace(p, sd=p.sd / w) for p, w in zip(kept, width.tolist(), strict=True))
    information = 0.5 * (information + information.T)
    return Likelihood(parameters, information / np.outer(width, width), score / width)


LEVEL = 0.05
"""Probability, over all comparisons of a kind, below which a difference is stated (usual)."""
MOST = 3
"""Parameters of an arm, or of a session, that are stated."""
SAME = 1e-7
"""Relative difference of nominal values and priors up to which robot files are of one model."""


@dataclass(frozen=True)
class Member:
    """A session of a fleet: its name, its arm, the name of its robot, and what it tells."""

    session: str
    arm: str
    robot: str
    likelihood: Likelihood


@dataclass(frozen=True)
class Difference:
    """A parameter of an arm that differs from other arms, or from the sessions before; SI."""

    arm: str
    parameter: Parameter
    value: float
    u: float
    p: float
    p_all: float
    since: str = ""  # the session, of a change

    @property
    def stated(self) -> bool:
        """Whether it is below the level of all comparisons."""
        return self.p_all < LEVEL


@dataclass(frozen=True)
class Model:
    """The arms of one robot model.

    Parameters
    ----------
    robot : str
    members : tuple of Member
    parameters : tuple of Parameter
        With their stated priors; K of them.
    arms : tuple of str
    learnt : Learnt or None
        None of fewer than `FEWEST` arms.
    gains : mapping
        Log density of each arm, left out, under the distribution of the others, less that under the stated
        prior; nats.
    unlike : tuple of Difference
        The clearest difference of each arm from the others, and further stated ones.
    changed : tuple of Difference
        The same of each session from those of its arm before it.
    comparisons, pairs : int
        Number of comparisons of each kind.
    """

    robot: str
    members: tuple[Member, ...]
    parameters: tuple[Parameter, ...]
    arms: tuple[str, ...]
    learnt: Learnt | None
    gains: Mapping[str, float]
    unlike: tuple[Difference, ...]
    changed: tuple[Difference, ...]
    comparisons: int
    pairs: int


def models_of(members: Sequence[Member]) -> tuple[Model, ...]:
    """Compare the arms of each robot model; sessions of an arm are in the order of time."""
    groups: list[list[Member]] = []
    for member in members:
        same = (g for g in groups if g[0].robot == member.robot and _alike(g, member))
        if (group := next(same, None)) is not None:
            group.append(member)
        else:
            groups.append([member])
    return tuple(map(_model, groups))


def _alike(group: Sequence[Member], member: Member) -> bool:
    """Whether common parameters have the nominal values and priors of a group."""
    by_name = {p.name: p for m in group for p in m.likelihood.parameters}
    pairs = [(by_name[p.name], p) for p in member.likelihood.parameters if p.name in by_name]
    values = np.array([[[p.nominal, p.centre, p.sd] for p in pair] for pair in pairs]).reshape(-1, 2, 3)
    return bool(np.allclose(values[:, 0], values[:, 1], rtol=SAME, atol=1e-9))


def _model(group: Sequence[Member]) -> Model:
    parameters = tuple({p.name: p for m in group for p in m.likelihood.parameters}.values())
    names = [p.name for p in parameters]
    arms = tuple(dict.fromkeys(m.arm for m in group))
    pairs = (len(group) - len(arms)) * len(names)
    likelihoods: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    changed: list[Difference] = []
    for m in group:
        now = m.likelihood.among(names)
        if m.arm not in likelihoods:
            likelihoods[m.arm] = now
            continue
        before = likelihoods[m.arm]
        covariance = np.linalg.inv(before[0] + np.eye(len(names)))
        clearest = shifts(*now, covariance @ before[1], covariance, MOST)
        here = _differences(clearest, m.arm, parameters, np.full(len(names), np.inf), pairs, m.session)
        changed += here
        # what was true before a change is not true any more
        likelihoods[m.arm] = now if here[0].stated else (before[0] + now[0], before[1] + now[1])
    every = Arms(np.array([likelihoods[a][0] for a in arms]), np.array([likelihoods[a][1] for a in arms]))
    if len(arms) < FEWEST:
        return Model(group[0].robot, tuple(group), parameters, arms, None, {}, (), tuple(changed), 0, pairs)
    learnt = learn(every)
    others, gains = left_out(every, learnt)
    unlike: list[Difference] = []
    comparisons = len(arms) * len(names)
    for k, (arm, of) in enumerate(zip(arms, others, strict=True)):
        clearest = shifts(every.information[k], every.score[k], of.mean, np.diag(of.usual**2), MOST)
        unlike += _differences(clearest, arm, parameters, np.maximum(of.dof, 1.0), comparisons)
    odd = {d.arm for d in unlike if d.stated}
    learnt = widened(every, others, learnt, np.array([arm not in odd for arm in arms]))
    return Model(
        group[0].robot, tuple(group), parameters, arms, learnt, dict(zip(arms, gains.tolist(), strict=True)),
        tuple(unlike), tuple(changed), comparisons, pairs,
    )  # fmt: skip


def _differences(
    clearest: Sequence[Shift], arm: str, parameters: Sequence[Parameter], dof: np.ndarray, count: int,
    since: str = "",
) -> list[Difference]:  # fmt: skip
    """The first of some shifts, and those stated that follow it without a gap."""
    out: list[Difference] = []
    for shift in clearest:
        p = parameters[shift.index]
        size, worth = abs(shift.ratio), dof[shift.index]
        chance = float(2.0 * (ndtr(-size) if np.isinf(worth) else t_sf(size, worth)))
        one = Difference(arm, p, shift.value * p.sd, shift.u * p.sd, chance, min(1.0, count * chance), since)
        if out and not one.stated:
            break
        out.append(one)
        if not one.stated:
            break
    return out


@dataclass(frozen=True)
class Prior:
    """The learnt prior of a parameter, SI: mean deviation from nominal with u, and standard deviations."""

    parameter: Parameter
    mean: float
    u_mean: float
    usual: float  # standard deviation of usual arms
    sd: float  # of the prior of a further arm
    arms: float  # number of arms that the standard deviation is worth


def priors(model: Model) -> tuple[Prior, ...]:
    """The learnt prior of every parameter of a model; none of too few arms."""
    if (of := model.learnt) is None:
        return ()
    return tuple(
        Prior(
            p, p.centre - p.nominal + float(of.mean[k]) * p.sd, float(of.u_mean[k]) * p.sd,
            float(of.scale[k]) * p.sd, float(of.sd[k]) * p.sd, float(of.dof[k]),
        )
        for k, p in enumerate(model.parameters)
    )  # fmt: skip
