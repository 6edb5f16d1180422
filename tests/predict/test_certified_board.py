"""The stated size of a board is a certified length, not a prior of the arm."""

from dataclasses import replace

import numpy as np
from camera_sessions import camera_session

import bayescal as bc
from bayescal.predict.forecast import certified_sizes


def test_the_stated_size_of_a_board_is_no_prior():
    session = camera_session(images=8, seed=3)
    (t,) = session.targets
    usual = replace(session, targets=(replace(t, values=t.values | {"u_scale": np.nan}),))
    stated = replace(session, targets=(replace(t, values=t.values | {"u_scale": 1e-3}),))  # as where none is
    assert not certified_sizes(usual)
    assert certified_sizes(stated) == {"cam scale x", "cam scale y"}
    shares = [bc.fit(each, samples=0).data.forecast.prior_share for each in (usual, stated)]
    assert shares[1] < 0.9 * shares[0]
