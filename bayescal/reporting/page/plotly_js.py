"""Plotly for pages: its source, compressed, and the hash that a content security policy permits.

Only the JavaScript file of the package is read: `plotly.graph_objects` is slow to import and not needed.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
from functools import lru_cache
from importlib.resources import files


@lru_cache(maxsize=1)
def plotly() -> tuple[str, str]:
    """Source of plotly.js as base64 of gzip, and its CSP hash ``'sha256-...'``.

    The page inflates it (DecompressionStream) and runs it as an inline script with this hash: the policy
    permits no other code.
    """
    source = files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    packed = gzip.compress(source, compresslevel=4, mtime=0)  # 9: a twentieth less, twice the time
    return base64.b64encode(packed).decode("ascii"), csp_hash(source)


def csp_hash(source: bytes) -> str:
    """Hash of an inline script, as a content security policy states it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(source).digest()).decode('ascii')}'"
