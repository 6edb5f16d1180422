"""Plausibility of a session at nominal geometry: units, joint columns, tools, limits and contacts.

Degrees taken for radians are 57 times too large, metres taken for millimetres 1000 times too small: either
way all rows are hundreds of millimetres off at nominal geometry, and none once the numbers are read as what
they are. The same holds of a sign, a zero, a coupling or an exchange of joints. No arm is nominally wrong by
that much, and no other change of one quantity removes such an error.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations, product, repeat

import numpy as np

from bayescal.arm.chain import Robot
from bayescal.dataset import consistency, image_changes
from bayescal.dataset.consistency import FEWEST, LENGTH_UNITS, OFF, away, contacts, nominal, of_another
from bayescal.dataset.contacts import Contacts, residual, settled
from bayescal.dataset.table import Table
from bayescal.dataset.target_kinds import KINDS, angle_sd, place_sd
from bayescal.dataset.types import Dataset, Target
from bayescal.errors import BayescalError
from bayescal.storage.files import Document

SUSPECT = 0.02
"""m: a session whose typical misfit is less is not suspected."""

FALLS = 3.0
"""A misfit that falls by this factor, to less than `FITS`, is another unit's."""

FITS = 0.1
"""m: what loosely known tools and targets may leave, in the right unit."""

TURNS = 4 * np.pi
"""rad: no joint shows more; readings that do are not in the unit that was said."""

ANGLES = tuple(sorted({k for f in (180 / np.pi, 1e3, np.pi / 0.18) for k in (f, 1 / f)}))
"""Ratios of units of angle: deg, rad and mrad."""

LENGTHS = tuple(sorted({k for f in (1e3, 10.0, 25.4, 1e6, 39.37007874015748, 100.0) for k in (f, 1 / f)}))
"""Ratios of units of length: m, cm, mm, µm and in."""


@dataclass(frozen=True)
class Suspicion:
    """Quantities (``j1`` ..., ``x``, ``length``) that fit once multiplied by `factor`: typical misfits, m."""

    quantities: tuple[str, ...]
    factor: float
    stated: float
    other: float


def suspicion(
    dataset: Dataset, settled: Callable[[Dataset], Dataset] = lambda dataset: dataset
) -> Suspicion | None:
    """The quantities that are most plainly in another unit than was said, or None.

    Judged by the median over the rows concerned of how far they are off their nominal targets (after
    a rigid fit, of an instrument's), and among several by that over how far the arm then moved: an arm
    that hardly moves fits any points that are shrunk. Costs one forward kinematics where nothing is wrong.
    What is nominal only for these very readings (a tool found from them) is found again by `settled`.
    """
    rows = dataset.measurements
    if len(rows.ids) < FEWEST:
        return None
    stated = away(dataset, rows.readings)
    suspicions: list[tuple[float, Suspicion]] = []
    for quantities, factor, concerned, other in chain(_angles(dataset), _lengths(dataset)):
        before = float(np.median(stated[concerned]))
        if before <= SUSPECT:
            continue
        other = settled(other)
        after = _typical(other, concerned)
        if after < min(before / FALLS, FITS):
            p = nominal(other, other.measurements.readings)[concerned]
            moved = float(np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)))
            suspicions.append((after / max(moved, 1e-9), Suspicion(quantities, factor, before, after)))
    return min(suspicions, key=lambda each: each[0])[1] if suspicions else None


def _typical(dataset: Dataset, rows: np.ndarray) -> float:
    """Median, m, of how far some rows (N,) are off their nominal targets."""
    return float(np.median(away(dataset, dataset.measurements.readings)[rows]))


Other = tuple[tuple[str, ...], float, np.ndarray, Dataset]
"""Quantities taken times a factor: they, it, the rows concerned (N,), and the dataset that then holds."""


