"""The linear least-squares iteration of Joubair and Bonev: identification Jacobian, unknown planes.

The text of the article was not available; this is the iteration as generally known. Distances to planes that
are fitted anew at every step, linear in the arm's parameters, columns scaled, no priors. Rank deficient:
the base against the planes, and parameters that move the ball alike (d of parallel axes). What QR finds
redundant stays nominal. The size of the arm comes from certified distances.
"""

from __future__ import annotations

from bayescal.methods.method import Method, Solution, where_it_stands
from bayescal.methods.solving import System, linear_steps, part
from bayescal.model import Block, Model, build
from bayescal.model.scene import Scene

NO_LENGTH = "no length is certified: without priors the scale of the arm is not identifiable"


def touches(block: Block) -> bool:
    """Whether a block's rows are constraints, not an instrument's readings."""
    return block.group == "contact"


def missing(model: Model) -> str:
    """What a session lacks for constraints with unknown targets."""
    touched = part(model, touches)
    if not touched.blocks:
        return "no contacts: all rows are measured by an instrument"
    return "" if touched.knows_length else NO_LENGTH


@where_it_stands
def solve(scene: Scene, effects: tuple[str, ...]) -> Solution:
    """Fit the arm to its constraints step by step."""
    return linear_steps(System(part(build(scene, effects), touches)))


LINEAR = Method(
    "linear steps",
    "Joubair and Bonev",
    "distances to planes, fitted again at each linear step; scaled columns; redundant parameters nominal",
    missing,
    solve,
)
