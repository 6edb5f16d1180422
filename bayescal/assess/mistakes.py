"""Gross mistakes of stated values that a fit shows: a radius for a diameter, another unit, a common factor.

Each hypothesis is the session with a value corrected. All are fitted in the same way, by a few Gauss-Newton
steps of geometry and compliance with an unknown scale of the noise, on some of all rows. With F = -2 log
density at the best point, a hypothesis of far smaller F than the session as stated is a finding; a hypothesis
of about the same F is one that these data cannot show.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bayescal.assess import WORDS
from bayescal.dataset import Certificate, Dataset
from bayescal.dataset.target_kinds import kinds_of
from bayescal.dataset.write import taken
from bayescal.effects import BASELINE, parameters_of, possible
from bayescal.estimate import linearise, unit_weights
from bayescal.model.block import Turned
from bayescal.model.model import Model, with_parameters
from bayescal.model.scene import Scene
from bayescal.statistics import grouped

MOST_ROWS = 200
"""Rows that a hypothesis is judged by: evenly from all."""
STEPS, SCALES = 20, 8
"""Gauss-Newton steps at most, and passes for the scale of the noise in each."""
CLOSED = 1.0
"""Change of F at which the steps end."""
SURE, SURE_PER_ROW = 60.0, 1.0
"""Least gain of F, in all and for each row, of a finding (assumed; of sessions without one: below 0.6)."""
ALIKE = 6.0
"""Difference of F up to which two hypotheses explain the rows equally well."""
EXPLAINED = 20.0
"""Times the stated noise of residuals that a right correction leaves at most (assumed)."""
WIDE = 0.1
"""Relative standard deviation of a common factor of all certified lengths (assumed)."""
CERTAIN = 6.0
"""Standard uncertainties from which on it is."""
DIFFERENT = 3e-3
"""Relative error of all certified lengths from which on it is a finding: less may be a temperature."""
MOST_GROUPS = 12
"""Spheres and cylinders of which each is judged alone."""
STEP = 1e-6


def model_of(scene: Scene, effects: tuple[str, ...] = BASELINE) -> tuple[Model | None, tuple[str, ...]]:
    """The model of a session with those effects that it can have, and their names; None without rows."""
    if not len(scene.rows("calibrate")):
        return None, ()
    circumstances = scene.circumstances()
    modelled = possible(effects, circumstances)
    return with_parameters(scene, modelled, parameters_of(modelled, circumstances, lenient=True)), modelled


@dataclass(frozen=True)
class Hypothesis:
    """A correction of stated values.

    `what` are the values, `like` what they look like; `place` is where they stand in dataset.yaml, and
    `remedy` how to correct them. `loads`: the correction changes torques, else surfaces alone.
    """

    what: str
    like: str
    remedy: str
    place: tuple[str, ...]
    dataset: Dataset
    loads: bool = False


@dataclass(frozen=True)
class Mistake:
    """A mistake in words: code, what, remedy, and its place in dataset.yaml."""

    code: str
    what: str
    remedy: str
    place: tuple[str, ...]


@dataclass(frozen=True)
class Judged:
    """What the rows of a session say of gross mistakes.

    Attributes
    ----------
    better : tuple of Hypothesis
        Those that explain the rows far better than the session as stated, and equally well.
    unknown : tuple of str
        Values whose gross mistakes these rows do not show.
    scale : tuple of float, or None
        Logarithm of the factor by which all certified lengths are too short, and its standard uncertainty;
        None where none are fitted.
    """

    better: tuple[Hypothesis, ...]
    unknown: tuple[str, ...]
    scale: tuple[float, float] | None

    @property
    def factor(self) -> float | None:
        """By which the certified lengths are too long, where that is beyond doubt."""
        if self.scale is None or self.better:
            return None
        size, u = self.scale
        return float(np.exp(-size)) if abs(size) > max(DIFFERENT, CERTAIN * u) else None


FACTORS = WORDS["factors"]
"""Factors by which a value is corrected, what it then was, and the remedy."""


def judged(dataset: Dataset) -> Judged | None:
    """Judge all hypotheses of a session; None where nothing can be fitted."""
    some = _some(dataset)
    model, _ = model_of(Scene(some))
    if model is None or not model.size:
        return None
    stated = fitted(model, np.zeros(model.size))
    fits = [(fitted(_model(h, model), stated.z), h) for h in hypotheses(some)]
    nearest = min((best for best, _ in fits), key=lambda best: best.f, default=stated)
    if nearest.f < stated.f - SURE and nearest.z.shape == stated.z.shape:  # it may only have had more steps
        stated = min(stated, fitted(model, nearest.z), key=lambda best: best.f)
    gain = max(SURE, SURE_PER_ROW * len(some.measurements.ids))
    good = [(best.f, h) for best, h in fits if best.f < stated.f - gain and best.kappa < EXPLAINED]
    least = min((f for f, _ in good), default=stated.f)
    better = tuple(h for f, h in good if f < least + ALIKE)
    unknown = dict.fromkeys(h.what for best, h in fits if best.f < stated.f + ALIKE)
    return Judged(better, () if better else tuple(unknown), _scale(some, model, stated))


def _model(of: Hypothesis, model: Model) -> Model:
    """The model of a hypothesis: that of the session with other surfaces, or new where torques change."""
    scene = Scene(of.dataset)
    if of.loads:
        other, _ = model_of(scene)
        assert other is not None
        return other
    blocks = tuple(
        b if isinstance(b, Turned) else replace(b, kind=scene.kind(scene.index[b.target], b.rows))
        for b in model.blocks
    )
    return replace(model, blocks=blocks)


def mistaken(judgement: Judged) -> Iterator[Mistake]:
    """The mistakes that the rows show; several that explain them equally well are alternatives."""
    if judgement.better:
        first, *others = judgement.better
        what = f"{first.what} looks like it is {first.like}: then the rows agree with the arm far better"
        if others:
            what += f" (or {', or '.join(f'{h.what} {h.like}' for h in others[:2])})"
        yield Mistake("gross_mistake", what, first.remedy, first.place)
    if judgement.factor is not None:
        way, factor = ("long", judgement.factor) if judgement.factor > 1 else ("short", 1 / judgement.factor)
        words = WORDS["certified_scale"]
        what = words["what"].format(way=way, factor=factor)
        yield Mistake("certified_scale", what, words["remedy"], ("certificates",))


def hidden(judgement: Judged) -> Iterator[str]:
    """Gross mistakes that the rows would not show, in words."""
    if judgement.unknown:
        yield f"a wrong unit or a factor of 2 of {', '.join(judgement.unknown)}"
    if judgement.scale is not None and not judgement.better and judgement.factor is None:
        least = 100 * max(DIFFERENT, CERTAIN * judgement.scale[1])
        yield f"a common error of all certified lengths below {least:.1g} %"


def hypotheses(dataset: Dataset) -> Iterator[Hypothesis]:
    """The corrections of a session, of the values that its rows depend on."""
    for name, field in _tools(dataset):
        key = f"{field}_mm"
        for factor, like, remedy in FACTORS[key]:
            corrected = tuple(
                replace(t, **{field: getattr(t, field) * factor}) if t.name == name else t
                for t in dataset.tools
            )
            place, other = ("tools", name, key), replace(dataset, tools=corrected)
            loads = field == "centre_of_mass"
            yield Hypothesis(f"`{key}` of `{name}`", like, remedy, place, other, loads)
    for name, targets in _round(dataset):
        for factor, like, remedy in FACTORS["diameter_mm"]:
            sized = tuple(
                replace(t, values=t.values | {"diameter": factor * t.values["diameter"]})
                if t.name in targets
                else t
                for t in dataset.targets
            )
            place, other = ("targets", targets[0], "diameter_mm"), replace(dataset, targets=sized)
            yield Hypothesis(f"`diameter_mm` of {name}", like, remedy, place, other)


def _tools(dataset: Dataset) -> Iterator[tuple[str, str]]:
    """Names of tools, and the field of a length that may be mistaken."""
    m = dataset.measurements
    touched = np.array([kind.touched for kind in kinds_of(dataset)])[m.target]
    for k, tool in enumerate(dataset.tools):
        used = m.tool == k
        if tool.ball_radius and np.any(touched & used):
            yield tool.name, "ball_radius"
        if dataset.robot.masses is not None and tool.mass and np.any(used) and np.any(tool.centre_of_mass):
            yield tool.name, "centre_of_mass"


def _round(dataset: Dataset) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Spheres and cylinders that rows measure, in words and by name: all, and each at its placements."""
    used = [dataset.targets[k] for k in np.unique(dataset.measurements.target)]
    groups = grouped((t.name.partition("@")[0], t.name) for t in used if "diameter" in t.values)
    if len(groups) > 1:
        yield "all spheres and cylinders", tuple(name for names in groups.values() for name in names)
    for name, names in groups.items() if len(groups) <= MOST_GROUPS else ():
        yield f"`{name}`", tuple(names)


