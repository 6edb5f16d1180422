"""The known effects: each a table of terms (site x driver) with prior scales; similar ones share a file."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

from bayescal.arm.chain import Prior
from bayescal.arm.motion import CERTIFICATE as CERTIFICATE
from bayescal.arm.motion import CONTACT as CONTACT
from bayescal.arm.motion import TURN as TURN
from bayescal.arm.motion import Term as Term
from bayescal.effects import by_time, compliance, geometry, gravity, imaging, lost_motion, probe, readings
from bayescal.effects.gravity import compliances as compliances
from bayescal.effects.location import Driver as Driver
from bayescal.effects.location import Site as Site
from bayescal.effects.location import Size as Size
from bayescal.effects.selection import Selection, Vocabulary, positive
from bayescal.effects.vocabulary import UNITS as UNITS
from bayescal.effects.vocabulary import CertifiedValue as CertifiedValue
from bayescal.effects.vocabulary import Circumstances as Circumstances
from bayescal.effects.vocabulary import Effect as Effect
from bayescal.effects.vocabulary import Face as Face
from bayescal.effects.vocabulary import Parameter as Parameter
from bayescal.effects.vocabulary import Scan as Scan
from bayescal.effects.vocabulary import Session as Session
from bayescal.effects.vocabulary import Setting as Setting
from bayescal.effects.vocabulary import View as View
from bayescal.errors import BayescalError

BASELINE = (geometry.GEOMETRY.name, compliance.COMPLIANCE.name)
"""The model of a fit or diagnosis for which none is given."""
LEVELS = {geometry.JOINT.name: geometry.JOINT}
"""Model levels simpler than `geometry`, for comparison; a diagnosis does not name them."""

ALWAYS = (geometry.TOOL.name, imaging.CAMERA.name)
"""Effects of every model, which no robot file holds: what the session states of tools, cameras and boards."""

EFFECTS = Vocabulary(
    (
        geometry.GEOMETRY,
        compliance.COMPLIANCE,
        compliance.HARDENING,
        gravity.BENDING,
        compliance.BASE_COMPLIANCE,
        gravity.PAYLOAD,
        readings.ECCENTRICITY,
        readings.SECOND_HARMONIC,
        readings.GEAR_MESH,
        lost_motion.BACKLASH,
        lost_motion.UNSETTLED,
        lost_motion.HYSTERESIS,
        readings.ENCODER_SCALE,
        readings.COUPLING,
        readings.STRAIGHTNESS,
        readings.ANGULAR_MOTION,
        readings.POSITIONING,
        gravity.AXIS_BENDING,
        by_time.THERMAL_DRIFT,
        by_time.STEP,
        probe.LOBING,
        lost_motion.LATENCY,
        probe.PLANE_FORM,
        probe.ARTEFACT,
        probe.BALL_RADIUS,
        imaging.FOCAL_LENGTH,
        imaging.IMAGE_CENTRE,
        imaging.LENS_DISTORTION,
        imaging.BOARD_SCALE,
        imaging.BOARD_BOW,
    ),
    reserved=(*LEVELS, *ALWAYS, "null", "unknown", "nominal"),
)
"""Causes of error that a model may have and a diagnosis may name. Those of `ALWAYS` belong to every model."""

MODELS: Mapping[str, Effect] = ChainMap(LEVELS, EFFECTS)  # type: ignore[arg-type]
"""All effects that `--model` accepts."""

register = EFFECTS.register
unregister = EFFECTS.unregister


def parameters_of(
    names: tuple[str, ...], circumstances: Circumstances, lenient: bool = False
) -> tuple[Parameter, ...]:
    """Parameters of a model: those of the named effects in order, and those of every model.

    A parameter that an effect shares with one before it, as an offset of 'geometry' after 'joint', is there
    once, with the prior of the first. A prior that the robot file states replaces that of its parameter,
    unless the name of the effect states a factor.

    Parameters
    ----------
    names : tuple of str
    circumstances : Circumstances
    lenient : bool
        Leave out an effect that displaces nothing, such as a payload on an arm whose compliances are zero.

    Raises
    ------
    BayescalError
        For an unknown effect, or if the session lacks data that the effect needs.
    """
    out: list[Parameter] = []
    priors = {prior.name: prior for prior in circumstances.robot.priors}
    for name in names:
        effect, setting = named(name)
        lacks = effect.missing(circumstances)
        scanned = effect.scan is not None and isinstance(setting, (float, tuple))
        if lacks and not (scanned and effect.scan and len(effect.scan.values(circumstances))):
            remedy = "leave it out, or add what is missing"
            raise BayescalError(f"{effect.name} cannot be judged: {lacks}", "--model", remedy)
        parameters = effect.at(circumstances, setting)
        parameters = [_with_prior(p, priors[p.name]) if p.name in priors else p for p in parameters]
        if lenient and not parameters:
            continue
        if isinstance(setting, str) and not parameters:
            what = f"{effect.name}@{setting} has no parameters here: {effect.words(setting)}"
            raise BayescalError(what, "--model", f"say {effect.name}")
        asked = Selection.read(name)
        if effect.alternatives and not asked.sites:
            parameters = [p for p in parameters if p.site == parameters[0].site]
        there = {p.name for p in out}
        out += [p for p in asked.of(parameters, f"--model '{name}'") if p.name not in there]
    return (*out, *geometry.TOOL.at(circumstances), *imaging.CAMERA.at(circumstances))


def _with_prior(p: Parameter, prior: Prior) -> Parameter:
    """A parameter with the prior that the robot file states."""
    if p.unit != prior.unit:
        what = f"the prior of {p.name} is in {prior.unit}, the parameter in {p.unit}"
        raise BayescalError(what, "robot file", "use the keys of its unit")
    return replace(p, mean=p.nominal + prior.deviation, sd=prior.sd, usual=(p.centre, p.sd))


def possible(names: tuple[str, ...], circumstances: Circumstances) -> tuple[str, ...]:
    """Those of some effects for which a session has what they need."""
    out = []
    for name in names:
        with suppress(BayescalError):
            parameters_of((name,), circumstances, lenient=True)
            out.append(name)
    return tuple(out)


def levels_of(effects: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Model levels: nominal, the simpler model of the first effect if it has one, then effect by effect."""
    simpler = MODELS[effects[0]].simpler if effects and effects[0] in MODELS else ""
    return [(), *([(simpler,)] if simpler else []), *(effects[:k] for k in range(1, len(effects) + 1))]


