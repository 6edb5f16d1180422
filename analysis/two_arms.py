"""Two arms that touch: sessions of a simulator of its own (`analysis.world.two_arms`), fitted and diagnosed.

    python -m analysis.two_arms [sessions] [first seed]

Of each session: error of the validation contacts before and after, the share of them within the stated 95 %
intervals, the hidden effect and the verdict. A third of the sessions has no effect; in the others a joint of
either arm has an error once per revolution. In every other session the ball also sits in seats on the cube.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

import bayescal as bc
from analysis.world import two_arms

MODEL = "geometry,compliance"
SIZES = (5e-5, 2e-4)  # rad


def session(seed: int, folder: Path) -> tuple[int, float]:
    """Write the files of a session; the joint with the effect, in the order of the chain, and its size.

    No joint is 0.
    """
    rng = np.random.default_rng([seed, 5])
    hidden, joint, size = {}, 0, 0.0
    if seed % 3:
        joint, size = int(rng.integers(1, 13)), float(np.exp(rng.uniform(*np.log(SIZES))))
        name = f"left_j{7 - joint}" if joint < 7 else f"right_j{joint - 6}"
        hidden = {"waves": {name: (size, float(rng.uniform(0, 6.28)))}}
    for name, text in two_arms.make(seed, seats=bool(seed % 2), **hidden)[0].items():
        (folder / name).write_text(text)
    return joint, size


def main(count: int = 12, first: int = 100) -> None:
    """Print a line a session, and the sums."""
    inside, contacts = 0.0, 0
    for seed in range(first, first + count):
        with tempfile.TemporaryDirectory() as name:
            joint, size = session(seed, Path(name))
            gap = bc.diagnose(name).record
            model = gap["refit"]["model"] if gap["refit"] else MODEL
            fitted = bc.fit(name, model=model, samples=0).record
        planes = fitted["validation"]["planes"]
        mine = sum(f["inside95_fraction"] * f["count"] for f in planes)
        inside, contacts = inside + mine, contacts + sum(f["count"] for f in planes)
        squares, counts = [f["calibrated_rms_um"] ** 2 for f in planes], [f["count"] for f in planes]
        left = np.sqrt(np.average(squares, weights=counts))
        found = ", ".join(f"{n['effect']} at {n['site']} ({n['probability']:.2f})" for n in gap["named"])
        hidden = f"joint {joint}, {1e6 * size:.0f} µrad" if joint else "no effect"
        print(f"{seed}: {hidden}: {gap['verdict']}: {found or '-'}; validation {left:.1f} µm")
    print(f"within 95 %: {inside / contacts:.3f} of {contacts} contacts")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
