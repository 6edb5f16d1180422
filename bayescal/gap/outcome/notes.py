"""What a reader must know beside the figures, in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayescal.dataset import Dataset
from bayescal.effects import Driver
from bayescal.estimate import Estimate
from bayescal.gap.outcome.magnitude import stated_noise
from bayescal.gap.search.unknown import Found, Pool
from bayescal.gap.settings import OUTCOME
from bayescal.predict.crossvalidation import LEFT_OUT, HeldOut, kept

DIRECTED = ("backlash", "latency", "unknown")


def play_or_late(alone: tuple[Found, ...], pool: Pool, credible: tuple[str, ...]) -> tuple[str, ...]:
    """Play, or joints that were still on their way when they were read: which of the two the data favour.

    Play follows the sign of a joint's speed; a reading that was not settled, or a commanded one that the
    joint has not reached, errs by the speed itself.
    """
    if not set(credible) & set(DIRECTED):
        return ()
    gain = {(pool.cells[f.cell].site, pool.cells[f.cell].driver): f.gain for f in alone}
    out = []
    for (site, driver), by_sign in gain.items():
        by_speed = gain.get((site, Driver("joint speed", driver.joint)))
        if driver.kind != "direction" or by_speed is None or max(by_sign, by_speed) < OUTCOME.plain:
            continue
        apart = by_sign - by_speed
        if apart > OUTCOME.apart:
            says = f"by its sign, {apart:.0f} nats better than by its speed: play, not unsettled readings"
        elif apart < -OUTCOME.apart:
            says = (
                f"by its speed, {-apart:.0f} nats better than by its sign: readings not settled, or "
                "commanded, rather than play"
            )
        else:
            says = "by its sign or its speed: play or unsettled readings, these contacts cannot tell which"
        out.append((max(by_sign, by_speed), f"{site} errs with the way it turns, {says}"))
    return tuple(text for _, text in sorted(out, reverse=True)[:1])  # of the others, part is the first one's


def cautions(dataset: Dataset) -> Iterator[str]:
    """What the session's readings leave open."""
    if dataset.readings == "command":
        yield (
            "the readings are commanded, not measured: what servos do not reach looks like play (by the "
            "way of approach) or like compliance (by torque), and cannot be told from them"
        )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _noise(fitted: Estimate, held: HeldOut) -> np.ndarray:
    """Noise (R,) of held-out residuals alone, m: without what other contacts leave uncertain of each."""
    usual = {g: stated_noise(fitted, g) * s for g, s in fitted.weights.scale.items()}
    return np.array([usual.get(g, sd) for g, sd in zip(held.group, held.noise, strict=True)])


def warnings(before: Estimate, after: Estimate, first: HeldOut, last: HeldOut) -> tuple[str, ...]:
    """What weakens the figures."""
    out = []
    model, fair = after.model, kept(first, last)
    expected, noise = _rms(first.sd[fair]), _rms(_noise(before, first)[fair])
    if expected > OUTCOME.loose * noise:
        out.append(
            f"these contacts leave the arm uncertain: the model itself expects {1e6 * expected:.0f} um held "
            "out, and no gap below that shows"
        )
    if last is not first and _rms(last.residual[fair]) > OUTCOME.grown * _rms(first.residual[fair]):
        out.append(
            "held-out errors grow with what was added: it fits the calibrated rows alone, so do not build "
            "on it"
        )
    if first.how == LEFT_OUT:
        out.append("the session keeps too few contacts back: each was left out of the fit in turn instead")
    gross = int(np.sum(~fair))
    if gross:
        out.append(f"{gross} held-out residuals that neither model explains were left out as gross")
    if len(after.rejected):
        out.append(f"{len(after.rejected)} fitted contacts were left out as outliers")
    values = model.physical(after.z)
    negative = [p.name for p, v in zip(model.parameters, values, strict=False) if p.positive and v < 0]
    if negative:
        out.append(f"{', '.join(negative)}: negative, which is not physical; these contacts do not tell it")
    if not before.model.knows_length:
        out.append(
            "no certified length among the fitted targets: the arm's size rests on its tolerance priors"
        )
    return tuple(out)
