"""The document: administrative data as given, results as in the budgets of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element, indent, tostring

import numpy as np

from bayescal import __version__
from bayescal.assess.budget import (
    COVERAGE,
    Basis,
    Budget,
    budget,
    of_distances,
    parameter,
    volume,
)
from bayescal.assess.iso9283 import Iso9283, iso9283
from bayescal.exporting.dcc.entries import Entries
from bayescal.exporting.dcc.xml import DCC, VERSION, XSI, add, contact, quantity, text

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
