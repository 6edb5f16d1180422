"""Limitations of a fit that a reader must know: a list with severities.

Gross errors of single measurements that a fit would not detect, and what they would do to distances.

Reliability after Baarda (A testing procedure for use in geodetic networks, 1968). A gross error e of a
measurement, over the standard uncertainty of its k residuals, leaves the share R e of itself in them, with
R = I - H and H = J C J' its leverage: the redundancy numbers of the measurement. The rule for outliers
(`estimate.outliers`) then has the noncentrality e' R e, and detects it with probability `POWER` where that
is the one of `detectable` (internal reliability). Undetected it moves the estimate by C J' e, and a distance
of slopes d by d C J' e (external reliability). For each measurement, the e of that noncentrality is taken
that gives the largest root mean square of these over all distances: the largest eigenvalue of a k x k matrix.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from scipy.special import gammaln

from bayescal.assess.acceptance import PLANNED, SHARED, Acceptance
from bayescal.assess.identifiability import Directions, in_words
from bayescal.assess.images import blurred, displaced, lost_images
from bayescal.assess.undetermined import Undetermined
from bayescal.dataset.consistency import contradictions, copies, planned, rounded
from bayescal.effects import BASELINE, MODELS
from bayescal.effects.location import CAMERA, micrometres
from bayescal.effects.selection import plain
from bayescal.estimate import Estimate
from bayescal.estimate.bounds import UNCHANGED, Rigid
from bayescal.estimate.outliers import LEAST_SPARE, detectable
from bayescal.estimate.solver import by_group
from bayescal.estimate.unexplained import AGAIN, FaceCheck, Unexplained
from bayescal.estimate.widths import Width, factors, sentences
from bayescal.model import ORIENTATION
from bayescal.model.block import ARM, Block
from bayescal.model.model import length_blocks
from bayescal.model.options import USUAL, FitOptions, family
from bayescal.predict.errors import slopes
from bayescal.predict.forecast import Forecast, workspace
from bayescal.predict.validation import Validation
from bayescal.statistics import rms
from bayescal.storage.reading import table_beside


@dataclass(frozen=True)
class Reliability:
    """Of each fitted measurement of a length, without the rejected ones."""

    rows: np.ndarray  # (N,) of the session
    error: np.ndarray  # (N,) m: length of the gross error that is detected with probability `POWER`
    shift: np.ndarray  # (N,) m: root mean square change of distances by it, over the workspace


def reliability(fitted: Estimate) -> Reliability:
    """The minimum detectable gross error of each measurement, and the change of distances that it causes.

    Linear in the error; orientations are not judged. Without parameters of the arm or distances all changes
    are 0.
    """
    model, space, arm = fitted.model, workspace(fitted), fitted.model.slices[ARM]
    mean = np.zeros((arm.stop - arm.start,) * 2)
    if model.parameters and len(space.pairs):
        by = slopes(model, space.motion, space.values, space.pairs)
        mean = by.T @ by / len(by)
    counts = {group: sum(len(b.rows) for b in blocks) for group, blocks in by_group(model).items()}
    parts = [_of_block(fitted, b, mean, counts[b.group]) for b in length_blocks(model)]
    rows, error, shift = np.concatenate([np.zeros((3, 0)), *parts], axis=1)
    return Reliability(rows.astype(int), error, shift)


def _of_block(fitted: Estimate, block: Block, mean: np.ndarray, count: int) -> np.ndarray:
    """Rows, errors and changes (3, C) of the kept measurements of a block, of `count` in its noise group.

    `mean` (P, P) is the mean square of the slopes of distances by z of the arm, m^2.
    """
    k, keep = block.kind.rows, fitted.weights.row[block.name] > 0
    jacobian = fitted.linear.jacobian[fitted.linear.of_block[block.name]].reshape(k, len(keep), -1)[:, keep]
    sigma = 1.0 / fitted.weights.whitening(block).reshape(k, -1)[:, keep]
    moved = jacobian @ fitted.covariance  # (k, C, D)
    share, turn = np.linalg.eigh(np.einsum("icd,jcd->cij", moved, jacobian))
    spare = np.maximum(1.0 - share, LEAST_SPARE)
    spread = turn / np.sqrt(spare)[:, None, :]  # R^-1/2, times a rotation
    of_arm = moved[..., fitted.model.slices[ARM]]
    square = np.einsum("icp,pq,jcq->cij", of_arm, mean, of_arm, optimize=True)
    largest, vector = np.linalg.eigh(np.swapaxes(spread, 1, 2) @ square @ spread)
    size = np.sqrt(detectable(k, fitted.dof[block.group], count))
    error = size * np.einsum("cij,cj->ic", spread, vector[..., -1]) * sigma
    shift = size * np.sqrt(np.maximum(largest[:, -1], 0.0))
    return np.stack([block.rows[keep], np.linalg.norm(error, axis=0), shift])


Severity = Literal["error", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
TEXTS = table_beside(__file__, "findings.toml")
"""Severities and words of limitations."""
WILD_SCALE = 100.0
"""Times the stated noise from which on residuals come from a wrong file, not from a small error of an arm."""
WILD_SIZE = 1e-4
"""m: smaller residuals are no sign of a wrong file, however small the stated noise is (assumed)."""
MANY_REJECTED = 0.05
"""Share of rejected measurements from which on it is told."""
FAR = 4.0
"""Prior standard deviations from nominal from which on a parameter is told."""
PRIOR_DECIDES = 0.5
"""Share of the predicted distance variance from which on it rests on the tolerances."""
ONE_SCALE, DETERMINED = 0.25, 0.5
"""Share of the squared deviations of lengths that one factor on all of them may leave, and the share of its
prior standard deviation below which the uncertainty of such a length is (conventions)."""
NOISY, UNEVEN = 4.0, 10.0
"""Degrees of freedom of the prior of a target's noise, and the log Bayes factor from which on it is told that
the noise differs between targets (assumed)."""
FAR_BEYOND = 3.0
"""Times the error of validation contacts from which on a distance error is one that they do not show."""


@dataclass(frozen=True)
class Finding:
    """A limitation, its severity, and a name that does not change with the wording."""

    code: str
    severity: Severity
    text: str

    @classmethod
    def said(cls, code: str, **values: object) -> Self:
        """A limitation in the words of the table, with the values that they name in braces."""
        words = TEXTS[code]
        return cls(code, words["severity"], words["text"].format_map(values))


@dataclass(frozen=True)
class Assessed:
    """The results from which findings are derived."""

    fitted: Estimate
    unexplained: Unexplained
    checked: Validation
    expected: Forecast
    undetermined: tuple[Undetermined, ...]
    seen: Directions
    faces: tuple[FaceCheck, ...]
    tests: Acceptance
    options: FitOptions = USUAL
    rigid: Rigid = UNCHANGED
    widths: tuple[Width, ...] = ()
    sd: np.ndarray | None = None  # (D,) stated, over that of the prior; default: the solver's


def findings(of: Assessed) -> tuple[Finding, ...]:
    """All limitations, the most severe first; none for a good session."""
    kinds = (_tests, _residuals, _noises, _boards, _parameters, _false_comfort, _gross_errors)
    every = [finding for kind in kinds for finding in kind(of)]
    return tuple(sorted(every, key=lambda f: SEVERITIES.index(f.severity)))


def _tests(of: Assessed) -> Iterator[Finding]:
    for check in of.tests.failed:
        ratio = f" (ratio {check.value:.2g}, limit {check.limit:.2g})"
        ratio = "" if check.test in (SHARED, PLANNED) else ratio
        yield Finding(check.test, "error", check.words + ratio)
    if of.tests.causes:
        yield Finding.said("rejected_rows_kept")


def _residuals(of: Assessed) -> Iterator[Finding]:
    fitted, unexplained, dataset = of.fitted, of.unexplained, of.fitted.model.scene.dataset
    if unexplained.excess:
        noise = f"of {AGAIN[unexplained.group]}" if unexplained.repeats is not None else "stated"
        sizes = f"residuals {1e6 * unexplained.fitted:.1f} µm, noise {noise} {1e6 * unexplained.floor:.1f} µm"
        if unexplained.fitted <= unexplained.floor:
            sizes = f"by validation errors, not by residuals of the fit: {sizes}"
        yield Finding.said("unexplained", excess=1e6 * unexplained.excess, sizes=sizes)
    scale = max(s for group, s in fitted.weights.scale.items() if group != ORIENTATION)
    if scale > WILD_SCALE and unexplained.fitted > WILD_SIZE:
        yield Finding.said("wrong_files", size=1e3 * unexplained.fitted)
    for wrong in contradictions(dataset):
        yield Finding("certified_length", "error", f"{wrong.what}; {wrong.remedy}")
    if words := copies(dataset):
        yield Finding("doubled_row", "warning", words)
    if (few := planned(dataset)) and not few.certain:
        yield Finding("planned_pose", "warning", few.words(dataset))
    if words := rounded(dataset):
        yield Finding("rounded_readings", "warning", words)
    count, rejected = sum(len(b.rows) for b in fitted.model.states), len(fitted.rejected)
    if rejected > MANY_REJECTED * count:
        yield Finding.said("many_rejected", rejected=rejected, count=count)
    if uneven := [f"{f.target} by {1e6 * f.form:.0f} µm RMS" for f in of.faces if f.uneven]:
        yield Finding.said("not_flat", names=", ".join(uneven))


def differing(count: np.ndarray, chi2: np.ndarray) -> float:
    """Log Bayes factor of a noise of each target over one noise for all.

    Parameters
    ----------
    count, chi2 : np.ndarray, shape (T,)
        Residuals on each target, and the sum of their squares over the noise of all. The variance of a target
        over that of all has an inverse gamma distribution.
    """
    nu = NOISY
    gamma = gammaln((nu + count) / 2) - gammaln(nu / 2) + nu / 2 * np.log(nu / 2)
    return float(np.sum(gamma + chi2 / 2 - (nu + count) / 2 * np.log((nu + chi2) / 2)))


def noise_ratios(count: np.ndarray, chi2: np.ndarray) -> np.ndarray:
    """Noise (T,) of each target over one noise for all, of mean logarithm 0; see `differing`."""
    log = 0.5 * np.log((NOISY + chi2) / (NOISY + count))
    return np.asarray(np.exp(log - np.average(log, weights=count)))


def _noises(of: Assessed) -> Iterator[Finding]:
    """Noise groups with targets whose residuals are of another size than those of the others."""
    linear, row = of.fitted.linear, of.fitted.weights.row
    for blocks in by_group(of.fitted.model).values():
        squares = dict[str, list[float]]()
        for b in blocks:
            keep = np.tile(row[b.name] > 0, b.kind.rows)
            squares.setdefault(b.target, []).extend(linear.residual[linear.of_block[b.name]][keep] ** 2)
        squares = {target: values for target, values in squares.items() if values}
        count, chi2 = (np.array([f(values) for values in squares.values()]) for f in (len, sum))
        level = np.sum(chi2) / max(np.sum(count), 1)
        if level > 0 and differing(count, chi2 / level) > UNEVEN:
            ratio = np.sqrt(chi2 / count / level)
            most, least = (f"{list(squares)[k]} {ratio[k]:.2g}" for k in (np.argmax(ratio), np.argmin(ratio)))
            yield Finding.said("noise_differs", most=most, least=least)


def _boards(of: Assessed) -> Iterator[Finding]:
    for board in displaced(of.fitted):
        yield Finding("points_differ", "warning", board.words)
    if words := lost_images(of.fitted):
        yield Finding("lost_images", "warning", words)
    if words := blurred(of.fitted):
        yield Finding("blurred", "note", words)


def _parameters(of: Assessed) -> Iterator[Finding]:
    model, z = of.fitted.model, of.fitted.z
    for u in of.undetermined:
        if u.matters or u.hidden:
            yield Finding("not_identifiable", "warning" if u.matters else "note", u.words)
    if not model.knows_length:
        yield Finding.said("no_length")
    limit, widening = FAR * max(1.0, 1 / of.options.prior_width), factors(of.widths)
    wider = np.array([widening.get(family(p), 1.0) for p in model.parameters])
    every = zip(model.parameters, z[: len(wider)] * wider, strict=True)
    beyond = [p for p, deviation in every if abs(deviation) > limit]
    far = [p.name for p in beyond]
    lens = any(p.site.kind == CAMERA.kind and p.effect == CAMERA.kind for p in beyond)
    yield from (Finding("far_from_prior", "warning", words) for words in of.options.contrary)
    stated = {prior.name for prior in model.scene.dataset.robot.priors}
    if unused := sorted(stated - {p.name for p in model.parameters}):
        yield Finding.said("prior_unused", names=", ".join(unused))
    if far:
        asked = ": is the calibration of the camera of images of this size and crop?" if lens else ""
        widened = " (before widening)" if widening else ""
        yield Finding.said("far_from_nominal", names=", ".join(far), far=FAR, widened=widened, lens=asked)
    if factor := _one_factor(of.fitted, wider, of.fitted.sd if of.sd is None else of.sd):
        yield Finding.said("one_scale", factor=factor)
    for words in sentences(of.widths):
        yield Finding("prior_width", "note", words)
    if of.rigid.words:
        yield Finding("rigid", "note", of.rigid.words)
    effects, circumstances = {plain(name) for name in model.effects}, model.scene.circumstances()
    for effect in (MODELS[name] for name in BASELINE if name not in effects):
        if lacks := effect.missing(circumstances):
            yield Finding.said("not_modelled", effect=effect.name, lacks=lacks)
    if absent := [name for name in model.effects if not MODELS[plain(name)].in_robot_file]:
        yield Finding.said("not_in_robot_file", names=", ".join(absent))


def _one_factor(fitted: Estimate, wider: np.ndarray, sd: np.ndarray) -> float | None:
    """The one factor on nominal lengths of links that explains how far they are from nominal, or None.

    `wider` (P,) are the factors on stated prior standard deviations, `sd` (D,) stated u over those.
    """
    every = zip(fitted.model.parameters, fitted.z, sd, wider, strict=False)
    lengths = [(z * by, p.nominal * by / p.sd) for p, z, u, by in every  # others than lengths are nominally 0
               if p.unit == "m" and p.nominal and u < DETERMINED]  # fmt: skip
    if len(lengths) < 2:
        return None
    size, nominal = np.array(lengths).T
    scale = size @ nominal / (nominal @ nominal)
    before, after = size @ size, float(np.sum((size - scale * nominal) ** 2))
    return 1 + scale if before - after > FAR**2 and after < ONE_SCALE * before else None


def rests_on_priors(expected: Forecast, unexplained: Unexplained) -> bool:
    """Whether priors decide the predicted distance error, with more than the noise of one contact."""
    return expected.prior_share > PRIOR_DECIDES and expected.prior_rms > unexplained.floor


def _false_comfort(of: Assessed) -> Iterator[Finding]:
    """Why small residuals do not prove small distance errors."""
    unexplained, expected, lead = of.unexplained, of.expected, of.expected.lead
    if len(of.seen.missing):
        seen, where = ("seen", "along it") if of.seen.images else ("probed", "across")
        yield Finding.said("directions", seen=seen, which=in_words(of.seen), where=where)
    if rests_on_priors(expected, unexplained):
        yield Finding.said("prior", share=100 * expected.prior_share)
    residuals = [p.residuals for p in of.checked.planes]
    contact = rms(np.concatenate(residuals)) if residuals else unexplained.fitted
    those = "those of validation contacts" if residuals else "they"
    distance = max(lead.u, expected.workspace.u)
    if distance > FAR_BEYOND * contact:
        yield Finding.said("contrast", those=those, contact=1e6 * contact, distance=1e6 * distance)
    if lead.measured is not None and lead.measured > lead.interval[1] and of.tests.explains:
        error, limit = 1e6 * lead.measured, 1e6 * lead.interval[1]
        yield Finding.said("distances", lead=lead, error=error, limit=limit)


def _gross_errors(of: Assessed) -> Iterator[Finding]:
    """A gross error that the rule for outliers does not see, and that changes distances by more than U."""
    gross, u = reliability(of.fitted), of.expected.workspace.expanded
    k = int(np.argmax(gross.shift)) if len(gross.rows) else -1
    if k >= 0 and gross.shift[k] > u:
        name = of.fitted.model.scene.dataset.measurements.ids[gross.rows[k]]
        sizes = {"error": micrometres(gross.error[k]), "shift": micrometres(gross.shift[k])}
        yield Finding.said("gross_error_unseen", count=len(gross.rows), name=name, u=micrometres(u), **sizes)
