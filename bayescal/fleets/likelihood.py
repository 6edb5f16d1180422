"""What a session tells of the parameters of its arm, without the prior of its fit (`estimate.shifts`).

Parameters that are no property of the arm (base, tool) are integrated out with their stated priors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.effects import UNITS, Parameter, Site
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError
from bayescal.estimate.shifts import likelihood
from bayescal.fitted.file import ARM_FILE, SCHEMA
from bayescal.model.options import family
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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def among(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Information (M, M) and score (M,) of other parameters: 0 of those that it does not have."""
        own = [k for k, name in enumerate(self.names) if name in names]
        at = [names.index(self.names[k]) for k in own]
        information, score = np.zeros((len(names), len(names))), np.zeros(len(names))
        information[np.ix_(at, at)], score[at] = self.information[np.ix_(own, own)], self.score[own]
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
    own = np.array([bool(family(p)) and p.effect in effects for p in used])
    if not own.all():
        across = information[np.ix_(own, ~own)] @ np.linalg.inv(
            information[np.ix_(~own, ~own)] + np.eye(int(np.sum(~own)))
        )
        score = score[own] - across @ score[~own]
        information = information[np.ix_(own, own)] - across @ information[np.ix_(~own, own)]
    # the widths that data told are no part of the stated prior
    widths = record.get("prior_widths", {})
    width = np.array([record["prior_width"] * widths.get(family(p), 1.0) for p in used])[own]
    kept = [p for p, mine in zip(used, own, strict=True) if mine]
    parameters = tuple(replace(p, sd=p.sd / w) for p, w in zip(kept, width.tolist(), strict=True))
    information = 0.5 * (information + information.T)
    return Likelihood(parameters, information / np.outer(width, width), score / width)
