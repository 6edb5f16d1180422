"""Digital Calibration Certificate (DCC 3.3.0, PTB) of a calibrated arm.

Administrative entries of a certificate, as its issuer gives them: nothing is invented.

Elements of a DCC: texts, contacts, and quantities of the D-SI with their expanded uncertainty.

The document: administrative data as given, results as in the budgets of the fit.

Validation of a certificate by a user's copy of the schema: dcc.xsd, with SI_Format.xsd beside it.
"""

from __future__ import annotations

import datetime
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal
from xml.etree.ElementTree import Element, SubElement, indent, register_namespace, tostring

import numpy as np
from pydantic import Field, ValidationError

from bayescal import __version__
from bayescal.assess.budget import COVERAGE, Budget, budget, of_distances
from bayescal.assess.inputs import Basis
from bayescal.assess.iso9283 import Iso9283, iso9283
from bayescal.assess.measurand import parameter, volume
from bayescal.errors import BayescalError
from bayescal.storage.files import Keys, check_schema, read_document

SCHEMA = "bayescal-certificate/1"
Text = Annotated[str, Field(pattern=r"^\S+(\s+\S+)*$")]
Country = Annotated[str, Field(pattern="^[A-Z]{2}$")]
Language = Annotated[str, Field(pattern="^[a-z]{2}$")]


class Contact(Keys):
    """A laboratory or a customer."""

    name: Text
    country: Country
    city: Text
    street: Text | None = None
    street_number: Text | None = None
    post_code: Text | None = None
    email: Text | None = None
    phone: Text | None = None


class Person(Keys):
    """A responsible person."""

    name: Text
    role: Text
    main_signer: bool = False


class Item(Keys):
    """The calibrated robot."""

    name: Text
    manufacturer: Text
    model: Text
    serial_number: Text


class Entries(Keys):
    """The content of the file."""

    schema_: Literal["bayescal-certificate/1"] = Field(alias="schema")
    identifier: Text
    language: Language
    country: Country
    begin: datetime.date
    end: datetime.date
    issued: datetime.date | None = None
    location: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]
    laboratory: Contact
    laboratory_code: Text | None = None
    customer: Contact
    responsible: Annotated[tuple[Person, ...], Field(min_length=1)]
    item: Item


def read_entries(path: Path) -> Entries:
    """Read the entries of a certificate.

    Raises
    ------
    BayescalError
        With the names of all entries that are missing, or with the first that is wrong.
    """
    document = read_document(path)
    check_schema(document, SCHEMA)
    try:
        entries = Entries.model_validate(document.data)
    except ValidationError as error:
        lost = [".".join(map(str, e["loc"])) for e in error.errors() if e["type"] == "missing"]
        if lost:
            what = f"missing: {', '.join(lost)}"
            raise BayescalError(what, document.name, "a certificate must state them") from None
        return document.parse(Entries)
    if entries.end < entries.begin:
        raise BayescalError("`end` is before `begin`", document.where(("end",)), "correct the dates")
    return entries


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


TWO = 2.0
"""k of figures of ISO 9283, whose u is of stated noise alone: normal."""


def dcc(entries: Entries, basis: Basis, notes: Sequence[str] = ()) -> str:
    """A Digital Calibration Certificate.

    Parameters
    ----------
    entries : Entries
        Administrative data.
    basis : Basis
        What the fit states.
    notes : sequence of str
        Statements of the certificate, in addition to that on the coverage.
    """
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": VERSION})
    root.set(f"{{{XSI}}}schemaLocation", f"{DCC} {DCC}/v{VERSION}/dcc.xsd")
    _administrative(add(root, "administrativeData"), entries, notes)
    _results(add(add(root, "measurementResults"), "measurementResult"), entries.language, basis)
    indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def _administrative(parent: Element, e: Entries, notes: Sequence[str]) -> None:
    lang = e.language
    software = add(add(parent, "dccSoftware"), "software")
    text(software, "name", "bayescal", "en")
    add(software, "release", __version__)
    core = add(parent, "coreData")
    dates = {"beginPerformanceDate": e.begin, "endPerformanceDate": e.end}
    entries: dict[str, object] = {
        "countryCodeISO3166_1": e.country, "usedLangCodeISO639_1": lang, "mandatoryLangCodeISO639_1": lang,
        "uniqueIdentifier": e.identifier, **dates, "performanceLocation": e.location,
    }  # fmt: skip
    if e.issued is not None:
        entries["issueDate"] = e.issued
    for key, value in entries.items():
        add(core, key, str(value))
    item = add(add(parent, "items"), "item")
    text(item, "name", e.item.name, lang)
    text(add(item, "manufacturer"), "name", e.item.manufacturer, lang)
    add(item, "model", e.item.model)
    serial = add(add(item, "identifications"), "identification")
    add(serial, "issuer", "manufacturer")
    add(serial, "value", e.item.serial_number)
    text(serial, "name", "serial number", "en")
    laboratory = add(parent, "calibrationLaboratory")
    if e.laboratory_code is not None:
        add(laboratory, "calibrationLaboratoryCode", e.laboratory_code)
    contact(laboratory, "contact", e.laboratory, lang)
    persons = add(parent, "respPersons")
    for person in e.responsible:
        own = add(persons, "respPerson")
        text(add(own, "person"), "name", person.name, lang)
        add(own, "role", person.role)
        if person.main_signer:
            add(own, "mainSigner", "true")
    contact(parent, "customer", e.customer, lang)
    statements = add(parent, "statements")
    coverage = (
        f"Expanded uncertainties U = k u with a coverage of {100 * COVERAGE:.2f} %, by JCGM 100:2008; "
        "k from Student's t for the effective degrees of freedom."
    )
    for words in (coverage, *notes):
        text(add(statements, "statement"), "declaration", words, "en")


