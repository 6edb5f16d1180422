"""What an integrator takes away: the calibrated robot in the formats of other programs.

A format is one file, which defines a `written.Format`, and one entry here.
"""

FORMATS = {
    "robot.yaml": "bayescal.exporting.robot:ROBOT_YAML",
    "urdf": "bayescal.exporting.urdf:URDF",
    "sdf": "bayescal.exporting.urdf:SDF",
    "mjcf": "bayescal.exporting.mjcf:MJCF",
    "ur-yaml": "bayescal.exporting.offsets:UR_YAML",
    "dh-csv": "bayescal.exporting.robot:DH_CSV",
    "joint-zeros": "bayescal.exporting.offsets:JOINT_ZEROS",
    "lerobot": "bayescal.exporting.offsets:FEETECH",
    "lerobot-dynamixel": "bayescal.exporting.offsets:DYNAMIXEL",
    "ros2-control": "bayescal.exporting.offsets:ROS2_CONTROL",
    "pal": "bayescal.exporting.urdf:PAL",
    "usd": "bayescal.exporting.usd:USD",
    "hand-eye": "bayescal.exporting.hand_eye:HAND_EYE",
}
"""Formats of an arm by their names: the module and the name of each; imported when it is used."""
CERTIFICATE = "dcc"
"""A Digital Calibration Certificate: a format of the command, which is no file of an arm."""
