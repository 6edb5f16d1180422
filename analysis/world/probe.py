"""Effects of what touches and is touched: lobes and delay of the trigger, faces not flat or not square."""

from __future__ import annotations

import numpy as np

from analysis.world.scene import FACES
from analysis.world.touch import Act, Moved, Seen, World


def lobing(rng: np.random.Generator, _w: World) -> Act:
    """Return a stylus on three seats of unequal stiffness: it tips over the nearest two."""
    seats = rng.uniform(0, 6.28) + np.array([0, 2, 4]) * np.pi / 3 + rng.uniform(-0.08, 0.08, 3)
    stiff, rise = rng.uniform(0.8, 1.2, 3), rng.uniform(0.8, 1.6)

    def move(seen: Seen, size: float, m: Moved) -> None:
        d = seen.push()
        side, around = np.hypot(d[:, 0], d[:, 1]), np.arctan2(d[:, 1], d[:, 0])
        tip = 1 / np.max(stiff * np.cos(around[:, None] - seats), axis=1)
        m.travel[:] += size * (tip - 1.35) * side**rise

    also = ["tool", "stylus", "ball", "flange"]
    where = [
        {"site": "probe", "driver": "approach direction in the tool frame", "also": also, "effect": "lobing"}
    ]
    return Act("lobing", where, "m", 8e-6, 3e-5, move, {"seats": seats.tolist(), "stiff": stiff.tolist()})


def latency(rng: np.random.Generator, w: World) -> Act:
    """Return readings taken late, by a time that is not quite the same."""
    shake = rng.uniform(0.02, 0.08) * rng.standard_normal(len(w.session.time))

    def move(seen: Seen, size: float, m: Moved) -> None:
        del seen
        m.lag[:] += size * (1 + shake)

    also = ["tool", "trigger", "velocity", "speed", "controller", "all joints"]
    where = [{"site": "probe", "driver": "velocity", "also": also, "effect": "latency"}]
    return Act("latency", where, "s", 2e-3, 6e-3, move, {"shake": float(np.std(shake))})


def plane_form(rng: np.random.Generator, _w: World) -> Act:
    """Return one face bowed, saddled and twisted, with a trace of a third order."""
    f, mix = rng.integers(4), rng.standard_normal(3)
    mix /= np.linalg.norm(mix)
    wave = rng.uniform(-0.15, 0.15, 2)

    def move(seen: Seen, size: float, m: Moved) -> None:
        u, v = seen.on_face().T
        bow, saddle, twist = u * u + 0.4 * v * v, u * u - v * v, u * v
        h = mix[0] * bow + mix[1] * saddle + 2 * mix[2] * twist + wave[0] * u**3 + wave[1] * v**3
        m.height[:] += size * h * (seen.session.target == f)

    also = [FACES[f][5:], f"target {FACES[f]}"]
    where = [{"site": FACES[f], "driver": "place on the face", "also": also, "effect": "plane-form"}]
    return Act("plane-form", where, "m", 1e-5, 5e-5, move, {"face": FACES[f], "mix": mix.tolist()})


def artefact(rng: np.random.Generator, _w: World) -> Act:
    """Return a cube with certified values in error, beyond the stated uncertainty."""
    tilt, size_of = rng.standard_normal((4, 2)), 0.04 * rng.standard_normal(4)

    def move(seen: Seen, size: float, m: Moved) -> None:
        f = np.minimum(seen.session.target, 3)
        h = 0.1143 * np.sum(tilt[f] * seen.on_face(), axis=1) + size_of[f]
        m.height[:] += size * h * (seen.session.target < 4)

    also = ["cube.", "artefact", "certificate", *FACES]
    where = [{"site": "cube", "driver": "certificate", "also": also, "effect": "artefact"}]
    detail = {"tilt": tilt.tolist(), "size": size_of.tolist()}
    return Act("artefact", where, "rad", 6e-5, 3e-4, move, detail, artefact=True)
