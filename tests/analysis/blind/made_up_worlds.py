"""Truths and answers of worlds that were never made."""

from analysis.blind.score import records

PLACE = {"site": "joint 4", "driver": "joint angle", "also": ["angle 4"]}


def truth(
    world="000", kind="single", effects=("step",), strength=200.0, outside=None, place=None, floor=10.0
):
    """What a manufacturer would say; one lambda an effect, or the same of all."""
    sizes = strength if isinstance(strength, tuple) else (strength,) * len(effects)
    names = [outside] if outside else effects
    each = dict(zip(names, sizes, strict=True))
    return {
        "world": world,
        "kind": kind,
        "effects": list(effects),
        "outside": outside,
        "lambda": {"value": min(each.values(), default=0.0), "each": each},
        "where": [(place or PLACE) | {"effect": name} for name in names],
        "noise_um": 8.0,
        "distance_rms_um": {"fit_without_effect": floor},
    }


def at(site="joint 4", driver="angle 4", name=None):
    """A place of gap.json."""
    return {"site": site, "driver": driver, "explained_by": name}


def answer(
    world="000", verdict="named", named=("step",), p=None, sets=None, chosen=None, where=None, distances=None,
    planes=None, points=None, seconds=2.0, baseline=("geometry", "compliance"), measured=(),
):  # fmt: skip
    """What a diagnosis would say; sure of its names unless told otherwise."""
    p = {of: float(verdict == of) for of in ("null", "unknown")} | (p or dict.fromkeys(named, 1.0))
    if sets is None:
        sets = [(tuple(named), 1.0)]
    return {
        "world": world,
        "seconds": seconds,
        "gap": {
            "baseline": list(baseline),
            "verdict": verdict,
            "named": [{"effect": name} for name in named],
            "probability": p,
            "hypotheses": [{"effects": list(names), "probability": q} for names, q in sets],
            "credible_set90": list(named if chosen is None else chosen),
            "where": [*([at(name=name) for name in named] if where is None else where), at()],
            "gap": {"noise_um": 8.0, "measured": list(measured)},
            "shrinkage": {"planes": planes, "distances": distances} | ({"points": points} if points else {}),
        },
    }  # fmt: skip


def shrunk(before, after, said=None, expects=None, floor=8.0):
    """A shrinkage of gap.json; as predicted unless told otherwise."""
    return {
        "before_rms_um": before,
        "after_rms_um": after,
        "floor_um": floor,
        "predicted_before_rms_um": before if said is None else said,
        "predicted_rms_um": after if expects is None else expects,
    }


def one(true, said):
    """The record of one world."""
    return records({true["world"]: true}, {true["world"]: said} if said else {})[0]


def many(*pairs):
    """Records of worlds that are numbered here."""
    truths = {f"{k:03d}": true | {"world": f"{k:03d}"} for k, (true, _) in enumerate(pairs)}
    answers = {f"{k:03d}": said | {"world": f"{k:03d}"} for k, (_, said) in enumerate(pairs) if said}
    return records(truths, answers)


def null(**more):
    """A world that hides nothing."""
    return truth(kind="null", effects=(), **more)


def pair(a="step", b="lobing", strength=(200.0, 50.0), **more):
    """A world that hides two effects."""
    return truth(kind="pair", effects=(a, b), strength=strength, **more)


def tracked(**more):
    """A world that a tracker measured."""
    return truth(**more) | {"session": {"stage": "tracker"}, "point_rms_um": {"fit_without_effect": 10.0}}


def strange(name="tooth", strength=(150.0,), **more):
    """A world that hides what the vocabulary has no word for."""
    return truth(kind="outside", effects=("unknown",), outside=name, strength=strength, **more)


def silent(verdict="null", **more):
    """An answer without a name."""
    names = () if verdict == "null" else ("unknown",)
    return answer(verdict=verdict, named=(), sets=[(names, 1.0)], **more)


def perfect():
    """Pairs of truths and answers that are right in all, one of every kind at least."""
    good = {"distances": shrunk(30.0, 10.0), "planes": shrunk(20.0, 8.0)}
    return [
        (null(), silent()),
        *((truth(strength=size), answer(**good)) for size in (5.0, 15.0, 25.0, 40.0, 60.0, 200.0)),
        (pair(), answer(named=("lobing", "step"), **good)),
        (strange(), silent("unknown", chosen=("unknown",))),
    ]
