"""The variant of a large effect is that which fits best by itself, not by the noise without the effect."""

import numpy as np
import pytest
from gap_problems import Bench

from bayescal.effects.location import joint
from bayescal.gap.linear.evidence import SCALE_PRIOR, SCALES
from bayescal.gap.linear.state import fit_state
from bayescal.gap.search.beam import Search


@pytest.mark.parametrize("strength", [300.0, 30_000.0])
def test_the_chosen_variant_of_an_effect_fits_best_by_itself(tracker, strength):
    """From some thousand on, all joints together looked better than the one that has the effect."""
    bench = Bench.of(tracker(seed=3, count=40).dataset)
    variants = bench.known.variants["encoder-scale"]
    own = next(v for v in variants if v.sites == (joint(2),))
    p = bench.made_up(1, bench.visible(bench.problem.pool[:, own.columns], strength, 1))
    search = Search(p, bench.known)
    search.hypotheses[frozenset()] = search.hypothesis(())
    search.extend(search.hypotheses[frozenset()], 0.0)
    found = search.hypotheses[frozenset({"encoder-scale"})]
    (member,) = found.members

    def evidence(variant, k):
        scales = np.full(len(variant.columns), SCALES[k])
        return fit_state(p, variant.columns, scales).log_evidence + variant.log_prior + SCALE_PRIOR[k]

    chosen = evidence(member.variant, int(np.flatnonzero(member.scale == SCALES)[0]))
    near = [int(k) for k in np.flatnonzero((member.scale / 2 <= SCALES) & (2 * member.scale >= SCALES))]
    every = [evidence(v, k) for v in variants for k in near]
    assert chosen == pytest.approx(max(every))
    assert chosen <= found.log_evidence + 1e-9 <= float(np.logaddexp.reduce(every)) + 0.1
