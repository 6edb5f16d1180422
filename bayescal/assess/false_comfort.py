"""Why small residuals would be no proof of small distance errors, in words."""

from __future__ import annotations

import numpy as np

from bayescal.assess.directions import Directions, in_words
from bayescal.estimate.unexplained import Unexplained
from bayescal.predict.forecast import Forecast
from bayescal.predict.validation import Validation

PRIOR_DECIDES = 0.5
"""Share of the predicted distance variance from which on the tolerances make the figure."""
FAR_BEYOND = 3.0
"""Times the held-out contacts' error from which on a distance error is one that they do not let expect."""


def false_comfort(
    checked: Validation, left: Unexplained, expected: Forecast, seen: Directions
) -> tuple[str, ...]:
    """What a reader of small residuals must know, a sentence each; none of a session that earns them."""
    out, lead = [], expected.lead
    if len(seen.missing):
        out.append(
            f"too few directions are probed: {in_words(seen)}, "
            "and errors across rest on the arm's other poses and on the priors"
        )
    # what the prior leaves matters where it is more than the noise of one contact
    if expected.prior_share > PRIOR_DECIDES and expected.prior_rms > left.floor:
        out.append(
            f"the prior decides: {100 * expected.prior_share:.0f} % of a distance's predicted variance is "
            "what the tolerances allow and no row narrowed down; the prediction is as good as they are"
        )
    residuals = [p.residuals for p in checked.planes]
    contact = float(np.sqrt(np.mean(np.concatenate(residuals) ** 2))) if residuals else left.fitted
    distance = max(lead.rms, expected.workspace.rms)
    if distance > FAR_BEYOND * contact:
        out.append(
            f"contacts are met to {1e6 * contact:.0f} um, yet a distance is known to {1e6 * distance:.0f} um "
            "only: small residuals do not prove this calibration"
        )
    if lead.measured is not None and lead.measured > lead.interval[1]:
        out.append(
            f"distances between {lead.over} are {1e6 * lead.measured:.0f} um off (rms), more than the "
            f"{1e6 * lead.interval[1]:.0f} um predicted at most: the model lacks something (bayescal gap)"
        )
    return tuple(out)
