"""A page as PDF, printed by a Chromium or Chrome that is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from bayescal.beside import scratch
from bayescal.errors import BayescalError

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)
"""Names and places of browsers that print without a window, in the order of preference."""
SECONDS = 120
MARK = b"\n%bayescal page\n"
"""Comment at the end of a PDF file that marks it as ours; readers ignore what follows the last line."""


def browser() -> str:
    """The path of a browser.

    Raises
    ------
    BayescalError
        If none is installed.
    """
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        what = "no Chromium or Chrome is installed, which prints the page"
        raise BayescalError(
            what, "--pdf", "install it (Debian: apt install chromium), or print the HTML page"
        )
    return found


def is_ours(path: Path) -> bool:
    """Whether a PDF file was printed by `pdf_of`."""
    return path.read_bytes()[-len(MARK) :] == MARK


def pdf_of(page: str) -> bytes:
    """A page (HTML text) as a PDF file, marked; the browser has a temporary profile and no network.

    Raises
    ------
    BayescalError
        If there is no browser, or it does not print.
    """
    program = browser()
    with scratch("bayescal-page") as folder:
        source, made = folder / "page.html", folder / "page.pdf"
        source.write_text(page, encoding="utf-8")
        command = [
            program,
            "--headless",
            "--disable-gpu",
            "--no-first-run",
            "--disable-extensions",
            "--disable-background-networking",
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder}/profile",
            "--no-pdf-header-footer",
            f"--print-to-pdf={made}",
            source.as_uri(),
        ]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # Chromium refuses its sandbox to root
        try:
            done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise BayescalError(
                f"{program} does not print: {error}", "--pdf", "print the HTML page"
            ) from None
        if not made.is_file() or not made.read_bytes().startswith(b"%PDF"):
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
            what = f"{program} does not print: {last[0]}"
            raise BayescalError(what, "--pdf", "print the HTML page in a browser")
        return made.read_bytes() + MARK
