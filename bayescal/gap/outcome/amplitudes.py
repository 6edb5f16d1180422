"""Amplitudes of the named effects, with standard uncertainty, from the parameters of the refit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from bayescal.distributions import chi2_sf
from bayescal.effects import EFFECTS, Driver, Parameter, Site
from bayescal.effects.selection import Selection
from bayescal.effects.sizes import DEVIATION, propagated
from bayescal.estimate import Estimate
from bayescal.gap.result import Amplitude, Named
from bayescal.gap.settings import OUTCOME


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
    degrees of freedom, at `OUTCOME.significant` over the number of amplitudes of the effect.
    """
    return tuple(a for n in named for a in _of(final, covariance, Selection.read(n.model)))


def _of(final: Estimate, covariance: np.ndarray, asked: Selection) -> Iterable[Amplitude]:
    model = final.model
    count = len(model.parameters)
    values = model.deviations(final.z[:count])
    covariance = covariance[:count, :count] * np.outer(model.sd, model.sd)
    effect = EFFECTS[asked.effect]
    groups = list(_groups(model.parameters, asked))
    for key, index in groups:
        site, driver, unit = key
        size = effect.sizes.get(unit, DEVIATION)
        own = np.ix_(index, index)
        x, c = values[index], covariance[own]
        value, u = propagated(size.value, x, c)
        if not size.joins and model.parameters[index[0]].positive:
            value = value + model.parameters[index[0]].nominal
        p = float(chi2_sf(x @ np.linalg.solve(c, x), len(x)))
        yield Amplitude(
            asked.effect,
            site,
            driver,
            tuple(model.parameters[k].name for k in index),
            size.what,
            value,
            u,
            unit,
            None if size.phase is None or len(x) != 2 else propagated(size.phase, x, c),
            p * len(groups) < OUTCOME.significant,
        )


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
