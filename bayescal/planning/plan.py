"""A plan: contacts chosen for distances and for what a diagnosis left open, in the order of probing."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.dataset import Dataset
from bayescal.dataset.write import taken
from bayescal.effects import BASELINE, UNITS
from bayescal.effects.compliance import COMPLIANCE
from bayescal.errors import BayescalError
from bayescal.gap.result import Pair, Side, Suspect
from bayescal.model import check_asked
from bayescal.model.options import Part
from bayescal.planning import order as orders
from bayescal.planning import result
from bayescal.planning.candidates import COUNT, candidates
from bayescal.planning.contrasts import contrasts
from bayescal.planning.exchange import observability_of, select
from bayescal.planning.goals import goals
from bayescal.planning.pool import Pool, Setup, check_count, linearised
from bayescal.planning.projection import Projection, nominal
from bayescal.planning.result import BOTH, DISTANCES, GAP, REPEAT, VALIDATE, Plan
from bayescal.planning.separate import best_of, choose, confusable, detectable, repeated, with_levers
from bayescal.probing.contacts import TURNING
from bayescal.statistics import spawned
from bayescal.storage.folders import check_unchanged
from bayescal.storage.reading import read_record
from bayescal.storage.stopping import Progress, silent

AIMS = (BOTH, DISTANCES, GAP)
PAYLOAD, APPROACH = "payload", "approach"
LEVERS = (PAYLOAD, APPROACH)
"""What may be varied beside the pose: the load on the flange, and the motion that reaches a contact."""
REPEATS = 10
"""Contacts that are measured once more, for the noise."""
SHARE = 0.1
"""Largest share of a plan that repeats are."""
RANDOM = 5
"""Random selections that a plan's detectability is compared with."""


@dataclass(frozen=True)
class PlanOptions:
    """What a plan is asked for.

    Attributes
    ----------
    contacts : int
        Contacts to calibrate with, including those that are measured twice. Those that validate spheres of
        certified distances are added.
    aim : str
        DISTANCES, GAP or BOTH: half for each.
    effects : tuple of str
        The model: names of `effects.MODELS`.
    levers : tuple of str
        Of `LEVERS`: what may be varied beside the pose.
    order : str
        Of `order.ORDERS`.
    candidates : int
        Number of candidates.
    seed : int
        The same seed gives the same plan.
    pairs : tuple of Pair
        What the contacts for the gap shall decide; default: every effect that the model lacks, at each site.
    without : tuple of Part
        Parts that the model lacks.
    probability : mapping of str to float, optional
        Of effects by a diagnosis: how much each counts beside the pairs.
    validation : bool
        Whether contacts that validate spheres of certified distances are added.
    """

    contacts: int = 200
    aim: str = BOTH
    effects: tuple[str, ...] = BASELINE
    levers: tuple[str, ...] = LEVERS
    order: str = orders.SWEEPS
    candidates: int = COUNT
    seed: int = 0
    pairs: tuple[Pair, ...] = ()
    without: tuple[Part, ...] = ()
    probability: Mapping[str, float] | None = None
    validation: bool = True

    def check(self) -> None:
        """Refuse options that are not possible.

        Raises
        ------
        BayescalError
            With the option of the command.
        """
        asked = [("--for", self.aim, AIMS, "one"), ("--order", self.order, tuple(orders.ORDERS), "one")]
        asked += [("--levers", lever, LEVERS, "some") for lever in self.levers]
        for option, value, names, number in asked:
            if value not in names:
                remedy = f"give {number} of {', '.join(names)}"
                raise BayescalError(f"`{value}` is not known", option, remedy)
        if self.contacts < 1:
            raise BayescalError(f"{self.contacts} contacts are no plan", "--contacts", "give 1 or more")
        check_asked(self.effects, 1.0)


