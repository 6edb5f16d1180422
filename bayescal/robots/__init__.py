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

from bayescal.robots.load import Loaded as Loaded
from bayescal.robots.load import builtin_robots as builtin_robots
from bayescal.robots.load import full_name as full_name
from bayescal.robots.load import is_xacro as is_xacro
from bayescal.robots.load import load_robot as load_robot
from bayescal.robots.load import names as names
from bayescal.robots.load import only_one_arm as only_one_arm
from bayescal.robots.load import only_revolute as only_revolute
from bayescal.robots.load import table as table
from bayescal.robots.schema import robot_to_yaml as robot_to_yaml
