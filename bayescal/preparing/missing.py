"""Findings of a check, and what a session lacks so that less can be calibrated, validated or assessed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from typing import Literal

import numpy as np

from bayescal.assess.identifiability import identifiability
from bayescal.assess.mistakes import fitted
from bayescal.assess.undetermined import undetermined
from bayescal.dataset import Dataset
from bayescal.dataset.read import SETTINGS, TABLE
from bayescal.dataset.table import joint_columns
from bayescal.dataset.target_kinds import kinds_of, place_sd, plannable
from bayescal.effects import EFFECTS
from bayescal.errors import BayescalError, listed
from bayescal.estimate import Estimate, check_enough, linearise, unfitted, unit_weights
from bayescal.gap.search.candidates import Candidates
from bayescal.model import ARM
from bayescal.model.model import Model
from bayescal.model.scene import Scene
from bayescal.planning.pool import RESERVE
from bayescal.predict.targets import tool_u, unlocated

Kind = Literal["refused", "odd", "missing"]
KINDS: tuple[Kind, ...] = ("refused", "odd", "missing")
"""Refused by `fit` and `gap`; probably a mistake; absent, so that less can be said."""


@dataclass(frozen=True)
class Finding:
    """A finding.

    Attributes
    ----------
    code : str
        A name that does not change with the wording.
    kind : str
        Of `KINDS`.
    what, where, remedy : str
        As of `BayescalError`; `where` is a file, with a line and a row id where there are.
    """

    code: str
    kind: Kind
    what: str
    where: str
    remedy: str

    @classmethod
    def of(cls, error: BayescalError, code: str) -> Finding:
        """What a reader refuses."""
        return cls(code, "refused", error.what, error.where, error.remedy)


PARALLEL = 0.995  # cosine, 6 deg, of normals of faces that count as parallel
SHOWN = 4
"""Targets that a finding names."""
LOCATES = 4
"""Contacts that locate a sphere of unknown centre and known diameter, with one to spare."""


def missing(
    scene: Scene, model: Model | None, tests: Candidates | None, posed: bool = True
) -> Iterator[Finding]:
    """All findings of this kind; `posed`: whether the readings can be taken for the poses of the arm."""
    dataset = scene.dataset
    yield from _roles(dataset)
    yield from _unused(dataset)
    yield from _predicted(scene)
    yield from _enough(scene, model)
    yield from _scale(model)
    yield from _faces(dataset)
    if posed and model is not None:
        yield from _undetermined(model)
        for lost in unlocated(unfitted(model, fitted(model, np.zeros(model.size)).z)):
            what = f"{lost.what}: it validates nothing"
            yield Finding("not_located", "missing", what, lost.where, lost.remedy)
    lacking = () if tests is None else [name for name in tests.missing if name in EFFECTS]
    if dataset.measurements.velocity is None and any(EFFECTS[name].directed for name in lacking):
        what = "no joint velocities: backlash and other errors by direction of motion cannot be assessed"
        first = joint_columns("degps", dataset.robot.units)[0]
        remedy = f"add the columns `{first}` ...; their signs are the direction of approach"
        yield Finding("no_velocities", "missing", what, TABLE, remedy)


def _predicted(scene: Scene) -> Iterator[Finding]:
    """Tools and instruments that only validation rows use: none to calibrate with or to locate them."""
    dataset, m = scene.dataset, scene.dataset.measurements
    fit_rows, validate = scene.rows("calibrate", "locate"), scene.rows("validate")
    if not len(scene.rows("calibrate")):
        return
    for k in np.setdiff1d(m.tool[validate], m.tool[fit_rows]).tolist():
        what = f"only validation rows use the tool {dataset.tools[k].name}: its centre is not fitted, and is "
        what += f"uncertain by {1e3 * tool_u(scene, k):g} mm in every prediction"
        remedy = "fit some rows with this tool, or state `u_mm` of its centre"
        yield Finding("predicted_tool", "missing", what, TABLE, remedy)
    for k in np.setdiff1d(m.target[validate], m.target[fit_rows]).tolist():
        target = dataset.targets[k]
        if target.kind == "instrument":
            what = f"only validation rows are of the instrument {target.name}: its pose, uncertain by "
            what += f"{1e3 * place_sd(target):g} mm, "
            what += "is estimated from them, which hides errors that displace it"
            yield Finding("predicted_instrument", "missing", what, TABLE, "fit some of its rows")


def _roles(dataset: Dataset) -> Iterator[Finding]:
    m = dataset.measurements
    validate = m.role == "validate"
    if not validate.any():
        what = "no row has the role `validate`: the error to expect is estimated from the fitted measurements"
        remedy = "give a part of the rows, measured for it, `validate` in the column `role`"
        yield Finding("no_validation", "missing", what, TABLE, remedy)
    few = []
    for k, target in enumerate(dataset.targets):
        of_target = validate[m.target == k]
        if kinds_of(dataset)[k].located and 0 < len(of_target) < LOCATES and of_target.all():
            few.append(f"`{target.name}`")
    if few:
        what = f"fewer than {LOCATES} contacts to validate {listed(few, SHOWN)}: they do not locate it"
        yield Finding("few_on_sphere", "missing", what, TABLE, f"measure {LOCATES} or more on each sphere")
    labels = [s[s != ""] for s in (m.repeat, m.stop) if s is not None]
    if not any(len(set(names)) < len(names) for names in labels):
        what = "no contact is repeated: the noise is not separable from errors of the model"
        remedy = "measure some contacts four times, with one name in the column `repeat`"
        yield Finding("no_repeats", "missing", what, TABLE, remedy)


def _unused(dataset: Dataset) -> Iterator[Finding]:
    """Targets that no row measures."""
    m = dataset.measurements
    idle = [f"`{t.name}`" for k, t in enumerate(dataset.targets) if not np.any(m.target == k)]
    if idle:
        what = f"no row measures {listed(idle, SHOWN)}"
        yield Finding("unused_target", "missing", what, SETTINGS, "remove the targets, or measure them")


def _enough(scene: Scene, model: Model | None) -> Iterator[Finding]:
    """Rows against unknowns."""
    if model is None:
        what = "no row has the role `calibrate`"
        yield Finding("too_few", "refused", what, TABLE, "leave `role` empty in the rows to be fitted")
        return
    try:
        check_enough(scene)
    except BayescalError as error:
        yield Finding.of(error, "too_few")
        return
    values = sum(block.residuals for block in model.blocks)
    if values < model.size + RESERVE:
        what = (
            f"{values} values to fit {model.size} unknowns ({len(model.parameters)} parameters and "
            f"{len(model.states)} targets): the noise cannot be checked well and a single outlier matters"
        )
        rows = len(scene.rows("calibrate"))
        enough = ceil((model.size + RESERVE) * rows / values)
        plan = "; `bayescal plan --after` proposes them" if plannable(scene.dataset) else ""
        remedy = f"fit {enough} rows or more in place of {rows}{plan}"
        yield Finding("few_rows", "missing", what, TABLE, remedy)


def _scale(model: Model | None) -> Iterator[Finding]:
    if model is not None and not model.knows_length:
        what = "no certified length among the fitted targets: the scale is that of the nominal robot"
        remedy = "state a certified distance of two fitted targets under `certificates`"
        yield Finding("no_length", "missing", what, SETTINGS, remedy)


def _faces(dataset: Dataset) -> Iterator[Finding]:
    """Sessions on planes of one direction alone."""
    m = dataset.measurements
    fitted = [dataset.targets[k] for k in np.unique(m.target[m.role == "calibrate"])]
    if not fitted or any(t.kind != "plane" for t in fitted):
        return
    normals = np.array([t.values["normal"] for t in fitted])
    if np.all(np.abs(normals @ normals[0]) > PARALLEL):
        which = "a single plane is" if len(fitted) == 1 else f"{len(fitted)} parallel planes are"
        what = f"{which} fitted: errors along the plane are not seen"
        remedy = "probe planes in three directions, or spheres"
        yield Finding("parallel_planes", "missing", what, SETTINGS, remedy)


def _undetermined(model: Model) -> Iterator[Finding]:
    """What the fitted measurements do not determine at the stated noise, with the arm at its nominal pose."""
    z = np.zeros(model.size)
    z[model.slices[ARM]] = -model.shift / model.sd
    weights = unit_weights(model, z)
    if not all(np.all(sigma > 0) for sigma in weights.sigma.values()):  # nan where none is stated
        return
    linear = linearise(model, z, weights)
    covariance = np.linalg.inv(linear.jacobian.T @ linear.jacobian + np.eye(model.size))
    nominal = Estimate(model, z, covariance, weights, linear, 0, np.zeros(0, int), {})
    for u in undetermined(nominal, identifiability(nominal)):
        if (u.matters or u.hidden) and u.changes != ("length",):  # see `_scale`
            yield Finding("not_identifiable", "missing", u.cause, TABLE, u.remedy)
