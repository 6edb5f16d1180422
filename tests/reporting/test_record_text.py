"""Records as JSON text: that of the standard library, and arrays as lists."""

import json

import numpy as np
import pytest

from bayescal.reporting.shared.origin import STANDSTILL, _signs, plain
from bayescal.storage.files import indented

RECORD = {
    "a": [1, 2.5, -1e-300, True, None, 'µ "x"\n'],
    "b": {"c": [], "d": {}, "e": [[1, 2], [], [3.0]], "f": [{"g": 1}, 2, ("h", [None])]},
    "": {1: "one", None: 2, 2.5: [0.1 + 0.2]},
    "text": "a, b",
    "number": np.float64(0.1),
}


@pytest.mark.parametrize("value", [RECORD, [], {}, [1.0], "x", None, [[[0]]]])
def test_text_is_that_of_the_standard_library(value):
    assert indented(value) == json.dumps(value, indent=1, allow_nan=False)


def test_a_number_that_is_not_finite_is_refused():
    with pytest.raises(ValueError):
        indented({"a": [1.0, float("nan")]})


def test_arrays_become_lists_with_none_for_what_is_not_finite():
    values = np.array([[1.5, np.nan], [np.inf, -2.0]])
    assert plain({"v": values, "k": np.arange(2), "b": np.array([True]), "t": np.array(["a"])}) == {
        "v": [[1.5, None], [None, -2.0]],
        "k": [0, 1],
        "b": [True],
        "t": ["a"],
    }
    assert {type(v) for row in plain(values) for v in row} == {float, type(None)}
    assert type(plain(np.arange(2))[0]) is int


def test_signs_of_motion():
    speed = 2 * STANDSTILL
    assert _signs(np.array([[speed, -speed, 0.0], [STANDSTILL / 2, -STANDSTILL / 2, speed]])) == [
        "+-0",
        "00+",
    ]
