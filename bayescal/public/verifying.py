"""Verification of an exported file, of the public API."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import RenderableType

    from bayescal.exporting.verify.result import Verification


@dataclass(frozen=True, repr=False)
class VerificationResult:
    """An exported file in its simulator."""

    verification: Verification

    @property
    def passed(self) -> bool:
        """Whether the simulator has the fitted arm, within the limits of its effects."""
        return self.verification.passed

    @property
    def record(self) -> dict[str, Any]:
        """The content of verify.json."""
        from bayescal.exporting.verify.record import record

        return record(self.verification)

    def report(self) -> RenderableType:
        """The text that `bayescal verify` prints, for rich."""
        from bayescal.exporting.verify.record import report

        return report(self.verification)

    def save(self, folder: str | PathLike[str]) -> tuple[str, ...]:
        """Write verify.json to a run folder; return the name of the file."""
        from bayescal.folders import whole

        with whole(Path(folder), "verify.json") as stage:
            text = json.dumps(self.record, indent=1, allow_nan=False) + "\n"
            (stage / "verify.json").write_text(text, encoding="utf-8")
        return ("verify.json",)

    def __str__(self) -> str:
        from bayescal.public.results import as_text

        return as_text(self.report())

    def __repr__(self) -> str:
        most = 1e6 * self.verification.levels[-1].maximum
        verdict = "passed" if self.passed else "failed"
        return f"<verification of {self.verification.path.name}: {verdict}, {most:.2g} µm at most>"


def verify(
    run: str | PathLike[str],
    file: str | PathLike[str],
    *,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> VerificationResult:
    """Load an exported arm in its simulator, and compare it with the fitted arm and with the measurements.

    Parameters
    ----------
    run : path
        Run folder of `fit` or `diagnose`.
    file : path
        File that was exported from it.
    progress : callable
        Called with the stage and its completed fraction.

    Raises
    ------
    BayescalError
        If the run folder has no arm, the simulator is not installed, or the file is not of this arm.

    Examples
    --------
    >>> import bayescal as bc
    >>> result = bc.verify("runs/session-fit", "arm.xml")  # doctest: +SKIP
    >>> result.passed  # doctest: +SKIP
    True
    """
    from bayescal.exporting.verify.result import verify as verified

    return VerificationResult(verified(Path(run), Path(file), progress))
