"""Digital Calibration Certificate (DCC 3.3.0, PTB) of a calibrated arm.

Administrative data are those that the issuer gives: nothing is invented. Results are those of the budgets of
the fit, as quantities of the D-SI with their expanded uncertainty; their elements are in `templates`. A
certificate is validated by a user's copy of the schema: dcc.xsd, with SI_Format.xsd beside it.
"""

import datetime
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal
from xml.etree.ElementTree import register_namespace

import numpy as np
from pydantic import Field, ValidationError

from bayescal import __version__
from bayescal.assess.budget import COVERAGE, Budget, budget, of_distances
from bayescal.assess.conformance import Iso9283, iso9283
from bayescal.assess.inputs import Basis
from bayescal.assess.measurand import parameter, volume
from bayescal.errors import BayescalError
from bayescal.exporting.xml_text import indented, rendered
from bayescal.statistics import decimals_of
from bayescal.storage.files import Keys, check_schema, read_document
from bayescal.storage.reading import library

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
register_namespace("dcc", DCC)
register_namespace("si", SI)
TWO = 2.0
"""k of figures of ISO 9283, whose u is of stated noise alone: normal."""


@dataclass(frozen=True)
class Quantity:
    """A real quantity: its value as text, the unit of memory, and, where it has them, U as text and k."""

    name: str
    value: str
    unit: str
    expanded: str = ""
    k: float = 0.0
    note: str = ""


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
    model, standard = basis.stated.plain.model, iso9283(basis)
    distances = [_expanded_alone(budget(basis, volume(basis))), *map(_with_u, of_distances(basis).values())]
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + indented(rendered(
        "dcc.xml.j2", dcc=DCC, si=SI, version=__version__, coverage=COVERAGE, entries=entries,
        notes=notes, dataset=model.scene.dataset, effects=model.effects, standard=standard,
        results={
            "errors of distances": distances,
            "parameters of the arm": [
                _with_u(budget(basis, parameter(basis, p.name))) for p in model.parameters
            ],
            "figures of ISO 9283": list(_figures(standard)),
        },
    ))  # fmt: skip


def _with_u(b: Budget) -> Quantity:
    """A value with its expanded uncertainty."""
    value, size = in_digits(b.measurand.value or 0.0, b.expanded)
    return Quantity(b.measurand.name, value, b.measurand.unit, size, b.k)


def _expanded_alone(b: Budget) -> Quantity:
    """The expanded uncertainty of any one of several distances, as a value."""
    _, size = in_digits(0.0, b.expanded)
    note = f"expanded uncertainty, k = {b.k:.2f}, of the {b.measurand.name}"
    return Quantity("expanded uncertainty U of a distance in the probed volume", size, "m", note=note)


def _figures(standard: Iso9283) -> Iterator[Quantity]:
    for f in standard.figures:
        for what, value, u in (("mean", f.mean, f.u), ("maximum", f.maximum, f.u_max)):
            name = f"{f.symbol}: {f.words}, {what} of {f.count}"
            if u is None:
                yield Quantity(name, f"{value:.3g}", "m")
            else:
                shown, size = in_digits(value, TWO * u)
                yield Quantity(name, shown, "m", size, TWO)


def in_digits(value: float, u: float) -> tuple[str, str]:
    """A value and its expanded uncertainty: two significant digits of U, the value to the same decimal."""
    if not (np.isfinite(u) and u > 0):
        return f"{value:.9g}", "0"
    decimals = max(decimals_of(u), 0)
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
    remedy = "install it: pip install 'bayescal[dcc]'"
    xmlschema = library("xmlschema", "needs the library xmlschema", "--schema", remedy)
    if not schema.is_file():
        raise BayescalError("no such file", f"--schema {schema}", "give the path of dcc.xsd")
    units = schema.with_name("SI_Format.xsd")
    if not units.is_file():
        what = "there is no SI_Format.xsd beside it"
        raise BayescalError(what, f"--schema {schema}", "put that of the D-SI there")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # signatures are not used: their schema may be missing
            here = {SI: str(units)}
            read = xmlschema.XMLSchema10(str(schema), locations=here, allow="local", validation="lax")
        fault = next(read.iter_errors(content), None)
    except (xmlschema.XMLSchemaException, OSError, ValueError) as error:
        raise BayescalError(f"cannot be read: {error}", f"--schema {schema}") from None
    if fault is not None:
        raise BayescalError(f"not valid: {fault.reason} ({fault.path})", f"--schema {schema}")
    return len(read.all_errors)
