"""Which logs there are: kinds in fixed shares, every effect and every cause in its turn, forms at random."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from analysis.world.motion.effects import BODY
from analysis.world.motion.effects_drive import DRIVE
from analysis.world.motion.log import Act, Log
from analysis.world.motion.outside import MECHANICS
from analysis.world.motion.outside_further import FURTHER
from analysis.world.motion.outside_more import MEASUREMENT
from analysis.world.motion.outside_third import NEEDS as NEEDS_OF_THIRD
from analysis.world.motion.outside_third import THIRD

Maker = Callable[[np.random.Generator, Log], Act]
LISTED = BODY | DRIVE
"""Effects of the list by name: function and forms."""
MIX = ("null", "null", "single", "single", "single", "pair")
"""Kinds of six logs; those with a cause outside the list are added by their share."""
SHARE = 0.25
"""Usual share of logs with a cause outside the list."""
KINDS = ("null", "single", "pair", "outside")
OUTSIDE = MECHANICS + MEASUREMENT
CAUSES = {"development": OUTSIDE, "reserved": FURTHER + OUTSIDE[::3], "third": THIRD}
"""Sets of causes outside the list."""
GOAL = (10.0, 800.0)
"""Wanted lambda, log-uniform from and to."""
NEEDS: dict[str, dict] = {
    "payload": {"loads": ("after", "interleaved")},
    "payload-offset": {"loads": ("after", "interleaved")},
    "stribeck": {"slow": (True,)},
    "presliding": {"slow": (True,)},
    "torque-drift": {"warm_K": (6.0, 8.0, 10.0), "temperature": (True,)},
    "viscous-temperature": {"warm_K": (6.0, 8.0, 10.0), "temperature": (True,)},
    "elasticity": {"link": (True,)},
    "backlash": {"link": (True,)},
    "servo-stiffness": {"servo": (True,)},
} | NEEDS_OF_THIRD
"""What a log needs for an effect to be visible at all: values of its notes."""


@dataclass(frozen=True)
class Recipe:
    """Kind of a log, the names of its effects or of its cause, and the functions that draw them."""

    kind: str
    names: tuple[str, ...]
    makers: tuple[Maker, ...]


def _of_list(name: str, held_out: bool) -> Maker:
    """Return the function that draws a listed effect in one of its forms."""
    function, forms = LISTED[name]

    def draw(rng: np.random.Generator, log: Log) -> Act:
        chosen = forms[-1] if held_out and rng.random() < 0.6 else forms[rng.integers(len(forms) - 1)]
        return function(rng, log, chosen)

    return draw


def block_of(kinds: Sequence[str], outside: float = SHARE) -> list[str]:
    """Return the kinds of a block of logs, of which a share (0 to .9) is outside the list, to within .01."""
    for times in range(1, 9):
        added = round(len(MIX) * times * outside / (1 - outside))
        block = MIX * times + ("outside",) * added
        if abs(added / len(block) - outside) <= 0.01:
            break
    return [kind for kind in block if kind in kinds]


def recipe(
    seed: int,
    number: int,
    kinds: Sequence[str] = KINDS,
    held_out: bool = False,
    causes: str = "",
    outside: float = SHARE,
) -> Recipe:
    """Return what is hidden in a log; no log depends on another.

    Parameters
    ----------
    seed, number : int
        The set, and which of its logs.
    kinds : sequence of str
        The kinds to be made, in the shares of `MIX`.
    held_out : bool
        Draw the reserved forms and causes.
    causes : str
        Of `CAUSES`; by default those of the development, or the reserved ones.
    outside : float
        Share of the logs with a cause outside the list, before `kinds` leaves some out.
    """
    mix = block_of(kinds, outside)
    block, slot = divmod(number, len(mix))
    order = np.random.default_rng([seed, 1, block]).permutation(len(mix))
    kind = mix[order[slot]]
    before = [mix[k] for k in order[:slot]].count(kind)
    rank = before + mix.count(kind) * block
    listed = tuple(LISTED)
    if kind == "null":
        return Recipe(kind, (), ())
    if kind == "pair":
        pick = np.random.default_rng([seed, 2, number]).choice(len(listed), 2, replace=False)
        names = tuple(listed[k] for k in pick)
        return Recipe(kind, names, tuple(_of_list(name, held_out) for name in names))
    causes = causes or ("reserved" if held_out else "development")
    pool = listed if kind == "single" else CAUSES[causes]
    again, place = divmod(rank, len(pool))
    chosen = pool[np.random.default_rng([seed, 3, again, len(pool)]).permutation(len(pool))[place]]
    if kind == "single":
        return Recipe(kind, (chosen,), (_of_list(chosen, held_out),))
    return Recipe(kind, (chosen.__name__.replace("_", "-"),), (partial(chosen),))


def wishes(rng: np.random.Generator, names: Sequence[str]) -> dict:
    """Return the notes of a session that its effects need."""
    out: dict = {}
    for name in names:
        out |= {key: values[rng.integers(len(values))] for key, values in NEEDS.get(name, {}).items()}
    return out