def _angles(dataset: Dataset) -> Iterator[Other]:
    """All joints, and each alone, in every other unit; smaller only where they are too large to be angles.

    Each prismatic joint in every other unit of length.
    """
    rows, slides = dataset.measurements, dataset.robot.slides
    every = np.ones(len(rows.ids), bool)

    def scaled(joints: list[int], factor: float) -> Other:
        readings = rows.readings[:, joints] * factor
        return tuple(f"j{j + 1}" for j in joints), factor, every, _with_readings(dataset, joints, readings)

    yield from (scaled([j], factor) for j, factor in product(np.flatnonzero(slides).tolist(), LENGTHS))
    turning = np.flatnonzero(~slides).tolist()
    largest = np.abs(rows.readings).max(axis=0)
    for joints in (turning, *([j] for j in turning)) if turning else ():
        size = largest[joints].max()
        for factor in ANGLES:
            if size > TURNS if factor < 1 else 0 < size <= TURNS / factor:
                yield scaled(joints, factor)


def _with_readings(dataset: Dataset, joints: list[int], readings: np.ndarray) -> Dataset:
    """The session with other readings (N, k) of k joints."""
    every = dataset.measurements.readings.copy()
    every[:, joints] = readings
    return replace(dataset, measurements=replace(dataset.measurements, readings=every))


def _lengths(dataset: Dataset) -> Iterator[Other]:
    """An instrument's points, and lengths of bars and wires, in every other unit."""
    rows = dataset.measurements
    for field, quantities in (("xyz", ("x", "y", "z")), ("length", ("length",))):
        values = getattr(rows, field)
        if values is None:
            continue
        concerned = np.isfinite(values.reshape(len(values), -1)).any(axis=1)
        for factor in LENGTHS if concerned.sum() >= FEWEST else ():
            changed = replace(rows, **{field: values * factor})
            yield quantities, factor, concerned, replace(dataset, measurements=changed)


ZEROS = (90.0, -90.0, 180.0)
"""deg: differences of the zero of a joint between conventions."""
TEETH = tuple(5.0 * k for k in range(-6, 7) if k)
"""deg: differences of a zero between which that of a horn on another tooth is searched."""
CLOSER, HALVED = 0.8, 5
"""Share of the misfit below which a zero is searched more narrowly, and how often the step is halved."""
IMAGES_OFF = 0.005
"""m: images are placed by themselves, and are off by less where nothing is wrong (assumed)."""
TOOTH = "mount the joint as the robot file has it (the horn of a servo, a belt), or correct `offset_deg`"
REMEDY = "check the robot (its type, signs and zeros)"
IMAGES = f"{REMEDY}, which image belongs to which joint readings, and the calibration of the camera"
TABLE = "measurements.csv"
ROBOT = "correct `link_from_reading` or `offset_deg` in the robot file, or the column"
LEFT = 0.05
"""m: what an arm in the right convention may leave, with loosely known targets."""


Change = tuple[str, str | tuple[str, ...], str, np.ndarray, Dataset]
"""In words, its column or its place in dataset.yaml, the remedy, the rows concerned (N,), and the session."""


def explanation(dataset: Dataset, document: Document) -> BayescalError | None:
    """The one change that explains all rows, with both misfits, its place and a remedy; or None."""
    rows = dataset.measurements
    if len(rows.ids) < FEWEST:
        return None
    stated = away(dataset, rows.readings)
    explanations = []
    nominally = chain(_joint_changes(dataset), _zeros(dataset, stated), _tool_changes(dataset))
    every = chain(zip(nominally, repeat(SUSPECT)), zip(image_changes.changes(dataset), repeat(IMAGES_OFF)))
    for (what, place, remedy, concerned, other), least in every:
        before = float(np.median(stated[concerned]))
        if before > least and (after := _typical(other, concerned)) < min(before / FALLS, LEFT):
            explanations.append((after, before, what, place, remedy))
    if not explanations:
        return None
    after, before, what, place, remedy = min(explanations, key=lambda each: each[0])
    what += f": rows are {1e3 * before:.0f} mm off their targets, and then {1e3 * after:.2g} mm"
    where = f"{TABLE}: `{place}`" if isinstance(place, str) else document.where(place)
    return BayescalError(what, where, remedy)


