"""A test whose loops are all empty fails: the rule of `loops`, which `conftest` applies to every test."""

import numpy as np
import pytest
from cases import refused
from loops import asserting, in_loops


def looped(values):
    for value in values:
        assert value
        np.testing.assert_allclose(value, 1.0)


def refusing(calls):
    for call in calls:
        refused("words", call)


def free(values):
    for value in values:
        assert value
    with pytest.raises(ZeroDivisionError):
        assert 1 / 0


def test_empty_loops_are_a_failure():
    assert in_loops(free) == set()
    assert (len(in_loops(looped)), len(in_loops(refusing))) == (2, 1)
    for function, values in ((free, []), (looped, [1.0])):
        asserting(function, lambda function=function, values=values: function(values))
    with pytest.raises(pytest.fail.Exception, match="no assertion of looped"):
        asserting(looped, lambda: looped([]))
    with pytest.raises(AssertionError):
        asserting(looped, lambda: looped([0.0]))


def test_every_test_is_called_so(request):
    """The hook is there: this loop is empty."""
    hook = request.config.hook.pytest_pyfunc_call
    assert any(one.plugin_name.endswith("conftest.py") for one in hook.get_hookimpls())