def _some(dataset: Dataset) -> Dataset:
    """The session with at most `MOST_ROWS` of its rows, all to be fitted."""
    m = dataset.measurements
    pick = np.unique(np.linspace(0, len(m.ids) - 1, min(len(m.ids), MOST_ROWS)).astype(int))
    rows = taken(m, pick)
    return replace(dataset, measurements=replace(rows, role=np.full(len(pick), "calibrate")))


@dataclass(frozen=True)
class _Best:
    """The least F that Gauss-Newton steps find, and where: z (D,) and the scale of the noise."""

    f: float
    z: np.ndarray
    kappa: float


def fitted(model: Model, z: np.ndarray) -> _Best:
    """The best point of a model from a start z (D,)."""
    weights, count = unit_weights(model, z), sum(b.residuals for b in model.blocks)
    best, before = _Best(np.inf, z, 1.0), np.inf
    for _ in range(STEPS):
        linear = linearise(model, z, weights)
        r, j = linear.residual, linear.jacobian
        rows, priors = float(np.sum(r[:count] ** 2)), float(np.sum(r[count:] ** 2) + z @ z)
        kappa = max(1.0, np.sqrt(rows / count))
        f = 2 * count * np.log(kappa) + rows / kappa**2 + priors
        if abs(f - before) < CLOSED:
            break
        before = f
        if f < best.f:
            best = _Best(float(f), z, float(kappa))
        by_rows, by_priors = j[:count].T @ j[:count], j[count:].T @ j[count:] + np.eye(len(z))
        slope_rows, slope_priors = j[:count].T @ r[:count], j[count:].T @ r[count:] + z
        change = np.zeros(len(z))
        for _ in range(SCALES):
            change = -np.linalg.solve(by_rows / kappa**2 + by_priors, slope_rows / kappa**2 + slope_priors)
            residual = r[:count] + j[:count] @ change
            kappa = max(1.0, np.sqrt(residual @ residual / count))
        z = z + change
    return best


