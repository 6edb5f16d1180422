"""The picture of the first page of the documentation: first screen of the page of the example session.

Run from the top of the project: ``python -m analysis.report_picture``. Needs Chromium or Chrome.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

import bayescal as bc
from bayescal.reporting.page.build import browser

ROOT = Path(__file__).resolve().parents[1]
SIZE = (1180, 540)
"""Width and height of the window, CSS pixels."""
SCALE = 1.5


def screenshot(page: Path, out: Path, size: tuple[int, int] = SIZE) -> None:
    """The first screen of a page, in light colours, as PNG."""
    with tempfile.TemporaryDirectory() as profile:
        words = [
            browser(), "--headless", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
            f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}",
            f"--force-device-scale-factor={SCALE}",
            f"--screenshot={out}", page.resolve().as_uri(),
        ]  # fmt: skip
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            words.insert(1, "--no-sandbox")  # Chromium refuses its sandbox to root
        subprocess.run(words, check=True, capture_output=True, timeout=120)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # the page states the run folder as it was given
        run = Path("runs/lrmate200ic-cube-fit")
        bc.fit(ROOT / "data" / "lrmate200ic-cube", samples=0).save(run)
        screenshot(run / "report.html", ROOT / "docs" / "pictures" / "report.png")
