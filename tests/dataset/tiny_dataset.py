"""A tiny valid dataset with every kind of target, to be spoilt one line at a time."""

from pathlib import Path

SETTINGS = """\
schema: bayescal-dataset/1
name: tiny
robot: fanuc-lrmate200ic
readings: encoder
gravity_mps2: [0, 0, -9.81]
tools:
  ball: {centre_mm: [60, 0, 120], ball_radius_mm: 3.0, mass_kg: 0.8, centre_of_mass_mm: [20, 0, 60]}
  mirror: {centre_mm: [60, 0, 120], u_mm: 1}
noise:
  contact_mm: 0.005
  point_mm: 0.010
  joint_deg: 0.0
targets:
  top: {kind: plane, normal: [0, 0, 1], offset_mm: -93.6}
  bottom: {kind: plane, normal: [0, 0, -1], offset_mm: 322.2}
  side: {kind: plane, normal: [1, 0, 0], offset_mm: 700}
  ball.A: {kind: sphere, centre_mm: [475, 272, -40], diameter_mm: 50.8}
  ball.B: {kind: sphere, centre_mm: [475, 422, -40], diameter_mm: 50.8}
  pin: {kind: cylinder, point_mm: [498, -290, 0], axis: [0, 0, 1], diameter_mm: 20}
  cone: {kind: fixed-point, centre_mm: [561, -40, -50], u_mm: 20, u_rad: 0}
  bar: {kind: distance, centre_mm: [510, 42, -401], length_mm: 300}
  wire: {kind: distance, centre_mm: [510, 42, -401]}
  tracker: {kind: instrument, xyz_mm: [1000, 0, 200], rpy_deg: [0, 0, 0]}
certificates:
  - {kind: parallel, faces: [top, bottom], distance_mm: 228.6, u_distance_mm: 0.003, u_angle_rad: 1.2e-5}
  - {kind: perpendicular, faces: [top, side], u_angle_rad: 1.2e-5}
  - {kind: distance, between: [ball.A, ball.B], distance_mm: 150.0, u_distance_mm: 0.001}
  - {kind: diameter, target: ball.A, u_diameter_mm: 0.001}
  - {kind: flat, target: top, u_form_mm: 0.002}
temperature_of: arm
record:
  date: 2026-03-04
  operator: 'A. <b>Operator</b>'
  serials: {arm: 0123, probe: "P: 7, [/]"}
  certificates: [DKD-K-1234, '77']
  temperature_degC: 20.5
plan:
  volume_of_interest: {centre_mm: [450, 0, 150], size_mm: [300, 300, 200]}
  regions:
    side: {centre_mm: [700, 10, 100], size_mm: [200, 120], along: [0, 1, 0]}
  table_mm: -250
  payload_kg: [2, 4.5]
  cone_deg: 45
  poses_deg: [[0, 20, -10, 0, -80, 0], [30, 40, -40, 0, -50, 0]]
source: made up
"""

HEADER = (
    "id,role,target,tool,j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg,"
    "x_mm,y_mm,z_mm,length_mm,u_mm,time_s,temperature_c,payload_kg,repeat"
)

TABLE = f"""\
{HEADER}
t1,calibrate,top,ball,0.035,31.351,-41.068,1.346,-50.565,-0.23,,,,,,0,21.5,0,r1
t2,calibrate,top,ball,0.983,29.728,-39.851,-1.417,-49.239,0.114,,,,,,10,21.5,0,r1
t3,validate,top,ball,-0.511,30.865,-40.59,-0.14,-51.098,-0.291,,,,,,20,21.5,0,
t4,,top,ball,-0.89,29.287,-39.249,-0.659,-50.044,1.442,,,,,,30,21.5,2,
s1,locate,ball.A,ball,31.385,20.674,-29.876,9.331,-61.018,21.41,,,,,,40,21.5,0,
s2,validate,ball.A,ball,30.048,18.848,-29.63,10.83,-59.661,21.252,,,,,,50,21.5,0,
s3,validate,ball.A,ball,28.619,20.086,-30.122,8.687,-59.576,21.058,,,,,,60,21.5,0,
s4,validate,ball.A,ball,30.279,19.28,-28.98,10.028,-59.967,20.759,,,,,,70,21.5,0,
c1,calibrate,pin,ball,-31.056,25.959,-34.45,-9.139,-55.925,-19.093,,,,,,80,21.5,0,
c2,calibrate,pin,ball,-30.926,23.745,-33.934,-8.916,-53.87,-20.084,,,,,0.02,90,21.5,0,
p1,calibrate,cone,ball,-8.816,34.768,-29.731,3.573,-59.48,91.257,,,,,,100,21.5,0,
p2,calibrate,cone,mirror,-9.02,36.157,-29.519,4.237,-59.194,89.135,,,,,,110,21.5,0,
b1,calibrate,bar,mirror,8.818,25.399,-45.359,0.676,-44.538,-60.206,,,,,,120,21.5,0,
b2,calibrate,wire,mirror,11.102,25.396,-44.069,-0.475,-44.869,-60.911,,,,300.2,,130,21.5,0,
i1,calibrate,tracker,mirror,4.326,26.984,1.324,-6.75,-32.58,-6.615,-270.87,55.05,96.48,,,140,21.5,0,
i2,calibrate,tracker,mirror,-19.513,-4.838,-20.81,-9.293,-39.348,3.835,-497.11,-160.22,-86.74,,,150,21.5,0,
i3,calibrate,tracker,mirror,23.584,23.733,4.557,12.963,-25.151,20.885,-349.05,298.54,153.03,,,160,21.5,0,
i4,calibrate,tracker,mirror,9.482,10.018,-31.146,-0.578,-44.358,-18.365,-459.55,72.11,-185.43,,,170,21.5,0,
i5,calibrate,tracker,mirror,0.303,24.254,-20.25,13.439,-28.719,-17.548,-299.11,-24.56,-75.06,,,180,21.5,0,
i6,calibrate,tracker,mirror,23.248,5.082,-20.238,17.35,-48.777,11.68,-481.72,199.01,-105.83,,,190,21.5,0,
"""


def line_of(text: str, part: str) -> int:
    """Line of the first occurrence of `part`."""
    return text[: text.index(part)].count("\n") + 1


def write(folder: Path, settings: str = SETTINGS, table: str = TABLE) -> Path:
    (folder / "dataset.yaml").write_text(settings, encoding="utf-8")
    (folder / "measurements.csv").write_text(table, encoding="utf-8")
    return folder