def _joint_changes(dataset: Dataset) -> Iterator[Change]:
    """Each change of a joint, of the coupling of joints 2 and 3, and of two columns."""
    q, n = dataset.measurements.readings, dataset.robot.n
    every = np.ones(len(q), bool)

    def change(what: str, joints: list[int], values: np.ndarray, remedy: str = ROBOT) -> Change:
        place = f"j{joints[0] + 1}_{dataset.robot.units[joints[0]]}"
        return what, place, remedy, every, _with_readings(dataset, joints, values)

    slides = dataset.robot.slides
    for k, name in enumerate(dataset.robot.joint_names):
        yield change(f"{name} has the opposite sign", [k], -q[:, [k]])
        for zero in () if slides[k] else ZEROS:
            yield change(f"the zero of {name} differs by {zero:g} deg", [k], q[:, [k]] + np.radians(zero))
    for sign in (1.0, -1.0) if n > 2 and not slides[:3].any() else ():
        yield change("J3 is coupled to J2", [2], q[:, [2]] + sign * q[:, [1]])
    for a, b in combinations(range(n), 2):
        if slides[a] != slides[b]:
            continue  # other columns
        unit = dataset.robot.units[a]
        what = f"the columns `j{a + 1}_{unit}` and `j{b + 1}_{unit}` are interchanged"
        yield change(what, [a, b], q[:, [b, a]], "exchange their headings")


def _zeros(dataset: Dataset, stated: np.ndarray) -> Iterator[Change]:
    """A difference of the zero of each joint that turns, where rows are off by `stated` (N,), m."""
    q, robot = dataset.measurements.readings, dataset.robot
    every, before = np.ones(len(q), bool), float(np.median(stated))
    for k in np.flatnonzero(~robot.slides).tolist() if before > SUSPECT else ():

        def moved(zero: float, k: int = k) -> Dataset:
            return _with_readings(dataset, [k], q[:, [k]] + np.radians(zero))

        misfit = {zero: _typical(moved(zero), every) for zero in TEETH}
        zero, step = min(misfit, key=misfit.__getitem__), TEETH[-1] - TEETH[-2]
        for _ in range(HALVED if misfit[zero] < CLOSER * before else 0):
            step /= 2
            misfit |= {angle: _typical(moved(angle), every) for angle in (zero - step, zero + step)}
            zero = min(misfit, key=misfit.__getitem__)
        what = f"the zero of {robot.joint_names[k]} differs by about {zero:.0f} deg"
        yield what, f"j{k + 1}_{robot.units[k]}", TOOTH, every, moved(zero)


def _tool_changes(dataset: Dataset) -> Iterator[Change]:
    """Each tool in each other unit."""
    for (index, tool), (factor, unit) in product(enumerate(dataset.tools), LENGTH_UNITS.items()):
        concerned = dataset.measurements.tool == index
        if concerned.sum() >= FEWEST:
            tools = tuple(replace(t, centre=t.centre * factor) if t is tool else t for t in dataset.tools)
            what, other = f"`centre_mm` of `{tool.name}` is in {unit}", replace(dataset, tools=tools)
            yield what, ("tools", tool.name, "centre_mm"), "write it in mm", concerned, other


BEYOND = np.deg2rad(10)
"""rad, m: how far beyond its limit a joint is believed."""

MANY = 0.3
"""Share of rows beyond a limit from which on the readings as a whole are wrong."""
LINES, IMAGES_NAMED = 20, 3
"""Lines, or images, of impossible rows that are listed, beside the first."""
SYSTEMATIC = 0.1
"""Share of impossible rows of a target from which on they are no gross errors of single rows (convention)."""

LEVER = 0.3
"""m: arm of an angle's uncertainty when a target's place is judged."""

