"""Open loop: an instrument reads the tool, and the arm is fitted to its readings."""

from __future__ import annotations

from bayescal.methods.linear import touches
from bayescal.methods.method import Method, Solution, where_it_stands
from bayescal.methods.solving import System, levenberg, part
from bayescal.model import Block, Model, build
from bayescal.model.scene import Scene


def is_read(block: Block) -> bool:
    """Whether an instrument reads a block's rows."""
    return not touches(block)


def missing(model: Model) -> str:
    """What a session lacks for open loop."""
    return "" if part(model, is_read).blocks else "no calibration row is measured by an instrument"


@where_it_stands
def solve(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """Fit the arm and the instrument's frame to what it read."""
    return levenberg(System(part(build(scene, effects), is_read)))


OPEN_LOOP = Method(
    "open loop",
    "Mooring, Roth and Driels",
    "non-linear least squares of instrument readings with unknown frame; contacts are not used",
    missing,
    solve,
)
