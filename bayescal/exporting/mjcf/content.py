"""What the parameters of a fitted arm mean for a simulator, sorted by their drivers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.arm.transforms import AXES
from bayescal.effects import Parameter
from bayescal.effects.sessions import alone
from bayescal.effects.vocabulary import Circumstances
from bayescal.exporting.fitted import FittedArm

STATE = ("constant", "time", "temperature", "event")
"""Drivers that are constant while an arm moves: a file has their values in one row, its state."""
TOUCHED = ("contact speed", "contact direction", "face", "certificate")
"""Drivers of errors of the probe and the artefact: they move no link."""


UNHELD = ("late", "level", "uneven")
"""Forms of a dependence that no element of MuJoCo has: a memory of earlier rows, a curve of an angle,
a spring that differs between the signs of the torque."""


@dataclass(frozen=True)
class Content:
    """Parameters of an arm with their values, as they apply in one row of its session.

    A common factor of several parameters is resolved into these. Parameters of other sessions are left out.
    """

    arm: FittedArm
    row: int

    @cached_property
    def circumstances(self) -> Circumstances:
        """The circumstances of the session's fitted measurements."""
        scene = self.arm.model.scene
        c = scene.circumstances(scene.rows("calibrate"))
        own = next((s for s in c.sessions if s.rows[self.row]), None)
        return c if own is None else alone(c, own)

    @cached_property
    def valued(self) -> tuple[tuple[Parameter, float], ...]:
        """Parameters and their deviations from nominal, SI."""
        out: list[tuple[Parameter, float]] = []
        for p, value in zip(self.arm.model.parameters, self.arm.values.tolist(), strict=True):
            if self._applies(p):
                out += [(own, value * own.centre) for own in p.stands_for] or [(p, value)]
        return tuple(out)

    def _applies(self, p: Parameter) -> bool:
        sessions = self.arm.model.scene.dataset.sessions
        rows = self.arm.model.scene.circumstances(np.zeros(0, int)).sessions if sessions else ()
        other = [s.name for s in rows if not s.rows[self.row]]
        return not any(p.name.startswith(f"{name}:") for name in other)

    def driven(self, *kinds: str) -> Iterator[tuple[Parameter, float]]:
        """Parameters with a driver of some kinds, and their values; none of a form in `UNHELD`."""
        own = ((p, value) for p, value in self.valued if p.driver.form not in UNHELD)
        return ((p, value) for p, value in own if p.driver.kind in kinds)

    def constants(self, row: int | None = None) -> np.ndarray:
        """Constant displacements of the frames, (n + 2, 6), rad and m, in a row; default: the state."""
        at = self.row if row is None else row
        out = np.zeros((self.arm.model.scene.chain.n + 2, 6))
        for p, value in self.driven(*STATE):
            for term in p.terms:
                if term.frame >= 0:
                    driver = np.asarray(term.driver)
                    out[term.frame, AXES.index(term.axis)] += value * float(
                        driver[at] if driver.ndim else driver
                    )
        return out
