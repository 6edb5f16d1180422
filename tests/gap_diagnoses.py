"""Diagnoses of invented numbers: all verdicts and unusual sessions, for tests of reports and figures."""

from dataclasses import replace

import numpy as np

from bayescal.effects.location import BASE, PROBE, Driver, joint
from bayescal.gap.result import (
    Advice,
    BlindSpot,
    CauseClass,
    Curve,
    Gap,
    Hypothetical,
    Magnitude,
    Margin,
    Measured,
    Named,
    Place,
    Shrinkage,
    Step,
    Verdict,
)
from bayescal.model import FitOptions, Scene

NAN = float("nan")
BACKLASH = Named("backlash", "backlash", (joint(3),), "", 0.97, 120.0)
STEP = Named("step", "step@41", (BASE,), "from row 41 on", 0.95, 30.0)
NAMED = {"named": (BACKLASH,), "named+unexplained": (BACKLASH, STEP)}
DRIVERS = (Driver("direction", 3), Driver("torque", 3))
CLASS = CauseClass((joint(3),), DRIVERS, {"backlash": 0.45, "other": 0.45})
SETS = {
    "null": ("null",),
    "named": ("backlash",),
    "named+unexplained": ("backlash", "step"),
    "class": ("backlash", "unknown"),
    "unknown": ("unknown",),
    "ambiguous": ("bending", "base-compliance"),
}


def diagnosis(dataset, kind: str = "named", distances: bool = True) -> Gap:
    """A gap as a diagnosis could report it, from invented numbers."""
    rng = np.random.default_rng(0)
    rows = Scene(dataset).rows("calibrate")
    x = np.degrees(dataset.measurements.readings[rows, 0])
    noise = 5e-6 * rng.standard_normal(len(rows))
    bump = 30e-6 * np.exp(-((x / 8) ** 2))
    sign = np.sign(rng.standard_normal(len(rows)))
    null = kind == "null"
    before = noise if null else noise + bump
    named = NAMED.get(kind, ())
    p = 0.6 if null else 1e-9
    where = (
        Place(joint(3), Driver("direction", 3), 12e-6, 0.7, p, p, 100.0, "backlash" if named else "",
              Curve("sign of the speed of joint 3", sign, before, 4e-6 * sign * np.sin(x), rows)),
        Place(joint(1), Driver("angle", 1, form="one place"), 5e-6, 0.1, p, p, 18.0, "",
              Curve("reading of joint 1 (deg)", x, before, bump, rows)),
        Place(PROBE, Driver("contact direction"), 1e-6, NAN, 0.4, 1.0, -2.0, "",
              Curve("", x[:0], x[:0], x[:0], rows[:0])),
    )  # fmt: skip
    sure = dict.fromkeys(SETS[kind], 0.9 / len(SETS[kind]))
    verdict = Verdict(
        kind, named, {"null": 0.0, "unknown": 0.05, "latency": 0.001} | sure, SETS[kind],
        (Hypothetical(tuple(n for n in SETS[kind] if n != "null"), 0.9, 60.0), Hypothetical((), 0.01, 0.0)),
        (), {"thermal-drift": "no time_s"}, ("backlash, not delayed readings",),
        CLASS if kind == "class" else None,
    )  # fmt: skip
    shrinkage = (Shrinkage("planes", 60, 13e-6, 6.4e-6, 6e-6, 0.96, (0.91, 0.99), 12e-6, 6.2e-6, True),)
    if distances:
        shrinkage += (Shrinkage("distances", 12, 27e-6, 31e-6, 5e-6, NAN, (NAN, NAN), 33e-6, 30e-6, False),)
    measured = (Measured("validation contacts", 60, 6.2e-6 if null else 13e-6, 6e-6, (5e-6, 7e-6)),)
    at = 500e-6 if distances else NAN
    models = (("nominal",), ("geometry",), ("geometry", "compliance"))
    ladder = [Step(m, 600e-6 / 5**k, at / 4**k, NAN, 40.0 if k else NAN, 6.0) for k, m in enumerate(models)]
    model = models[-1]
    for n in named:
        model = (*model, n.model)
        ladder.append(Step(model, 6.4e-6, 5e-6 if distances else NAN, NAN, 41.0, 7.0))
    poses = tuple(tuple(r) for r in dataset.measurements.readings[:3])
    return Gap(
        dataset, ("geometry", "compliance"), FitOptions(seed=3),
        Magnitude("validation data", 13e-6, 6e-6, (5.4e-6, 6.7e-6), "repeats", 0.0 if null else 11.6e-6,
                  (0.0, 2e-6) if null else (9.8e-6, 13.2e-6), measured),
        where, {"target": (Margin("cube.+y", "cube.+y", 30, 14e-6, 1e-6, 1e-4),)}, verdict,
        () if null else shrinkage, tuple(ladder),
        (Advice(("bending", "base-compliance"), "payload +2 kg", poses, 12.0, 260.0),),
        (BlindSpot("lobing", PROBE, 4e-6, 8e-6, "m", 2e-6),
         BlindSpot("backlash", joint(6), 1e-5, 2e-5, "rad", NAN)),
        (rows, before, noise), ("beware",), (rows[:0], rows[:0]),
    )  # fmt: skip


def bare(dataset) -> Gap:
    """A gap with every table empty."""
    nothing = dict.fromkeys(("where", "shrinkage", "levels", "advice", "blind_spots"), ())
    return replace(diagnosis(dataset, "null"), margins={}, **nothing)


def plane(dataset):
    """One face alone, with no time, velocities or temperature."""
    m = dataset.measurements
    keep = np.flatnonzero(m.target == 1)
    few = {name: getattr(m, name)[keep] for name in ("role", "target", "tool", "readings", "line")}
    absent = dict.fromkeys(("velocity", "command", "torque", "time", "temperature", "payload"))
    table = replace(m, ids=tuple(m.ids[k] for k in keep), **few, **absent)
    return replace(dataset, measurements=table, certificates=())


def seven(dataset):
    """The same contacts by an arm with one joint more."""
    robot, m = dataset.robot, dataset.measurements
    more = {name: np.append(getattr(robot, name), 0.0) for name in ("alpha", "a", "d", "offset", "beta")}
    robot = replace(
        robot, joint_names=(*robot.joint_names, "J7"), **more,
        limits=np.vstack([robot.limits, [-3.0, 3.0]]), link_from_reading=np.eye(7),
        masses=None, centres_of_mass=None, compliance=None, reductions=None,
    )  # fmt: skip
    readings = np.column_stack([m.readings, np.zeros(len(m.readings))])
    table = replace(m, readings=readings, velocity=None, command=None, torque=None)
    return replace(dataset, robot=robot, measurements=table)