LIKE, OTHER_UNIT = "look like", "another unit's"
LOOKS_LIKE = LENGTH_UNITS | {
    180 / np.pi: "radians",
    np.pi / 180: "degrees converted twice",
    1e-3 * 180 / np.pi: "milliradians",
}
"""Factor by which values must be multiplied to be in deg or mm, and the probable unit."""


def check(dataset: Dataset, table: Table, document: Document) -> None:
    """Refuse the first implausible row or target, with its line; or the one change that explains all rows.

    The uncertainty of a target's pose is that of its prior; the frame of an instrument is unknown.
    """
    for problem in problems(dataset, table, document):
        raise problem if LIKE in problem.what else explanation(dataset, document) or problem


def problems(dataset: Dataset, table: Table, document: Document) -> Iterator[BayescalError]:
    """What `check` refuses, with places and remedies; what follows from a problem before is left out."""
    rows = dataset.measurements
    beyond, many = _beyond_limits(dataset.robot, rows.readings, table)
    if beyond is not None:
        yield beyond
    if many:
        return
    if (in_other_units := _in_other_units(dataset, table)) is not None:
        yield in_other_units
        return
    p, every = nominal(dataset, rows.readings), away(dataset, rows.readings)
    limit = np.array([max(OFF, 5 * (t.u or 0.0)) for t in dataset.tools])[rows.tool]
    for index, target in enumerate(dataset.targets):
        part = np.flatnonzero(rows.target == index)
        off = image_changes.by_corners(dataset, index, part, every[part])
        if KINDS[target.kind].placed and (off > limit[part]).any():
            mine = contacts(dataset, index, p, part)
            if (misplaced := _misplaced(mine, off, document)) is not None:
                yield misplaced
                continue
            off = settled(mine)
        of_image, of_row = partial(image_changes.impossible, dataset), partial(of_another, dataset, p)
        explain = of_image if KINDS[target.kind].posed else of_row
        wrong_row = _impossible(target, off, limit[part], part, table, document, explain)
        if wrong_row is not None:
            yield wrong_row
    for wrong in consistency.contradictions(dataset):
        if wrong.impossible:
            where = document.where(wrong.place)
            yield BayescalError(f"{wrong.what}, as the rows on them are", where, wrong.remedy)


def _beyond_limits(robot: Robot, readings: np.ndarray, table: Table) -> tuple[BayescalError | None, bool]:
    """A reading beyond its limits, and whether many are.

    Limits apply to the row of `link_from_reading`, without the sign of its diagonal.
    """
    sign = np.where(np.diag(robot.link_from_reading) < 0, -1.0, 1.0)
    angle = readings @ robot.link_from_reading.T * sign
    beyond = np.maximum(robot.limits[:, 0] - angle, angle - robot.limits[:, 1])
    bad = (beyond > BEYOND).any(axis=1)
    if not bad.any():
        return None, False
    row = int(np.argmax(bad))
    joint = int(np.argmax(beyond[row]))
    unit, (low, high) = robot.units[joint], robot.shown(robot.limits.T)[:, joint]
    coupled = int(np.count_nonzero(robot.link_from_reading[joint]) > 1)
    what = f"{robot.joint_names[joint]} is at {robot.shown(angle[row])[joint]:.6g} {unit}"
    what += " by its row of link_from_reading" * coupled + f", its limits are {low:g} to {high:g} {unit}"
    many = bool(bad.mean() > MANY)
    often = "many rows are: were degrees converted twice, or signs or coupling changed?"
    return table.error(row, what, often if many else "check the reading, or the robot's limits"), many


