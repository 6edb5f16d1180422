"""Which residuals are lengths: those of contacts and points, not the turns that instruments read beside."""

from __future__ import annotations

from bayescal.model import Block, Model, Turned


def length_blocks(model: Model) -> tuple[Block, ...]:
    """Blocks whose residuals are lengths, m; a model has them before those of orientations, rad."""
    return tuple(b for b in model.blocks if not isinstance(b, Turned))


def main_group(model: Model) -> str:
    """The noise group of most lengths: noise scales are told beside its own."""
    count: dict[str, int] = {}
    for b in length_blocks(model):
        count[b.group] = count.get(b.group, 0) + b.residuals
    return max(count, key=lambda group: count[group])
