"""Statements of a diagnosis as text: warnings, and what the data leave undecided.

Amplitudes of the named effects, with standard uncertainty, from the parameters of the refit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.assess import images
from bayescal.assess.undetermined import Undetermined
from bayescal.dataset import Dataset
from bayescal.dataset.consistency import copies, rounded
from bayescal.effects import EFFECTS, UNITS, Driver, Parameter, Site
from bayescal.effects.location import ARM as WHOLE
from bayescal.effects.location import CONSTANT, DEVIATION, Value, propagated
from bayescal.effects.selection import Selection
from bayescal.estimate import Estimate
from bayescal.estimate.unexplained import stated_noise
from bayescal.gap.linear.problem import without_nuisance
from bayescal.gap.linear.state import State, fit_state
from bayescal.gap.outcome.magnitude import difference, log_predictive
from bayescal.gap.result import TOGETHER, Amplitude, Named
from bayescal.gap.search.unknown import CellFit, Pool
from bayescal.gap.settings import OUTCOME
from bayescal.model import ARM
from bayescal.predict.crossvalidation import IMAGES_LEFT_OUT, LEFT_OUT
from bayescal.predict.errors import ValidationErrors, by_points, kept
from bayescal.statistics import chi2_sf, rms


def displaced(arm: Estimate, complete: Estimate, covariance: np.ndarray | None) -> tuple[str, ...]:
    """The parameter of an arm that its fit with all named effects displaces most, in words; none if little.

    Parameters
    ----------
    arm, complete : Estimate
        Without some of the named effects, and with all of them.
    covariance : np.ndarray, shape (D, D), or None
        The stated covariance of the z of `arm`.
    """
    if complete is arm or covariance is None:
        return ()
    part, parameters = arm.model.slices[ARM], arm.model.parameters
    values = dict(zip(complete.model.names, complete.model.physical(complete.z).tolist(), strict=True))
    before = arm.model.physical(arm.z)[part]
    change = np.array([values.get(p.name, v) for p, v in zip(parameters, before, strict=True)]) - before
    u = arm.model.sd * np.sqrt(np.diag(covariance)[part])
    k = int(np.argmax(np.abs(change) / u))
    if abs(change[k]) <= OUTCOME.displaced * u[k]:
        return ()
    unit, by = UNITS[parameters[k].unit]
    ratio = abs(change[k]) / u[k]
    return (f"{parameters[k].name} by {by * change[k]:.3g} {unit}, {ratio:.0f} standard uncertainties",)


def play_or_late(alone: tuple[CellFit, ...], pool: Pool, credible: tuple[str, ...]) -> tuple[str, ...]:
    """Backlash or readings that were not settled: which of the two the data favour.

    Backlash follows the sign of the speed of a joint. The error of a reading that was not settled, or of a
    commanded position that the joint has not reached, follows the speed itself. An unmodelled effect is
    either only if no other location explains more.
    """
    gain = {(pool.cells[f.cell].site, pool.cells[f.cell].driver): f.gain for f in alone}
    least = OUTCOME.plain
    if not any(name in EFFECTS and EFFECTS[name].directed for name in credible):
        if "unknown" not in credible:
            return ()
        least = max(least, max(gain.values(), default=0.0) - OUTCOME.apart)
    out = []
    for (site, driver), by_sign in gain.items():
        by_speed = gain.get((site, Driver("joint speed", driver.joint)))
        if driver.kind != "direction" or by_speed is None or max(by_sign, by_speed) < least:
            continue
        apart = by_sign - by_speed
        if apart > OUTCOME.apart:
            says = f"its sign fits {apart:.0f} nats better than its speed: backlash, not a settling error"
        elif apart < -OUTCOME.apart:
            says = (
                f"its speed fits {-apart:.0f} nats better than its sign: a settling error or commanded "
                "readings, not backlash"
            )
        else:
            says = "backlash (sign) and a settling error (speed) are not distinguishable"
        out.append(
            (max(by_sign, by_speed), f"the error of {site} depends on its direction of motion; {says}")
        )
    return tuple(text for _, text in sorted(out, reverse=True)[:1])  # other errors may follow from this


def cautions(dataset: Dataset) -> Iterator[str]:
    """Joints of two arms, and limitations by the kind of readings."""
    if dataset.robot.two_arms:
        yield dataset.robot.two_arms
    if dataset.readings == "command":
        yield (
            "the readings are commanded, not measured: servo errors are not distinguishable from backlash "
            "(direction of motion) and compliance (torque)"
        )


BY_MASSES = 25.0
"""Nats that errors of masses gain, from which on they are stated (tuned: sessions of noise only by another
author have up to 19 whose masses are right; with wrong masses there are 14 to 97)."""
DETERMINED = 3.0
"""Standard uncertainties of an error of a mass from which on it is stated by itself (convention)."""


def wrong_masses(state: State, masses: Sequence[Parameter]) -> str:
    """What errors of the stated masses explain beside a hypothesis, which includes them; "" if little.

    Parameters
    ----------
    state : State
        The hypothesis, with the errors of masses last among the columns of its model.
    masses : sequence of Parameter
        Those errors.
    """
    if not masses:
        return ""
    p, size = state.problem, len(state.problem.z) - len(masses)
    bare = without_nuisance(p, size)
    fits = [fit_state(bare, state.columns, state.scales, w, state.robust) for w in (None, state.weight)]
    as_stated = max(fits, key=lambda fit: fit.log_evidence)
    gained = state.log_evidence - as_stated.log_evidence
    if gained < BY_MASSES:
        return ""
    kept = (state.weight[: p.lengths] > 0) & (as_stated.weight[: p.lengths] > 0)
    before, after = (1e6 * rms(p.metres(fit.residual)[kept]) for fit in (as_stated, state))
    last = slice(size, len(p.z))
    z, u = (p.z + state.step[: len(p.z)])[last], np.sqrt(np.diag(state.covariance)[last])
    k = int(np.argmax(np.abs(z) / u))
    unit, by = ("%", 100.0) if masses[k].unit == "1" else UNITS[masses[k].unit]
    by, most = by * masses[k].sd, ""
    if abs(z[k]) > DETERMINED * u[k]:
        most = f" (most clearly one of {by * z[k]:.2g} ± {by * u[k]:.1g} {unit}: {masses[k].name})"
    return (
        f"with errors of the stated masses and centres of mass{most}, residuals of {before:.3g} µm RMS are "
        f"{after:.3g}, {gained:.0f} nats more probable: they are wrong, or what else follows gravity as they "
        "do; the arm is fitted with them as stated: weigh the tool, and find its centre of mass"
    )


def _noise(fitted: Estimate, held: ValidationErrors) -> np.ndarray:
    """Noise (R,) of validation residuals, m, without the uncertainty of the parameters."""
    usual = {g: stated_noise(fitted, g) * s for g, s in fitted.weights.scale.items()}
    return np.array([usual.get(g, sd) for g, sd in zip(held.group, held.noise, strict=True)])


@dataclass(frozen=True)
class Change:
    """How validation errors change by named effects: the RMS weights all rows alike, the density by its u."""

    before: float  # m, RMS of the residuals that are gross under one model at most
    after: float
    nats: float  # of log density
    u: float

    @classmethod
    def of(cls, first: ValidationErrors, last: ValidationErrors) -> Change:
        """That from one model to another."""
        fair, (density, block) = kept(first, last), log_predictive(last)
        before, after = (rms(held.residual[fair], of_none=0.0) for held in (first, last))
        return cls(before, after, *difference(density - log_predictive(first)[0], block))

    @property
    def increased(self) -> bool:
        """Whether errors increase."""
        return self.after > OUTCOME.grown * self.before

    @property
    def significant(self) -> bool:
        """Whether the density changes by more than its uncertainty, also where a single block has none."""
        return not abs(self.nats) <= OUTCOME.risen * self.u

    @property
    def refuted(self) -> bool:
        """Whether errors increase, and their density falls significantly."""
        return self.increased and self.significant and self.nats <= 0

    @property
    def sizes(self) -> str:
        """The errors in words."""
        return f"from {1e6 * self.before:.3g} to {1e6 * self.after:.3g} µm RMS per coordinate"


def increased(first: ValidationErrors, last: ValidationErrors) -> Iterator[str]:
    """Whether validation errors increase with the named effects, and whether their density falls then."""
    change = Change.of(first, last)
    if not change.increased:
        return
    if change.refuted:
        yield (
            f"validation errors increase with the named effects, {change.sizes}: these describe the "
            "calibration rows only, and the arm is without them"
        )
    elif change.significant:
        fair = kept(first, last)
        was, now = rms(first.sd[fair], of_none=0.0), rms(last.sd[fair], of_none=0.0)
        yield (
            f"validation errors increase with the named effects, {change.sizes}, but so does their log "
            f"density, by {change.nats:.0f} nats: it weights each error by its predicted uncertainty (RMS "
            f"{1e6 * was:.3g} µm, with the effects {1e6 * now:.3g} µm); the effects do not reduce errors "
            "everywhere"
        )
    else:
        yield (
            f"validation errors do not decrease with the named effects ({change.sizes}); the change of "
            f"their log density, {change.nats:+.1f} nats, is within its uncertainty of {change.u:.1f}"
        )


def warnings(
    before: Estimate,
    after: Estimate,
    first: ValidationErrors,
    last: ValidationErrors,
    lacking: Sequence[Undetermined] = (),
    unsure: Sequence[int] = (),
) -> Iterator[str]:
    """Limitations of the results; `lacking` is what `after` leaves undetermined.

    `unsure` are rows that may be before a sudden change or after it.
    """
    if count := int(np.sum(np.isin(before.model.scene.rows("validate"), unsure))):
        lie = "validation rows lie" if count > 1 else "validation row lies"
        yield f"{count} {lie} within the interval of a sudden change: its most probable row there is used"
    fair = kept(first, last)
    expected, noise = rms(first.sd[fair], of_none=0.0), rms(_noise(before, first)[fair], of_none=0.0)
    if expected > OUTCOME.loose * noise:
        yield (
            f"the parameters are uncertain: the model expects a validation RMS of {1e6 * expected:.0f} µm, "
            "and effects below that are not visible"
        )
    if last is not first:
        yield from increased(first, last)
    if first.how in (LEFT_OUT, IMAGES_LEFT_OUT):
        yield f"no or too few validation measurements: {first.how} is used instead"
    if gross := len(np.unique(first.rows[~fair])):
        every = len(np.unique(first.rows))
        was = "were" if gross > 1 else "was"
        yield (
            f"{gross} of {every} validation measurements {was} excluded as gross under both models; "
            "a fit counts them in its validation errors"
        )
    if count := len(after.rejected):
        was = "rows were excluded as outliers" if count > 1 else "row was excluded as an outlier"
        yield f"{count} calibration {was}"
    yield from (board.words for board in images.displaced(after))
    dataset = before.model.scene.dataset
    yield from filter(None, (images.blurred(before), copies(dataset), rounded(dataset)))
    yield from (u.words for u in lacking if u.matters)
    if not before.model.knows_length:
        yield "no certified length among the fitted targets: the scale of the arm is determined by its prior"


def amplitudes(final: Estimate, covariance: np.ndarray, named: Sequence[Named]) -> tuple[Amplitude, ...]:
    """Amplitudes of every named effect at each of its sites, the effects in order.

    Parameters
    ----------
    final : Estimate
        The refit with all named effects.
    covariance : np.ndarray, shape (D, D)
        Stated covariance of its z.
    named : sequence of Named

    Notes
    -----
    The amplitude of k parameters is significant where x' C^-1 x exceeds the quantile of chi-squared, of k
    degrees of freedom, at `OUTCOME.significant` over the number of amplitudes of the effect. Where none is,
    and all parameters of the effect together are, their displacement of the TCP is one more.
    """
    return tuple(a for n in named for a in _of(final, covariance, Selection.read(n.model)))


def _of(final: Estimate, covariance: np.ndarray, asked: Selection) -> Iterable[Amplitude]:
    model = final.model
    count = len(model.parameters)
    values = model.deviations(final.z[:count])
    covariance = covariance[:count, :count] * np.outer(model.sd, model.sd)
    effect, robot = EFFECTS[asked.effect], model.scene.dataset.robot
    groups, clear = list(_groups(model.parameters, asked.among(model.parameters))), False
    for (site, driver, unit), index in groups:
        size = effect.sizes.get(unit, DEVIATION)
        x, c = values[index], covariance[np.ix_(index, index)]
        value, u = propagated(size.value, x, c)
        if not size.joins and model.parameters[index[0]].positive:
            value = value + model.parameters[index[0]].nominal
        p = float(chi2_sf(x @ np.linalg.solve(c, x), len(x)))
        phase = None if size.phase is None or len(x) != 2 else phase_shown(size.phase, x, c, driver, robot)
        names, here = tuple(model.parameters[k].name for k in index), p * len(groups) < OUTCOME.significant
        clear = clear or here
        yield Amplitude(asked.effect, site, driver, names, size.what, value, u, unit, phase, here)
    every = [k for _, index in groups for k in index]
    if not clear and len(groups) > 1:
        yield from _together(final, asked.effect, every, values[every], covariance[np.ix_(every, every)])


def _together(
    final: Estimate, effect: str, every: list[int], x: np.ndarray, c: np.ndarray
) -> Iterable[Amplitude]:
    """What all parameters of an effect do at the fitted measurements, where only all together are clear.

    The root mean square of the displacements J x of the TCP: a sum is determined whose parts are not.
    """
    if float(chi2_sf(x @ np.linalg.solve(c, x), len(x))) >= OUTCOME.significant:
        return
    motion = final.model.motion(np.unique(np.concatenate([b.rows for b in final.model.blocks])))
    deviations = final.model.deviations(final.z[: len(final.model.parameters)])
    by = by_points(motion, deviations, motion.points(deviations))[:, every]
    if not np.any(by):  # of a contact or a certificate
        return
    square = np.einsum("apn,aqn->pq", by, by) / by.shape[2]
    value = float(np.sqrt(x @ square @ x))
    u = float(np.sqrt(x @ square @ c @ square @ x)) / value
    parameters = [final.model.parameters[k] for k in every]
    sites, names = {p.site for p in parameters}, tuple(p.name for p in parameters)
    site = sites.pop() if len(sites) == 1 else WHOLE
    yield Amplitude(effect, site, CONSTANT, names, TOGETHER, value, u, "m", None, True)


def phase_shown(
    of: Callable[[np.ndarray], Value], x: np.ndarray, c: np.ndarray, driver: Driver, robot: Robot
) -> tuple[float, float]:
    """Phase of a wave by the reading that the controller shows, with u, rad; its parameters are by the link.

    Where the joint turns with the reading, these differ by its offset; where it turns against it, by the sign
    of both the angle and its error too. Of coupled joints the angle follows the signs and the coupling.
    """
    phi, u = propagated(of, x, c)
    row, k = robot.link_from_reading[driver.joint - 1], driver.joint - 1
    offset = 0.0 if robot.slides[k] else robot.offset[k]
    against = row[k] < 0 and not np.any(np.delete(row, k))
    shown = (-1.0 if against else 1.0) * (phi + driver.order * offset)
    return float(np.angle(np.exp(1j * shown))), u


def _groups(
    parameters: Sequence[Parameter], asked: Selection
) -> Iterable[tuple[tuple[Site, Driver, str], list[int]]]:
    """Parameters of each amplitude of an effect: of one session, site, driver and unit, or one alone."""
    out: dict[tuple, list[int]] = {}
    effect = EFFECTS[asked.effect]
    for k, p in enumerate(parameters):
        if p.effect != asked.effect or not (p.stands_for or asked.holds(p)):
            continue
        session = p.name.rpartition(":")[0]
        alone = "" if effect.sizes.get(p.unit, DEVIATION).joins else p.name
        out.setdefault((p.site, p.driver, p.unit, session, alone), []).append(k)
    return ((key[:3], index) for key, index in out.items())
