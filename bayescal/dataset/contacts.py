"""Residuals of contacts at nominal geometry, and how far a target must move to explain them.

The estimate is robust: it distinguishes an impossible row from an uncertain position of the target.

Whether the stated region of a target is one of it: of its kind, and on its surface.

Which targets a certificate may join, and whether their nominal places allow what it states.

What is attached to the flange in each row: tool and payload. Which targets are one rigid body.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayescal.arm.transforms import rigid_alignment, rpy_matrix
from bayescal.dataset.target_kinds import KINDS, Seen, angle_sd, place_sd
from bayescal.dataset.types import Certificate, Dataset, Patch, Target
from bayescal.errors import BayescalError
from bayescal.statistics import grouped
from factors import certificate
from factors.kind import Feature

ARM_ERROR = 0.01
"""m: what an arm may nominally be wrong by; a smaller misfit weighs in full."""

HOLD = 0.025
"""m: misfit of one contact that pulls as strongly as a target's prior holds."""

Residual = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Contacts:
    """The M rows of one target: ball centres p (M, 3), m, and what its kind is made of."""

    target: Target
    p: np.ndarray
    seen: Seen


def residual(contacts: Contacts, p: np.ndarray | None = None) -> Residual:
    """Residuals (M, k), m, and their gradients by p (M, k, 3), at `p` or at the contacts' own."""
    p = contacts.p if p is None else p
    kind = KINDS[contacts.target.kind].build(contacts.target, contacts.seen)
    r, slopes, _ = kind.linearise(np.zeros(len(kind.sd)), p.T)
    return r.T, np.moveaxis(slopes, -1, 0)


def settled(contacts: Contacts, passes: int = 12) -> np.ndarray:
    """Residuals' lengths (M,), m, once the target has moved rigidly to where most contacts want it.

    Gauss-Newton on a displacement and rotation of the target, held by its prior (three times its
    uncertainty of place, one and a half times that of direction), with Cauchy weights whose scale
    follows the median: most rows move the target, a few wild ones do not.
    """
    p = contacts.p
    u, angle = place_sd(contacts.target), angle_sd(contacts.target)
    pivot = np.median(p, axis=0)
    arm = p - pivot
    hold = np.repeat([1 / (3 * u + 0.001), 1 / (1.5 * angle + 0.001)], 3) ** 2
    move = np.zeros(6)
    for _ in range(passes):
        r, g = residual(contacts, _moved(p, pivot, move))
        size = np.linalg.norm(r, axis=1)
        weight = _cauchy(size, 2 * float(np.median(size))) / HOLD**2
        jacobian = -np.concatenate([g, np.cross(arm[:, None, :], g)], axis=2)
        normal = np.einsum("mki,mkj,m->ij", jacobian, jacobian, weight) + np.diag(hold)
        gradient = np.einsum("mki,mk,m->i", jacobian, r, weight) + hold * move
        move = move - np.linalg.solve(normal, gradient)
    return np.linalg.norm(residual(contacts, _moved(p, pivot, move))[0], axis=1)


