"""Blocks whose residuals are lengths: contacts and points, not the orientations that instruments read."""

from __future__ import annotations

from bayescal.model.block import Block, Turned
from bayescal.model.model import Model


def length_blocks(model: Model) -> tuple[Block, ...]:
    """Blocks whose residuals are lengths, m; in a model they precede those of orientations, rad."""
    return tuple(b for b in model.blocks if not isinstance(b, Turned))


def main_group(model: Model) -> str:
    """The noise group with most lengths: reports give other noise scales in addition to its scale."""
    count: dict[str, int] = {}
    for b in length_blocks(model):
        count[b.group] = count.get(b.group, 0) + b.residuals
    return max(count, key=lambda group: count[group])


def noise_groups(model: Model) -> tuple[str, ...]:
    """All noise groups of a fitted model, that of most lengths first; none if nothing is fitted."""
    present = dict.fromkeys(b.group for b in model.blocks)
    if not length_blocks(model):
        return tuple(present)
    first = main_group(model)
    return (first, *(g for g in present if g != first))
