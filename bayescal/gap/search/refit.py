"""The non-linear refit of a model with the named effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.effects import Parameter
from bayescal.estimate import Estimate, estimate
from bayescal.gap.search.beam import Member
from bayescal.model import ARM, with_parameters


def model_name(member: Member) -> str:
    """An effect in the form of ``--model``, with its setting where it has one."""
    setting = member.variant.setting
    if setting is None:
        return member.effect
    return f"{member.effect}@{setting if isinstance(setting, str) else format(setting, 'g')}"


def parameters_of_members(pool: Sequence[Parameter], members: Sequence[Member]) -> list[Parameter]:
    """Parameters of the variants of members, with prior mean zero and the prior scales of the best fit."""
    return [
        replace(pool[k], sd=pool[k].sd * m.scale, mean=pool[k].nominal)
        for m in members
        for k in m.variant.columns
    ]


def refit(
    before: Estimate, pool: Sequence[Parameter], members: Sequence[Member], robust: bool = True
) -> Estimate:
    """Fit a model again with the parameters of some effects in addition to its own."""
    old = before.model
    extra = parameters_of_members(pool, members)
    effects = (*old.effects, *(model_name(m) for m in members))
    model = with_parameters(old.scene, effects, (*old.parameters, *extra))
    own = old.slices[ARM].stop
    start = np.concatenate([before.z[:own], np.zeros(len(extra)), before.z[own:]])
    return estimate(model, robust=robust, start=start)
