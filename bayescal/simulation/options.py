"""Options of a simulated session."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.effects import EFFECTS
from bayescal.effects.selection import plain
from bayescal.errors import BayescalError

GROUP = 4  # contacts of a repeat group
FEWEST_ON_SPHERE = 6
LARGEST_SCALE = 4.0
"""Error scale from which on a parameter is usually further from nominal than a fit accepts without a warning
(`assess.findings.FAR` prior standard deviations); contacts on spheres miss them from about 5 on."""


@dataclass(frozen=True)
class Options:
    """A session to simulate. Counts are of contacts, except `spheres` of an artefact and its `placements`.

    `arm_seed` is the seed of the true arm and its tool, to simulate another session of the same arm; None
    for the seed of the session. `contacts` are for calibration, including repeats (groups of four); `later`
    are on the same faces, for validation. `error_scale` multiplies every deviation of the true arm.
    `noise` (m) is the noise of a contact, `joint_noise` (rad) that of a reading, `outliers` the fraction of
    gross contacts, `payload` (kg) is attached for half of the plane contacts.
    """

    robot: str = "fanuc-lrmate200ic"
    effects: tuple[str, ...] = ("geometry", "compliance")
    name: str = "simulated"
    seed: int = 0
    error_scale: float = 1.0
    contacts: int = 500
    later: int = 60
    repeats: int = 15
    spheres: int = 3
    placements: int = 4
    sphere_contacts: int = 11
    noise: float = 5e-6
    joint_noise: float = 0.0
    outliers: float = 0.0
    payload: float = 0.0
    arm_seed: int | None = None

    @property
    def seed_of_arm(self) -> int:
        """Seed of the true arm."""
        return self.seed if self.arm_seed is None else self.arm_seed

    def check(self) -> None:
        """Raise an error for invalid options.

        Raises
        ------
        BayescalError
            With the option.
        """
        for option in (
            "seed",
            "error_scale",
            "later",
            "repeats",
            "spheres",
            "placements",
            "noise",
            "joint_noise",
            "payload",
        ):
            value = getattr(self, option)
            if not (np.isfinite(value) and value >= 0):
                raise BayescalError("a negative value makes no sense", flag(option), "give 0 or more")
        if self.error_scale > LARGEST_SCALE:
            what = (
                f"{self.error_scale:g} times its tolerances is no error of an arm that a calibration corrects"
            )
            raise BayescalError(what, "--error-scale", f"give {LARGEST_SCALE:g} or less")
        for name in self.effects:
            if (effect := plain(name)) not in EFFECTS:
                what = f"no effect is called `{effect}`"
                raise BayescalError(what, "--effects", f"known: {', '.join(EFFECTS)}")
        if self.seed_of_arm < 0:
            raise BayescalError("a negative value makes no sense", "--arm-seed", "give 0 or more")
        if not 0 <= self.outliers < 0.5:
            raise BayescalError(f"{self.outliers:g} is no fraction of contacts", "--outliers", "0 to 0.5")
        if self.contacts < 16:
            raise BayescalError(f"{self.contacts} contacts are too few", "--contacts", "give 16 or more")
        if GROUP * self.repeats > self.contacts:
            what = f"{self.repeats} groups of {GROUP} are more than the {self.contacts} contacts"
            raise BayescalError(what, "--repeats", "give fewer repeats or more contacts")
        if self.spheres and self.placements and self.sphere_contacts < FEWEST_ON_SPHERE:
            what = f"{self.sphere_contacts} contacts cannot locate a sphere"
            raise BayescalError(what, "--sphere-contacts", f"give {FEWEST_ON_SPHERE} or more")
        if self.spheres > 8:
            raise BayescalError(
                f"{self.spheres} spheres are too many for one artefact", "--spheres", "give 8 or fewer"
            )


def flag(option: str) -> str:
    """Name of an option on the command line."""
    unit = {"noise": "-um", "joint_noise": "-deg"}.get(option, "")
    return f"--{option.replace('_', '-')}{unit}"


def stream(seed: int, *names: str) -> np.random.Generator:
    """An independent generator for each name, so that draws of one part do not change those of another."""
    words = [int.from_bytes(name.encode(), "little") for name in names]
    return np.random.default_rng(np.random.SeedSequence([seed, *words]))
