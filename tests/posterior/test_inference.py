"""The ArviZ record: what is written is read again, with its groups and units."""

import numpy as np

from bayescal.posterior.inference import inference_data, load, save


def test_record_comes_back(tmp_path):
    rng = np.random.default_rng(0)
    groups = {
        "posterior": {"a2": ((), rng.normal(size=(4, 10))), "J": (("joint",), rng.normal(size=(4, 10, 3)))},
        "observed_data": {"distance_mm": (("pair",), np.array([1.0, 2.0]))},
    }
    data = inference_data(groups, {"joint": ["a", "b", "c"], "pair": ["x", "y"]}, {"a2": "mm"}, {"seed": "1"})
    save(data, tmp_path / "p.nc")
    back = load(tmp_path / "p.nc")
    np.testing.assert_array_equal(np.asarray(back["posterior"]["a2"]), groups["posterior"]["a2"][1])
    assert back["posterior"]["a2"].attrs["units"] == "mm"
    assert list(back["posterior"]["J"].coords["joint"].values) == ["a", "b", "c"]
    assert list(back["observed_data"]["distance_mm"].coords["pair"].values) == ["x", "y"]
