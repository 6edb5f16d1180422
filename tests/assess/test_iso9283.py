"""Figures of ISO 9283 against their formulas, on readings made for it."""

from dataclasses import replace

import numpy as np
import pytest

from bayescal.assess.inputs import Basis
from bayescal.assess.iso9283 import iso9283
from bayescal.calibration import fit
from bayescal.estimate import calibrated
from bayescal.estimate.discrepancy import stated
from bayescal.model.scene import Scene
from bayescal.simulation import Options, simulate


@pytest.fixture(scope="module")
def cycled(tracker):
    """60 readings to fit, then 5 poses that an instrument reads four times each."""
    dataset = tracker(1, 80).dataset
    m = dataset.measurements
    readings, xyz = m.readings.copy(), m.xyz.copy()
    role, first = np.where(np.arange(80) < 60, "calibrate", "validate"), 60 + 4 * ((np.arange(80) - 60) // 4)
    first[:60] = np.arange(60)
    rng = np.random.default_rng(3)
    readings, xyz = readings[first], xyz[first] + 2e-5 * rng.standard_normal(xyz.shape)
    return replace(dataset, measurements=replace(m, readings=readings, xyz=xyz, role=role))


def test_poses_by_hand(cycled):
    found = calibrated(Scene(cycled, oriented=True), ("geometry", "compliance"), robust=False)
    basis = Basis(stated(found))
    (row,) = basis.prepared.rows
    error = row.in_rows.T.reshape(5, 4, 3)
    middle = error.mean(axis=1)
    apart = np.linalg.norm(error - middle[:, None], axis=2)
    rp = apart.mean(axis=1) + 3.0 * apart.std(axis=1, ddof=1)
    figures = {f.symbol: f for f in iso9283(basis).figures}
    assert figures["AP"].count == figures["RP"].count == 5
    assert figures["AP"].mean == pytest.approx(np.mean(np.linalg.norm(middle, axis=1)))
    assert figures["AP"].maximum == pytest.approx(np.max(np.linalg.norm(middle, axis=1)))
    assert figures["RP"].mean == pytest.approx(rp.mean())
    assert figures["RP"].maximum == pytest.approx(rp.max())
    # four readings of one coordinate, and the location of the instrument by sixty
    alone = row.noise.mean() / 2.0
    assert alone < figures["AP"].u_max < 1.5 * alone
    assert alone / np.sqrt(5) < figures["AP"].u < alone
    assert any("5 poses with 4 cycles each" in text for text in iso9283(basis).differs)


def test_contacts_and_distances():
    session = simulate(Options(contacts=90, later=6, repeats=4, spheres=3, placements=1, seed=7)).dataset
    found = fit(session, ("geometry", "compliance"), samples=0)
    figures = {f.symbol: f for f in iso9283(found.basis).figures}
    error = [abs(d.error) for d in found.final.validation.distances]
    assert figures["AD"].mean == pytest.approx(np.mean(error))
    assert figures["AD"].maximum == pytest.approx(np.max(error))
    assert figures["AD"].count == 3
    largest = found.final.validation.distances[int(np.argmax(error))]
    # without the arm's parameters it is less than the prediction with them, and at least the certificate
    assert largest.u_certified < figures["AD"].u_max < np.std(largest.predicted)
    assert "AP" not in figures
    assert figures["AP n"].maximum <= max(np.abs(p.residuals).max() for p in found.final.validation.planes)
    assert figures["AP n"].words == "pose accuracy, component along the normal of the surface"
    assert any("normal" in text for text in iso9283(found.basis).differs)


def test_nothing_without_validation_rows(cycled):
    role = np.full(80, "calibrate")
    alone = replace(cycled, measurements=replace(cycled.measurements, role=role))
    found = calibrated(Scene(alone, oriented=True), ("geometry",), robust=False)
    assert iso9283(Basis(stated(found))) == iso9283(Basis(stated(found))).__class__((), ())
