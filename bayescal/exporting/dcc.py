"""Digital Calibration Certificate (DCC 3.3.0, PTB) of a calibrated arm.

Administrative data are those that the issuer gives: nothing is invented. Results are those of the budgets of
the fit, as quantities of the D-SI with their expanded uncertainty. A certificate is validated by a user's
copy of the schema: dcc.xsd, with SI_Format.xsd beside it.
"""

from __future__ import annotations

import datetime
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal
from xml.etree.ElementTree import Element, indent, register_namespace, tostring

import numpy as np
from pydantic import Field, ValidationError

from bayescal import __version__
from bayescal.assess.budget import COVERAGE, Budget, budget, of_distances
from bayescal.assess.inputs import Basis
from bayescal.assess.iso9283 import Iso9283, iso9283
from bayescal.assess.measurand import parameter, volume
from bayescal.errors import BayescalError
from bayescal.exporting.xml_text import element
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


TWO = 2.0
"""k of figures of ISO 9283, whose u is of stated noise alone: normal."""


def _dcc(name: str, *content: str | Element | None) -> Element:
    return element(f"{{{DCC}}}{name}", *content)


def _si(name: str, *content: str | Element) -> Element:
    return element(f"{{{SI}}}{name}", *content)


def _stated(name: str, value: object) -> Element | None:
    """An element with a value, if there is one."""
    return None if value is None else _dcc(name, str(value))


def _text(name: str, words: str, language: str = "en") -> Element:
    """An element with a text in a language."""
    return _dcc(name, element(f"{{{DCC}}}content", words, lang=language))


def _contact(name: str, of: Contact, language: str) -> Element:
    """A name with an address."""
    place = {
        "city": of.city, "countryCode": of.country, "postCode": of.post_code, "street": of.street,
        "streetNo": of.street_number,
    }  # fmt: skip
    return _dcc(
        name,
        _text("name", of.name, language),
        _stated("eMail", of.email),
        _stated("phone", of.phone),
        _dcc("location", *(_stated(key, value) for key, value in place.items())),
    )


def _quantity(
    name: str, value: str, unit: str, expanded: tuple[str, float, float] | None = None, note: str = ""
) -> Element:
    """A real quantity; `expanded` is its U as text, k, and the coverage probability.

    `unit` is that of memory, a key of `D_SI`.
    """
    real = _si("real", _si("value", value), _si("unit", D_SI[unit]))
    if expanded is not None:
        size, k, coverage = expanded
        of = _si(
            "expandedMU",
            _si("valueExpandedMU", size),
            _si("coverageFactor", f"{k:.2f}"),
            _si("coverageProbability", f"{coverage:.4f}"),
            _si("distribution", "normal"),
        )
        real.append(_si("measurementUncertaintyUnivariate", of))
    return _dcc("quantity", _text("name", name), _text("description", note) if note else None, real)


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
    root = _dcc(
        "digitalCalibrationCertificate",
        _administrative(entries, notes),
        _dcc("measurementResults", _dcc("measurementResult", *_results(basis))),
    )
    root.set("schemaVersion", VERSION)
    root.set(f"{{{XSI}}}schemaLocation", f"{DCC} {DCC}/v{VERSION}/dcc.xsd")
    indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def _administrative(e: Entries, notes: Sequence[str]) -> Element:
    lang = e.language
    core = {
        "countryCodeISO3166_1": e.country, "usedLangCodeISO639_1": lang, "mandatoryLangCodeISO639_1": lang,
        "uniqueIdentifier": e.identifier, "beginPerformanceDate": e.begin, "endPerformanceDate": e.end,
        "performanceLocation": e.location, "issueDate": e.issued,
    }  # fmt: skip
    item = _dcc(
        "item",
        _text("name", e.item.name, lang),
        _dcc("manufacturer", _text("name", e.item.manufacturer, lang)),
        _dcc("model", e.item.model),
        _dcc(
            "identifications",
            _dcc(
                "identification",
                _dcc("issuer", "manufacturer"),
                _dcc("value", e.item.serial_number),
                _text("name", "serial number"),
            ),
        ),
    )
    persons = (
        _dcc(
            "respPerson",
            _dcc("person", _text("name", person.name, lang)),
            _dcc("role", person.role),
            _dcc("mainSigner", "true") if person.main_signer else None,
        )
        for person in e.responsible
    )
    coverage = (
        f"Expanded uncertainties U = k u with a coverage of {100 * COVERAGE:.2f} %, by JCGM 100:2008; "
        "k from Student's t for the effective degrees of freedom."
    )
    statements = (_dcc("statement", _text("declaration", words)) for words in (coverage, *notes))
    return _dcc(
        "administrativeData",
        _dcc("dccSoftware", _dcc("software", _text("name", "bayescal"), _dcc("release", __version__))),
        _dcc("coreData", *(_stated(key, value) for key, value in core.items())),
        _dcc("items", item),
        _dcc(
            "calibrationLaboratory",
            _stated("calibrationLaboratoryCode", e.laboratory_code),
            _contact("contact", e.laboratory, lang),
        ),
        _dcc("respPersons", *persons),
        _contact("customer", e.customer, lang),
        _dcc("statements", *statements),
    )


