"""Commands other than those of a dataset, with the files that they read: robots, exports, plans, logs."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from analysis.fuzz.seeds import ROOT, Files, datasets, logs, runs

Command = tuple[Files, tuple[str, ...]]
"""Files, and the arguments of the command; {in} stands for their folder, {out} for that of the output."""

UR = "universal-robots-ur5e"


@cache
def _urdf() -> bytes:
    """The arm of the example, with a fixed link, a branch and a link that is named twice in comments."""
    from urdf_texts import joint, link

    text = _exported("urdf")["arm.urdf"].decode().replace("bayescal", "arm")
    more = link("box", 0.2, (0, 0, 0.1)) + joint("bolt", "flange", "box", "fixed", (0.01, 0, 0))
    return text.replace("</robot>", f"{more}</robot>").encode()


@cache
def _xacro() -> Files:
    """The same arm as a macro in an included file."""
    name = 'xmlns:xacro="http://ros.org/wiki/xacro"'
    inside = _urdf().decode().partition("<robot")[2].partition(">")[2].rpartition("</robot>")[0]
    return {
        "arm.xacro": (
            f'<robot name="arm" {name}><xacro:arg name="root" default="base_link"/>'
            '<xacro:property name="width" value="${pi / 20}"/><xacro:include filename="part.xacro"/>'
            '<xacro:part root="$(arg root)" width="${width / 2}"/></robot>'
        ).encode(),
        "part.xacro": (
            f'<robot {name}><xacro:macro name="part" params="root width">{inside}</xacro:macro></robot>'
        )
        .replace('"base_link"', '"${root}"')
        .encode(),
    }


def _robot_yaml() -> bytes:
    return (ROOT / "bayescal" / "robots" / "fanuc-lrmate200ic.yaml").read_bytes()


def _init(name: str, content: Files, *more: str) -> Command:
    return content, ("init", "{out}/set", "--robot", f"{{in}}/{name}", *more)


def _simulate(name: str, content: Files) -> Command:
    few = ("--contacts", "30", "--later", "4", "--repeats", "2", "--spheres", "0", "--placements", "1")
    return content, ("simulate", "--robot", f"{{in}}/{name}", "--out", "{out}/sim", *few)


@cache
def _setup(artefact: str) -> Files:
    """What `init` writes."""
    from bayescal.public.starting import init

    return _saved(lambda out: init(out / "set", "fanuc-lrmate200ic", artefact, tool="60 0 120 mm"))


def _practice() -> Command:
    return _setup("cube"), ("simulate", "--setup", "{in}/set", "--out", "{out}/sim")


def _plan() -> Command:
    counts = ("--contacts", "40", "--candidates", "100", "--for", "distances", "--model", "joint")
    return _setup("cube"), ("plan", "{in}/set", *counts, "--out", "{out}/plan")


@cache
def _arm() -> Files:
    """Of a run folder, what `export` reads."""
    return runs()["export"][0]


def _saved(save: Callable[[Path], object]) -> Files:
    """The files that something writes to a folder, without pictures and draws."""
    with tempfile.TemporaryDirectory() as folder:
        save(Path(folder))
        return {
            p.relative_to(folder).as_posix(): p.read_bytes()
            for p in sorted(Path(folder).rglob("*"))
            if p.is_file() and not p.name.endswith((".nc", ".png", ".html"))
        }


def _export(to: str, files: Files, *more: str) -> Command:
    return _arm() | files, ("export", "{in}/run", "--to", to, "--force", "--out", "{out}/arm", *more)


@cache
def _exported(to: str) -> Files:
    import bayescal as bc

    with tempfile.TemporaryDirectory() as folder:
        for name, content in _arm().items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        result = bc.export(Path(folder) / "run", to, force=True)
        return _saved(lambda out: result.save(out / f"arm.{'xml' if to == 'mjcf' else to}"))


def _verify(to: str) -> Command:
    files = _exported(to)
    name = min(files, key=len)
    return _arm() | files, ("verify", "{in}/run", f"{{in}}/{name}", "--out", "{out}/verified")


@cache
def _ur() -> Files:
    """A run folder of a UR5e."""
    import bayescal as bc

    session = bc.simulate(UR, contacts=60, later=6, repeats=2, spheres=0, placements=1, seed=1)
    fit = bc.fit(session, model="joint", samples=0)
    return {f"run/{k}": v for k, v in _saved(lambda out: fit.save(out / "run", False)).items()} | {}


def _of_ur(to: str, name: str, content: bytes) -> Command:
    run = {k.replace("run/run/", "run/"): v for k, v in _ur().items()}
    kept = {k: v for k, v in run.items() if k == "run/arm.json" or k.startswith("run/dataset")}
    arguments = (
        "export",
        "{in}/run",
        "--to",
        to,
        "--force",
        "--into",
        f"{{in}}/{name}",
        "--out",
        "{out}/arm",
    )
    return kept | {name: content}, arguments


def _ur_yaml() -> bytes:
    """The calibration that ur_calibration writes: d and a of the nominal arm."""
    from bayescal.arm.transforms import rpy_of
    from bayescal.exporting.geometry import steps, zero_frames
    from bayescal.exporting.offsets import KEYS, LINKS
    from bayescal.robots import load_robot

    frames = zero_frames(load_robot(UR)[0])
    lines = ["kinematics:"]
    for link, t in zip(LINKS, steps(frames)[:-1], strict=True):
        values = (*t[:3, 3].tolist(), *rpy_of(t[:3, :3]).tolist())
        lines += [f"  {link}:", *(f"    {key}: {v!r}" for key, v in zip(KEYS, values, strict=True))]
    return "\n".join([*lines, "  hash: calib_12345", ""]).encode()


def _certificate() -> Command:
    from test_dcc import ENTRIES

    return _export("dcc", {"entries.yaml": ENTRIES.encode()}, "--certificate", "{in}/entries.yaml")


@cache
def _diagnosed() -> Command:
    """A diagnosis, and its session."""
    import bayescal as bc

    files = datasets()["cube"]
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        found = bc.diagnose(folder, model="joint")
        return {f"run/{k}": v for k, v in _saved(lambda out: found.save(out / "gap", False)).items()}, ()


def _gap_run() -> Files:
    return {k.replace("run/gap/", "run/"): v for k, v in _diagnosed()[0].items()}


def _after() -> Command:
    counts = ("--contacts", "45", "--candidates", "120")
    files = {f"set/{k}": v for k, v in datasets()["cube"].items()} | _gap_run()
    return files, ("plan", "{in}/set", "--after", "{in}/run", *counts, "--out", "{out}/plan")


def _several() -> Command:
    run = runs()["report"][0]
    other = {k.replace("run/", "other/", 1): v for k, v in run.items()}
    return run | other, ("report", "{in}/run", "{in}/other", "--out", "{out}/page.html")


def _controllers() -> dict[str, Callable[[], Command]]:
    """Listings of controllers, with the points of a tracker in a file of their own."""
    from test_makers import LISTED

    from bayescal.dataset import read_dataset

    @cache
    def rich():
        with tempfile.TemporaryDirectory() as folder:
            for name, content in datasets()["rich"].items():
                (Path(folder) / name).write_bytes(content)
            return read_dataset(Path(folder))

    def listing(name: str) -> Command:
        write, prefix = LISTED[name]
        rows = rich().measurements
        points = [
            f"{prefix}{k + 1} {x:.6f} {y:.6f} {z:.6f}"
            for k, (x, y, z) in enumerate((1e3 * rows.xyz).tolist())
        ]
        files = {"log.txt": write(rich()).encode(), "points.txt": "\n".join(points).encode()}
        more = ("--points", "{in}/points.txt", "--points-map", "mm", "--pair", "id", "--noise", "0.02 mm")
        robot = ("--robot", "fanuc-lrmate200ic")
        return files, ("import", "{in}/log.txt", "--format", name, *more, *robot, "--out", "{out}/set")

    return {name: lambda name=name: listing(name) for name in LISTED}


def _book() -> Command:
    import openpyxl

    files, arguments = logs()["words"]
    work, out = openpyxl.Workbook(), io.BytesIO()
    for line in files["log.txt"].decode().splitlines():
        cells = line.split(";")
        work.active.append([cells[0], *(float(c) if c.lstrip("-")[:1].isdigit() else c for c in cells[1:])])
    work.save(out)
    kept = {k: v for k, v in files.items() if k != "log.txt"} | {"log.xlsx": out.getvalue()}
    return kept, tuple(a.replace("log.txt", "log.xlsx") for a in arguments)


def _named(name: str) -> Command:
    return runs()[name]


COMMANDS: dict[str, tuple[float, Callable[[], Command]]] = {
    "report": (1.0, lambda: _named("report")),
    "reports": (0.5, _several),
    "report gap": (1.0, lambda: (_gap_run(), ("report", "{in}/run", "--out", "{out}/page.html"))),
    "export": (1.0, lambda: _named("export")),
    "targets": (1.5, lambda: _named("targets")),
    "fanuc": (1.5, lambda: _named("fanuc")),
    "kuka": (1.5, lambda: _named("kuka")),
    "log by map": (3.0, lambda: logs()["map"]),
    "log by words": (3.0, lambda: logs()["words"]),
    "workbook": (2.0, _book),
    **{
        f"listing {name}": (1.5, lambda name=name: _controllers()[name]())
        for name in ("fanuc-ls", "fanuc-va", "kuka-dat", "abb-mod")
    },
    "urdf": (8.0, lambda: _init("arm.urdf", {"arm.urdf": _urdf()})),
    "urdf tip": (1.0, lambda: _init("arm.urdf#flange", {"arm.urdf": _urdf()})),
    "robot.yaml": (6.0, lambda: _init("robot.yaml", {"robot.yaml": _robot_yaml()})),
    "xacro": (1.0, lambda: _init("arm.xacro", _xacro(), "--allow-xacro")),
    "simulate robot.yaml": (0.8, lambda: _simulate("robot.yaml", {"robot.yaml": _robot_yaml()})),
    "simulate urdf": (1.0, lambda: _simulate("arm.urdf", {"arm.urdf": _urdf()})),
    "practice": (0.4, _practice),
    "plan": (0.15, _plan),
    "plan after": (0.05, _after),
    "into urdf": (
        3.0,
        lambda: _export("urdf", {"a.urdf": _exported("urdf")["arm.urdf"]}, "--into", "{in}/a.urdf"),
    ),
    "into mjcf": (6.0, lambda: _of_ur("mjcf", "arm.xml", (ROOT / "tests/data/ur5e_scene.xml").read_bytes())),
    "into ur-yaml": (1.0, lambda: _of_ur("ur-yaml", "mine.yaml", _ur_yaml())),
    "verify urdf": (0.6, lambda: _verify("urdf")),
    "verify mjcf": (0.4, lambda: _verify("mjcf")),
    "certificate": (0.5, _certificate),
    "budget": (0.5, lambda: (runs()["report"][0], ("budget", "{in}/run", "--parameter", "theta2"))),
    "compare": (0.05, lambda: (datasets()["cube"], ("compare", "{in}", "--out", "{out}/compared"))),
}
"""Commands with the weight by which one is chosen; a costly one seldom."""


@cache
def command(name: str) -> Command:
    """Files and arguments of a command."""
    return COMMANDS[name][1]()


def chosen(rng: np.random.Generator) -> str:
    """A command by weight."""
    weights = np.array([weight for weight, _ in COMMANDS.values()])
    return str(rng.choice(list(COMMANDS), p=weights / weights.sum()))
