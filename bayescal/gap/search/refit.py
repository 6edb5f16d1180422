"""The non-linear refit of a model with the named effects: the same fit as that of `fit` with their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bayescal.assess.shared_causes import judged_complete
from bayescal.effects import Setting
from bayescal.effects.selection import Selection, driver_words, shortest
from bayescal.estimate import Estimate, calibrated
from bayescal.gap.search.beam import Member
from bayescal.gap.search.candidates import Candidates
from bayescal.model.parts import Part


def model_name(member: Member, known: Candidates) -> str:
    """A member in the form of ``--model``: effect, setting, site and priors; see `selection`."""
    v = member.variant
    own = [known.pool[k] for k in v.columns]
    sites = v.sites
    drivers: tuple[str, ...] = ()
    if v.partial or isinstance(v.setting, tuple):
        sites = tuple(dict.fromkeys(p.site for p in own))
        drivers = tuple(dict.fromkeys(map(driver_words, own)))
    elif v.sites and v.effect not in known.partly:
        alike = (o for o in known.variants[v.effect] if (o.setting, o.sites) == (v.setting, v.sites))
        here = {driver_words(known.pool[k]) for o in alike for k in o.columns}
        mine = tuple(dict.fromkeys(map(driver_words, own)))
        drivers = mine if here != set(mine) else ()
    setting = _setting(v.setting)
    usual = v.effect in known.partly or (member.scale == 1.0 and all(p.centre == p.nominal for p in own))
    factor = None if usual else member.scale
    return str(Selection(v.effect, setting, sites, drivers, v.together, factor))


def _setting(setting: Setting) -> str | None:
    """A setting as the text after ``@``; see `bayescal.effects.named`."""
    if isinstance(setting, tuple):
        return "/".join(shortest(value) for _, value in setting)
    return shortest(setting) if isinstance(setting, float) else setting


def still_without(without: Sequence[Part], members: Sequence[Member]) -> tuple[Part, ...]:
    """Parts that stay nominal: those that no member is."""
    named = {(m.effect, site) for m in members for site in m.variant.sites}
    return tuple(part for part in without if (part.effect, part.site) not in named)


def refit(
    before: Estimate,
    known: Candidates,
    members: Sequence[Member],
    robust: bool = True,
    prior_width: float = 1.0,
    without: Sequence[Part] = (),
) -> Estimate:
    """Fit a baseline with some effects in addition to its own.

    Outliers are judged after the model is complete: rejected rows that share a cause are fitted, as by `fit`.

    Parameters
    ----------
    before : Estimate
        Of the baseline.
    known : Candidates
        Of the search; a member that is a part of the baseline's effects has the priors of the effect.
    members : sequence of Member
    robust, prior_width, without
        As of the baseline.
    """
    extra = tuple(model_name(m, known) for m in members if m.effect not in known.partly)
    scene = replace(before.model.scene, stance=None, compliances={})
    left = still_without(without, members)
    found = calibrated(scene, (*before.model.effects, *extra), prior_width, robust, left)
    return judged_complete(found)[0] if robust else found
