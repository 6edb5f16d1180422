"""Sessions with causes that are not in the list of known effects, made up by the simulator of bayescal.

Each displaces a site by one unknown number times a driver, as an effect does, but by a driver that no effect
has: products of two quantities, memory, chance. The detectability is set, as `bayescal gap` defines it.
``python -m analysis.made_up OUT --seed 500`` writes `OUT/NNN` and `OUT/truth/NNN.json`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from bayescal.arm.chain import frames
from bayescal.arm.motion import CONTACT, Term
from bayescal.dataset import Dataset
from bayescal.effects import EFFECTS, Circumstances, Effect, Parameter, register
from bayescal.effects.common import usual
from bayescal.effects.location import BASE, PROBE, TOOL, Driver, Site, joint
from bayescal.estimate import calibrated
from bayescal.gap.linear.problem import Slopes
from bayescal.gap.linear.state import fit_state
from bayescal.gap.outcome.where import unabsorbed
from bayescal.model import FitOptions
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate
from bayescal.simulation.record import write

BASELINE = ("geometry", "compliance")
LAMBDAS = (60.0, 250.0, 800.0)
LEVER = 0.1
"""Metres that count as a radian."""
Motion = tuple[int, str, np.ndarray]
Cause = tuple[Site, Callable[[Circumstances], list[Motion]]]


def load(c: Circumstances, j: int) -> np.ndarray:
    """Torque (N,) of a joint over its usual one."""
    assert c.torques is not None
    return c.torques[:, j - 1] / usual(c, c.torques[:, j - 1])


def sign(c: Circumstances, j: int) -> np.ndarray:
    """Direction of motion (N,) of a joint."""
    assert c.velocity is not None
    return c.velocity[:, j - 1] / np.hypot(c.velocity[:, j - 1], 5e-4)


def down(c: Circumstances) -> np.ndarray:
    """Direction of gravity in the frame of the flange, (N, 3)."""
    turned = frames(c.chain, c.q)[:, -1, :3, :3]
    return turned.swapaxes(1, 2) @ (c.gravity / np.linalg.norm(c.gravity))


def standard(x: np.ndarray) -> np.ndarray:
    """Without its mean, and of standard deviation 1."""
    return (x - x.mean()) / max(float(x.std()), 1e-9)


def remembered(x: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """State (N,) that forgets all but a share `keep` (N,) at each row, and adds x (N,)."""
    out, state = np.empty(len(x)), 0.0
    for k in range(len(x)):
        state = state * keep[k] + x[k]
        out[k] = state
    return out


def within(x: np.ndarray, width: float) -> np.ndarray:
    """Position (N,) from -1 to 1 in lost motion of some width, along x (N,)."""
    out, state = np.zeros(len(x)), 0.0
    for k in range(1, len(x)):
        state = float(np.clip(state + 2 * (x[k] - x[k - 1]) / width, -1, 1))
        out[k] = state
    return out


def _loaded_friction(c: Circumstances) -> list[Motion]:
    return [(3, "rz", sign(c, 3) * np.abs(load(c, 3)))]


def _one_sided_friction(c: Circumstances) -> list[Motion]:
    return [(2, "rz", sign(c, 2) * (0.2 + np.clip(load(c, 2), 0, None)))]


def _loose_stylus(c: Circumstances) -> list[Motion]:
    tool, g = c.chain.n + 1, down(c)
    return [(tool, axis, LEVER * np.tanh(g[:, k] / 0.2)) for k, axis in enumerate(("tx", "ty"))]


def _sagging_flange(c: Circumstances) -> list[Motion]:
    tool, g = c.chain.n + 1, down(c)
    return [(tool, "tx", LEVER * g[:, 0]), (tool, "tz", -0.7 * LEVER * g[:, 2] * np.abs(g[:, 0]))]


def _warming_tool(c: Circumstances) -> list[Motion]:
    return [(c.chain.n + 1, "tz", LEVER * (1 - np.exp(-np.arange(len(c.q)) / 70)))]


def _docking_base(c: Circumstances) -> list[Motion]:
    visit = np.arange(len(c.q)) // 45
    x = np.random.default_rng(5).normal(size=(visit.max() + 1, 3))[visit]
    return [(0, axis, LEVER * x[:, k]) for k, axis in enumerate(("tx", "ty", "rz"))]


def _loaded_lag(c: Circumstances) -> list[Motion]:
    assert c.velocity is not None
    return [(3, "rz", standard(c.velocity[:, 2]) * load(c, 3))]


def _twisted_cable(c: Circumstances) -> list[Motion]:
    x = c.readings[:, 3] + c.readings[:, 5]
    return [(5, "rz", np.tanh((x - np.median(x)) / 0.4) * np.abs(np.sin(c.readings[:, 4])))]


def _warming_gear(c: Circumstances) -> list[Motion]:
    time = 20.0 * np.arange(len(c.q)) if c.time is None else c.time
    way = np.abs(np.diff(c.readings[:, 1], prepend=c.readings[0, 1]))
    return [(2, "rz", standard(remembered(way, np.exp(-np.diff(time, prepend=time[0]) / 700.0))))]


def _slipping_brake(c: Circumstances) -> list[Motion]:
    change = np.diff(load(c, 2), prepend=load(c, 2)[0])
    slips = np.cumsum(np.sign(change) * (np.abs(change) > np.quantile(np.abs(change), 0.93)))
    return [(2, "rz", standard(np.sign(slips) * np.sqrt(np.abs(slips))))]


def _hanging_trigger(c: Circumstances) -> list[Motion]:
    g, way = down(c), np.where(np.isnan(c.approach), 0.0, c.approach)
    return [(CONTACT, "normal", LEVER * np.sum(way * g, axis=1) * np.abs(g[:, 2]))]


def _uneven_floor(c: Circumstances) -> list[Motion]:
    return [(0, "rx", np.cos(2 * c.q[:, 0])), (0, "ry", 0.6 * np.sin(2 * c.q[:, 0]))]


def _base_play(c: Circumstances) -> list[Motion]:
    assert c.moments is not None
    moment = c.moments[:, 0, 0]
    return [(0, "rx", within(moment, 1.2 * float(np.std(moment))))]


def _snapping_link(c: Circumstances) -> list[Motion]:
    assert c.loads is not None
    return [(3, "ry", np.tanh(standard(c.loads.moments[:, 3, 1]) / 0.1))]


def _soft_at_an_angle(c: Circumstances) -> list[Motion]:
    x = load(c, 4)
    return [(4, "rz", np.sign(x) * np.abs(x) ** 0.4 * np.cos(c.q[:, 3]) ** 2)]


CAUSES: dict[str, Cause] = {
    "loaded-friction": (joint(3), _loaded_friction),
    "one-sided-friction": (joint(2), _one_sided_friction),
    "loose-stylus": (TOOL, _loose_stylus),
    "sagging-flange": (TOOL, _sagging_flange),
    "warming-tool": (TOOL, _warming_tool),
    "docking-base": (BASE, _docking_base),
    "loaded-lag": (joint(3), _loaded_lag),
    "twisted-cable": (joint(5), _twisted_cable),
    "warming-gear": (joint(2), _warming_gear),
    "slipping-brake": (joint(2), _slipping_brake),
    "hanging-trigger": (PROBE, _hanging_trigger),
    "uneven-floor": (BASE, _uneven_floor),
    "base-play": (BASE, _base_play),
    "snapping-link": (joint(3), _snapping_link),
    "soft-at-an-angle": (joint(4), _soft_at_an_angle),
}
"""Site and motion of each cause."""


def effect_of(name: str, size: float) -> Effect:
    """A cause as an effect of one parameter, whose prior is its size (rad)."""
    site, motions = CAUSES[name]

    def parameters(c: Circumstances) -> list[Parameter]:
        terms = tuple(Term(*motion) for motion in motions(c))
        where = {"site": site, "driver": Driver("made up")}
        return [Parameter("made up", "rad", terms, 1e-3 * size, mean=size, **where)]

    return Effect("made-up", "a cause that is not in the list", parameters)


def detectability(dataset: Dataset, effect: Effect, size: float) -> float:
    """Lambda of a cause in a session: the square of what the baseline does not absorb, over the noise."""
    fitted = calibrated(Scene(dataset, oriented=True), BASELINE, FitOptions(robust=False))
    scene = fitted.model.scene
    (parameter,) = effect.at(scene.circumstances(scene.rows("calibrate")))
    problem = Slopes.of(fitted).problem(fitted.z, [parameter], ())
    state = fit_state(problem, (), (), robust=False)
    return float(np.sum(unabsorbed(state, problem.pool[:, 0] / parameter.sd * size) ** 2))


def made(folder: Path, seed: int, number: int) -> str:
    """Write one session and its truth; returns a line that describes it."""
    name = list(CAUSES)[number // len(LAMBDAS)]
    rng = np.random.default_rng([seed, number])
    wanted, size = LAMBDAS[number % len(LAMBDAS)] * rng.uniform(0.7, 1.4), 1e-5
    options = Options(
        effects=(*BASELINE, "made-up"), seed=seed + number, contacts=int(rng.integers(280, 420)), later=40,
        noise=8e-6, outliers=0.01,
    )  # fmt: skip
    for _ in range(3):
        effect = effect_of(name, size)
        register(effect)
        try:
            session = simulate(options)
        finally:
            EFFECTS.unregister("made-up")
        found = detectability(session.dataset, effect, size)
        if abs(np.log(found / wanted)) < 0.1:
            break
        size *= float(np.sqrt(wanted / found))
    write(session, folder / f"{number:03d}")
    (folder / f"{number:03d}" / "baseline.txt").write_text(",".join(BASELINE), encoding="utf-8")
    where = [{"site": str(CAUSES[name][0]), "driver": name}]
    truth = {"kind": "outside", "effects": ["unknown"], "outside": name, "where": where}
    text = json.dumps(truth | {"lambda": {"value": found}})
    (folder / "truth" / f"{number:03d}.json").write_text(text, encoding="utf-8")
    return f"{number:03d} {name} lambda {found:.0f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Write all sessions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args(arguments)
    (asked.folder / "truth").mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(asked.workers) as pool:
        for line in pool.map(partial(made, asked.folder, asked.seed), range(len(CAUSES) * len(LAMBDAS))):
            print(line, flush=True)


if __name__ == "__main__":
    main()
