"""A plan by hand, from the rows of a simulated session: what the reports and exports are tested with."""

import numpy as np
from sessions import with_columns

from bayescal.dataset import Box, Dataset
from bayescal.effects.location import PROBE, joint, link
from bayescal.planning import result
from bayescal.planning.pool import Pool, Setup

AWAY = 4.0
"""s of motion back from a contact at the speed of approach: 20 mm at 5 mm/s."""


def some(dataset: Dataset, rows: np.ndarray, ids: tuple[str, ...]) -> Dataset:
    """Rows of a session with other names."""
    m = dataset.measurements
    columns = {name: column[rows] for name, column in vars(m).items() if name != "ids" and column is not None}
    return with_columns(dataset, ids=ids, **columns)


def made_up_plan(dataset: Dataset, count: int = 40, validation: int = 8) -> result.Plan:
    """The first rows of a session as a plan, with invented figures."""
    ids = tuple(f"p{k:03d}" for k in range(1, count + validation + 1))
    session = some(dataset, np.arange(count + validation), ids)
    m = session.measurements
    role = np.where(np.arange(len(ids)) < count, "calibrate", "validate")
    repeat = np.where(np.arange(len(ids)) % 10 == 3, "r1", "")
    repeat[count:] = ""
    session = with_columns(session, role=role, repeat=repeat)
    purpose = [result.DISTANCES if k % 2 else result.GAP for k in range(count)]
    purpose += [result.VALIDATE] * validation
    purpose = tuple(result.REPEAT if r else p for p, r in zip(purpose, repeat, strict=True))
    back = 0.0 if m.velocity is None else AWAY * m.velocity
    setup = Setup(dataset, {}, Box(np.array([0.4, 0.0, 0.3]), np.array([0.3, 0.4, 0.2])), (0.5,))
    dropped = {"beyond a joint limit": 812, "arm hits the table": 95}
    pool = Pool(setup, dataset, 0, dataset.measurements.readings, dropped)
    return result.Plan(
        pool=pool,
        session=session,
        purpose=purpose,
        approach=session.measurements.readings - back,
        effects=("geometry", "compliance"),
        expected=(
            result.ExpectedDistances(
                "certified distances", 15, 4.9e-6, 7.1e-6,
                {"noise": 0.21, "certificate": 0.04, "probing": 0.72, "prior": 0.03},
            ),
            result.ExpectedDistances(
                "volume of interest", 200, 6.1e-6, 9.8e-6,
                {"noise": 0.83, "certificate": 0.11, "probing": 0.0, "prior": 0.06},
            ),
        ),
        parameters=(
            result.ExpectedParameter("a2", "mm", 0.0071, 0.3),
            result.ExpectedParameter("compliance J2", "urad/(N m)", 0.021, 3.0),
        ),
        observability={"O1": 812.0, "O2": 0.0021, "O3": 31.0, "O4": 0.07, "O5": 0.9},
        observability_random={"O1": 610.0, "O2": 0.0013, "O3": 19.0, "O4": 0.03, "O5": 1.4},
        curve=((50, 8.8e-6), (100, 6.3e-6), (200, 4.9e-6), (400, 4.1e-6)),
        curve_random=((50, 14e-6), (100, 10e-6), (200, 7.1e-6), (400, 5.2e-6)),
        equals_random=463.0,
        next_u=4.8e-6,
        detectable=(
            result.Detectable("backlash", joint(3), "rad", 4e-6, 7e-6, 3e-5),
            result.Detectable("backlash", joint(6), "rad", 2e-5, 5e-5, 3e-5),
            result.Detectable("bending", link(3), "rad/(N m)", 1e-7, 4e-7, 3e-7),
            result.Detectable("lobing", PROBE, "m", 1.2e-6, 1.4e-6, 3e-6),
            result.Detectable("latency", PROBE, "s", np.inf, np.inf, 1e-3),
        ),
        confusable=(
            result.Confusable(("compliance at joint 3", "bending of link 3"), 3.1, 27.0),
            result.Confusable(("eccentricity of joint 1", "base-compliance"), 0.4, 0.6, "a payload of 2 kg"),
        ),
        travel=2150.0,
        seconds=14.2,
        warnings=("fewer contacts than unknowns + 40",),
    )  # fmt: skip
