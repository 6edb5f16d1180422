"""The export of a Digital Calibration Certificate."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from bayescal.errors import BayescalError
from bayescal.public.results import FitResult, GapResult

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True, repr=False)
class CertificateResult:
    """A Digital Calibration Certificate; `content` is its XML."""

    content: str
    name: str
    validated: str = ""

    def report(self) -> RenderableType:
        """What was written, to be printed by a `rich.console.Console`."""
        checked = (
            f"valid by {self.validated}" if self.validated else "not validated: --schema names a dcc.xsd"
        )
        return f"Digital Calibration Certificate 3.3.0, {checked}"

    def save(self, path: str | PathLike[str] | None = None) -> tuple[Path, ...]:
        """Write the certificate; return its path. A file that exists is not replaced."""
        from bayescal.files import write_together

        file = Path(path or self.name)
        if file.exists():
            raise BayescalError("exists", str(file), "give another --out: certificates are not replaced")
        write_together({file: self.content})
        return (file,)

    def __repr__(self) -> str:
        return f"<certificate {self.name}>"


def certificate(
    run: FitResult | GapResult | str | PathLike[str],
    entries: str | PathLike[str],
    *,
    schema: str | PathLike[str] = "",
    force: bool = False,
) -> CertificateResult:
    """A Digital Calibration Certificate (DCC 3.3.0) of a calibration, with the numbers of its budgets.

    Parameters
    ----------
    run : FitResult, GapResult or path
    entries : path
        YAML file with the administrative data; see docs/budget.md.
    schema : path, optional
        A copy of dcc.xsd, with SI_Format.xsd beside it, by which the certificate is validated.
    force : bool
        In spite of reasons against the arm, which the certificate then states.

    Raises
    ------
    BayescalError
        With the entries that are missing, reasons against the arm, or what is not valid.
    """
    from bayescal.exporting import gate
    from bayescal.exporting.dcc import check_valid, dcc, read_entries
    from bayescal.public.budgets import stated

    if not str(entries):
        what = "a certificate needs its administrative data"
        raise BayescalError(what, "--certificate", "name a YAML file: see docs/budget.md")
    given = read_entries(Path(entries))
    arm, basis, _ = stated(run)
    gate.check(arm.use, force, "certified")
    notes = (*arm.use.notes, *(f"Issued in spite of: {reason}" for reason in arm.use.against))
    content = dcc(given, basis, notes)
    validated = str(schema)
    if validated and (faults := check_valid(content, Path(schema))):
        validated += f", of which {faults} faulty or missing parts were not checked"
    return CertificateResult(content, f"{arm.dataset.robot.name}-dcc.xml", validated)
