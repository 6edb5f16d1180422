"""Whether the stated region of a target is one of it: of its kind, and on its surface."""

from __future__ import annotations

import numpy as np

from bayescal.dataset.types import Patch, Target

OFF = 2e-3
"""m: greatest distance of a region's centre from the nominal surface or axis (assumed: rounded values)."""
ALONG_NORMAL = 0.99  # cosine from which on a direction is not one of the face


def reason_against(target: Target, patch: Patch) -> tuple[str, str] | None:
    """What is wrong with the region of a target, and the remedy; None if nothing is."""
    sizes = {"plane": 2, "cylinder": 1}
    if target.kind not in sizes:
        what = f"has no meaning: it is of kind {target.kind}"
        return what, "state regions of planes and cylinders; contacts on other kinds follow from their entry"
    if len(patch.size) != sizes[target.kind]:
        each = {"plane": "[width, height]", "cylinder": "[length]"}[target.kind]
        return f"has {len(patch.size)} entries in `size_mm`", f"a {target.kind} needs {each}"
    across = np.asarray(target.values["normal" if target.kind == "plane" else "axis"], float)
    if target.kind == "plane":
        off = abs(float(across @ patch.centre) - float(target.values["offset"]))
        if patch.along is not None and abs(float(across @ patch.along)) > ALONG_NORMAL:
            return "states `along` across its face", "give a direction in the face"
    else:
        away = patch.centre - np.asarray(target.values["point"], float)
        off = float(np.linalg.norm(away - across * (across @ away)))
    if off > OFF:
        noun = "face" if target.kind == "plane" else "axis"
        return f"has its centre {off * 1e3:.1f} mm off the {noun}", "give a centre on it, in F0"
    return None