def plan(setup: Setup, options: PlanOptions = PlanOptions(), progress: Progress = silent) -> Plan:
    """Choose contacts to measure.

    Parameters
    ----------
    setup : Setup
        Of a session that is to be measured, or to be continued.
    options : PlanOptions
    progress : callable
        Called with the stage and its completed fraction.

    Raises
    ------
    BayescalError
        If an option is not possible, no target is reached, or the contacts are fewer than the unknowns.
    """
    begin = time.perf_counter()
    options.check()
    effects, without, pairs = options.effects, options.without, options.pairs
    of_pool, of_distances, of_gap, of_order = spawned(options.seed, 4)
    turning = TURNING if APPROACH in options.levers else 0.0
    if PAYLOAD not in options.levers or setup.dataset.robot.masses is None:
        setup = replace(setup, payloads=())
    pool = candidates(setup, options.candidates, of_pool, progress, turning, options.validation)
    linear = linearised(pool, effects, without=without)
    few = check_count(linear, options.contacts)
    wanted = goals(pool, linear)
    decide = contrasts(pool, nominal(pool.session, effects, without), pairs, without, options.probability)
    vocabulary = decide.vocabulary
    random = result.Random(pool, options.seed)

    again = 0 if options.aim == DISTANCES else min(REPEATS, int(SHARE * options.contacts))
    fresh = options.contacts - again
    first = {DISTANCES: fresh, GAP: 0, BOTH: fresh // 2}[options.aim]
    rng = np.random.default_rng(of_distances)
    for_distances = np.empty(0, int)
    if first:
        for_distances = select(linear, wanted, first, rng, progress=partial(progress, "distances"))
    rng = np.random.default_rng(of_gap)
    for_gap = choose(decide, fresh - first, rng, for_distances, progress=partial(progress, "gap"))
    if options.aim == GAP:
        for_gap = best_of(decide, [for_gap, *random.selections(fresh, RANDOM)])
    chosen = np.concatenate([for_distances, for_gap])
    repeats = repeated(decide, chosen, rng, again)
    every = np.concatenate([chosen, repeats])

    progress("expected", 0.0)
    by_chance = random.selections(options.contacts, RANDOM)
    selections = [Projection(vocabulary.columns, s) for s in by_chance]
    planned = Projection(vocabulary.columns, every)
    before = [Projection(vocabulary.columns)] if pool.measured else selections
    similar = confusable(vocabulary, planned, before, pairs)
    separated = with_levers(pool, effects, chosen, similar, rng, without)
    curve = result.curves(linear, wanted, every, random)
    purpose = [DISTANCES] * len(for_distances) + [GAP] * len(for_gap) + [REPEAT] * again
    rows = np.concatenate([pool.candidates[every], pool.validation])
    purpose += [VALIDATE] * len(pool.validation)
    progress("order", 0.0)
    moves = orders.Transits(pool)
    visit = orders.ordered(pool, rows, options.order, np.random.default_rng(of_order), moves.blocked)
    progress("motions", 0.5)
    rows = rows[visit]
    ways = moves.ways(rows)
    session = _session(pool, rows, repeats=set(pool.candidates[repeats].tolist()))
    progress("done", 1.0)
    return Plan(
        pool=replace(pool, setup=replace(setup)),  # without the free configurations of its hands: 60 MB
        session=session,
        purpose=tuple(purpose[k] for k in visit),
        approach=pool.approach[rows],
        effects=effects,
        expected=result.expected(linear, wanted, every, random),
        parameters=result.parameters(linear, every),
        observability=observability_of(linear, every),
        observability_random=_median([observability_of(linear, s) for s in by_chance]),
        detectable=detectable(vocabulary, planned, selections),
        confusable=separated,
        travel=orders.travel(pool, rows, ways.leave, ways.via),
        **vars(ways),
        **vars(curve),
        seconds=time.perf_counter() - begin,
        warnings=(
            *setup.notes,
            *pool.warnings,
            *(text for text in (*(goal.note for goal in wanted), few) if text),
            *_closed(session, ways.by_hand),
        ),
        aim=options.aim,
        order=options.order,
        seed=options.seed,
    )


def _session(pool: Pool, rows: np.ndarray, repeats: set[int]) -> Dataset:
    """The planned rows as a session, in order; both measurements of a repeated contact share its name."""
    m = taken(pool.session.measurements, rows)
    width, measured = len(str(len(rows))), pool.session.measurements.ids[: pool.measured]
    prefixes = ["p", *(f"p{k}-" for k in range(2, len(measured) + 3))]
    prefix = next(p for p in prefixes if not any(name.startswith(p) for name in measured))
    twice = [row for row in dict.fromkeys(rows.tolist()) if row in repeats]
    groups = {row: f"r{k + 1:02d}" for k, row in enumerate(twice)}
    ids = tuple(f"{prefix}{k + 1:0{width}d}" for k in range(len(rows)))
    time = None if m.time is None else np.sort(m.time)
    repeat = np.array([groups.get(row, "") for row in rows.tolist()])
    m = replace(m, ids=ids, line=np.arange(len(rows)) + 2, time=time, repeat=repeat)
    return replace(pool.session, measurements=m)


def _closed(session: Dataset, by_hand: Sequence[str]) -> list[str]:
    """A warning of contacts to which no free way was found."""
    ids = [name for name, words in zip(session.measurements.ids, by_hand, strict=True) if words]
    text = f"no collision-free path found to {', '.join(ids)} from the contact before: jog manually"
    return [text] if ids else []


def _median(each: Sequence[dict[str, float]]) -> dict[str, float]:
    return {key: float(np.median([one[key] for one in each])) for key in each[0]}


GAP_FILE, COPY, SCHEMA = "gap.json", "dataset", "bayescal-gap/1"
AGAIN = "repeat bayescal gap with this version"
SI = {name: (unit, factor) for unit, (name, factor) in UNITS.items()}
"""SI unit, and factor from it, by the unit in a file."""


@dataclass(frozen=True)
class Continuation:
    """What a diagnosis leaves open.

    Attributes
    ----------
    effects : tuple of str
        The model beside which effects are named, as for --model.
    without : tuple of str
        Parts that it lacks.
    pairs : tuple of Pair
        Explanations between which the data do not decide, and names that are not confirmed. Without any, the
        next contacts shall show every effect.
    probability : mapping of str to float
        Of every effect that was assessed.
    noise_scale : mapping of str to float
        Factors on the stated noise that were found, by noise group.
    """

    effects: tuple[str, ...]
    without: tuple[str, ...]
    pairs: tuple[Pair, ...]
    probability: Mapping[str, float]
    noise_scale: Mapping[str, float]


def continuation(dataset: Dataset, gap: Path | str) -> Continuation:
    """Read what a diagnosis of a session leaves open.

    Parameters
    ----------
    dataset : Dataset
        The session that was diagnosed.
    gap : path
        Its gap.json, or the run folder that holds it.

    Raises
    ------
    BayescalError
        If there is no such diagnosis, or it is one of other data or of another version.
    """
    path = Path(gap)
    path = path / GAP_FILE if path.is_dir() else path
    if not path.exists():
        raise BayescalError("no such file", str(path), "give the run folder of bayescal gap")
    record = read_record(path, SCHEMA, AGAIN)
    check_unchanged(path.parent, (path.name,))
    of = record.get("dataset")
    is_copy = dataset.folder.resolve() == (path.parent / COPY).resolve()  # rewritten: it has another hash
    check_unchanged(path.parent, (COPY,) if is_copy else ())
    if not isinstance(of, dict) or not (is_copy or of.get("sha256") == dataset.sha256):
        what = f"it is no diagnosis of the present files of {dataset.name}"
        raise BayescalError(what, str(path), "repeat bayescal gap of this dataset")
    return continued(record, str(path))


def continued(record: Mapping[str, Any], where: str) -> Continuation:
    """What the content of a gap.json leaves open.

    Raises
    ------
    BayescalError
        If it is of another version.
    """
    try:
        effects, without = tuple(record["baseline"]), tuple(record["without"])
        probability = {name: float(p) for name, p in record["probability"].items()}
        noise_scale = {group: float(k) for group, k in record["noise_scale"].items()}
        named = [n["effect"] for n in record["named"]]
        undecided = ([_side(pair[key]) for key in ("a", "b", "common")] for pair in record["undecided"])
        pairs = tuple(Pair(*sides) for sides in undecided)
    except KeyError as error:
        raise BayescalError(f"it lacks {error}", where, AGAIN) from None
    except (TypeError, ValueError, AttributeError) as error:
        raise BayescalError(f"incomplete: {error}", where, AGAIN) from None
    if COMPLIANCE.name in named and COMPLIANCE.name not in effects:  # the other effects are named beside it
        effects = (*effects, COMPLIANCE.name)
        effects_of = ({s.selection.effect for s in (*p.a, *p.b)} for p in pairs)
        pairs = tuple(p for p, of in zip(pairs, effects_of, strict=True) if COMPLIANCE.name not in of)
    return Continuation(effects, without, pairs, probability, noise_scale)


def _side(entries: list[Mapping[str, Any]]) -> Side:
    """Effects with their parameters in SI."""
    out = []
    for s in entries:
        stated = {p["parameter"]: (p["value"], *SI[p["unit"]]) for p in s["values"]}
        values = {name: value / factor for name, (value, _, factor) in stated.items()}
        out.append(Suspect(s["model"], values, {name: unit for name, (_, unit, _) in stated.items()}))
    return tuple(out)
