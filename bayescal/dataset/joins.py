"""Which targets a certificate may join, and whether their nominal places allow what it states."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayescal.dataset.target_kinds import KINDS
from bayescal.dataset.types import Target
from bayescal.errors import BayescalError
from factors.certificate import FORMS, LENGTHS, RELATIONS, ordered
from factors.feature import Feature
from factors.relation import Relation, aligned, apart, off_plane, square

WRONG: dict[Relation, Callable[[float], bool]] = {
    aligned: lambda cosine: cosine < 0.85,
    square: lambda cosine: cosine > 0.5,
}
"""Which cosines of nominal directions are some 30 degrees or more off."""

SHARE: dict[Relation, float] = {off_plane: 0.1, apart: 1e-6}
"""Of a stated length, what the nominal places must show: a plane's side is theirs to tell (assumed)."""


def forms_of(targets: Sequence[Target]) -> tuple[str, str]:
    """The forms of two targets."""
    a, b = targets
    return KINDS[a.kind].form, KINDS[b.kind].form


def check(kind: str, length: float | None, pair: Sequence[Target], where: str) -> None:
    """Refuse two targets that a certificate of this kind, of this length (m), cannot join.

    Raises
    ------
    BayescalError
        Where the pair has no meaning, is not nominally parallel or perpendicular as stated, or coincides.
    """
    a, b = sorted(pair, key=lambda t: FORMS.index(KINDS[t.kind].form))
    names, forms = f"`{a.name}` and `{b.name}`", ordered(forms_of(pair))
    if forms not in RELATIONS[kind]:
        what = f"a `{kind}` certificate cannot join {names}, a {a.kind} and a {b.kind}"
        raise BayescalError(what, where, f"it joins {joinable(kind)}")
    first, second = _nominal(a), _nominal(b)
    relations = RELATIONS[kind][forms]
    if first.direction is not None and second.direction is not None:
        cosine = abs(float(first.direction @ second.direction))
        # two axes have one distance where they are parallel
        angles = (aligned,) if kind == "distance" else relations
        if any(WRONG[r](cosine) for r in angles if r in WRONG):
            angle = np.degrees(np.arccos(min(1.0, cosine)))
            said = "as far apart as parallel axes are" if kind == "distance" else kind
            whose = {"plane": "normals", "axis": "axes"}[forms[0]] if forms[0] == forms[1] else "directions"
            what = f"{names} are certified {said}, but their {whose} are nominally {angle:.0f} deg apart"
            raise BayescalError(what, where, "check the names and the directions of both")
    for relation in (r for r in relations if r in SHARE):
        out = _apart(relation, first, second)
        if length is not None and out <= SHARE[relation] * length:
            what = f"{names} are certified {1e3 * length:.6g} mm apart, but nominally {1e3 * out:.6g} mm"
            raise BayescalError(
                what, where, "write their nominal places: these tell on which side one stands"
            )


def nominal_length(pair: Sequence[Target], kind: str) -> float | None:
    """Distance, m, of two targets at their nominal places, which a certificate of a kind states; or None."""
    a, b = sorted(pair, key=lambda t: FORMS.index(KINDS[t.kind].form))
    relations = RELATIONS[kind].get(ordered(forms_of(pair)), ())
    first, second = _nominal(a), _nominal(b)
    for relation in relations:
        if relation in LENGTHS:
            return abs(_apart(relation, first, second))
    return None


def joinable(kind: str) -> str:
    """The kinds of target that a kind of certificate joins, in words."""
    of = {form: "/".join(k.name for k in KINDS.values() if k.form == form) for form in FORMS}
    return ", ".join(f"{of[a]} with {of[b]}" for a, b in RELATIONS[kind])


def _nominal(target: Target) -> Feature:
    kind = KINDS[target.kind]
    direction = np.asarray(target.values[kind.direction]) if kind.direction else None
    return Feature(kind.place(target), np.zeros((0, 3)), direction)


def _apart(relation: Relation, a: Feature, b: Feature) -> float:
    return float(relation(a, b)(a, b)[0][0])