def _in_other_units(dataset: Dataset, table: Table) -> BayescalError | None:
    """Readings that are consistent with the session only in another unit than the stated one."""
    suspected = suspicion(dataset)
    if suspected is None:
        return None
    number = suspected.quantities[0].removeprefix("j")
    unit = dataset.robot.units[int(number) - 1] if number.isdigit() else "mm"
    columns = [f"`{quantity}_{unit}`" for quantity in suspected.quantities]
    every = len(columns) == dataset.robot.n
    noun = "the joint readings" if every else f"the values of {', '.join(columns)}"
    units = (word for factor, word in LOOKS_LIKE.items() if np.isclose(factor, suspected.factor))
    what = f"{noun} {LIKE} {next(units, OTHER_UNIT)}: "
    what += f"a row is {1e3 * suspected.stated:.0f} mm off, and then {1e3 * suspected.other:.2g}"
    return table.error(0, what, f"these columns hold {unit}: convert them")


def _misplaced(contacts: Contacts, away: np.ndarray, document: Document) -> BayescalError | None:
    """A misplaced target.

    The error of all its contacts is larger than its prior explains, or is small if its values are read in
    another unit.
    """
    target = contacts.target
    u, angle = place_sd(target), angle_sd(target)
    if away.min() <= OFF:
        return None
    remedy = ""
    for factor, unit in ((1e3, "m"), (1e-3, "µm")):
        keep = (KINDS[target.kind].direction, "diameter")
        values = {k: v if k in keep else v * factor for k, v in target.values.items()}
        other = replace(contacts, target=replace(target, values=values))
        if np.median(np.linalg.norm(residual(other)[0], axis=1)) < OFF:
            remedy = f"its values look like {unit}: write them in mm"
    if remedy or away.min() > 5 * (u + angle * LEVER):
        what = f"all contacts of `{target.name}` are nominally {1e3 * away.min():.0f} mm or more off it"
        remedy = remedy or "check its place, its frame (F0) and the units, or state a wider `u_mm`"
        return BayescalError(what, document.where(("targets", target.name)), remedy)
    return None


def _impossible(
    target: Target, away: np.ndarray, limit: np.ndarray, part: np.ndarray, table: Table, document: Document,
    explain: Callable[[np.ndarray, np.ndarray], tuple[str, bool, str]],
) -> BayescalError | None:  # fmt: skip
    """A row that disagrees with most of its target's rows, or a target on which none agree.

    `explain`: as `image_changes.impossible`, of the rows that disagree and how far, m, the largest first.
    """
    bad = away > limit
    if not bad.any():
        return None
    seen = KINDS[target.kind].posed
    which = "image" if seen else "reading" if KINDS[target.kind].of_instrument else "contact"
    if bad.mean() > 0.5:
        what = f"most {which}s of `{target.name}` disagree with the arm by {1e3 * np.median(away):.0f} mm"
        remedy = IMAGES if seen else f"{REMEDY}, the target, the tool and the units"
        return BayescalError(what, document.where(("targets", target.name)), remedy)
    worst = np.flatnonzero(bad)[np.argsort(-away[bad], kind="stable")]
    row = int(worst[0])
    others = {
        "image": "where the other images put the board of",
        "reading": "the point of the other readings on",
        "contact": "the fit of the other contacts on",
    }[which]
    what = f"impossible {which}: {1e3 * away[row]:.0f} mm from {others} `{target.name}`"
    others_off = part[bad & (away < away[row])]
    images = seen and "stop" in table.cells
    places = np.asarray(table.cells["stop"] if images else table.line)[others_off]
    names = list(dict.fromkeys(map(str, places)))
    few = IMAGES_NAMED if images else LINES
    named = f"{'images' if images else 'lines'} {', '.join(names[:few])}" + ", ..." * (len(names) > few)
    count = f"{len(others_off)} more row{'s are' if len(others_off) > 1 else ' is'}"
    more = f"; {count} too far off: {named}" if len(others_off) else ""
    said, explained, advice = explain(part[worst], away[worst])
    remedy = advice or "check target, tool and joint readings, or leave the row out"
    if bad.mean() > SYSTEMATIC and not explained:
        remedy = IMAGES if seen else f"{REMEDY}, target, tool and joint readings"
    return table.error(part[row], what + said + more, remedy)
