"""The compiled kernel works where no folder for compiled code can be written."""

import pytest
from numba.core import caching

from bayescal.arm import kernel


@pytest.mark.parametrize("compiled", [kernel._jit, kernel._inline], ids=["jit", "inline"])
def test_no_folder_for_compiled_code(compiled, monkeypatch):
    """Installed in a folder that the user cannot write, without a home: numba finds no place and raises."""

    def refused(self):
        raise OSError("read-only")

    locators = caching.CompileResultCacheImpl._locator_classes
    for locator in locators:
        monkeypatch.setattr(locator, "ensure_cache_path", refused, raising=False)
    with pytest.raises(RuntimeError, match="no locator"):
        kernel.numba.njit(cache=True)(doubled)
    assert compiled(doubled)(2.0) == 4.0


def doubled(x):
    return 2.0 * x