def _results(parent: Element, lang: str, basis: Basis) -> None:
    dataset = basis.stated.plain.model.scene.dataset
    model = basis.stated.plain.model
    text(parent, "name", f"Calibration of {dataset.robot.name}", "en")
    text(parent, "description", f"dataset {dataset.name}, SHA-256 {dataset.sha256}", "en")
    methods = add(parent, "usedMethods")
    found = iso9283(basis)
    method = add(methods, "usedMethod")
    text(method, "name", f"Bayesian calibration, model: {', '.join(basis.stated.plain.model.effects)}", "en")
    add(method, "norm", "JCGM 100:2008")
    if found.figures:
        method = add(methods, "usedMethod")
        text(method, "name", "figures of ISO 9283", "en")
        text(method, "description", "differs from the standard: " + "; ".join(found.differs), "en")
        add(method, "norm", "ISO 9283:1998")
    results = add(parent, "results")
    each = of_distances(basis).values()
    data = _result(results, "errors of distances")
    _expanded_alone(data, budget(basis, volume(basis)))
    for b in each:
        _with_u(data, b)
    if model.parameters:
        data = _result(results, "parameters of the arm")
        for p in model.parameters:
            _with_u(data, budget(basis, parameter(basis, p.name)))
    if found.figures:
        _figures(_result(results, "figures of ISO 9283"), found)


def _result(results: Element, name: str) -> Element:
    out = add(results, "result")
    text(out, "name", name, "en")
    return add(out, "data")


def _with_u(data: Element, b: Budget) -> None:
    """A value with its expanded uncertainty."""
    value, size = in_digits(b.measurand.value or 0.0, b.expanded)
    quantity(data, b.measurand.name, value, b.measurand.unit, "en", (size, b.k, COVERAGE))


def _expanded_alone(data: Element, b: Budget) -> None:
    """The expanded uncertainty of any one of several distances, as a value."""
    _, size = in_digits(0.0, b.expanded)
    note = f"expanded uncertainty, k = {b.k:.2f}, of the {b.measurand.name}"
    quantity(data, "expanded uncertainty U of a distance in the probed volume", size, "m", "en", note=note)


def _figures(data: Element, found: Iso9283) -> None:
    for f in found.figures:
        for what, value, u in (("mean", f.mean, f.u), ("maximum", f.maximum, f.u_max)):
            name = f"{f.symbol}: {f.words}, {what} of {f.count}"
            if u is None:
                quantity(data, name, f"{value:.3g}", "m", "en")
            else:
                shown, size = in_digits(value, TWO * u)
                quantity(data, name, shown, "m", "en", (size, TWO, COVERAGE))


def in_digits(value: float, u: float) -> tuple[str, str]:
    """A value and its expanded uncertainty: two significant digits of U, the value to the same decimal."""
    if not (np.isfinite(u) and u > 0):
        return f"{value:.9g}", "0"
    decimals = 1 - int(np.floor(np.log10(u)))
    decimals = max(1 - int(np.floor(np.log10(round(u, decimals)))), 0)
    return f"{round(value, decimals) + 0.0:.{decimals}f}", f"{u:.{decimals}f}"


def check_valid(content: str, schema: Path) -> int:
    """Refuse a certificate that a schema does not accept; the number of faults of the schema is returned.

    Parts of the schema with a fault (a file that it includes and that is not here) are not checked.

    Parameters
    ----------
    content : str
    schema : Path
        The official dcc.xsd of version 3.3.0, or another schema. Files that it includes are not downloaded:
        ``SI_Format.xsd`` must be in its folder.

    Raises
    ------
    BayescalError
        With the first reason, or if there is no such schema, or no library to read it.
    """
    try:
        import xmlschema
    except ImportError:
        remedy = "install it: pip install 'bayescal[dcc]'"
        raise BayescalError("needs the library xmlschema", "--schema", remedy) from None
    if not schema.is_file():
        raise BayescalError("no such file", f"--schema {schema}", "give the path of dcc.xsd")
    units = schema.with_name("SI_Format.xsd")
    if not units.is_file():
        what = "there is no SI_Format.xsd beside it"
        raise BayescalError(what, f"--schema {schema}", "put that of the D-SI there")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # signatures are not used: their schema may be missing
            known = xmlschema.XMLSchema10(
                str(schema), locations={SI: str(units)}, allow="local", validation="lax"
            )
        found = next(known.iter_errors(content), None)
    except (xmlschema.XMLSchemaException, OSError, ValueError) as error:
        raise BayescalError(f"cannot be read: {error}", f"--schema {schema}") from None
    if found is not None:
        raise BayescalError(f"not valid: {found.reason} ({found.path})", f"--schema {schema}")
    return len(known.all_errors)