def _moved(p: np.ndarray, pivot: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Points as a target moved by `move` sees them: the inverse motion."""
    return (p - move[:3] - pivot) @ rpy_matrix(move[3:]) + pivot


def _cauchy(size: np.ndarray, scale: float) -> np.ndarray:
    return 1 / (1 + (size / max(ARM_ERROR, scale)) ** 2)


def scatter(p: np.ndarray, seen: np.ndarray, near: float, passes: int = 30) -> np.ndarray:
    """Distances (M,), m, of points p from an instrument's readings after the best rigid fit.

    Refitted with Cauchy weights until all lie within `near` (m), or `passes` times.
    """
    away = np.zeros(len(p))
    for _ in range(passes):
        placed = rigid_alignment(p, seen, _cauchy(away, float(np.median(away))))
        away = np.linalg.norm(p - seen @ placed[:3, :3].T - placed[:3, 3], axis=1)
        if away.max() <= near:
            break
    return away


OFF = 2e-3
"""m: greatest distance of a region's centre from the nominal surface or axis (assumed: rounded values)."""
ALONG_NORMAL = 0.99  # cosine from which on a direction is not one of the face


def reason_against(target: Target, patch: Patch) -> tuple[str, str] | None:
    """What is wrong with the region of a target, and the remedy; None if nothing is."""
    kind = KINDS[target.kind]
    sizes = kind.probing.sizes
    if not sizes:
        what = f"has no meaning: it is of kind {target.kind}"
        return what, "state regions of planes and cylinders; contacts on other kinds follow from their entry"
    if len(patch.size) != len(sizes):
        return f"has {len(patch.size)} entries in `size_mm`", f"a {target.kind} needs [{', '.join(sizes)}]"
    across, away = np.asarray(target.values[kind.direction], float), patch.centre - kind.place(target)
    along = float(across @ away)
    if kind.form == "plane":
        noun, off = "face", abs(along)
        if patch.along is not None and abs(float(across @ patch.along)) > ALONG_NORMAL:
            return "states `along` across its face", "give a direction in the face"
    else:
        noun, off = "axis", float(np.linalg.norm(away - across * along))
    if off > OFF:
        return f"has its centre {off * 1e3:.1f} mm off the {noun}", "give a centre on it, in F0"
    return None


WRONG: dict[certificate.Relation, Callable[[float], bool]] = {
    certificate.aligned: lambda cosine: cosine < 0.85,
    certificate.square: lambda cosine: cosine > 0.5,
}
"""Which cosines of nominal directions are some 30 degrees or more off."""

SHARE: dict[certificate.Relation, float] = {certificate.off_plane: 0.1, certificate.apart: 1e-6}
"""Of a stated length, what the nominal places must show: a plane's side is theirs to tell (assumed)."""


def forms_of(targets: Sequence[Target]) -> tuple[str, str]:
    """The forms of two targets."""
    return KINDS[targets[0].kind].form, KINDS[targets[1].kind].form


LENGTHS = ("distance", "diameter")
"""Kinds of certificates that state a length alone."""


def measured_again(certificates: Sequence[Certificate], fitted: Set[str]) -> list[tuple[int, ...]]:
    """Certificates of fitted targets by number, those together that state one length at several placements.

    The directions of angles turn with the artefact: these are values of each placement.
    """
    values: dict[tuple[Any, ...], list[int]] = {}
    for number, c in enumerate(certificates):
        if c.points is not None or fitted >= set(c.targets):
            again = c.kind in LENGTHS and all("@" in name for name in c.targets)
            key = (c.kind, c.parts, c.distance, c.u_distance) if again else (number,)
            values.setdefault(key, []).append(number)
    return [tuple(numbers) for numbers in values.values()]


def errors_of_distances(certificates: Sequence[Certificate]) -> np.ndarray:
    """Lower factor (D, D), m, of the covariance of certified distances: one artefact has one error."""
    out = np.zeros((len(certificates), len(certificates)))
    for numbers in measured_again(certificates, {name for c in certificates for name in c.targets}):
        u = certificates[numbers[0]].u_distance or 0.0
        out[np.ix_(numbers, numbers)] = u * certificate.colouring(len(numbers))
    return out


def check(kind: str, length: float | None, pair: Sequence[Target], where: str) -> None:
    """Refuse two targets that a certificate of this kind, of this length (m), cannot join.

    Raises
    ------
    BayescalError
        Where the pair has no meaning, is not nominally parallel or perpendicular as stated, or coincides.
    """
    a, b = _sorted(pair)
    names, forms = f"`{a.name}` and `{b.name}`", certificate.ordered(forms_of(pair))
    if forms not in certificate.RELATIONS[kind]:
        what = f"a `{kind}` certificate cannot join {names}, a {a.kind} and a {b.kind}"
        raise BayescalError(what, where, f"it joins {joinable(kind)}")
    first, second = _nominal(a), _nominal(b)
    relations = certificate.RELATIONS[kind][forms]
    if first.direction is not None and second.direction is not None:
        cosine = abs(float(first.direction @ second.direction))
        # two axes have one distance where they are parallel
        angles = (certificate.aligned,) if kind == "distance" else relations
        if any(WRONG[r](cosine) for r in angles if r in WRONG):
            angle = np.degrees(np.arccos(min(1.0, cosine)))
            said = "as far apart as parallel axes are" if kind == "distance" else kind
            whose = {"plane": "normals", "axis": "axes"}[forms[0]] if forms[0] == forms[1] else "directions"
            what = f"{names} are certified {said}, but their {whose} are nominally {angle:.0f} deg apart"
            raise BayescalError(what, where, "check the names and the directions of both")
    for relation in (r for r in relations if r in SHARE):
        distance = _apart(relation, first, second)
        if length is not None and distance <= SHARE[relation] * length:
            what = f"{names} are certified {1e3 * length:.6g} mm apart, but nominally {1e3 * distance:.6g} mm"
            remedy = "write their nominal places: these tell on which side one stands"
            raise BayescalError(what, where, remedy)


def length_of(pair: Sequence[Target], kind: str) -> float | None:
    """Distance, m, of two targets at their nominal places, which a certificate of a kind states; or None."""
    first, second = map(_nominal, _sorted(pair))
    relations = certificate.RELATIONS[kind].get(certificate.ordered(forms_of(pair)), ())
    return next((abs(_apart(r, first, second)) for r in relations if r in certificate.LENGTHS), None)


def _sorted(pair: Sequence[Target]) -> list[Target]:
    """Two targets in the order of their forms, in which relations take them."""
    return sorted(pair, key=lambda t: certificate.FORMS.index(KINDS[t.kind].form))


def joinable(kind: str) -> str:
    """The kinds of target that a kind of certificate joins, in words."""
    of = {form: "/".join(k.name for k in KINDS.values() if k.form == form) for form in certificate.FORMS}
    return ", ".join(f"{of[a]} with {of[b]}" for a, b in certificate.RELATIONS[kind])


def _nominal(target: Target) -> Feature:
    kind = KINDS[target.kind]
    direction = np.asarray(target.values[kind.direction]) if kind.direction else None
    return Feature(kind.place(target), np.zeros((0, 3)), direction)


def _apart(relation: certificate.Relation, a: Feature, b: Feature) -> float:
    return float(relation(a, b)(a, b)[0][0])


def connected(names: Iterable[str], pairs: Iterable[tuple[str, ...]]) -> list[list[str]]:
    """Groups of names that pairs connect, in the order of their first names."""
    group = {name: [name] for name in names}
    for a, b in pairs:
        if group[a] is not group[b]:
            group[a].extend(group[b])
            group |= dict.fromkeys(group[b], group[a])
    return list({id(members): members for members in group.values()}.values())


def bodies(dataset: Dataset, names: Iterable[str]) -> dict[str, list[str]]:
    """Rigid bodies of some targets, by name: certificates or names tie them (``ball.A@2`` to ``ball@2``)."""
    targets, body = list(names), dict[str, str]()
    for name in targets:
        artefact, _, placement = name.partition("@")
        body[name] = artefact.partition(".")[0] + ("@" + placement if placement else "")
    ties = [[t for t in c.targets if t in body] for c in dataset.certificates]
    ties += grouped((body[t], t) for t in targets).values()
    groups = connected(targets, (pair for tie in ties for pair in itertools.pairwise(tie)))
    return {g[0] if len(g) == 1 else "+".join(dict.fromkeys(body[t] for t in g)): g for g in groups}


def load_mass(dataset: Dataset) -> np.ndarray:
    """Mass of the load on the flange, (N,), kg."""
    m = dataset.measurements
    mass = np.array([tool.mass for tool in dataset.tools], float)[m.tool]
    return mass if m.payload is None else mass + m.payload


def load_centre(dataset: Dataset) -> np.ndarray:
    """Centre of mass of the load in the flange frame, (N, 3), m; default: the ball's centre."""
    centres = [t.centre if t.centre_of_mass is None else t.centre_of_mass for t in dataset.tools]
    return np.array(centres)[dataset.measurements.tool]
