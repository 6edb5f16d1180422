"""Small sessions to be damaged: every kind of target and column, and what later commands read."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[2]
BESIDE = ("", "dataset", "programs", "importing", "exporting")
sys.path[:0] = [str(ROOT / "tests" / name) for name in BESIDE]
EVERY = 14
"""Of the example session, the rows on planes that are kept, and all contacts of the first placement."""

Files = dict[str, bytes]


@cache
def datasets() -> dict[str, Files]:
    """Dataset folders by name; `rich` has a robot file of its own, `arm` a URDF."""
    from tiny_dataset import SETTINGS, TABLE

    data = ROOT / "data" / "lrmate200ic-cube"
    lines = (data / "measurements.csv").read_bytes().splitlines(keepends=True)
    of_planes = [line for line in lines[1:] if b",cube." in line]
    first = [line for line in lines[1:] if b"@1," in line]
    settings, table = _rich()
    return {
        "tiny": {"dataset.yaml": SETTINGS.encode(), "measurements.csv": TABLE.encode()},
        "cube": {
            "dataset.yaml": (data / "dataset.yaml").read_bytes(),
            "measurements.csv": b"".join([lines[0], *of_planes[::EVERY], *first]),
        },
        "rich": {
            "dataset.yaml": settings.replace(b"robot: fanuc-lrmate200ic", b"robot: robot.yaml"),
            "measurements.csv": table,
            "robot.yaml": (ROOT / "bayescal" / "robots" / "fanuc-lrmate200ic.yaml").read_bytes(),
        },
        "arm": _urdf(),
    }


def _rich() -> tuple[bytes, bytes]:
    """Poses that a tracker reads: velocities, commands, torques, temperatures, stops, payloads."""
    from bayescal.arm.chain import chain_of, frames, link_angles
    from bayescal.arm.statics import gravity_loads
    from bayescal.dataset import Dataset, Measurements, Noise, Target, Tool, write_dataset
    from bayescal.dataset.consistency import nominal
    from bayescal.robots import load_robot

    rng, robot, count = np.random.default_rng(0), load_robot("fanuc-lrmate200ic")[0], 30
    readings = np.radians(rng.uniform([-60, -10, -60, -60, -80, -90], [60, 50, 0, 60, -20, 90], (count, 6)))
    tool = Tool(
        "mirror", np.array([0.06, 0.0, 0.12]), mass=0.8, centre_of_mass=np.array([0.02, 0.0, 0.06]), u=1e-3
    )
    names = np.array([f"s{k // 2}" for k in range(count)])
    rows = Measurements(
        ids=tuple(f"p{k}" for k in range(count)),
        role=np.where(np.arange(count) % 5 == 4, "validate", "calibrate"),
        target=np.zeros(count, int),
        tool=np.zeros(count, int),
        readings=readings,
        line=np.arange(2, count + 2),
        velocity=np.radians(rng.uniform(-5, 5, readings.shape)),
        command=readings + 1e-5,
        stop=names,
        time=20.0 * np.arange(count),
        temperature=21 + 0.1 * np.arange(count),
        payload=np.where(np.arange(count) % 3, 0.0, 1.5),
        u=np.full(count, 2e-5),
    )
    target = Target("tracker", "instrument", {"xyz": np.array([2.0, 0, 0.5]), "rpy": np.zeros(3)})
    dataset = Dataset(
        "rich", Path(), robot, "fanuc-lrmate200ic", "encoder", np.array([0, 0, -9.81]), (tool,),
        Noise(2e-5, 2e-5, orientation=1e-4), (target,), (), rows, "arm", "measured",
    )  # fmt: skip
    q = link_angles(robot, readings)
    loads = gravity_loads(
        robot,
        chain_of(robot),
        q,
        dataset.gravity,
        tool.mass + rows.payload,
        np.tile(tool.centre_of_mass, (count, 1)),
    )
    xyz = nominal(dataset, readings) - target.values["xyz"] + 3e-5 * rng.standard_normal((count, 3))
    flange = frames(chain_of(robot), q)[:, -1, :3, :3]
    rpy = Rotation.from_matrix(flange).as_euler("xyz")
    torque = loads.moments[:, 1:, 2] @ robot.link_from_reading
    dataset = replace(dataset, measurements=replace(rows, xyz=xyz, rpy=rpy, torque=torque))
    with tempfile.TemporaryDirectory() as folder:
        write_dataset(dataset, Path(folder) / "rich")
        return tuple(
            (Path(folder) / "rich" / name).read_bytes() for name in ("dataset.yaml", "measurements.csv")
        )  # type: ignore[return-value]


def _urdf() -> Files:
    """Two joints of a URDF whose end touches a plane."""
    from urdf_texts import joint, link, robot

    arm = robot(
        link("root"), joint("j1", "root", "l1", xyz=(0, 0, 0.3)), link("l1", 2.0),
        joint("j2", "l1", "l2", xyz=(0.4, 0, 0)), link("l2", 1.0),
        joint("mount", "l2", "tip", "fixed", (0.3, 0, 0)),
        link("tip"),
    )  # fmt: skip
    settings = """\
