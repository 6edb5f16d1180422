"""A truth drawn from the priors of the very model that is fitted, and the session that it gives.

Places of faces, of the instrument and of the stylus tip are drawn closer to their nominal values than their
priors of 50 mm and 0.2 rad (`SPREAD`): contacts determine them so much better that the posterior is the same.

The certificates of the faces are data that every session has: the truth is drawn from the priors given these.
For a linear model this is exact: the most probable unknowns for a prior mean and certified values that are
both drawn anew have the posterior distribution (randomise, then optimise; Bardsley et al. 2014, SIAM J. Sci.
Comput. 36, A1895).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from analysis.calibration_checks.designs import Design, planned
from bayescal.dataset import Dataset, Target
from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.write import taken
from bayescal.effects.geometry import TOOL
from bayescal.effects.gravity import CENTRE_OFF, LOAD_OFF, LOAD_SHARE, MASS_SHARE
from bayescal.estimate import STATED_WORTH, linearise, unit_weights
from bayescal.model import ARM, Model, build
from bayescal.model.scene import Scene
from bayescal.simulation import Options, World, state_of, touch
from bayescal.simulation.record import OUTLIER, distance_certificates, true_targets
from factors.contacts import Plane

MODEL = ("geometry", "compliance")
SPREAD = {"m": 1e-3, "rad": 2e-3}
"""Largest standard deviations of the places of faces, instrument and stylus tip that are drawn."""
STEPS = 4
"""Newton steps: the certificates are nearly linear in the faces."""


@dataclass(frozen=True)
class Simulated:
    """A session and its truth: unknowns of the arm by name (whitened), faces, noise scales by group."""

    dataset: Dataset
    actual: Dataset  # the same, with the masses that the arm has
    world: World
    arm: Mapping[str, float]  # z
    states: Mapping[str, np.ndarray]  # z of instruments
    scales: Mapping[str, float]  # noise scale of each group
    gross: np.ndarray  # rows

    def points(self, rows: np.ndarray) -> np.ndarray:
        """True TCP positions (3, R) in F0, m, of rows."""
        model = self.world.model(self.actual)
        return model.motion(rows).points(self.world.deviations(model))

    def z(self, model: Model) -> np.ndarray:
        """The true unknowns (D,) of a fitted model; nan for those that the truth does not have."""
        out = np.full(model.size, np.nan)
        arm = model.slices[ARM]
        out[arm] = [self.arm.get(p.name, np.nan) for p in model.parameters]
        true = {t.name: t for t in self.world.targets}
        for block in model.states:
            of_face = isinstance(block.kind, Plane)
            own = state_of(true[block.target], block) if of_face else self.states[block.target]
            out[model.slices[block.target]] = own
        return out


def simulated(design: Design, seed: int) -> Simulated:
    """A session of a design with a truth of its own."""
    dataset, scenery = planned(design)
    rng = np.random.default_rng([seed, 0x5BC])
    model = build(Scene(dataset, oriented=True), MODEL)
    z = _unknowns(model, rng)
    scales = {b.group: float(np.sqrt(STATED_WORTH / rng.chisquare(STATED_WORTH))) for b in model.blocks}
    arm = dict(zip(model.names, z[model.slices[ARM]].tolist(), strict=False))
    options = Options(seed=seed, placements=1, sphere_contacts=8)
    spheres = {t.name: t for t in true_targets(options, scenery)}
    targets = tuple(_true(t, model, z, spheres) for t in dataset.targets)
    of_spheres = distance_certificates(options, scenery, targets)
    dataset = replace(dataset, certificates=(*dataset.certificates, *of_spheres))

    def deviations(of: Model) -> np.ndarray:
        return of.deviations(np.array([arm.get(p.name, 0.0) for p in of.parameters]))

    world = World(MODEL, deviations, targets)
    m = dataset.measurements
    group = np.array([KINDS[t.kind].noise for t in dataset.targets])[m.target]
    contacts = np.flatnonzero(group == "contact")
    error = scales["contact"] * (dataset.noise.contact or 0.0) * rng.normal(size=len(contacts))
    count = round(design.gross * int(np.sum(m.role[contacts] == "calibrate")))
    gross = rng.choice(np.flatnonzero(m.role[contacts] == "calibrate"), count, replace=False)
    size = np.exp(rng.uniform(*np.log(OUTLIER), count)) * rng.choice([-1.0, 1.0], count)
    error[gross] += size
    actual = _other_masses(dataset, rng) if design.masses else dataset
    touched = touch(world, replace(actual, measurements=taken(m, contacts)), error)
    readings = m.readings.copy()
    readings[contacts] = touched.measurements.readings
    m = replace(m, readings=readings)
    states = {}
    if m.xyz is not None:
        read = np.flatnonzero(group == "point")
        noise = scales["point"] * (dataset.noise.point or 0.0) * rng.normal(size=(len(read), 3))
        own = model.block_of["tracker"]
        states["tracker"] = z[model.slices["tracker"]]
        arm_now = world.model(replace(actual, measurements=m))
        at = arm_now.motion(read).points(deviations(arm_now))
        nought = replace(own.kind, xyz=np.zeros((len(read), 3)))
        xyz = m.xyz.copy()
        xyz[read] = nought.residual(own.state(states["tracker"]), at).T + noise
        m = replace(m, xyz=xyz)
    dataset, actual = (replace(d, measurements=m) for d in (dataset, actual))
    return Simulated(dataset, actual, world, arm, states, scales, np.sort(contacts[gross]))


def _unknowns(model: Model, rng: np.random.Generator) -> np.ndarray:
    """Whitened unknowns (D,) drawn from their priors, given the certificates."""
    prior = np.concatenate([model.sd, *(b.sd for b in model.states)])
    sd = np.minimum(1.0, np.array([SPREAD.get(u, np.inf) for u in model.units]) / prior)
    of_arm = np.array([p.effect != TOOL.name for p in model.parameters])
    sd[model.slices[ARM]] = np.where(of_arm, 1.0, sd[model.slices[ARM]])
    mean = sd * rng.standard_normal(model.size)
    weights = unit_weights(model, np.zeros(model.size))
    count = sum(b.residuals for b in model.blocks)
    error = rng.standard_normal(sum(c.rows for c in model.constraints))
    z = mean
    for _ in range(STEPS):
        linear = linearise(model, z, weights)
        j, r = linear.jacobian[count:], linear.residual[count:] - error
        z = z - np.linalg.solve(j.T @ j + np.diag(sd**-2), j.T @ r + (z - mean) / sd**2)
    return z


def _true(target: Target, model: Model, z: np.ndarray, spheres: Mapping[str, Target]) -> Target:
    if target.name not in model.block_of:
        return spheres[target.name]
    block = model.block_of[target.name]
    if not isinstance(block.kind, Plane):
        return target
    normal, offset = block.kind.normal_and_offset(block.state(z[model.slices[target.name]]))
    return replace(target, values={"normal": normal, "offset": float(offset)})


def _other_masses(dataset: Dataset, rng: np.random.Generator) -> Dataset:
    """The session with masses and centres of mass of links and tools in error, by `effects.gravity`."""
    robot = dataset.robot
    masses, centres = np.array(robot.masses), np.array(robot.centres_of_mass)
    off = CENTRE_OFF + MASS_SHARE * np.abs(centres)
    links = replace(
        robot,
        masses=masses * (1.0 + MASS_SHARE * rng.standard_normal(masses.shape)),
        centres_of_mass=centres + off * rng.standard_normal(centres.shape),
    )
    tools = tuple(
        replace(
            t,
            mass=t.mass * (1.0 + LOAD_SHARE * rng.standard_normal()),
            centre_of_mass=(t.centre if t.centre_of_mass is None else t.centre_of_mass)
            + LOAD_OFF * rng.standard_normal(3),
        )
        for t in dataset.tools
    )
    return replace(dataset, robot=links, tools=tools)
