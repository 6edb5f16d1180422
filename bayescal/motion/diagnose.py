"""The diagnosis of a log: which effects explain what the baseline leaves."""

from __future__ import annotations

import numpy as np

from bayescal.errors import BayescalError
from bayescal.logs import Log
from bayescal.logs.types import CALIBRATE, VALIDATE
from bayescal.motion import outcome
from bayescal.motion.beside import beside, simplified
from bayescal.motion.estimate import estimated, noise_about
from bayescal.motion.linear import joined, normal
from bayescal.motion.named import named_arm
from bayescal.motion.pool import Pool
from bayescal.motion.result import MotionGap
from bayescal.motion.servo import with_torques
from bayescal.motion.settings import NOISE, VERDICT
from bayescal.motion.signals import all_signals
from bayescal.motion.verdict import confirmed, decide
from bayescal.storage.stopping import Progress, silent


def diagnose(log: Log, progress: Progress = silent) -> MotionGap:
    """Diagnose a joint log.

    Raises
    ------
    BayescalError
        If the log has no torques with a sign, or no motion of a role that is needed.
    """
    log = with_torques(log)
    if not log.of_role(VALIDATE):
        raise BayescalError("no motion has the role validate", log.name, "withhold one or more")
    progress("signals", 0.0)
    estimate = estimated(all_signals(log))
    progress("columns", 0.2)
    pool = Pool.of(estimate)
    noise = estimate.noise
    motions = pool.table.of_role(CALIBRATE)
    for k in range(NOISE.repeats):
        progress("search", 0.4 + 0.2 * k)
        search = pool.search(normal(motions, noise))
        noise = noise_about(motions, search.fit(search.run()[0].members))
    seen, held = normal(motions, noise), normal(pool.table.of_role(VALIDATE), noise)
    # all motions tell which effects there are; how large they are, those of role `calibrate` alone
    whole = pool.search(joined(seen, held))
    hypotheses = whole.run()
    progress("causes beside the list", 0.7)
    pool, hypotheses = beside(pool, noise, whole, hypotheses)
    del motions, search, whole  # of the columns before: much of the memory of a long log
    seen = normal(pool.table.of_role(CALIBRATE), noise, seen)
    held = normal(pool.table.of_role(VALIDATE), noise, held)
    search, whole = pool.search(seen), pool.search(joined(seen, held))
    hypotheses = simplified(whole, hypotheses)
    verdict = confirmed(decide(whole, hypotheses), search, held)
    progress("result", 0.8)
    named = search.fit(verdict.named.members)
    model = named_arm(estimate, search.fit(), pool.scale)
    score = np.array([h.score for h in hypotheses])
    weight = np.exp(score - np.max(score))
    ranked = zip(hypotheses[: VERDICT.listed], weight / np.sum(weight), strict=False)
    return MotionGap(
        estimate=estimate,
        verdict=verdict,
        where=outcome.places(search, pool, verdict),
        amplitudes=outcome.amplitudes(search, pool, verdict),
        shrinkage=outcome.shrinkage(search, pool, verdict, held),
        hypotheses=tuple((h.names, float(w), h.log_evidence) for h, w in ranked),
        not_assessed=outcome.not_assessed(search, pool),
        advice=tuple(outcome.advice(search, pool, verdict)),
        values=named.values,
        u=named.u,
        warnings=log.notes,
        model=model,
        arm=named_arm(estimate, named, pool.scale) if verdict.named.members else model,
    )
