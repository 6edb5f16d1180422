"""The verdict of a fit in fit.json: tests, what rejected measurements share, decisions on a tolerance."""

from __future__ import annotations

from typing import Any

from bayescal.assess.acceptance import Acceptance, Check
from bayescal.assess.budget import COVERAGE
from bayescal.assess.conformance import Tolerance
from bayescal.dataset import Dataset
from bayescal.reporting.shared.text import MM, UM


def verdict_record(tests: Acceptance, dataset: Dataset) -> dict[str, Any]:
    """``verdict``: the word, the tests that fail (`reasons`) and all of them, shared causes of rejections."""
    return {
        "words": tests.verdict,
        "explains": tests.explains,
        "validated": tests.validated,
        "determined": tests.determined,
        "reasons": [_check(c) for c in tests.failed],
        "tests": [_check(c) for c in tests.checks],
        "shared_causes": [
            {
                "kind": cause.kind,
                "label": cause.label,
                "rows": [dataset.measurements.ids[row] for row in cause.rows],
                "rows_in_group": cause.size,
                "rejected": cause.rejected,
                "count": cause.count,
                "p": cause.p_value,
            }
            for cause in tests.causes
        ],
    }


def _check(c: Check) -> dict[str, Any]:
    return {
        "test": c.test, "value": c.value, "limit": c.limit, "p": c.p_value, "level": c.level, "words": c.words
    }  # fmt: skip


def tolerance_record(decided: Tolerance) -> dict[str, Any]:
    """``acceptance``: decisions by ISO 14253-1 on a tolerance of distance errors."""
    return {
        "rule": "ISO 14253-1: PASS where abs(error) + U <= tolerance, FAIL where abs(error) - U > tolerance",
        "tolerance_mm": MM * decided.tolerance,
        "k": decided.k,
        "coverage": COVERAGE,
        "decision": decided.decision,
        "why": decided.why,
        "volume": {"probability": decided.probability, "U_um": UM * decided.expanded},
        "distances": [
            {
                "between": list(d.between),
                "error_um": UM * d.error,
                "U_um": UM * d.expanded,
                "k": d.k,
                "probability": d.probability,
                "decision": d.decision,
            }
            for d in decided.distances
        ],
    }
