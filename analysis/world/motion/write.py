"""The files of a log: dataset.yaml with all that is nominal, and motion.csv with what was measured."""

from __future__ import annotations

import io
from collections.abc import Iterable

import numpy as np

from analysis.world.motion.arms import Arm, U
from analysis.world.motion.plan import Session


def _list(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{float(v) + 0.0:.6g}" for v in values) + "]"


def robot_text(arm: Arm) -> list[str]:
    """Return the lines of the nominal robot in dataset.yaml."""
    lines = ["robot:", "  joints:"]
    for j in range(arm.size):
        inertia = arm.inertia[j][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        lines += [
            f"    - {{name: J{j + 1}, origin_mm: {_list(1e3 * arm.chain.origin[j])},"
            f" rpy_deg: {_list(np.degrees(arm.chain.rpy[j]))}, axis: [0, 0, 1], gear_ratio: {arm.gear[j]:g},"
            f" armature_kgm2: {arm.armature[j]:g}, rated_torque_Nm: {arm.rated[j]:g},"
            f" coulomb_Nm: {arm.coulomb[j]:g}, viscous_Nms_per_rad: {arm.viscous[j]:g},",
            f"       mass_kg: {arm.mass[j]:g}, centre_of_mass_mm: {_list(1e3 * arm.centre[j])},"
            f" inertia_kgm2: {_list(inertia)}}}",
        ]
    gyration = f"radius_of_gyration_mm: {1e3 * arm.load_gyration:g}"
    load = f"{{centre_of_mass_mm: {_list(1e3 * arm.load_centre)}, {gyration}}}"
    u = f"mass: {U['mass']:g}, centre_of_mass_mm: {1e3 * arm.centre_u:g}, inertia: {U['inertia']:g}"
    u += f", armature: {U['armature']:g}, friction_transition: {U['friction_transition']:g}"
    return [*lines, f"  friction_transition_degps: {np.degrees(arm.transition):.5g}",
            "  gravity_mps2: [0, 0, -9.81]", f"  payload: {load}", f"  u: {{{u}}}"]  # fmt: skip


def dataset_text(name: str, arm: Arm, session: Session, notes: dict[str, str]) -> str:
    """Return dataset.yaml; notes are its further lines, by key."""
    lines = ["schema: bayescal-motion/1", f"name: {name}", *robot_text(arm), f"rate_hz: {session.rate:g}"]
    lines += [f"{key}: {value}" for key, value in notes.items()]
    lines.append("motions:")
    for k, m in enumerate(session.motions, 1):
        words = f"role: {m.role}, kind: {'excitation' if m.kind == 'slow' else m.kind}, same_as: {m.same_as}"
        lines.append(f"  - {{id: {k}, {words}, payload_kg: {m.payload:g}}}")
    return "\n".join([*lines, ""])


def motion_table(session: Session, columns: dict[str, tuple[str, np.ndarray]]) -> str:
    """Return motion.csv: columns by name, each with its format and its values (rows,)."""
    runs = zip(session.motions, session.runs, strict=True)
    head = ["t_s", "motion", "role", *columns]
    formats = ",".join(form for form, _ in columns.values())
    values = np.column_stack([session.time, *(v for _, v in columns.values())])
    out = io.StringIO()
    out.write(",".join(head) + "\n")
    for number, (m, run) in enumerate(runs, 1):
        line = f"%.4f,{number},{m.role},{formats}\n"
        out.write("".join([line % tuple(row) for row in values[run].tolist()]))
    return out.getvalue()
