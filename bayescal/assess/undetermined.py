"""What a session leaves undetermined, why, and what to measure.

A direction is a combination of parameters that the rows reduce little (`identifiability`). For each, the
smallest change of the session is found that would determine it: a session of `PLANNED` rows with that change
is linearised, and its information is added. The changes are those that a user can make (`CHANGES`). What no
change determines either has no effect on a measurement, or one below the noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayescal.assess import WORDS, identifiability
from bayescal.assess.identifiability import Conditions, Identifiability, directions, in_words, simplified
from bayescal.effects.location import micrometres
from bayescal.errors import listed
from bayescal.estimate import Estimate

STILL = np.radians(15.0)
"""rad: range of a joint below which it counts as not moved (assumed)."""
ON_AXIS = 2e-3
"""m: distance of the TCP from the last axis below which it counts as on it (assumed)."""
REDUNDANT = 0.01
"""Displacement of any measurement by a prior standard deviation, in units of its noise, that is none."""
HIDDEN = 0.3
"""Displacement, in units of the noise, below which what is not determined has no effect."""
IMAGE_VALUES = 6
"""Values of an image: the position and the orientation of the board in it."""
NAMED = 6
"""Parameters that a sentence names."""

State = Literal["measure", "rows", "noise", "redundant"]


def _poses(session: Conditions) -> str:
    if still := _still(session):
        return f"{still} hardly moved"
    count = len(np.unique(session.readings[session.rows], axis=0))
    of_image = session.model.scene.in_images[session.rows].all()  # the place of the board in it
    if count * (IMAGE_VALUES if of_image else session.values_per_row) < session.model.size:
        several = f"{count} different poses cannot determine {session.model.size} unknowns"
        return several if count > 1 else "all measurements have one pose"
    return "the poses are too much alike"


def _still(session: Conditions) -> str:
    robot, readings = session.model.scene.dataset.robot, session.readings[session.rows]
    still = [n for n, span in zip(robot.joint_names, np.ptp(readings, axis=0), strict=True) if span < STILL]
    return "" if len(still) == robot.n else ", ".join(still)


def _look(session: Conditions) -> str:
    return in_words(directions(session.model)) or "each target is seen along few directions"


def _sides(session: Conditions) -> str:
    images = session.model.scene.in_images[session.rows].all()
    return "take images from other sides" if images else "probe planes in three directions, or spheres"


def _tool(session: Conditions) -> str:
    if session.lever < ON_AXIS:
        return f"the TCP is on the axis of {session.model.scene.dataset.robot.joint_names[-1]}"
    return "one TCP does not show all rotations of the flange"


CHANGES: dict[str, tuple[Callable[[Conditions], str], Callable[[Conditions], str]]] = {
    "poses": (_poses, lambda s: f"measure in poses over most of the range of {_still(s) or 'every joint'}"),
    "directions": (_look, _sides),
    "length": (
        lambda s: "certified lengths are too uncertain" if s.model.knows_length else "no length is certified",
        lambda s: "state a certified distance between fitted targets",
    ),
    "payload": (
        lambda s: "gravity torques vary too little",
        lambda s: f"measure also with {identifiability.PAYLOAD:g} kg more payload",
    ),
    "tool": (_tool, lambda s: "measure also with a second tool, its point 100 mm away"),
}
"""What a session may lack, the least costly first: the reason, and what to measure."""
OTHERWISE = WORDS["otherwise"]
"""Reason and remedy of what no change determines."""
COMBINED = "no measurement depends on each by itself"
"""Reason for redundant combinations of parameters of which other combinations are measured."""


@dataclass(frozen=True)
class Undetermined:
    """Combinations of parameters with a common cause.

    Attributes
    ----------
    parameters : tuple of str
        All that have a part in them.
    combinations : int
    what : str
        What is not determined, in words.
    changes : tuple of str
        The smallest set of `CHANGES` that determines them; () if more rows of the same kind do, or nothing.
    state : str
        ``measure``: the changes determine them; ``rows``: more rows do; ``noise``: their effect is below the
        noise; ``redundant``: they have none.
    displacement : float
        RMS displacement, m, of TCP positions over the range of all joints by what is not determined.
    noise : float
        Of one measurement, m.
    reason, remedy : str
    """

    parameters: tuple[str, ...]
    combinations: int
    what: str
    changes: tuple[str, ...]
    state: State
    displacement: float
    noise: float
    reason: str
    remedy: str

    @property
    def matters(self) -> bool:
        """Whether a point that the arm can go to with this tool is affected beyond the noise."""
        return self.state != "redundant" and self.displacement > self.noise

    @property
    def hidden(self) -> bool:
        """Whether it may matter otherwise: with another tool, or with less noise."""
        below = self.state == "noise" and self.displacement > HIDDEN * self.noise
        return not self.matters and ("tool" in self.changes or below)

    @property
    def words(self) -> str:
        """In one sentence."""
        return f"{self.cause}: {self.remedy}"

    @property
    def cause(self) -> str:
        """What is not determined, what it leaves, and why."""
        effect = "no effect with this tool"
        if self.displacement > HIDDEN * self.noise:
            effect = f"{micrometres(self.displacement)} RMS over the range of all joints"
        return f"{self.what} ({effect}), because {self.reason}"


def undetermined(fitted: Estimate, determined: Identifiability) -> tuple[Undetermined, ...]:
    """What is not determined, by cause, the largest consequence first.

    Parameters
    ----------
    fitted : Estimate
    determined : Identifiability
        Of this estimate.
    """
    if not determined.weak:
        return ()
    session = Conditions(fitted, determined.index)
    possible = session.possible(tuple(CHANGES))
    weak = np.array([d.vector for d in determined.weak]).T
    seen, turn = np.linalg.eigh(weak.T @ session.information(possible[-1]) @ weak)
    no_effect = np.sqrt(np.maximum(seen, 0.0) / identifiability.PLANNED) < REDUNDANT
    groups: dict[tuple[State, tuple[str, ...]], list[np.ndarray]] = {}
    if np.any(no_effect):
        groups["redundant", ()] = [*(weak @ turn[:, no_effect]).T]
    for v in simplified(weak @ turn[:, ~no_effect]).T if not np.all(no_effect) else ():
        groups.setdefault(_cause(session, determined, v, possible), []).append(v)
    each = ((cause, np.array(vectors).T) for cause, vectors in groups.items())
    by_cause = [_described(session, determined, *cause, v) for cause, v in each]
    return tuple(sorted(by_cause, key=lambda u: -u.displacement))


def _cause(
    session: Conditions, determined: Identifiability, v: np.ndarray, possible: list[tuple[str, ...]]
) -> tuple[State, tuple[str, ...]]:
    """The state of a direction (P,), and the smallest of the possible changes that determines it."""
    precision = np.eye(len(v)) + determined.information
    for changes in possible:
        u = v @ np.linalg.solve(precision + session.information(changes), v)
        if u <= 1.0 - identifiability.DETERMINED:
            return ("measure" if changes else "rows"), changes
    return "noise", ()


def _listed(parameters: tuple[str, ...], combinations: int) -> str:
    which = listed(parameters, NAMED)
    singly = combinations == len(parameters)
    return f"{which} are not identifiable" if singly else f"combinations of {which} are not identifiable"


def _described(
    session: Conditions, determined: Identifiability, state: State, changes: tuple[str, ...],
    v: np.ndarray,
) -> Undetermined:  # fmt: skip
    """Directions (P, K) with a common cause, in words."""
    names = [p.name for p in determined.parameters]
    shown = np.max(np.abs(v), axis=1) > identifiability.SHOWN
    covariance = v.T @ np.linalg.solve(np.eye(len(v)) + determined.information, v)
    of = {p.effect for p, show in zip(determined.parameters, shown, strict=True) if show}
    if state != "redundant" and of == {"camera"}:
        reason, remedy = OTHERWISE["stated"]
    elif state == "measure":
        reason = " and ".join(CHANGES[c][0](session) for c in changes)
        remedy = ", ".join(CHANGES[c][1](session) for c in changes)
    else:
        reason, remedy = OTHERWISE[state]
    parameters = tuple(n for n, show in zip(names, shown, strict=True) if show)
    if state == "redundant" and v.shape[1] < len(parameters):
        reason = COMBINED
    what = determined.direction(v[:, 0]).words if v.shape[1] == 1 else _listed(parameters, v.shape[1])
    return Undetermined(
        parameters, v.shape[1], what, changes, state,
        session.displacement(v @ covariance @ v.T), session.noise, reason, remedy,
    )  # fmt: skip