schema: bayescal-dataset/1
name: two
robot: arm.urdf
readings: encoder
tools:
  ball: {centre_mm: [0, 0, -50], ball_radius_mm: 3}
noise: {contact_mm: 0.01}
targets:
  slab: {kind: plane, normal: [0, 0, 1], offset_mm: 247}
  seat: {kind: fixed-point, centre_mm: [600, 250, 250]}
"""
    rows = [f"c{k},slab,{-60 + 8 * k},{30 - 3 * k}" for k in range(18)]
    table = "id,target,j1_deg,j2_deg\n" + "\n".join(rows) + "\n"
    return {"dataset.yaml": settings.encode(), "measurements.csv": table.encode(), "arm.urdf": arm.encode()}


@cache
def logs() -> dict[str, tuple[Files, tuple[str, ...]]]:
    """Logs to import, and the arguments of the command; {in} stands for the folder."""
    files = datasets()["rich"]
    rows = [line.split(b",") for line in files["measurements.csv"].split()]
    at = [
        rows[0].index(name)
        for name in (b"id", *(b"j%d_deg" % k for k in range(1, 7)), b"x_mm", b"y_mm", b"z_mm")
    ]
    head = [b"Point", b"A1", b"A2", b"A3", b"A4", b"A5", b"A6", b"X [mm]", b"Y [mm]", b"Z [mm]"]
    text = b"\n".join(b";".join(row[k] for k in at) for row in rows[1:])
    log = b";".join(head) + b"\n" + text + b"\n"
    settings = files["dataset.yaml"].replace(b"torques: measured", b"torques: computed")
    template = {"template/dataset.yaml": settings, "template/robot.yaml": files["robot.yaml"]}
    common = ("import", "{in}/log.txt", "--template", "{in}/template", "--out", "{out}/imported")
    mapping = b"id: Point\nj*: A* deg\nx: X\ny: Y\nz: Z\n"
    return {
        "map": ({"log.txt": log, "map.yaml": mapping, **template}, (*common, "--map", "{in}/map.yaml")),
        "words": ({"log.txt": log, **template}, (*common, "--map", "j*=A* deg, x=X, y=Y, z=Z, id=Point")),
    }


@cache
def runs() -> dict[str, tuple[Files, tuple[str, ...]]]:
    """A run folder of a fit, with targets; and the commands that read them."""
    from program_texts import FANUC, KUKA

    import bayescal as bc

    with tempfile.TemporaryDirectory() as folder:
        session = Path(folder) / "cube"
        session.mkdir()
        for name, content in datasets()["cube"].items():
            (session / name).write_bytes(content)
        bc.fit(session, model="joint", samples=0).save(Path(folder) / "run", False)
        run = {
            f"run/{p.relative_to(Path(folder) / 'run')}": p.read_bytes()
            for p in sorted((Path(folder) / "run").rglob("*"))
            if p.is_file() and not p.name.endswith((".nc", ".png", ".html"))
        }
    targets = b"x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n450,0,200,180,0,0\n450,20,200,180,0,10\n"
    arm = {k: v for k, v in run.items() if k.startswith("run/dataset") or k in ("run/arm.json",)}

    def compensate(name: str, content: bytes) -> tuple[Files, tuple[str, ...]]:
        paths = ("{in}/run", f"{{in}}/{name}", "--force", "--out", f"{{out}}/{name}")
        return arm | {name: content}, ("compensate", *paths)

    return {
        "report": (run, ("report", "{in}/run", "--out", "{out}/page.html")),
        "export": (arm, ("export", "{in}/run", "--to", "dh-csv", "--force", "--out", "{out}/arm.csv")),
        "targets": compensate("t.csv", targets),
        "fanuc": compensate("p.ls", FANUC),
        "kuka": compensate("p.src", KUKA.replace(b"A2 -80.0,A3 90", b"A2 20.0,A3 -15")),
    }
