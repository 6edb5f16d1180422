"""Elements of a DCC: texts, contacts, and quantities of the D-SI with their expanded uncertainty."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement, register_namespace

from bayescal.exporting.dcc.entries import Contact

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
XSI = "http://www.w3.org/2001/XMLSchema-instance"
VERSION = "3.3.0"
D_SI = {
    "m": r"\metre",
    "rad": r"\radian",
    "rad/(N m)": r"\radian\newton\tothe{-1}\metre\tothe{-1}",
    "rad/(N m)^2": r"\radian\newton\tothe{-2}\metre\tothe{-2}",
    "m/(N m)": r"\metre\newton\tothe{-1}\metre\tothe{-1}",
    "kg": r"\kilogram",
    "kg m": r"\kilogram\metre",
    "s": r"\second",
    "1": r"\one",
}
"""Units of the D-SI by those in memory."""

for prefix, space in (("dcc", DCC), ("si", SI), ("xsi", XSI)):
    register_namespace(prefix, space)


def add(parent: Element, name: str, text: str | None = None, space: str = DCC) -> Element:
    """A further child element."""
    out = SubElement(parent, f"{{{space}}}{name}")
    out.text = text
    return out


def text(parent: Element, name: str, content: str, language: str) -> Element:
    """An element with a text in a language."""
    out = add(parent, name)
    add(out, "content", content).set("lang", language)
    return out


def contact(parent: Element, name: str, of: Contact, language: str) -> Element:
    """A name with an address."""
    out = add(parent, name)
    text(out, "name", of.name, language)
    for key, value in (("eMail", of.email), ("phone", of.phone)):
        if value is not None:
            add(out, key, value)
    place = add(out, "location")
    entries = {
        "city": of.city, "countryCode": of.country, "postCode": of.post_code, "street": of.street,
        "streetNo": of.street_number,
    }  # fmt: skip
    for key, given in entries.items():
        if given is not None:
            add(place, key, given)
    return out


def quantity(
    parent: Element, name: str, value: str, unit: str, language: str,
    expanded: tuple[str, float, float] | None = None, note: str = "",
) -> Element:  # fmt: skip
    """A real quantity; `expanded` is its U as text, k, and the coverage probability.

    `unit` is that of memory, a key of `D_SI`.
    """
    out = add(parent, "quantity")
    text(out, "name", name, language)
    if note:
        text(out, "description", note, language)
    real = add(out, "real", space=SI)
    add(real, "value", value, SI)
    add(real, "unit", D_SI[unit], SI)
    if expanded is not None:
        size, k, coverage = expanded
        of = add(add(real, "measurementUncertaintyUnivariate", space=SI), "expandedMU", space=SI)
        add(of, "valueExpandedMU", size, SI)
        add(of, "coverageFactor", f"{k:.2f}", SI)
        add(of, "coverageProbability", f"{coverage:.4f}", SI)
        add(of, "distribution", "normal", SI)
    return out