def _results(basis: Basis) -> tuple[Element, ...]:
    """Parts of the results: what was calibrated and how, and the quantities."""
    model, standard = basis.stated.plain.model, iso9283(basis)
    dataset = model.scene.dataset
    named = _text("name", f"Bayesian calibration, model: {', '.join(model.effects)}")
    methods = [_dcc("usedMethod", named, _dcc("norm", "JCGM 100:2008"))]
    distances = [_with_u(b) for b in of_distances(basis).values()]
    results = [_result("errors of distances", [_expanded_alone(budget(basis, volume(basis))), *distances])]
    if model.parameters:
        parameters = [_with_u(budget(basis, parameter(basis, p.name))) for p in model.parameters]
        results.append(_result("parameters of the arm", parameters))
    if standard.figures:
        differs = _text("description", "differs from the standard: " + "; ".join(standard.differs))
        name, norm = _text("name", "figures of ISO 9283"), _dcc("norm", "ISO 9283:1998")
        methods.append(_dcc("usedMethod", name, differs, norm))
        results.append(_result("figures of ISO 9283", list(_figures(standard))))
    return (
        _text("name", f"Calibration of {dataset.robot.name}"),
        _text("description", f"dataset {dataset.name}, SHA-256 {dataset.sha256}"),
        _dcc("usedMethods", *methods),
        _dcc("results", *results),
    )


def _result(name: str, quantities: Sequence[Element]) -> Element:
    return _dcc("result", _text("name", name), _dcc("data", *quantities))


def _with_u(b: Budget) -> Element:
    """A value with its expanded uncertainty."""
    value, size = in_digits(b.measurand.value or 0.0, b.expanded)
    return _quantity(b.measurand.name, value, b.measurand.unit, (size, b.k, COVERAGE))


def _expanded_alone(b: Budget) -> Element:
    """The expanded uncertainty of any one of several distances, as a value."""
    _, size = in_digits(0.0, b.expanded)
    note = f"expanded uncertainty, k = {b.k:.2f}, of the {b.measurand.name}"
    return _quantity("expanded uncertainty U of a distance in the probed volume", size, "m", note=note)


def _figures(standard: Iso9283) -> Iterator[Element]:
    for f in standard.figures:
        for what, value, u in (("mean", f.mean, f.u), ("maximum", f.maximum, f.u_max)):
            name = f"{f.symbol}: {f.words}, {what} of {f.count}"
            if u is None:
                yield _quantity(name, f"{value:.3g}", "m")
            else:
                shown, size = in_digits(value, TWO * u)
                yield _quantity(name, shown, "m", (size, TWO, COVERAGE))


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
            read = xmlschema.XMLSchema10(
                str(schema), locations={SI: str(units)}, allow="local", validation="lax"
            )
        fault = next(read.iter_errors(content), None)
    except (xmlschema.XMLSchemaException, OSError, ValueError) as error:
        raise BayescalError(f"cannot be read: {error}", f"--schema {schema}") from None
    if fault is not None:
        raise BayescalError(f"not valid: {fault.reason} ({fault.path})", f"--schema {schema}")
    return len(read.all_errors)
