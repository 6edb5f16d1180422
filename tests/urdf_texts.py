"""URDF texts for tests."""

import numpy as np


def words(values) -> str:
    return " ".join(repr(float(v)) for v in values)


def link(name, mass=None, centre=(0, 0, 0)) -> str:
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    inside = f'<inertial><origin xyz="{words(centre)}"/><mass value="{mass}"/>{inertia}</inertial>'
    return f'<link name="{name}">{inside if mass is not None else ""}</link>'


def joint(name, parent, child, kind="revolute", xyz=(0, 0, 0), rpy=(0, 0, 0), axis=(0, 0, 1), more="") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{words(xyz)}" rpy="{words(rpy)}"/>'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="{words(axis)}"/>'
        f'<limit lower="-2" upper="3" effort="1" velocity="1"/>{more}</joint>'
    )


def robot(*parts: str) -> str:
    return f'<?xml version="1.0"?><robot name="arm">{"".join(parts)}</robot>'


def arm(seed: int, n: int, style: str, slides: tuple[int, ...] = ()) -> str:
    """A chain of n joints, `slides` (from 1) prismatic, with fixed ones between, branches, and a skew tip."""
    rng = np.random.default_rng(seed)
    square = (0.0, np.pi / 2, -np.pi / 2, np.pi)
    parts, before = [link("root")], "root"
    for i in range(1, n + 1):
        if rng.random() < 0.4:
            parts += [link(f"rib{i}", 0.3, rng.uniform(-0.1, 0.1, 3))]
            shift, turn = rng.uniform(-0.2, 0.2, 3), rng.uniform(-1, 1, 3)
            parts += [joint(f"weld{i}", before, f"rib{i}", "fixed", shift, turn)]
            before = f"rib{i}"
        rpy = rng.uniform(-3, 3, 3) if style == "skew" else rng.choice(square, 3)
        axis = rng.standard_normal(3) if style == "skew" else rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)]
        if style == "parallel":
            rpy, axis = np.array([0, 0, rng.uniform(-3, 3)]), np.array([1e-3 * (i % 2), 0.0, (-1.0) ** i])
        parts += [link(f"l{i}", rng.uniform(0, 5), rng.uniform(-0.2, 0.2, 3))]
        kind = "prismatic" if i in slides else "revolute"
        parts += [joint(f"j{i}", before, f"l{i}", kind, rng.uniform(-0.5, 0.5, 3), rpy, axis)]
        parts += [link(f"box{i}", 0.2, rng.uniform(-0.1, 0.1, 3))]
        shift, turn = rng.uniform(-0.1, 0.1, 3), rng.uniform(-1, 1, 3)
        parts += [joint(f"bolt{i}", f"l{i}", f"box{i}", "fixed", shift, turn)]
        before = f"l{i}"
    parts += [link("plate", 0.1), link("tip")]
    parts += [joint("mount", before, "plate", "fixed", (0.1, 0.02, 0.3), (0.3, -0.2, 0.1))]
    parts += [joint("end", "plate", "tip", "fixed", (0, 0, 0.05))]
    return robot(*parts)
