"""Administrative entries of a certificate, as its issuer gives them: nothing is invented."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from bayescal.errors import BayescalError
from bayescal.files import Keys, check_schema, read_document

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
