"""Clearance of arm, tool, artefact and table: capsules and convex solids, at rest and on motions.

Names
-----
Clearance
    The check: `collides`, `distances`.
path_free
    The same along the retract from contacts.
scene_of, Scene, Solid
    What stands around the arm, from the targets of a session.
arm_capsules, link_radii
    The shape of an arm with its tool.
"""

from bayescal.probing.clearance import Clearance, path_free
from bayescal.probing.scene import Scene, Solid, arm_capsules, link_radii, on_table, scene_of, sphere
from bayescal.probing.shapes import FIXED, Ball, Box, Capsule, HalfSpace, Shape

__all__ = [
    "FIXED",
    "Ball",
    "Box",
    "Capsule",
    "Clearance",
    "HalfSpace",
    "Scene",
    "Shape",
    "Solid",
    "arm_capsules",
    "link_radii",
    "on_table",
    "path_free",
    "scene_of",
    "sphere",
]
