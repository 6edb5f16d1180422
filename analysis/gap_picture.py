"""The figure of a diagnosis in the README: a session with backlash, diagnosed with a model that lacks it.

Run from the top of the project: ``python analysis/gap_picture.py``.
"""

from __future__ import annotations

from pathlib import Path

from bayescal.gap.diagnose import diagnose
from bayescal.reporting.figures.figures import draw
from bayescal.reporting.gap.record import gap_record
from bayescal.reporting.style import drawing, png
from bayescal.simulation import Options, simulate

ROOT = Path(__file__).resolve().parents[1]
HIDDEN = Options(effects=("geometry", "compliance", "backlash"), seed=4)


if __name__ == "__main__":
    out = ROOT / "docs" / "pictures" / "gap-where.png"
    record = gap_record(diagnose(simulate(HIDDEN).dataset))
    with drawing():
        out.write_bytes(png(draw("where", record)))
