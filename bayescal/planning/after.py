"""What the next contacts of a measured session shall decide, from its diagnosis (gap.json)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayescal.dataset import Dataset
from bayescal.effects import UNITS
from bayescal.effects.compliance import COMPLIANCE
from bayescal.errors import BayescalError
from bayescal.folders import check_unchanged
from bayescal.gap.result import Pair, Side, Suspect
from bayescal.reading import read_record

GAP, SCHEMA = "gap.json", "bayescal-gap/1"
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
    """

    effects: tuple[str, ...]
    without: tuple[str, ...]
    pairs: tuple[Pair, ...]
    probability: Mapping[str, float]


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
    path = path / GAP if path.is_dir() else path
    if not path.exists():
        raise BayescalError("no such file", str(path), "give the run folder of bayescal gap")
    record = read_record(path, SCHEMA, AGAIN)
    check_unchanged(path.parent, (path.name,))
    of = record.get("dataset")
    if not isinstance(of, dict) or of.get("sha256") != dataset.sha256:
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
        named = [n["effect"] for n in record["named"]]
        pairs = tuple(
            Pair(*(_side(pair[key]) for key in ("a", "b", "common"))) for pair in record["undecided"]
        )
    except KeyError as error:
        raise BayescalError(f"it lacks {error}", where, AGAIN) from None
    except (TypeError, ValueError, AttributeError) as error:
        raise BayescalError(f"incomplete: {error}", where, AGAIN) from None
    if COMPLIANCE.name in named and COMPLIANCE.name not in effects:  # the other effects are named beside it
        effects = (*effects, COMPLIANCE.name)
        pairs = tuple(
            p for p in pairs if not any(s.selection.effect == COMPLIANCE.name for s in (*p.a, *p.b))
        )
    return Continuation(effects, without, pairs, probability)


def _side(entries: list[Mapping[str, Any]]) -> Side:
    """Effects with their parameters in SI."""
    out = []
    for s in entries:
        stated = {p["parameter"]: (p["value"], *SI[p["unit"]]) for p in s["values"]}
        values = {name: value / factor for name, (value, _, factor) in stated.items()}
        out.append(Suspect(s["model"], values, {name: unit for name, (_, unit, _) in stated.items()}))
    return tuple(out)
