"""Findings of a check, and what a session lacks so that less can be calibrated, validated or assessed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from math import ceil
from typing import Any, Literal

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
from bayescal.storage.reading import table_beside

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
    def said(cls, texts: Any, kind: Kind, code: str, where: str, **values: object) -> Finding:
        """A finding in the words of a table by kind and code, with the values that they name in braces."""
        words = texts[kind][code]
        what, remedy = (words[part].format_map(values) for part in ("what", "remedy"))
        return cls(code, kind, what, where, remedy)

    @classmethod
    def of(cls, error: BayescalError, code: str) -> Finding:
        """What a reader refuses."""
        return cls(code, "refused", error.what, error.where, error.remedy)


TEXTS = table_beside(__file__, "findings.toml")
"""Words of the findings of sessions and of joint logs."""
said = partial(Finding.said, TEXTS["sessions"])
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
    if model is not None and not model.knows_length:
        yield said("missing", "no_length", SETTINGS)
    yield from _faces(dataset)
    if posed and model is not None:
        yield from _undetermined(model)
        for lost in unlocated(unfitted(model, fitted(model, np.zeros(model.size)).z)):
            yield said("missing", "not_located", lost.where, what=lost.what, remedy=lost.remedy)
    lacking = () if tests is None else [name for name in tests.missing if name in EFFECTS]
    if dataset.measurements.velocity is None and any(EFFECTS[name].directed for name in lacking):
        first = joint_columns("degps", dataset.robot.units)[0]
        yield said("missing", "no_velocities", TABLE, first=first)


def _predicted(scene: Scene) -> Iterator[Finding]:
    """Tools and instruments that only validation rows use: none to calibrate with or to locate them."""
    dataset, m = scene.dataset, scene.dataset.measurements
    fit_rows, validate = scene.rows("calibrate", "locate"), scene.rows("validate")
    if not len(scene.rows("calibrate")):
        return
    for k in np.setdiff1d(m.tool[validate], m.tool[fit_rows]).tolist():
        name, u = dataset.tools[k].name, 1e3 * tool_u(scene, k)
        yield said("missing", "predicted_tool", TABLE, name=name, u=u)
    for k in np.setdiff1d(m.target[validate], m.target[fit_rows]).tolist():
        target = dataset.targets[k]
        if target.kind == "instrument":
            u = 1e3 * place_sd(target)
            yield said("missing", "predicted_instrument", TABLE, name=target.name, u=u)


def _roles(dataset: Dataset) -> Iterator[Finding]:
    m = dataset.measurements
    validate = m.role == "validate"
    if not validate.any():
        yield said("missing", "no_validation", TABLE)
    few = []
    for k, target in enumerate(dataset.targets):
        of_target = validate[m.target == k]
        if kinds_of(dataset)[k].located and 0 < len(of_target) < LOCATES and of_target.all():
            few.append(f"`{target.name}`")
    if few:
        yield said("missing", "few_on_sphere", TABLE, least=LOCATES, names=listed(few, SHOWN))
    labels = [s[s != ""] for s in (m.repeat, m.stop) if s is not None]
    if not any(len(set(names)) < len(names) for names in labels):
        yield said("missing", "no_repeats", TABLE)


def _unused(dataset: Dataset) -> Iterator[Finding]:
    """Targets that no row measures."""
    m = dataset.measurements
    idle = [f"`{t.name}`" for k, t in enumerate(dataset.targets) if not np.any(m.target == k)]
    if idle:
        yield said("missing", "unused_target", SETTINGS, names=listed(idle, SHOWN))


def _enough(scene: Scene, model: Model | None) -> Iterator[Finding]:
    """Rows against unknowns."""
    if model is None:
        yield said("refused", "too_few", TABLE)
        return
    try:
        check_enough(scene)
    except BayescalError as error:
        yield Finding.of(error, "too_few")
        return
    values = sum(block.residuals for block in model.blocks)
    if values < model.size + RESERVE:
        rows, unknowns = len(scene.rows("calibrate")), (len(model.parameters), len(model.states))
        enough = ceil((model.size + RESERVE) * rows / values)
        plan = "; `bayescal plan --after` proposes them" if plannable(scene.dataset) else ""
        counts = {"values": values, "size": model.size, "of": unknowns, "rows": rows, "enough": enough}
        yield said("missing", "few_rows", TABLE, **counts, plan=plan)


def _faces(dataset: Dataset) -> Iterator[Finding]:
    """Sessions on planes of one direction alone."""
    m = dataset.measurements
    fitted = [dataset.targets[k] for k in np.unique(m.target[m.role == "calibrate"])]
    if not fitted or any(t.kind != "plane" for t in fitted):
        return
    normals = np.array([t.values["normal"] for t in fitted])
    if np.all(np.abs(normals @ normals[0]) > PARALLEL):
        which = "a single plane is" if len(fitted) == 1 else f"{len(fitted)} parallel planes are"
        yield said("missing", "parallel_planes", SETTINGS, which=which)


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
        if (u.matters or u.hidden) and u.changes != ("length",):  # see `no_length`
            yield Finding("not_identifiable", "missing", u.cause, TABLE, u.remedy)
