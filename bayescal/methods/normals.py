"""Plane normals from cross products of probed triplets (Zhong and Lewis; Tang).

Three contacts of a face span it, and their cross product is its normal, whichever three they are. Normals
of one face must agree, those of two as their certificates say. Directions do not tell lengths: the arm may
grow as a whole. A certified distance between two faces, each through the middle of its contacts, sets the
size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.methods.published import Method, is_plane
from bayescal.methods.solving import Rows, RowsOf, part
from bayescal.model import Block, Model
from bayescal.predict.errors import by_points
from factors.contacts import Plane

DEALS = 4
"""How many times the contacts of a face are dealt out to triplets, each time from other thirds."""


def triplets(place: np.ndarray) -> np.ndarray:
    """Wide triplets (K, 3) of contacts at places (C, 2) on a face: one of each third around the middle.

    Dealt `DEALS` times with the thirds turned on: about C x `DEALS` / 3 triplets.
    """
    out = place - place.mean(axis=0)
    around = np.argsort(np.arctan2(out[:, 1], out[:, 0]))
    third = len(place) // 3
    deals = []
    for deal in range(DEALS):
        turned = np.roll(around, -(deal * third) // DEALS)
        deals.append(turned[: 3 * third].reshape(3, third).T)
    return np.concatenate(deals)


@dataclass(frozen=True)
class Dealt:
    """Triplets (K, 3) of a face's contacts, and how much the lean of each counts, (K,): reach over noise."""

    triplets: np.ndarray
    reach: np.ndarray

    @classmethod
    def of(cls, place: np.ndarray, sigma: float) -> Dealt:
        """Deal contacts at places (C, 2), m, on a face with noise sigma, m."""
        dealt = triplets(place)
        first, second = place[dealt[:, 1]] - place[dealt[:, 0]], place[dealt[:, 2]] - place[dealt[:, 0]]
        area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        return cls(dealt, np.sqrt(area) / sigma)

    def crosses(self, p: np.ndarray, by: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cross products (K, 3) of contacts p (C, 3), and their gradients from those of p, (C, 3, P)."""
        a, b, c = self.triplets.T
        first, second, by_first, by_second = p[b] - p[a], p[c] - p[a], by[b] - by[a], by[c] - by[a]
        of_first = np.cross(by_first, second[:, :, None], axis=1)
        of_second = np.cross(first[:, :, None], by_second, axis=1)
        return np.cross(first, second), of_first + of_second


def points(block: Block, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ball centres (C, 3), m, and their gradients by the arm's deviations (C, 3, P)."""
    p = block.motion.points(values)
    return p.T, np.transpose(by_points(block.motion, values, p), (2, 0, 1))


def in_normals(model: Model) -> RowsOf:
    """Rows of normals: how far each leans from its face, times its triplet's reach, over the noise."""
    dealt = {}
    for block in model.blocks:
        kind = block.kind
        assert isinstance(kind, Plane)
        place = (model.scene.points[block.rows] - kind.pivot) @ kind.tangents.T
        dealt[block.target] = Dealt.of(place, float(np.median(block.sigma)))

    def rows(block: Block, values: np.ndarray, z: np.ndarray) -> Rows:
        kind, state, face = block.kind, block.state(z), dealt[block.target]
        assert isinstance(kind, Plane)
        cross, by_cross = face.crosses(*points(block, values))
        along, by_along = cross @ kind.normal, np.einsum("i,kip->kp", kind.normal, by_cross)
        lean = cross @ kind.tangents.T / along[:, None]  # tangents of the tilts
        by_lean = np.einsum("ji,kip->kjp", kind.tangents, by_cross) - lean[:, :, None] * by_along[:, None]
        by_lean = by_lean / along[:, None, None]
        tilts = np.zeros((len(cross), 2, len(kind.sd)))
        tilts[:, 0, 0] = tilts[:, 1, 1] = -face.reach
        # the face goes through the middle of its contacts: no more than that is said of its place
        middle, by_middle, at_middle = _middle(block, values, z)
        return (
            np.append(((lean - state[:2]) * face.reach[:, None]).ravel(), middle),
            np.vstack([(by_lean * face.reach[:, None, None]).reshape(-1, len(values)), by_middle]),
            np.vstack([block.by_z(tilts).reshape(-1, block.size), at_middle]),
        )

    return rows


def _middle(block: Block, values: np.ndarray, z: np.ndarray) -> Rows:
    """One row of a face: the mean of its contacts' distances to it, over its uncertainty."""
    r, by_arm, by_target = block.linearise(values, z)
    sigma = float(np.median(block.sigma)) / np.sqrt(len(r))
    return r.mean() / sigma, by_arm.mean(axis=0) / sigma, by_target.mean(axis=0) / sigma


def missing(model: Model) -> str:
    """What a session lacks for normals."""
    faces = part(model, is_plane)
    if not faces.blocks:
        return "no plane is probed"
    thin = [block.target for block in faces.blocks if len(block.rows) < 3]
    if thin:
        return f"{', '.join(thin)}: fewer than three contacts do not define a plane"
    if not any(constraint.kind == "parallel" for constraint in faces.constraints):
        return "no distance between parallel faces is certified: normals do not determine lengths"
    return ""


NORMALS = Method(
    "normals",
    "Zhong and Lewis; Tang et al.",
    "normals from triplets of contacts agree within a face and with certificates; a distance sets the scale",
    missing,
    is_plane,
    in_normals,
)
