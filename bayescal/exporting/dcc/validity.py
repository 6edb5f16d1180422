"""Validation of a certificate by a user's copy of the schema: dcc.xsd, with SI_Format.xsd beside it."""

from __future__ import annotations

import warnings
from pathlib import Path

from bayescal.errors import BayescalError
from bayescal.exporting.dcc.xml import SI


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
