"""Names of added parts that no part of the user's file has."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree import ElementTree as ET

from bayescal.errors import BayescalError
from bayescal.exporting.xml_text import XmlText

KINDS = {
    "body": "body",
    "joint": "joint",
    "freejoint": "joint",
    "site": "site",
    "default": "class",
    "fixed": "tendon",
    "spatial": "tendon",
}
"""What the name of an element is one of; elements below <equality> are equalities."""
REFERENCES = {
    "joint": "joint",
    "joint1": "joint",
    "joint2": "joint",
    "body1": "body",
    "body2": "body",
    "class": "class",
    "childclass": "class",
}
"""What an attribute of an added element names."""

Renamed = Mapping[str, Mapping[str, str]]
"""Names in the file of added parts that are called otherwise there, by kind."""


def with_unique_names(xml: XmlText, model: Any, arm: Iterable[str], where: str) -> Renamed:
    """Give added elements other names where the file has theirs: ``flange_2``.

    Parameters
    ----------
    xml : XmlText
        Its tree is changed.
    model : MjModel
        Of the file without the added elements; it also has the names of attached parts.
    arm : iterable of str
        Names of the joints of the arm, to which added elements refer.
    where : str
        Name of the file.

    Raises
    ------
    BayescalError
        If an added joint has the name of a joint of the arm: what refers to it would be ambiguous.
    """
    equalities = {e for section in xml.root.iter("equality") for e in section}
    taken: dict[str, set[str]] = {kind: set() for kind in (*KINDS.values(), "equality")}
    for kind, count in (("body", model.nbody), ("joint", model.njnt), ("site", model.nsite)):
        taken[kind] |= {getattr(model, kind)(k).name for k in range(count)}
    for e in xml.kept():
        taken[_kind(e, equalities)].add(_name(e)) if _kind(e, equalities) else None
    added = [(e, _kind(e, equalities)) for e in xml.added()]
    renamed: dict[str, dict[str, str]] = {}
    for name, kind in dict.fromkeys((_name(e), kind) for e, kind in added if kind):
        if name in taken[kind]:
            if kind == "joint" and name in arm:
                what = f"an added joint would have the name of the arm's joint {name}"
                raise BayescalError(what, where, "rename that joint")
            new = next(own for k in range(2, 10**6) if (own := f"{name}_{k}") not in taken[kind])
            renamed.setdefault(kind, {})[name] = new
            taken[kind].add(new)
    for e, kind in added:
        if new_name := renamed.get(kind, {}).get(_name(e)):
            e.set("class" if kind == "class" else "name", new_name)
        for key, of in REFERENCES.items():
            if e.get(key) in renamed.get(of, {}):
                e.set(key, renamed[of][e.get(key, "")])
    return renamed


def _kind(e: ET.Element, equalities: set[ET.Element]) -> str:
    """What the name of an element is one of; "" where it has none."""
    return ("equality" if e in equalities else KINDS.get(e.tag, "")) if _name(e) else ""


def _name(e: ET.Element) -> str:
    return e.get("class", "") if e.tag == "default" else e.get("name", "")
