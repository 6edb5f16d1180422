"""What is done around the edits of a user's file.

Parts of an earlier export are taken out before; after, added parts get names that the file does not have, and
its keyframes the positions of more joints.
"""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from bayescal.errors import BayescalError
from bayescal.exporting.mjcf.mechanism import PARTS
from bayescal.exporting.mjcf.readings import Joints, Law, posture
from bayescal.exporting.mjcf.scene_arm import SceneFile, compiled
from bayescal.exporting.xml_text import XmlText, numbers

POSE = ("pos", "quat")


def without_earlier(root: ET.Element) -> frozenset[str]:
    """Take the parts of an earlier export out of a file, which is changed; names of its joints.

    They are recognised by their default class. A body that only carried added hinges gives its child back its
    place; masses and poses of the user's bodies are as the earlier export wrote them.
    """
    classes = {e.get("class", "") for e in root.iter("default") if _default(e)}
    added = {
        e for e in root.iter()
        if e.get("class") in classes or e.get("childclass") in classes or (e.tag == "body" and _only_tips(e))
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
    named = re.fullmatch(rf"{PARTS.CLASS}(_\d+)?", name) is not None
    return named and joint is not None and PARTS.NEUTRAL["joint"].items() <= joint.attrib.items()


def _only_tips(body: ET.Element) -> bool:
    """Whether a body is a flange with tips of tools alone."""
    return len(body) > 0 and all(e.tag == "site" and e.get("rgba") == PARTS.TIP["rgba"] for e in body)


def _carrier(body: ET.Element, added: set[ET.Element]) -> bool:
    """Whether a body only has added hinges, a joint at most, and one other body."""
    tags = [e.tag for e in body if e not in added and e.tag != "inertial"]
    named = re.fullmatch(r"(stand|.*_carrier)(_\d+)?", body.get("name", ""))
    return named is not None and sorted(tags) in (["body"], ["body", "joint"])


def _unwrap(carrier: ET.Element, parent: ET.Element) -> None:
    """Put the body in a carrier in its place, with the joint that the carrier took from it."""
    inner = next(e for e in carrier if e.tag == "body")
    joint = next((e for e in carrier if e.tag == "joint"), None)
    if joint is not None:
        carrier.remove(joint)
        inner.insert(0, joint)
        for name in POSE:
            inner.set(name, carrier.get(name, ""))
    index = list(parent).index(carrier)
    carrier.remove(inner)
    parent.remove(carrier)
    parent.insert(index, inner)


def with_keyframes(
    scene: SceneFile, before: Any, gone: Collection[str], law: Law, joints: Joints, renamed: Mapping[str, str]
) -> None:
    """Rewrite positions and speeds of the keyframes for the joints of the patched file.

    Parameters
    ----------
    scene : SceneFile
        The patched file; its tree is changed.
    before : MjModel
        Of the file as it was.
    gone : collection of str
        Joints of that file that are taken out of it.
    law, joints
        Of the arm: added joints stand as its readings demand.
    renamed : mapping
        Names of added joints in the file, where they differ.
    """
    keys = scene.root.findall("keyframe/key")
    if not keys:
        return
    stated = [{name: key.attrib.pop(name) for name in MOVING if name in key.attrib} for key in keys]
    after = compiled(scene.xml.text, scene.path.parent, scene.path.name)
    old, new = ([model.joint(j).name for j in range(model.njnt)] for model in (before, after))
    for k, (key, texts) in enumerate(zip(keys, stated, strict=True)):
        if old == new and not gone:
            key.attrib.update(texts)
            continue
        values = before.key_qpos[k]
        angles = np.array([values[before.joint(name).qposadr[0]] for name in joints.names])
        stood = posture(law, joints, np.linalg.solve(law.nominal, joints.signs * angles))
        stood = {renamed.get(name, name): value for name, value in stood.items()}
        if "qpos" in texts:
            key.set("qpos", numbers(_moved(before, after, gone, values, "qpos", stood)))
        if "qvel" in texts:
            key.set("qvel", numbers(_moved(before, after, gone, before.key_qvel[k], "qvel", {})))


MOVING = {"qpos": ("jnt_qposadr", (7, 4, 1, 1)), "qvel": ("jnt_dofadr", (6, 3, 1, 1))}
"""Addresses of what a keyframe states, and its sizes by the type of a joint."""


def _moved(
    before: Any, after: Any, gone: Collection[str], values: np.ndarray, what: str, stood: Mapping[str, float]
) -> np.ndarray:
    """Values of the joints of the patched file: those of the file's own joints, and of the added ones."""
    start, sizes = MOVING[what]
    out = after.qpos0.copy() if what == "qpos" else np.zeros(after.nv)
    old = [j for j in range(before.njnt) if before.joint(j).name not in gone]
    names, remaining = {before.joint(j).name for j in old}, iter(old)
    for j in range(after.njnt):
        name, address = after.joint(j).name, int(getattr(after, start)[j])
        if not name or name in names:
            was, size = int(getattr(before, start)[next(remaining)]), sizes[int(after.jnt_type[j])]
            out[address : address + size] = values[was : was + size]
        elif name in stood:
            out[address] = stood[name]
    return out


KINDS = {"body": "body", "joint": "joint", "freejoint": "joint", "site": "site", "default": "class"}
KINDS |= dict.fromkeys(("fixed", "spatial"), "tendon")
"""What the name of an element is one of; elements below <equality> are equalities."""
REFERENCES = dict.fromkeys(("joint", "joint1", "joint2"), "joint")
REFERENCES |= dict.fromkeys(("body1", "body2"), "body") | dict.fromkeys(("class", "childclass"), "class")
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
    kinds = {e: "equality" if e in equalities else KINDS.get(e.tag, "") for e in xml.root.iter() if _name(e)}
    taken: dict[str, set[str]] = defaultdict(set)
    for kind, count in (("body", model.nbody), ("joint", model.njnt), ("site", model.nsite)):
        taken[kind] |= {getattr(model, kind)(k).name for k in range(count)}
    for e in xml.kept():
        taken[kinds.get(e, "")].add(_name(e))
    added = [(e, kinds.get(e, "")) for e in xml.added()]
    renamed: dict[str, dict[str, str]] = {}
    for name, kind in dict.fromkeys((_name(e), kind) for e, kind in added if kind):
        if name in taken[kind]:
            if kind == "joint" and name in arm:
                what = f"an added joint would have the name of the arm's joint {name}"
                raise BayescalError(what, where, "rename that joint")
            new = next(free for k in range(2, 10**6) if (free := f"{name}_{k}") not in taken[kind])
            renamed.setdefault(kind, {})[name] = new
            taken[kind].add(new)
    for e, kind in added:
        if new_name := renamed.get(kind, {}).get(_name(e)):
            e.set("class" if kind == "class" else "name", new_name)
        for key, of in REFERENCES.items():
            if e.get(key) in renamed.get(of, {}):
                e.set(key, renamed[of][e.get(key, "")])
    return renamed


def _name(e: ET.Element) -> str:
    return e.get("class", "") if e.tag == "default" else e.get("name", "")
