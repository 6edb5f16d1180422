"""One log from its seed and number alone: an arm, its motions, something hidden, and the files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.world.motion import arms, mix, noise, plan, rig, size, write
from analysis.world.motion.log import GRAVITY, Act, Change, Log, rigid

SCHEMA = "motion-truth/1"
NOISE = 0.0040
"""Usual RMS of the torque's noise, as a share of the rated torque."""
MOVING = 0.02
"""Speed of the quickest joint above which a row counts as moving, rad/s."""
BASELINE = ["inertials", "armature", "coulomb", "viscous", "offset"]


@dataclass(frozen=True)
class Made:
    """A log: its files by name, its ground truth, and the hidden effects with their sizes."""

    texts: dict[str, str]
    truth: dict
    log: Log
    base: size.Baseline
    acts: list[tuple[Act, float]]
    drawn: arms.Arm


def make(
    seed: int,
    number: int,
    kinds: Sequence[str] = mix.KINDS,
    held_out: bool = False,
    motions: int = 0,
    length: float = 0.0,
    causes: str = "",
    outside: float = mix.SHARE,
) -> Made:
    """Make a log.

    Parameters
    ----------
    seed, number : int
        The same seed gives the same set of logs; no log depends on another.
    kinds : sequence of str
        Of `mix.KINDS`, those that are made.
    held_out : bool
        With the reserved forms and causes.
    motions, length : int, float
        Number of motions and their duration (s); by default drawn.
    causes, outside : str, float
        As `mix.recipe`.
    """
    rng = np.random.default_rng([seed, 0, number])
    what = mix.recipe(seed, number, kinds, held_out, causes, outside)
    wanted = mix.wishes(rng, what.names)
    drawn = arms.nominal(rng, str(rng.choice(tuple(arms.SORTS), p=[0.4, 0.25, 0.2, 0.15])))
    arm = arms.true(rng, drawn)
    made = rig.draw(rng, drawn, wanted)
    session, command = rig.follow(plan.plan(rng, drawn, wanted, motions, length), made)
    turbulence = noise.draw(rng, NOISE * drawn.rated)
    body, columns = rigid(arm, session, GRAVITY)
    still = replace(session, dq=0 * session.q, ddq=0 * session.q)
    offset = 0.01 * drawn.rated * rng.standard_normal(arm.size)
    torque = body + arm.armature * session.ddq + arm.friction(session.dq) + offset
    log = Log(
        arm=arm,
        session=session,
        noise=turbulence,
        torque=torque,
        rigid=body,
        still=rigid(arm, still, GRAVITY)[0],
        stiffness=made.stiffness if made.servo else None,
        current=made.current,
        u_constant=rig.U_CONSTANT,
        u_alignment=rig.U_ALIGNMENT,
        gravity=GRAVITY,
    )
    base = size.baseline(log, columns, drawn)
    found = [_sized(rng, maker, base, log) for maker in what.makers]
    acts = [(act, amount) for act, amount, _ in found]
    change = total(log, [log.seen(act, amount) for act, amount in acts])
    disturbance = noise.sampled(rng, turbulence, session.runs, session.step)
    alignment = float(rig.U_ALIGNMENT * np.clip(rng.standard_normal(), -2, 2))
    measured = log.at(np.full(len(session.time), alignment)) + change.torque + disturbance
    name = f"motion log {number:03d}"
    stated = turbulence.rms * rng.uniform(0.78, 1.28)
    texts = {
        "dataset.yaml": write.dataset_text(name, drawn, session, rig.notes(made, stated)),
        "motion.csv": write.motion_table(session, rig.columns(rng, log, made, measured, command, change)),
    }
    read = made.constant / made.true_constant if made.current else np.ones(arm.size)
    truth = _truth(base, what, found, change, disturbance, read) | {"seed": seed, "alignment_s": alignment}
    truth = {"world": f"{number:03d}", "schema": SCHEMA} | truth
    truth["session"] = session.notes | {
        "arm": drawn.name,
        "servo": made.servo,
        "current": made.current,
        "link": made.link,
    }
    truth["true_inertials"] = [round(float(v), 6) for v in arm.parameters]
    return Made(texts, plain(truth), log, base, acts, drawn)


def total(log: Log, changes: Sequence[Change]) -> Change:
    """Return the sum of changes."""
    none = np.zeros_like(log.torque)

    def added(key: str) -> np.ndarray:
        return sum((v for c in changes if (v := getattr(c, key)) is not None), none)

    return Change(added("torque"), added("link"), added("track"))


def _sized(
    rng: np.random.Generator, maker: mix.Maker, base: size.Baseline, log: Log
) -> tuple[Act, float, dict]:
    """Draw an effect and its size for a wanted lambda; again where no possible size has it."""
    goal = float(np.exp(rng.uniform(*np.log(mix.GOAL))))
    best: tuple[Act, float, dict] | None = None
    for _ in range(5):
        act = maker(rng, log)
        amount = size.solved(base, act, act.usual, act.most, goal)
        parts = size.detectability(base, log.seen(act, amount))
        note = {"goal": goal, "value": sum(parts.values()), "parts": parts}
        if best is None or note["value"] > best[2]["value"]:
            best = (act, amount, note)
        if best[2]["value"] > 0.98 * goal:
            break
    assert best is not None
    return best


def _truth(
    base: size.Baseline,
    what: mix.Recipe,
    found: list,
    change: Change,
    disturbance: np.ndarray,
    read: np.ndarray,
) -> dict:
    """Return the hidden effects, their detectability and the RMS of the validation torques.

    With stated torque constants, a torque is read as `read` times the true one (n,).
    """
    log, s = base.log, base.log.session
    rows = s.rows("validate") & (np.max(np.abs(s.dq), axis=1) > MOVING)
    outside = what.kind == "outside"
    names = [act.name for act, _, _ in found]
    each = {act.name: note["value"] for act, _, note in found}
    both = change.torque + disturbance
    rest = {
        "oracle": disturbance,
        "baseline": base.residual(both, base.absorbed(both)),
        "baseline_noise_free": base.residual(change.torque, base.absorbed(change.torque)),
    }
    turbulence = log.noise
    return {
        "kind": what.kind,
        "effects": ["unknown"] if outside else names,
        "outside": names[0] if outside else None,
        "form": {act.name: act.form for act, _, _ in found},
        "where": [w for act, _, _ in found for w in act.where],
        "lambda": {
            "value": min(each.values(), default=0.0),
            "each": each,
            "total": sum(size.detectability(base, change).values()),
            "parts": {act.name: note["parts"] for act, _, note in found},
        },
        "lambda_goal": {act.name: note["goal"] for act, _, note in found},
        "amplitude": {act.name: {"value": amount, "unit": act.unit} for act, amount, _ in found},
        "effect_parameters": {act.name: act.detail for act, _, _ in found},
        "baseline": BASELINE + (["torque-constant"] if log.current else []),
        "rate_hz": s.rate,
        "motions": len(s.motions),
        "rows": len(s.time),
        "noise": {
            "torque_rms_Nm": turbulence.rms,
            "slow_share": turbulence.slow,
            "fast_s": turbulence.fast_s,
            "slow_s": turbulence.slow_s,
        },
        "torque_rms_Nm": {k: read * np.sqrt(np.mean(v[rows] ** 2, axis=0)) for k, v in rest.items()},
    }


def plain(value: Any) -> Any:
    """Return a value as JSON knows it, to six digits."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return float(f"{value:.6g}") if isinstance(value, float) else value
