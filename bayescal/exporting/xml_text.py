"""XML of a user, changed in place: all that is not changed stays, to the byte. Elements of a new file.

The elements are read as a tree, and the tree is changed. The text is then made of the parts of the old one:
start tags whose attributes did not change, what stands between elements (comments, blanks, line ends), and
end tags. An added element has the indentation of its place.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from xml.etree import ElementTree as ET
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.arm.transforms import rpy_of
from bayescal.robots.urdf import parse_markup
from bayescal.storage.writing import templates_beside

ATTRIBUTE = re.compile(rb"""(\s+)([^\s=/>"']+)(\s*=\s*)("[^"]*"|'[^']*')""")
TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
"""A tag; a > in a quoted value does not end it."""
UNIT = b"  "
"""Indentation of the first child of an element, where the file shows no other."""


def number(value: float) -> str:
    """A number with all its digits; no minus zero."""
    return repr(float(value) + 0.0)


def numbers(values: Iterable[float] | np.ndarray) -> str:
    """Numbers with all their digits, separated by blanks."""
    return " ".join(map(number, np.asarray(values, float).tolist()))


TEMPLATES = templates_beside(
    __file__,
    {
        "number": number,
        "numbers": numbers,
        "xyz": lambda pose: numbers(pose[:3, 3]),
        "rpy": lambda pose: numbers(rpy_of(pose[:3, :3])),
        "quat": lambda pose: numbers(Rotation.from_matrix(pose[:3, :3]).as_quat()[[3, 0, 1, 2]]),
    },
    autoescape=True,
)
"""Templates of new files; values are escaped."""


def rendered(template: str, **fields: object) -> str:
    """The text of a template."""
    return TEMPLATES.get_template(template).render(fields)


def indented(text: str) -> str:
    """An XML text with an element in each line."""
    root = ET.fromstring(text)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


@dataclass(frozen=True)
class _Old:
    """An element as it stands in the old text: positions of its tags, and what it had."""

    start: int
    inside: int  # behind the start tag
    inner: int  # of the end tag; `inside` for an empty element
    end: int
    attributes: Mapping[str, str]
    children: tuple[ET.Element, ...]


class XmlText:
    """The text of an XML file, and its root element, which may be changed.

    Raises
    ------
    BayescalError
        As `robots.urdf.parse_markup`.
    """

    def __init__(self, text: str, name: str) -> None:
        self._data = text.encode("utf-8")
        self.root = parse_markup(self._data, name)
        self._old = dict(zip(self.root.iter(), _spans(self._data, self.root), strict=True))

    def added(self) -> Iterator[ET.Element]:
        """Elements of the tree that the file did not have."""
        return (e for e in self.root.iter() if e not in self._old)

    def kept(self) -> Iterator[ET.Element]:
        """Elements of the tree that the file had."""
        return (e for e in self.root.iter() if e in self._old)

    @property
    def inside(self) -> str:
        """The text between the tags of the root element, as it was read."""
        root = self._old[self.root]
        return self._data[root.inside : root.inner].decode("utf-8")

    def spliced(self, by: Mapping[ET.Element, str]) -> str:
        """The text as it was read, with other texts in place of some elements."""
        out, end = b"", 0
        for e, text in by.items():
            old = self._old[e]
            out += self._data[end : old.start] + text.encode("utf-8")
            end = old.end
        return (out + self._data[end:]).decode("utf-8")

    @property
    def text(self) -> str:
        """The text of the tree as it is now."""
        gaps, tails = self._gaps()
        root, line = self._old[self.root], self._newline

        def written(e: ET.Element, indent: bytes) -> bytes:
            old, children, begin = self._old.get(e), list(e), indent
            if old is None:
                head = b"<" + e.tag.encode() + _attributes(e.attrib)
                empty, unit = not children, UNIT if b"\t" not in indent else b"\t"
                tail, before = line + indent + b"</" + e.tag.encode() + b">", line + indent + unit
            else:
                tag = self._data[old.start : old.inside]
                head = with_attributes(tag, old.attributes, e.attrib)
                empty = old.inside == old.end
                if empty and not children:
                    return head
                head = re.sub(rb"\s*/?>$", b"", head) if empty else head[:-1]
                begin = self._indent(old)
                before = self._before(old)
                close = b"</" + e.tag.encode() + b">"
                tail = line + begin + close if empty else tails[e] + self._data[old.inner : old.end]
                empty = False
            if empty:
                return head + b"/>"
            parts = [head, b">"]
            for child in children:
                gap = gaps.get(child, before)
                parts += [gap, written(child, before.rpartition(line)[2] if line in before else begin)]
            return b"".join([*parts, tail])

        new = written(self.root, b"")
        return (self._data[: root.start] + new + self._data[root.end :]).decode("utf-8")

    def _gaps(self) -> tuple[dict[ET.Element, bytes], dict[ET.Element, bytes]]:
        """What stands before each old element, and before the end tag of each.

        Comments before an element that was removed stay; what belongs to one that was moved goes with it.
        """
        present, gaps, tails = set(self.root.iter()), {}, {}
        for e, old in self._old.items():
            end, comments = old.inside, b""
            for child in old.children:
                gap = self._data[end : self._old[child].start]
                end = self._old[child].end
                if child in present:
                    gaps[child], comments = comments + gap, b""
                elif gap.strip():
                    comments += gap.rstrip()
            tails[e] = comments + self._data[end : old.inner]
        return gaps, tails

    @cached_property
    def _newline(self) -> bytes:
        return b"\r\n" if b"\r\n" in self._data else b"\n"

    def _indent(self, old: _Old) -> bytes:
        """Blanks at the beginning of the line of an element."""
        line = self._data[self._data.rfind(b"\n", 0, old.start) + 1 : old.start]
        return line[: len(line) - len(line.lstrip())]

    def _before(self, old: _Old) -> bytes:
        """What is to stand before an added child: as before the others."""
        starts = [self._old[child] for child in old.children]
        ends = [old.inside, *(old_child.end for old_child in starts)]
        for old_child, end in zip(starts, ends, strict=False):
            if b"\n" in self._data[end : old_child.start]:
                return self._newline + self._indent(old_child)
        unit = b"\t" if b"\t" in self._indent(old) else UNIT
        return b"" if starts else self._newline + self._indent(old) + unit


def with_attributes(tag: bytes, before: Mapping[str, str], now: Mapping[str, str]) -> bytes:
    """A start tag (or an empty element) with changed attributes; further ones are added last."""
    out, done = b"", 0
    for match in ATTRIBUTE.finditer(tag):
        key = match[2].decode()
        out += tag[done : match.start()]
        done = match.end()
        if key not in before or now.get(key) == before[key]:  # also what declares a namespace
            out += match[0]
        elif key in now:
            out += match[1] + match[2] + match[3] + quoteattr(now[key]).encode()
    end = re.search(rb"\s*/?>$", tag)
    assert end, "a tag ends with >"
    more = {key: value for key, value in now.items() if key not in before}
    return out + tag[done : end.start()] + _attributes(more) + tag[end.start() :]


def _attributes(each: Mapping[str, str]) -> bytes:
    return "".join(f" {key}={quoteattr(value)}" for key, value in each.items()).encode()


def _spans(data: bytes, root: ET.Element) -> list[_Old]:
    """Where the elements stand, in the order of the file."""
    starts: list[int] = []
    ends: dict[int, int] = {}
    stack: list[int] = []
    parser = expat.ParserCreate("utf-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        stack.append(len(starts))
        starts.append(parser.CurrentByteIndex)

    def end(tag: str) -> None:
        ends[stack.pop()] = parser.CurrentByteIndex

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data, True)
    out = []
    for k, e in enumerate(root.iter()):
        inside = _behind_tag(data, starts[k])
        empty = data[inside - 2 : inside] == b"/>"
        inner = inside if empty else ends[k]
        end_of_e = inside if empty else _behind_tag(data, inner)
        out.append(_Old(starts[k], inside, inner, end_of_e, dict(e.attrib), tuple(e)))
    return out


def _behind_tag(data: bytes, start: int) -> int:
    """Position behind a tag that begins at `start`."""
    tag = TAG.match(data, start)
    assert tag, "a parsed tag ends"
    return tag.end()
