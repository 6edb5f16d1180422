"""Time of an update after a contact: of `bayescal.watching`, of the complete solver, and of GTSAM's iSAM2.

    python -m analysis.benchmarks.watch_speed

All three continue one simulated session from its first rows, side by side in one run. iSAM2 has a factor a
contact with the derivatives of this contact alone, all prepared beforehand: its time is that of GTSAM.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import gtsam
import numpy as np

from analysis.benchmarks.clock import seconds
from bayescal.calibration import fit
from bayescal.dataset.types import Dataset
from bayescal.dataset.write import taken
from bayescal.effects import BASELINE
from bayescal.estimate import Estimate, calibrated
from bayescal.model import ARM
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate
from bayescal.watching import update

CONTACTS, LATER = 1000, 40


def first(dataset: Dataset, count: int) -> Dataset:
    """The first rows of a session."""
    return replace(dataset, measurements=taken(dataset.measurements, np.arange(count)))


def incremental(found: Estimate, rows: range) -> Iterator[tuple[float, gtsam.ISAM2]]:
    """Times of iSAM2 with a custom factor for each further row, s."""
    model, w = found.model, found.weights
    arm = gtsam.symbol("a", 0)
    keys = {b.target: gtsam.symbol("t", k) for k, b in enumerate(model.blocks)}
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(0.1)
    tree = gtsam.ISAM2(parameters)
    factors = {}
    for b in model.blocks:
        for place, row in enumerate(b.rows):
            part = model.part(b, np.array([row]))
            whiten = 1.0 / (w.sigma[b.name][place] * w.scale[b.group])
            factors[int(row)] = (b.target, _factor(model, part, whiten, arm, keys[b.target]))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    slices = model.slices
    for name, key in ((ARM, arm), *keys.items()):
        size = slices[name].stop - slices[name].start
        graph.add(gtsam.PriorFactorVector(key, np.zeros(size), gtsam.noiseModel.Unit.Create(size)))
        values.insert(key, found.z[slices[name]])
    for k in range(rows.start):
        if k in factors:
            graph.add(factors[k][1])
    tree.update(graph, values)
    for k in rows:
        graph = gtsam.NonlinearFactorGraph()
        graph.add(factors[k][1])
        begin = time.perf_counter()
        tree.update(graph, gtsam.Values())
        tree.calculateEstimateVector(arm)
        tree.marginalCovariance(arm)
        yield time.perf_counter() - begin, tree


def _factor(model, part, whiten: float, arm: int, key: int) -> gtsam.CustomFactor:  # type: ignore[no-untyped-def]
    def error(_, values, gradients):  # type: ignore[no-untyped-def]
        r, by_arm, by_target = part.linearise(model.deviations(values.atVector(arm)), values.atVector(key))
        if gradients is not None:
            gradients[0], gradients[1] = whiten * by_arm * model.sd, whiten * by_target
        return whiten * r

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(part.residuals), [arm, key], error)


def main() -> None:
    """Print the times and their ratios."""
    session = simulate(Options(contacts=CONTACTS, later=0, repeats=0, spheres=0, seed=1)).dataset
    before = fit(first(session, CONTACTS - LATER), BASELINE, samples=0)
    found = update.begun(before.final.estimate, BASELINE, before.options)
    exact = []
    for count in range(CONTACTS - LATER + 1, CONTACTS + 1):
        begin = time.perf_counter()
        found = update.followed(found, first(session, count), BASELINE, before.options, ())
        update.judged(found, count - 1)
        update.distance_u(found)
        exact.append(time.perf_counter() - begin)
    scene = Scene(session, oriented=True)
    whole = np.median([seconds(lambda: calibrated(scene, BASELINE, before.options)) for _ in range(3)])
    tree = [t for t, _ in incremental(found, range(CONTACTS - LATER, CONTACTS))]
    ours, isam = float(np.median(exact)), float(np.median(tree))
    print(f"{CONTACTS} contacts, {found.model.size} unknowns; medians of {LATER} updates")
    print(f"update of `bayescal watch`   {1e3 * ours:6.1f} ms  (largest {1e3 * max(exact):.1f})")
    print(f"iSAM2, update and covariance {1e3 * isam:6.1f} ms  ({isam / ours:.2f} of it)")
    print(f"complete solver              {1e3 * whole:6.1f} ms  ({whole / ours:.1f} of it)")


if __name__ == "__main__":
    main()
