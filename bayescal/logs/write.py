"""A mechanism as the `robot` of dataset.yaml, as `bayescal.logs.schema.Arm` reads it."""

from __future__ import annotations

import numpy as np

from bayescal.arm.transforms import rpy_of
from bayescal.logs.mechanism import PAIRS, Mechanism
from bayescal.storage.writing import flow, flow_list, number, scalar

OPTIONAL = {
    "gear_ratio": "gear_ratio",
    "armature_kgm2": "armature",
    "rated_torque_Nm": "rated",
    "coulomb_Nm": "coulomb",
    "viscous_Nms_per_rad": "viscous",
}
"""Keys of a joint that need not be there, and the fields of `Mechanism` that hold them."""


def arm_text(m: Mechanism) -> str:
    """YAML of an arm: mm, deg, kg, kg m2, N m.

    Raises
    ------
    ValueError
        If its joints are coupled, which the format cannot hold.
    """
    if m.coupled:
        raise ValueError("coupled joints")

    def listed(values: np.ndarray) -> str:
        return flow_list(number(x, 9) for x in values)

    lines = ["joints:"]
    for k in range(m.n):
        optional = [(key, number(getattr(m, name)[k], 9)) for key, name in OPTIONAL.items()]
        entries = [
            ("name", scalar(m.joint_names[k])),
            ("origin_mm", listed(1e3 * m.place[k, :3, 3])),
            ("rpy_deg", listed(np.rad2deg(rpy_of(m.place[k, :3, :3])))),
            ("axis", listed(m.axis[k])),
            ("mass_kg", number(m.mass[k], 9)),
            ("centre_of_mass_mm", listed(1e3 * m.centre[k])),
            ("inertia_kgm2", listed(np.array([m.inertia[k][i, j] for i, j in PAIRS]))),
            *[(key, text) for key, text in optional if text != "nan"],
        ]
        lines.append(f"  - {flow(entries)}")
    load = [
        ("centre_of_mass_mm", listed(1e3 * m.payload_centre)),
        ("radius_of_gyration_mm", number(1e3 * m.payload_gyration, 9)),
    ]
    lines += [f"friction_transition_degps: {number(np.rad2deg(m.transition), 9)}", f"payload: {flow(load)}"]
    return "\n".join(lines) + "\n"
