"""Compiled functions work where no folder for compiled code can be written."""

import runpy

import pytest
from cases import ROOT
from numba import njit
from numba.core import caching

COMPILED = sorted(
    path
    for package in ("bayescal", "factors")
    for path in (ROOT / package).rglob("*.py")
    if any(words in path.read_text(encoding="utf-8") for words in ("import numba", "arm.compiled import"))
)


@pytest.mark.parametrize("path", COMPILED, ids=lambda p: p.stem)
def test_no_folder_for_compiled_code(path, monkeypatch):
    """Installed in a folder that the user cannot write, without a home: numba finds no place and raises."""

    def refused(self):
        raise OSError("read-only")

    for locator in caching.CompileResultCacheImpl._locator_classes:
        monkeypatch.setattr(locator, "ensure_cache_path", refused, raising=False)
    with pytest.raises(RuntimeError, match="no locator"):
        njit(cache=True)(doubled)
    assert runpy.run_path(str(path))


def doubled(x):
    return 2.0 * x


def test_modules_with_compiled_functions_are_found():
    assert {"kernel", "noise_integral"} <= {path.stem for path in COMPILED}
