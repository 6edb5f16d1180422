"""Parts that an earlier export added to a file: they are taken out, and new ones take their places."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET

from bayescal.exporting.mjcf.links import NEUTRAL, TIP
from bayescal.exporting.mjcf.text import DEFAULT

POSE = ("pos", "quat")


def without_earlier(root: ET.Element) -> frozenset[str]:
    """Take the parts of an earlier export out of a file, which is changed; names of its joints.

    They are recognised by their default class. A body that only carried added hinges gives its child back its
    place; masses and poses of the user's bodies are as the earlier export wrote them.
    """
    own = {e.get("class", "") for e in root.iter("default") if _default(e)}
    added = {
        e for e in root.iter()
        if e.get("class") in own or e.get("childclass") in own or (e.tag == "body" and _only_tips(e))
    }  # fmt: skip
    parents = {child: e for e in root.iter() for child in e}
    names = {j.get("name", "") for e in added for j in e.iter("joint") if parents[e].tag != "tendon"}
    carriers = [e for e in root.iter("body") if any(j in added for j in e) and _carrier(e, added)]
    for e in added:
        parents[e].remove(e)
    for carrier in carriers:
        _unwrap(carrier, parents[carrier])
    return frozenset(names - {""})


def _default(e: ET.Element) -> bool:
    """Whether a default class is that of an export, and not one of the user with its name."""
    joint, name = e.find("joint"), e.get("class", "")
    named = re.fullmatch(rf"{DEFAULT}(_\d+)?", name) is not None
    return named and joint is not None and NEUTRAL["joint"].items() <= joint.attrib.items()


def _only_tips(body: ET.Element) -> bool:
    """Whether a body is a flange with tips of tools alone."""
    return len(body) > 0 and all(e.tag == "site" and e.get("rgba") == TIP["rgba"] for e in body)


def _carrier(body: ET.Element, added: set[ET.Element]) -> bool:
    """Whether a body only has added hinges, a joint at most, and one other body."""
    rest = [e.tag for e in body if e not in added and e.tag != "inertial"]
    named = re.fullmatch(r"(stand|.*_carrier)(_\d+)?", body.get("name", ""))
    return named is not None and sorted(rest) in (["body"], ["body", "joint"])


def _unwrap(carrier: ET.Element, parent: ET.Element) -> None:
    """Put the body in a carrier in its place, with the joint that the carrier took from it."""
    inner = next(e for e in carrier if e.tag == "body")
    joint = next((e for e in carrier if e.tag == "joint"), None)
    if joint is not None:
        carrier.remove(joint)
        inner.insert(0, joint)
        for name in POSE:
            inner.set(name, carrier.get(name, ""))
    at = list(parent).index(carrier)
    carrier.remove(inner)
    parent.remove(carrier)
    parent.insert(at, inner)
