"""fleet.json: every session with what its run folders state, the arms, effects they share, learnt priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayescal.effects import UNITS
from bayescal.fleets.compare import Difference, Model, priors
from bayescal.reporting.origin import LIBRARIES, entry, plain, software
from bayescal.storage.reading import Json, read_record

FLEET, SCHEMA = "fleet.json", "bayescal-fleet/1"
REPEAT = "remove the folder, and repeat bayescal fleet"
PAGES = {"fit": "report.html", "gap": "gap.html"}
"""Page of each run folder of a session."""
UNKNOWN = "unknown"
LEARNT = ("stated_sd=parameter.sd", "deviation=mean", "u_deviation=u_mean", "usual_sd=usual", "sd")
"""Fields of a parameter of ``models``."""
SIZE = ("what", "value", "u", "unit")
"""Keys of an amplitude."""


def session_entry(name: str, path: Path, below: str, status: str, error: str) -> dict[str, Any]:
    """A session without results: its name, its dataset, its folder below that of the fleet, what failed."""
    return {
        "session": name, "dataset": str(path), "folder": below, "status": status, "error": error or None,
        "name": None, "sha256": None, "robot": None, "serial": None, "date": None, "arm": None, "fit": None,
        "gap": None, "effects": [], "probability": {},
    }  # fmt: skip


def with_fit(session: Json, folder: Path) -> dict[str, Any]:
    """The session with what fit.json states."""
    record = read_record(folder / "fit.json", "bayescal-fit/1", REPEAT)
    expected = record["predicted_distance"]
    keys = ("over", "count", "predicted_rms_um", "expanded_U_um", "measured_rms_um")
    return {
        **session,
        "name": record["dataset"]["name"],
        "sha256": record["dataset"]["sha256"],
        "robot": record["arm"]["robot"],
        "serial": record["record"]["serials"]["arm"],
        "date": record["record"]["date"],
        "fit": {key: expected.get(key) for key in keys}
        | {"verdict": record["verdict"]["words"], "usable": record["verdict"]["explains"]},
    }


def with_gap(session: Json, folder: Path) -> dict[str, Any]:
    """The session with what gap.json states: an entry of ``effects`` for each named effect and site."""
    record = read_record(folder / "gap.json", "bayescal-gap/1", REPEAT)
    sizes = {(a["effect"], a["site"]): a for a in record["amplitudes"]}
    named = [
        _named(one["effect"], site, one["probability"], sizes.get((one["effect"], site), {}))
        for one in record["named"]
        for site in one["sites"]
    ]
    if not named and record["verdict"] in (UNKNOWN, "class"):
        members = (record["class"] or {}).get("members") or [UNKNOWN]
        p = record["probability"].get(UNKNOWN) if list(members) == [UNKNOWN] else None
        named.append(_named(" or ".join(members), (record["class"] or {}).get("site") or "", p, {}))
    return {
        **session,
        "gap": {"verdict": record["verdict"], "words": record["words"]},
        "effects": named,
        "probability": record["probability"],
    }


def _named(effect: str, site: str, probability: float | None, size: Json) -> Json:
    stated = {key: size.get(key) for key in SIZE}
    return {"effect": effect, "site": site, "probability": probability, **stated}


def fleet_record(
    sessions: Sequence[Json], models: Sequence[Model], inputs: Json, files: Mapping[int, str]
) -> dict[str, Any]:
    """The content of fleet.json; `files` are the robot files of the models, by their index."""
    count = {status: sum(s["status"] == status for s in sessions) for status in ("fitted", "kept", "failed")}
    record = {
        "schema": SCHEMA,
        "software": software(LIBRARIES),
        "inputs": inputs,
        "count": {"sessions": len(sessions), **count},
        "arms": _arms(sessions, models),
        "effects": _effects(sessions),
        "models": [_model(m, files.get(k)) for k, m in enumerate(models)],
        "sessions": list(sessions),
    }
    return {key: plain(value) for key, value in record.items()}


def _arms(sessions: Sequence[Json], models: Sequence[Model]) -> list[dict[str, Any]]:
    """The arms in order: by what was found of them, then by the expanded uncertainty of distances."""
    return sorted((_arm(arm, m, sessions) for m in models for arm in m.arms), key=_order)


def _arm(arm: str, m: Model, sessions: Sequence[Json]) -> dict[str, Any]:
    of_arm = [s for s in sessions if s["arm"] == arm and s["robot"] == m.robot and s["fit"]]
    return {
        "arm": arm,
        "robot": m.robot,
        "sessions": [s["session"] for s in of_arm],
        **{key: of_arm[-1]["fit"][key] for key in ("expanded_U_um", "measured_rms_um")},
        "effects": list({(e["effect"], e["site"]): e for s in of_arm for e in s["effects"]}.values()),
        "differs": [_difference(d) for d in m.unlike if d.arm == arm],
        "changed": [_difference(d) for d in m.changed if d.arm == arm],
        "log_score_nats": m.gains.get(arm),
    }


def _order(arm: Json) -> tuple[Any, ...]:
    stated = [[d["p_all"] for d in arm[key] if d["stated"]] for key in ("changed", "differs")]
    return (-sum(map(len, stated)), -len(arm["effects"]), -(arm["expanded_U_um"] or 0.0), arm["arm"])


def _difference(d: Difference) -> dict[str, Any]:
    out = {"parameter": d.parameter.name, "unit": UNITS[d.parameter.unit][0]}
    out |= entry(d, "value", "u", unit=d.parameter.unit) | entry(d, "p_value=p", "p_all", "stated")
    return out | {"since": d.since or None}


def _effects(sessions: Sequence[Json]) -> list[dict[str, Any]]:
    """Effects by site: the arms of which a session has it named, and the number expected of all arms."""
    by_site: dict[tuple[str, str, str], list[tuple[str, Json]]] = {}
    for s in sessions:
        for e in s["effects"]:
            by_site.setdefault((s["robot"], e["effect"], e["site"]), []).append((s["arm"], e))
    every = (_effect(*key, each, sessions) for key, each in by_site.items())
    return sorted(every, key=lambda e: -len(e["arms"]))


def _effect(
    robot: str, effect: str, site: str, each: Sequence[tuple[str, Json]], sessions: Sequence[Json]
) -> dict[str, Any]:
    """An effect at a site: `each` is an arm, and the effect as a session of it has it."""
    chances: dict[str, float] = {}
    for s in sessions:
        if s["robot"] == robot and s["gap"]:
            chances[s["arm"]] = max(chances.get(s["arm"], 0.0), s["probability"].get(effect) or 0.0)
    sizes = [e["value"] for _, e in each if e["value"] is not None]
    return {
        **{"effect": effect, "site": site, "robot": robot},
        "arms": list(dict.fromkeys(arm for arm, _ in each)),
        **{"of": len(chances), "expected_arms": sum(chances.values())},
        "unit": each[0][1]["unit"],
        "values": [min(sizes), max(sizes)] if sizes else None,
    }


def _model(m: Model, file: str | None) -> dict[str, Any]:
    entries = []
    for prior in priors(m):
        p = prior.parameter
        unit, factor = UNITS[p.unit]
        stated = {"name": p.name, "unit": unit, "stated_deviation": factor * (p.centre - p.nominal)}
        entries.append(stated | entry(prior, *LEARNT, unit=p.unit) | {"effective_arms": prior.arms})
    gains = list(m.gains.values())
    return {
        **entry(m, "robot", "arms", "comparisons", "comparisons_between_sessions=pairs"),
        "log_score_nats": sum(gains) / len(gains) if gains else None,
        "better": sum(g > 0 for g in gains),
        "widened": None if m.learnt is None else m.learnt.factor,
        "file": file,
        "parameters": entries,
    }
