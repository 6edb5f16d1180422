"""Damage to XML (URDF, xacro, MJCF), to JSON records and to workbooks: the tree, not the text."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

Rng = np.random.Generator
Change = Callable[[bytes, Rng], bytes]

VALUES = (
    "", " ", "nan", "inf", "-inf", "1e308", "1e400", "-1e9", "1e9", "1e-320", "0", "0 0 0", "0 0", "1 2 3 4",
    "nan nan nan", "0 0 1e308", "1e200 1e200 1e200", "1e-200 0 0", "1,2,3", "0x10", "١ ٢ ٣", "true", "world",
    "base_link", "root", "l1", "../../etc/passwd", "/dev/zero", "http://x/y.stl", "file:///etc/passwd",
    "package://x/y.stl", "x" * 3000, "é", "&lt;", "a\nb", "${1/0}", "${9**9**9}", "${'x' * 10**9}",
    "${undefined}", "$(arg none)", "$(find nowhere)", "hinge", "free", "planar", "floating", "prismatic",
    "mimic", "continuous", "fixed", "99999999999999999999", "\u202e",
)  # fmt: skip
"""Values of any attribute."""
INSERTED = (
    '<include file="arm.xml"/>', '<include file="/dev/zero"/>', '<include file="../../x.xml"/>',
    '<xacro:include xmlns:xacro="http://ros.org/wiki/xacro" filename="arm.xacro"/>',
    '<xacro:include xmlns:xacro="http://ros.org/wiki/xacro" filename="/dev/zero"/>',
    '<xacro:include xmlns:xacro="http://ros.org/wiki/xacro" filename="missing.xacro"/>',
    '<xacro:property xmlns:xacro="http://ros.org/wiki/xacro" name="a" value="${a + 1}"/>',
    '<xacro:macro xmlns:xacro="http://ros.org/wiki/xacro" name="m" params=""><xacro:m/></xacro:macro>',
    '<xacro:m xmlns:xacro="http://ros.org/wiki/xacro"/>',
    '<xacro:if xmlns:xacro="http://ros.org/wiki/xacro" value="${[1] * 10**9}"/>',
    '<asset><mesh name="m" file="missing.stl"/></asset>', '<asset><mesh name="m" file="/dev/zero"/></asset>',
    '<asset><mesh name="m" file="arm.xml"/></asset>', '<compiler meshdir="/"/>', '<compiler angle="degree"/>',
    '<size memory="900G"/>', '<size nkey="999999999"/>', '<option timestep="0" gravity="nan 0 0"/>',
    '<option gravity="0 0 0"/>', '<freejoint/>', '<joint type="slide"/>', '<body/>', '<frame/>', '<x/>',
    '<replicate count="999999999"><body/></replicate>', '<composite type="cable" count="9999999 1 1"/>',
    '<keyframe><key qpos="1 2"/></keyframe>', '<keyframe><key ctrl="nan"/></keyframe>',
    '<equality><joint joint1="a" joint2="a"/></equality>', '<inertial mass="-1" pos="0 0 0"/>',
    '<limit lower="2" upper="-2"/>', '<mimic joint="j1"/>', '<parent link="tip"/>', '<child link="root"/>',
    '<origin xyz="0 0 0"/>', '<axis xyz="0 0 0"/>', '<link name="l1"/>', '<mujoco/>', "<robot/>",
)  # fmt: skip
"""Elements put somewhere."""
HEADS = (
    '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>',
    '<!DOCTYPE x SYSTEM "file:///etc/passwd">', '<!DOCTYPE x [<!ENTITY % p SYSTEM "/dev/zero">%p;]>',
    '<?xml version="1.0" encoding="utf-16"?>', '<?xml version="1.0" encoding="latin-1"?>',
    '<?xml version="1.0" encoding="nowhere"?>', '<?xml version="9"?>', "<!--" + "-" * 30 + "-->",
    "<!-- <mujoco> </mujoco> <robot> -->", "<?php x?>", "text", "\ufeff", "<x/>",
)  # fmt: skip
"""What is put before the root element."""


def _pick(rng: Rng, values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def _tree(change: Callable[[ET.Element, Rng], None]) -> Change:
    """A change of the tree of an XML text; none of text that is no XML or too deep to be written."""

    def run(text: bytes, rng: Rng) -> bytes:
        try:
            root = ET.fromstring(text)
        except (ET.ParseError, ValueError, LookupError):
            return text
        change(root, rng)
        try:
            return ET.tostring(root, encoding="utf-8")
        except RecursionError:
            return text

    return run


def _inner(root: ET.Element, rng: Rng) -> tuple[ET.Element, ET.Element]:
    """An element other than the root, and its parent."""
    pairs = [(child, parent) for parent in root.iter() for child in parent]
    return _pick(rng, pairs) if pairs else (root, ET.Element("none"))


def _attributed(root: ET.Element, rng: Rng) -> ET.Element:
    return _pick(rng, [e for e in root.iter() if e.attrib] or [root])


def _value(root, rng):
    element = _attributed(root, rng)
    if element.attrib:
        element.set(_pick(rng, sorted(element.attrib)), _pick(rng, VALUES))


def _value_of_another(root, rng):
    """Names and references of others: duplicates, joints in a ring, joints that follow themselves."""
    element = _attributed(root, rng)
    if element.attrib:
        name = _pick(rng, sorted(element.attrib))
        same = [e.get(name) for e in root.iter() if name in e.attrib]
        element.set(name, _pick(rng, same))


def _number(root, rng):
    """A number within an attribute, times a factor."""
    element = _attributed(root, rng)
    for name, value in element.attrib.items():
        words = value.split()
        try:
            k = int(rng.integers(len(words)))
            words[k] = repr(float(words[k]) * _pick(rng, (1e3, 1e-3, -1.0, 1e9, 57.3, 0.0, 1e30)))
        except ValueError:
            continue
        element.set(name, " ".join(words))
        return


def _attribute_removed(root, rng):
    element = _attributed(root, rng)
    if element.attrib:
        del element.attrib[_pick(rng, sorted(element.attrib))]


def _attribute_renamed(root, rng):
    element = _attributed(root, rng)
    if element.attrib:
        name = _pick(rng, sorted(element.attrib))
        element.set(
            _pick(rng, (name + "x", "type", "name", "class", "childclass", "file")), element.attrib.pop(name)
        )


def _element_removed(root, rng):
    child, parent = _inner(root, rng)
    if child is not root:
        parent.remove(child)


def _element_twice(root, rng):
    child, parent = _inner(root, rng)
    for _ in range(int(rng.choice([1, 1, 1, 2, 400]))):
        parent.append(child)


def _element_renamed(root, rng):
    child, _ = _inner(root, rng)
    child.tag = _pick(rng, [e.tag for e in root.iter()] + ["x", "mujoco", "robot", "joint", "link", "body"])


def _element_moved(root, rng):
    child, parent = _inner(root, rng)
    inside = set(child.iter())
    others = [e for e in root.iter() if e not in inside]
    if child is not root and others:
        parent.remove(child)
        _pick(rng, others).append(child)


def _element_inserted(root, rng):
    target = _pick(rng, list(root.iter()))
    target.insert(int(rng.integers(len(target) + 1)), ET.fromstring(_pick(rng, INSERTED)))


def _text_inserted(root, rng):
    _pick(rng, list(root.iter())).text = _pick(rng, VALUES).replace("\x00", "")


def _nested(text: bytes, rng: Rng) -> bytes:
    """Elements in elements, where the text ends."""
    tag = _pick(rng, (b"body", b"link", b"x", b"joint", b"default"))
    many = int(rng.choice([5, 300, 3000, 60_000]))
    end = text.rfind(b"</")
    end = end if end >= 0 else len(text)
    return (
        text[:end]
        + b"<"
        + tag
        + b">"
        + (b"<" + tag + b">") * many
        + (b"</" + tag + b">") * (many + 1)
        + text[end:]
    )


def _many(text: bytes, rng: Rng) -> bytes:
    """A long chain, or a wide fan, of links and joints."""
    many, wide = int(rng.choice([50, 1500, 12_000])), rng.random() < 0.5
    parts = [
        f'<link name="n{k}"/><joint name="m{k}" type="{"fixed" if k % 7 else "revolute"}">'
        f'<parent link="{"root" if wide or not k else f"n{k - 1}"}"/><child link="n{k}"/>'
        f'<limit lower="-1" upper="1"/></joint>'
        for k in range(many)
    ]
    end = max(text.rfind(b"</robot>"), 0)
    return text[:end] + "".join(parts).encode() + text[end:]


def _head(text: bytes, rng: Rng) -> bytes:
    return _pick(rng, HEADS).encode() + (text.partition(b"?>")[2] if text.startswith(b"<?xml") else text)


MARKUP: dict[str, Change] = {
    **{
        f.__name__.lstrip("_").replace("_", " "): _tree(f)
        for f in (
            _value, _value_of_another, _number, _attribute_removed, _attribute_renamed, _element_removed,
            _element_twice, _element_renamed, _element_moved, _element_inserted, _text_inserted,
        )
    },
    **{f"value {k}": _tree(_value) for k in range(4)},
    **{f"value of another {k}": _tree(_value_of_another) for k in range(3)},
    **{f"element inserted {k}": _tree(_element_inserted) for k in range(3)},
    "head": _head,
    "nested": _nested,
    "many": _many,
}  # fmt: skip

JSON_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1e308, 1e999, float("nan"), 10**400, "", "x", "nan", [], {}, [[]], [None],
    {"": 0},
    "\x1b[31m", "y" * 3000, "../../x", "/etc/passwd", -1e-300, 2**63, [1, 2], {"a": {"b": 1}}, "\ud800",
)  # fmt: skip


def _slots(value: Any, found: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """Every container of a record with each of its keys."""
    keys = value.keys() if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in list(keys):
        found.append((value, key))
        _slots(value[key], found)
    return found


def record_entry(text: bytes, rng: Rng) -> bytes:
    """An entry of a JSON record removed, doubled, renamed, refilled, or put in the place of another."""
    try:
        record = json.loads(text)
    except ValueError:
        return text
    slots = _slots(record, [])
    if not slots:
        return text
    # entries of the first levels as often as those of long lists
    near = [s for s in slots if isinstance(s[0], dict)] or slots
    where, key = _pick(rng, near if rng.random() < 0.7 else slots)
    old = where[key]
    how = int(rng.integers(7))
    if how == 0:
        del where[key]
    elif how == 1 and isinstance(old, (int, float)) and not isinstance(old, bool):
        where[key] = old * _pick(rng, (-1.0, 1e3, 1e-3, 0.0, 1e30))
    elif how == 2 and isinstance(old, list) and old:
        where[key] = _pick(rng, (old[:-1], [*old, old[0]], old[::-1], old[:1], old * 2))
    elif how == 3:
        other, name = _pick(rng, slots)
        where[key] = json.loads(json.dumps(other[name])) if name in other or isinstance(other, list) else None
    elif how == 4 and isinstance(where, dict):
        where[_pick(rng, ("x", key + "x", key.upper()))] = where.pop(key)
    else:
        where[key] = _pick(rng, JSON_VALUES)
    return json.dumps(record).encode("utf-8", "replace")


def _rezipped(content: bytes, change: Callable[[dict[str, bytes], Rng], None], rng: Rng) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as old:
            parts = {name: old.read(name) for name in old.namelist()}
    except Exception:  # an earlier change has broken it
        return content
    change(parts, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for name, part in parts.items():
            new.writestr(name, part)
    return out.getvalue()


def _part(parts: dict[str, bytes], rng: Rng) -> None:
    name = _pick(rng, sorted(parts))
    parts[name] = MARKUP[_pick(rng, sorted(set(MARKUP) - {"many"}))](parts[name], rng)


def _part_removed(parts: dict[str, bytes], rng: Rng) -> None:
    del parts[_pick(rng, sorted(parts))]


def _bomb(parts: dict[str, bytes], rng: Rng) -> None:
    """A sheet that is small only while it is compressed."""
    row = b'<row r="%d"><c r="XFD%d"><v>1</v></c></row>'
    rows = b"".join(row % (k, k) for k in _pick(rng, (range(1, 400), (1, 1_048_576), range(1, 60_000))))
    for name in [n for n in parts if n.startswith("xl/worksheets/")]:
        stated = re.sub(rb'<dimension ref="[^"]*"', b'<dimension ref="A1:XFD1048576"', parts[name])
        head, mark, _ = stated.partition(b"<sheetData>")
        parts[name] = head + mark + rows + b"</sheetData></worksheet>"


def _spaces(parts: dict[str, bytes], rng: Rng) -> None:
    name = _pick(rng, sorted(parts))
    parts[name] += b" " * 300_000_000


WORKBOOK: dict[str, Change] = {
    **{f"part {k}": lambda content, rng: _rezipped(content, _part, rng) for k in range(6)},
    "part removed": lambda content, rng: _rezipped(content, _part_removed, rng),
    "bomb": lambda content, rng: _rezipped(content, _bomb, rng),
    "spaces": lambda content, rng: _rezipped(content, _spaces, rng),
}
