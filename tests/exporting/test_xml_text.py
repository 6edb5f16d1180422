"""XML changed in place: what does not change stays to the byte, and the text is the tree."""

from xml.etree import ElementTree as ET

import numpy as np
import pytest
from cases import cases

from bayescal.exporting.xml_text import XmlText

TAGS, VALUES = ("a", "b-c", "long_name"), ("", "1 2", "x > y", "a &amp; b", "&lt;&#181;", "it's")
GAPS = cases("xml_gaps")


def random_xml(rng: np.random.Generator, depth: int = 0) -> str:
    """An element with attributes of any quotes and blanks, comments, text and children."""
    tag, quote = rng.choice(TAGS), rng.choice(['"', "'"])
    out = f"<{tag}"
    for key in rng.permutation(["x", "name", "y"])[: rng.integers(4)]:
        value = str(rng.choice(VALUES))
        mark = quote if quote not in value else '"'
        out += f"{rng.choice([' ', chr(10) + '  '])}{key}{rng.choice(['=', ' = '])}{mark}{value}{mark}"
    children = int(rng.integers(4)) if depth < 3 else 0
    if not children and rng.random() < 0.7:
        return out + rng.choice(["/>", " />", f"></{tag}>", f"></{tag} >"])
    inner = "".join(str(rng.choice(GAPS)) + random_xml(rng, depth + 1) for _ in range(children))
    return f"{out}>{inner}{rng.choice(GAPS)}</{tag}>"


def shape(e: ET.Element):
    return e.tag, dict(e.attrib), [shape(child) for child in e]


@pytest.mark.parametrize("seed", range(40))
def test_the_text_is_the_tree(seed):
    rng = np.random.default_rng(seed)
    text = f"<!-- before -->\n{random_xml(rng)}\n<!-- behind -->"
    xml = XmlText(text, "x")
    assert xml.text == text
    for _ in range(6):
        elements = list(xml.root.iter())
        e = elements[rng.integers(len(elements))]
        parents = {child: own for own in elements for child in own}
        kind = rng.integers(6)
        if kind == 0:
            e.set("x", str(rng.choice(['"', "<&>", "7"])))
        elif kind == 1 and e.attrib:
            del e.attrib[next(iter(e.attrib))]
        elif kind == 2:
            e.insert(int(rng.integers(len(e) + 1)), ET.Element("new", n="1"))
        elif kind == 3 and e in parents:
            parents[e].remove(e)
        elif kind == 4 and e in parents:  # a new element around an old one
            own, around = parents[e], ET.Element("around")
            at = list(own).index(e)
            own.remove(e)
            around.append(e)
            own.insert(at, around)
        elif kind == 5 and len(e) > 1:
            last = e[-1]
            e.remove(last)
            e.insert(0, last)
        assert shape(ET.fromstring(xml.text)) == shape(xml.root)
    assert xml.text.startswith("<!-- before -->\n<")
    assert xml.text.endswith(">\n<!-- behind -->")


def test_only_the_changed_attribute_changes():
    text = "<a>\n\t<b\n  k = 'x=\"1\"'  x='1'\ty=\"&lt;\" /> <!-- x='1' -->\n\t<b x='1'/>\n</a>"
    xml = XmlText(text, "x")
    xml.root[0].set("x", "2")
    assert xml.text == text.replace("  x='1'\ty", '  x="2"\ty')
    del xml.root[0].attrib["x"]
    assert xml.text == text.replace("  x='1'\ty", "\ty")


def test_added_elements_have_the_indentation_of_their_place():
    xml = XmlText("<a>\r\n   <b>\r\n      <c/>\r\n   </b>\r\n   <d/>\r\n</a>\r\n", "x")
    ET.SubElement(ET.SubElement(xml.root[0], "n"), "m")
    ET.SubElement(xml.root[1], "n")
    ET.SubElement(xml.root, "n")
    assert xml.text == (
        "<a>\r\n   <b>\r\n      <c/>\r\n      <n>\r\n        <m/>\r\n      </n>\r\n   </b>\r\n"
        "   <d>\r\n     <n/>\r\n   </d>\r\n   <n/>\r\n</a>\r\n"
    )
    assert XmlText("<a><b/></a>", "x").text == "<a><b/></a>"
    line = XmlText("<a><b/></a>", "x")
    ET.SubElement(line.root, "n")
    assert line.text == "<a><b/><n/></a>"


def test_comments_of_removed_elements_stay_and_names_of_spaces_too():
    text = '<a xmlns:i="http://i/" i:k="v" x="1">\n <!-- of b -->\n <b/>\n <c/>\n</a>'
    xml = XmlText(text, "x")
    xml.root.remove(xml.root[0])
    assert xml.text == text.replace("\n <b/>", "")
    xml.root.set("x", "2")
    assert xml.text == text.replace("\n <b/>", "").replace('x="1"', 'x="2"')
