"""Robots: the built-in ones, and those in a robot.yaml, URDF or xacro file beside a dataset.

Functions
---------
load_robot
    A `Robot` by name or path.
builtin_robots
    Names of the built-in ones.
robot_to_yaml
    Text of a robot.yaml.
table
    The built-in ones: joints, reach, masses, sources.
"""

from __future__ import annotations

from bayescal.robots.load import (
    Loaded,
    builtin_robots,
    full_name,
    is_xacro,
    load_robot,
    names,
    only_revolute,
    table,
)
from bayescal.robots.schema import robot_to_yaml

__all__ = [
    "Loaded",
    "builtin_robots",
    "full_name",
    "is_xacro",
    "load_robot",
    "names",
    "only_revolute",
    "robot_to_yaml",
    "table",
]
