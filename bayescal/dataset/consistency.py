"""Checks of a session against nominal geometry: rows, certified lengths, orientations, planned rows, torques.

A plan has readings at which the nominal arm touches the nominal target exactly; no measured contact has,
because arm, targets and noise are off by micrometres at least. Some contacts come near by chance. If an error
at nominal geometry has the scale s, about the median of its target, then abs(r) < t has the probability
sqrt(2 / pi) t / s, and the k smallest of N errors are all below t with the binomial probability of k or more.
Contacts are taken for planned ones where this is below `CHANCE` 2^-k. Only errors far below the noise are
counted, so that repeats of a contact count as independent.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import bdtrc

from bayescal.arm.chain import chain_of, frames, link_angles, points
from bayescal.arm.statics import gravity_loads, torques_on_links
from bayescal.arm.transforms import rpy_matrix
from bayescal.dataset import target_kinds
from bayescal.dataset.contacts import Contacts, length_of, load_centre, load_mass, residual, scatter, settled
from bayescal.dataset.table import Table, joint_columns
from bayescal.dataset.target_kinds import KINDS, LOOSE
from bayescal.dataset.types import Dataset, Target
from bayescal.errors import BayescalError
from bayescal.statistics import decimals_of
from bayescal.storage.files import Document

OFF = 0.05
"""m: a contact this far from where the others of its target put the surface is impossible."""

EXPLAINED, COORDINATES = 0.7, 3
"""Share of every error from which on another target explains contacts that are off theirs, and the number of
their coordinates that it must explain (assumed)."""

FEWEST = 4
"""Rows of an instrument from which a rigid fit, or their turns from row to row, can judge any of them."""


def nominal(dataset: Dataset, readings: np.ndarray) -> np.ndarray:
    """Nominal ball centres in F0, (N, 3) m, at readings (N, n), rad."""
    tool = np.array([t.centre for t in dataset.tools])[dataset.measurements.tool]
    return points(chain_of(dataset.robot), link_angles(dataset.robot, readings), tool)


def contacts(dataset: Dataset, target: int, p: np.ndarray, part: np.ndarray) -> Contacts:
    """Some rows (M,) of one target, with ball centres p (N, 3), m, of all rows."""
    seen = target_kinds.seen(dataset, target, part, p[part].mean(axis=0))
    return Contacts(dataset.targets[target], p[part], seen)


def of_another(dataset: Dataset, p: np.ndarray, part: np.ndarray, off: np.ndarray) -> tuple[str, bool, str]:
    """Whether rows (M,) of a target, all off by `off` (M,), m, are those of another of its kind.

    As `image_changes.impossible`. They and its own rows place it; it explains them if that takes away
    `EXPLAINED` of every error, of at least `COORDINATES`: one contact may be near another face by chance.
    """
    target, best, name = int(dataset.measurements.target[part[0]]), 1.0 - EXPLAINED, ""
    kind = dataset.targets[target].kind
    tried = KINDS[kind].placed and residual(contacts(dataset, target, p, part))[0].size >= COORDINATES
    for other, candidate in enumerate(dataset.targets if tried else ()):
        its_rows = np.flatnonzero(dataset.measurements.target == other)
        if other != target and candidate.kind == kind and len(its_rows):
            every = settled(contacts(dataset, other, p, np.concatenate([its_rows, part])))
            if (ratio := float(np.max(every[len(its_rows) :] / off))) < best:
                best, name = ratio, candidate.name
    remedy = f"they agree with the contacts on `{name}`: correct their target, or leave them out"
    return "", bool(name), remedy if name else ""


def seen(dataset: Dataset, target: int, p: np.ndarray, part: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """Errors of some rows (M,) of an instrument after the best rigid fit, m; 0 where there are too few."""
    if (misfit := KINDS[dataset.targets[target].kind].misfit) is not None:
        return misfit(dataset, target, part, readings) if len(part) else np.zeros(0)
    xyz = dataset.measurements.xyz
    return np.zeros(len(part)) if len(part) < FEWEST or xyz is None else scatter(p[part], xyz[part], OFF)


def away(dataset: Dataset, readings: np.ndarray) -> np.ndarray:
    """Distance of every row from its target at nominal geometry, (N,) m."""
    p, out = nominal(dataset, readings), np.zeros(len(readings))
    for index, target in enumerate(dataset.targets):
        part = np.flatnonzero(dataset.measurements.target == index)
        if not KINDS[target.kind].placed:
            out[part] = seen(dataset, index, p, part, readings)
        elif len(part):
            out[part] = np.linalg.norm(residual(contacts(dataset, index, p, part))[0], axis=1)
    return out


LENGTH_UNITS = {1e3: "m", 25.4: "inches", 10.0: "cm", 1e-3: "µm"}
"""Factor by which a length must be multiplied to be in mm, and the probable unit."""
RATIOS = {25.4: "inches"} | LENGTH_UNITS | {39.37: "m taken for inches"}
"""The same of a certified length, which may be converted once too often; the first that fits is named."""
NEAR = 0.05
"""Relative tolerance of such a factor: nominal places are rounded."""

FINE = 5e-3
"""m: a nominal arm places surfaces no better than this."""


@dataclass(frozen=True)
class Contradiction:
    """A certificate by its place in dataset.yaml, what is wrong with its length, and a remedy.

    `impossible`: the rows on its targets contradict it too, by more than any error of an arm.
    """

    place: tuple[str | int, ...]
    what: str
    remedy: str
    impossible: bool


def contradictions(dataset: Dataset) -> Iterator[Contradiction]:
    """Certified distances that no error of the nominal places explains.

    Places are believed within their standard uncertainty, or, where rows were taken on both targets, within
    three times the typical distance of these rows from them.
    """
    targets = {t.name: t for t in dataset.targets}
    errors = cache(lambda: away(dataset, dataset.measurements.readings))
    for number, c in enumerate(dataset.certificates):
        if c.distance is None or len(c.targets) < 2:
            continue
        pair = [targets[name] for name in c.targets]
        there = length_of(pair, c.kind)
        if there is None or abs(c.distance - there) <= NEAR * c.distance:
            continue
        loose = max(LOOSE if t.u is None else 5 * t.u for t in pair)
        explained = max(FINE, 3 * sum(_typical_error(dataset, t, errors) for t in pair))
        if abs(c.distance - there) <= min(loose, explained):
            continue
        like = next((unit for f, unit in RATIOS.items() if abs(c.distance * f - there) < NEAR * there), "")
        back = next((u for f, u in RATIOS.items() if abs(c.distance - there * f) < NEAR * there * f), "")
        names = " and ".join(f"`{name}`" for name in c.targets)
        what = f"{names}: certified {1e3 * c.distance:.6g} mm, nominally {1e3 * there:.6g} mm apart"
        remedy = "check the certificate, the names and the nominal places"
        if back:
            remedy = f"the value was converted once too often, or the nominal places are in {back}"
        if like:
            remedy = f"the certified value looks like {like}: write it in mm"
        place = ("artefact",) if c.derived else ("certificates", number)
        yield Contradiction(place, what, remedy, abs(c.distance - there) > OFF + explained)


def _typical_error(dataset: Dataset, target: Target, errors: Callable[[], np.ndarray]) -> float:
    """Median distance, m, of the rows of a target from its nominal place; infinite if few rows say it."""
    index = [t.name for t in dataset.targets].index(target.name)
    rows = np.flatnonzero(dataset.measurements.target == index)
    judged = len(rows) >= FEWEST and KINDS[target.kind].placed
    return float(np.median(errors()[rows])) if judged else float("inf")


APART = np.radians(5.0)
"""What arm and reading may typically differ by: no arm is nominally so wrong, and no instrument."""


def check(dataset: Dataset, table: Table) -> None:
    """Refuse orientations in another unit or convention than the contract's.

    How far a frame turns between two rows depends neither on the instrument's frame nor on how the tool
    stands on the flange.
    """
    rows = dataset.measurements
    if rows.rpy is None:
        return
    flange = frames(chain_of(dataset.robot), link_angles(dataset.robot, rows.readings))[:, -1, :3, :3]
    read = np.flatnonzero(np.isfinite(rows.rpy).all(axis=1))
    for target, tool in np.unique(np.stack([rows.target[read], rows.tool[read]], axis=1), axis=0):
        part = read[(rows.target[read] == target) & (rows.tool[read] == tool)]
        if len(part) < FEWEST:
            continue
        seen, turned = _from_row_to_row(rpy_matrix(rows.rpy[part])), _from_row_to_row(flange[part])
        off = float(np.median(np.abs(seen - turned)))
        if off > APART:
            what = f"orientations that `{dataset.targets[target].name}` read turn from row to row by "
            what += f"{np.degrees(off):.0f} deg more or less than the arm"
            remedy = "check rx_deg, ry_deg, rz_deg: degrees, R = Rz(rz) Ry(ry) Rx(rx)"
            raise table.error(part[0], what, remedy)


def _from_row_to_row(turns: np.ndarray) -> np.ndarray:
    """Angles (C - 1,), rad, between successive rotations (C, 3, 3)."""
    from scipy.spatial.transform import Rotation  # slow to import, and many sessions need none

    rotations = Rotation.from_matrix(turns)
    return np.asarray((rotations[1:] * rotations[:-1].inv()).magnitude())


CHANCE = 1e-3
"""Chance that a session of measured contacts has any that is taken for a planned one."""
SHARE = 0.02
"""Of the stated noise, below which errors are counted."""
NOISE = 1e-6
"""m: of a session that states none (assumed)."""
SEVERAL = 3
"""Contacts from which on they were certainly not made: fewer occur by chance in some of many sessions."""
SLOPE = float(np.sqrt(2 / np.pi))


@dataclass(frozen=True)
class Planned:
    """Contacts that have the readings of a plan: rows, the chance of so many, and their largest error, m."""

    rows: np.ndarray
    chance: float
    error: float

    @property
    def certain(self) -> bool:
        """Whether these are more than chance, or the form of an error, may explain."""
        return len(self.rows) >= SEVERAL

    def words(self, dataset: Dataset, most: int = 4) -> str:
        """In words, with the first ids."""
        ids = [dataset.measurements.ids[k] for k in self.rows[:most]]
        more = ", ..." if len(self.rows) > most else ""
        error = f"{float(f'{1e9 * self.error:.1g}'):.9g} nm" if self.error > 1e-10 else "less than 0.1 nm"
        contacts = "1 contact has" if len(self.rows) == 1 else f"{len(self.rows)} contacts have"
        made = "such a contact was not made"
        if not self.certain:
            made = f"perhaps not made (chance of such measured contacts {self.chance:.1g})"
        touches = f"the nominal arm touches the nominal target within {error}"
        return f"{contacts} the readings of a plan ({', '.join(ids)}{more}): {touches}; {made}"


def planned(dataset: Dataset) -> Planned | None:
    """The contacts of a session that were never made, or None.

    Parameters
    ----------
    dataset : Dataset
    """
    m = dataset.measurements
    r = np.full(len(m.ids), np.nan)
    scale, noise = np.ones(len(r)), np.ones(len(r))
    errors = away(dataset, m.readings) if len(r) else r
    for k, target in enumerate(dataset.targets):
        rows, kind = np.flatnonzero(m.target == k), KINDS[target.kind]
        if not len(rows) or not kind.placed or kind.reads:
            continue
        noise[rows] = getattr(dataset.noise, kind.noise) or NOISE
        r[rows] = errors[rows]
        scale[rows] = np.maximum(np.median(r[rows]), noise[rows])
    rows = np.flatnonzero(np.isfinite(r))
    near = np.where(rows.size and r[rows] < SHARE * noise[rows], r[rows] / scale[rows], np.inf)
    order = np.argsort(near, kind="stable")[: int(np.sum(np.isfinite(near)))]
    if not len(order):
        return None
    count = np.arange(1, len(order) + 1)
    chance = bdtrc(count - 1, len(rows), np.minimum(SLOPE * near[order], 1.0))
    weighed = chance * 2.0 ** np.minimum(count, 1000)
    if np.min(weighed) >= CHANCE:
        return None
    k = int(np.flatnonzero(weighed == np.min(weighed))[-1])
    planned_rows = np.sort(rows[order[: k + 1]])
    return Planned(planned_rows, float(chance[k]), float(np.max(r[planned_rows])))


def doubled(dataset: Dataset) -> list[tuple[int, int]]:
    """Rows with all values of an earlier row and no `repeat` or `stop` in common: (row, the earlier one).

    Targets of joined sessions are compared by the names that the sessions give them.
    """
    m = dataset.measurements
    names = [t.name.removeprefix(f"{t.session}:") for t in dataset.targets]
    target = np.array([names.index(name) for name in names])[m.target]
    more = (target, m.tool, m.xyz, m.rpy, m.length, m.pixel, m.payload)
    blocks = [m.readings, *(b.reshape(len(m.ids), -1) for b in more if b is not None)]
    keys = np.nan_to_num(np.column_stack(blocks), nan=-1e9)
    first = dict[bytes, int]()
    pairs = [(row, first.setdefault(key.tobytes(), row)) for row, key in enumerate(keys)]
    labels = [s for s in (m.stop, m.repeat) if s is not None]
    return [(k, one) for k, one in pairs if one != k and not any(s[k] and s[k] == s[one] for s in labels)]


def copies(dataset: Dataset) -> str:
    """What speaks against independent rows, as a sentence; "" where no row is a copy."""
    if not (pairs := doubled(dataset)):
        return ""
    ids, (row, one) = dataset.measurements.ids, pairs[0]
    rows = f"{len(pairs)} of {len(ids)} rows have" if len(pairs) > 1 else "1 row has"
    what = f"{rows} the values of another row to the last digit (`{ids[row]}` those of `{ids[one]}`)"
    why = "a copy counts as a further measurement, so that uncertainties are too small"
    return f"{what}: {why}; remove copies"


STEPS = sorted([m * 10.0**-k for k in range(7) for m in (1, 2, 5)] + [360.0 / 2**k for k in range(10, 33)])
"""deg: steps of readings: of displays and files, and of encoders in whole counts of a turn (assumed)."""
VALUES = 20
"""Different readings of a joint from which on they state a step."""
NEAR_STEP = 0.02
"""Of a step: the rounding of its last digit."""
SEEN_STEP = 0.5
"""Of the stated noise of measurements, from which on rounded readings are told."""


def step_of(readings: np.ndarray) -> float:
    """The largest of `STEPS`, deg, of which readings (N,), deg, are multiples; 0 where they state none."""
    values = np.unique(readings)
    if len(values) < VALUES:
        return 0.0
    parts = ((values / step, step) for step in reversed(STEPS))
    return next((step for part, step in parts if np.max(np.abs(part - np.rint(part))) < NEAR_STEP), 0.0)


def steps(dataset: Dataset) -> np.ndarray:
    """Step (n,) in which the readings of each joint are written, deg; 0 where it is none, or of a slide."""
    each = zip(dataset.robot.slides, np.degrees(dataset.measurements.readings).T, strict=True)
    return np.array([0.0 if slides else step_of(q) for slides, q in each])


def rounded(dataset: Dataset) -> str:
    """Readings of too few digits for the stated noise, as a sentence; "" where they are fine enough."""
    m, step = dataset.measurements, steps(dataset)
    u = np.where(step > np.sqrt(12.0) * np.degrees(dataset.noise.joint), step / np.sqrt(12.0), 0.0)
    stated = [n for n in (dataset.noise.contact, dataset.noise.point) if n]
    if not np.any(u) or not stated:
        return ""
    tcp = nominal(dataset, m.readings)
    moved = [nominal(dataset, m.readings + row) - tcp for row in np.diag(np.radians(u))]
    size = float(np.sqrt(np.mean(np.sum(np.square(moved), axis=0))))
    if size < SEEN_STEP * min(stated):
        return ""
    digits = decimals_of(float(np.max(u)))  # two, and not less than u: what is advised must be enough
    what = f"readings have steps of up to {np.max(step):.4g} deg: {1e6 * size:.2g} µm at the tool"
    remedy = f"state `noise.joint_deg: {np.ceil(np.max(u) * 10.0**digits) / 10.0**digits:g}`"
    return f"{what}, beside a stated noise of {1e6 * min(stated):.2g} µm; log more digits, or {remedy}"


FELT = 1.0
"""RMS, N m, from which on the computed torque of a joint states a sign (assumed)."""
OPPOSED = -0.8
"""Correlation about zero of measured and computed torques below which their signs differ (assumed)."""


def check_present(dataset: Dataset, document: Document) -> None:
    """Refuse a session that states measured torques and has none."""
    if dataset.torques == "measured" and dataset.measurements.torque is None:
        what = "`torques: measured`, but measurements.csv has no columns `j1_nm` ..."
        raise BayescalError(what, document.where(("torques",)), "add them, or leave `torques` out")


def check_sign(dataset: Dataset, document: Document) -> None:
    """Refuse torques with which the motors hold the arm, in place of those with which the load turns it."""
    robot, m = dataset.robot, dataset.measurements
    if dataset.torques != "measured" or m.torque is None or robot.masses is None:
        return
    q, chain = link_angles(robot, m.readings), chain_of(robot)
    loads = gravity_loads(robot, chain, q, dataset.gravity, load_mass(dataset), load_centre(dataset))
    computed, measured = loads.torques(robot.slides), torques_on_links(robot, m.torque)
    size = np.sqrt(np.mean(computed**2, axis=0) * np.mean(measured**2, axis=0))
    alike = np.mean(computed * measured, axis=0) / np.maximum(size, 1e-12)
    wrong = (np.sqrt(np.mean(computed**2, axis=0)) > FELT) & (alike < OPPOSED)
    if np.any(wrong):
        names = joint_columns("nm", robot.units)
        columns = ", ".join(f"`{names[j]}`" for j in np.flatnonzero(wrong))
        what = f"{columns}: opposite in sign to the gravity torque of the load"
        remedy = "give the torque with which the load turns the joint, positive in the sense of its reading"
        raise BayescalError(what, document.where(("torques",)), remedy)
