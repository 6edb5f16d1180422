"""Second forms of the effects of what touches and is touched: independent of the first."""

from __future__ import annotations

import numpy as np

from analysis.world.scene import FACES
from analysis.world.touch import Act, Moved, Seen, World


def lobing(rng: np.random.Generator, _w: World) -> Act:
    """Return three lobes with a share of another order: two (a bent stylus), four or six (its seats)."""
    order, share, phase = int(rng.choice([2, 4, 6])), rng.uniform(0.3, 0.7), rng.uniform(0, 2 * np.pi, 2)

    def move(seen: Seen, size: float, m: Moved) -> None:
        d = seen.push()
        side, around = np.hypot(d[:, 0], d[:, 1]), np.arctan2(d[:, 1], d[:, 0])
        lobes = np.cos(3 * around + phase[0]) + share * np.cos(order * around + phase[1])
        m.travel[:] += size * side * lobes

    also = ["tool", "stylus", "ball", "flange"]
    driver = "approach direction in the tool frame"
    where = [{"site": "probe", "driver": driver, "also": also, "effect": "lobing"}]
    detail = {"order": order, "share": share}
    return Act("lobing", where, "m", 8e-6, 3e-5, move, detail, form="another order")


def latency(rng: np.random.Generator, w: World) -> Act:
    """Return readings that a controller takes in cycles: from half to one and a half of the mean delay."""
    cycle = rng.uniform(0.5, 1.5, len(w.session.time))

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.lag[:] += size * cycle

    also = ["tool", "trigger", "velocity", "speed", "controller", "all joints"]
    where = [{"site": "probe", "driver": "velocity", "also": also, "effect": "latency"}]
    return Act("latency", where, "s", 2e-3, 6e-3, move, form="sampled in cycles")


def plane_form(rng: np.random.Generator, _w: World) -> Act:
    """Return one face with a wide elevation off its middle, longer one way than the other."""
    f, spot, wide = rng.integers(4), rng.uniform(-0.5, 0.5, 2), rng.uniform(0.45, 0.9, 2)
    sign = rng.choice([-1.0, 1.0])

    def move(seen: Seen, size: float, m: Moved) -> None:
        far = np.sum(((seen.on_face() - spot) / wide) ** 2, axis=1)
        m.height[:] += sign * size * np.exp(-far / 2) * (seen.session.target == f)

    also = [FACES[f][5:], f"target {FACES[f]}"]
    where = [{"site": FACES[f], "driver": "place on the face", "also": also, "effect": "plane-form"}]
    detail = {"face": FACES[f], "spot": spot.tolist(), "wide": wide.tolist()}
    return Act("plane-form", where, "m", 1e-5, 5e-5, move, detail, form="elevation")


def artefact(rng: np.random.Generator, _w: World) -> Act:
    """Return a cube of which one face alone is out of square, and none of the wrong size."""
    f, tilt = rng.integers(4), rng.standard_normal(2)
    tilt /= np.linalg.norm(tilt)

    def move(seen: Seen, size: float, m: Moved) -> None:
        h = 0.1143 * seen.on_face() @ tilt
        m.height[:] += 2 * size * h * (seen.session.target == f)

    also = ["cube.", "artefact", "certificate", *FACES]
    where = [{"site": "cube", "driver": "certificate", "also": also, "effect": "artefact"}]
    detail = {"face": FACES[f], "tilt": tilt.tolist()}
    return Act("artefact", where, "rad", 6e-5, 3e-4, move, detail, artefact=True, form="one face")