def _scale(dataset: Dataset, model: Model, best: _Best) -> tuple[float, float] | None:
    """Logarithm of a common factor of all certified lengths, estimated with the arm, and its uncertainty."""
    longer, _ = model_of(Scene(replace(dataset, certificates=_longer(dataset, 1.0 + STEP))))
    assert longer is not None
    z, count = best.z, sum(b.residuals for b in model.blocks)
    weights = unit_weights(model, z)
    linear = linearise(model, z, weights)
    by = (linearise(longer, z, weights).residual - linear.residual) / STEP
    if not np.any(by[count:]):
        return None
    whiten = np.where(np.arange(len(by)) < count, 1.0 / best.kappa, 1.0)
    rows = np.column_stack([linear.jacobian, by]) * whiten[:, None]
    information = rows.T @ rows + np.diag([*np.ones(model.size), WIDE**-2])
    slope = rows.T @ (linear.residual * whiten) + np.append(z, 0.0)
    covariance = np.linalg.inv(information)
    return -float(covariance[-1] @ slope), float(np.sqrt(covariance[-1, -1]))


def _longer(dataset: Dataset, factor: float) -> tuple[Certificate, ...]:
    """The certificates with all distances multiplied."""
    out = []
    for c in dataset.certificates:
        points, distance = c.points, c.distance
        if points is not None:
            grown = tuple(tuple(factor * x for x in p) for p in points.coordinates)
            points = replace(points, coordinates=grown)
        out.append(replace(c, points=points, distance=None if distance is None else factor * distance))
    return tuple(out)