def confusable(one: str, other: str) -> bool:
    """Whether two effects may have a similar form; it is sufficient that either effect states it."""
    pairs = ((one, other), (other, one))
    return any(a in EFFECTS and b in EFFECTS[a].confusable_with for a, b in pairs)


def named(name: str) -> tuple[Effect, Setting]:
    """An effect and the setting or form that its name may carry: ``step@212``, ``backlash@reading``.

    ``gear-mesh@100/50 at joint 1 and joint 5`` has a setting for each site. For the other parts of a name see
    `selection`.

    Raises
    ------
    BayescalError
        For an effect, a setting or a form that does not exist.
    """
    asked, where = Selection.read(name), f"--model {name}"
    plain, setting = asked.effect, asked.setting
    if plain not in MODELS:
        raise BayescalError(f"no effect is called `{plain}`", "--model", f"known: {', '.join(MODELS)}")
    effect = MODELS[plain]
    if setting is None:
        return effect, None
    if effect.form(setting) is not None:
        return effect, setting
    forms = ", ".join(f"{plain}@{form.name}" for form in effect.forms)
    if effect.scan is None and forms:
        raise BayescalError(f"{plain} has no form `{setting}`", where, f"it has: {forms}")
    if effect.scan is None:
        raise BayescalError(f"{plain} has no setting", where, f"say {plain}")
    wanted = f"give the {effect.scan.what}" + (f", or one of {forms}" if forms else "")
    values = [positive(text, where, wanted) for text in setting.split("/")]
    if len(values) == 1:
        return effect, values[0]
    if not effect.scan.by_site:
        raise BayescalError(f"{plain} has one setting for all sites", where, f"say {plain}@{values[0]:g}")
    if len(values) != len(asked.sites):
        what = f"{plain} has {len(values)} settings; the number of sites is {len(asked.sites)}"
        remedy = "name as many sites: gear-mesh@100/50 at joint 1 and joint 5"
        raise BayescalError(what, f"--model '{name}'", remedy)
    return effect, tuple(zip(asked.sites, values, strict=True))


def names() -> tuple[str, ...]:
    """Names of all effects that a model may have, including registered ones.

    Examples
    --------
    >>> import bayescal as bc
    >>> bc.effects.names()[:2]
    ('geometry', 'compliance')
    """
    return tuple(EFFECTS)


def describe(name: str) -> str:
    """Describe an effect in one line.

    Raises
    ------
    BayescalError
        For an unknown effect.

    Examples
    --------
    >>> import bayescal as bc
    >>> isinstance(bc.effects.describe("backlash"), str)
    True
    """
    return named(name)[0].summary
