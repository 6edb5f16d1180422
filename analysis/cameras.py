"""Simulated camera sessions through the diagnosis: which side it names, and how often intervals hold.

python -m analysis.cameras --seed 20261 --count 30
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from analysis.world.camera import build
from bayescal.dataset import Dataset, read_dataset
from bayescal.errors import BayescalError
from bayescal.gap.diagnose import diagnose
from bayescal.gap.result import Gap
from bayescal.methods.hand_eye import SOLVERS, on_flange
from bayescal.model.scene import Scene

SIDE = {
    "focal-length": "camera", "image-centre": "camera", "lens-distortion": "camera", "board-scale": "board",
    "board-bow": "board", "step": "mount", "latency": "clock",
}  # fmt: skip
"""Side of an effect; all others are of the arm."""
SITES = {"camera": "camera", "board": "board", "tool": "mount", "base": "mount"}
"""Side of a site where no effect is named; all others are of the arm."""
INTERVAL = 1.96


def run(seed: int, number: int, side: str = "", goal: float = 0.0) -> dict:
    """Make a session, diagnose it, and compare the answer with the truth."""
    texts, truth = build(seed, number, side, goal)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in texts.items():
            (Path(folder) / name).write_text(text)
        start = time.perf_counter()
        dataset = read_dataset(folder)
        try:
            found = diagnose(dataset)
        except BayescalError as error:
            return truth | {"error": str(error)}
    seconds = time.perf_counter() - start
    named = [f"{n.model} at {n.site}" if n.site else n.model for n in found.verdict.named]
    if found.verdict.kind == "null":
        sides = ["null"]
    elif found.verdict.named:
        sides = sorted({SIDE.get(n.effect, "arm") for n in found.verdict.named})
    else:
        causes = found.verdict.causes
        sites = causes.sites if causes else tuple(p.site for p in found.where[:1])
        sides = sorted({SITES.get(site.kind, "arm") for site in sites})
    answer = {"kind": found.verdict.kind, "named": named, "sides": sides, "seconds": seconds}
    return truth | answer | intervals(found, truth) | {"solvers_mm": solvers(dataset, truth)}


def solvers(dataset: Dataset, truth: dict) -> dict[str, float]:
    """Return errors of the origin on the flange by the solvers of OpenCV, mm."""
    scene, true = Scene(dataset), np.array(truth["on_flange"])[3:]
    return {s: 1e3 * float(np.linalg.norm(on_flange(scene, 0, s)[:, 3] - true)) for s in SOLVERS}


def intervals(found: Gap, truth: dict) -> dict:
    """Return errors of the hand-eye over their uncertainty, and in mm and deg."""
    estimate = found.arm or found.calibrated
    assert estimate is not None
    model = estimate.model
    value = model.physical(estimate.z)
    covariance = estimate.covariance if found.covariance is None else found.covariance
    u = np.sqrt(np.diag(covariance)) * np.concatenate([model.sd, *(b.sd for b in model.states)])
    place = {name: k for k, name in enumerate(model.names)}
    at = [place[f"on-flange {axis}"] for axis in "xyz"]
    true = np.array(truth["on_flange"])
    off = value[at] - true[3:]
    block = model.states[0]
    frame = block.kind.describe(block.state(estimate.z[model.slices[block.target]]))["frame"]
    fixed = np.array(truth["fixed"])
    apart = Rotation.from_matrix(frame[:3, :3]) * Rotation.from_rotvec(fixed[:3]).inv()
    return {
        "ratios": (off / u[at]).tolist(),
        "hand_mm": 1e3 * float(np.linalg.norm(off)),
        "fixed_mm": 1e3 * float(np.linalg.norm(frame[:3, 3] - fixed[3:])),
        "fixed_deg": float(np.degrees(apart.magnitude())),
    }


def main() -> None:
    """Print a line for each session, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=20261)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--side", default="")
    parser.add_argument("--goal", type=float, default=0.0)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    results = []
    for number in range(asked.first, asked.first + asked.count):
        r = run(asked.seed, number, asked.side, asked.goal)
        results.append(r)
        right = r.get("sides") == [r["side"]]
        words = r.get("error", "")
        if not words:
            best = min(r["solvers_mm"].values())
            words = f"{r['kind']} {r['named']} hand {r['hand_mm']:.2f} mm (OpenCV {best:.2f})"
            words += f", fixed {r['fixed_mm']:.2f} mm"
        print(number, r["side"], *r["effects"], f"{r['lambda']:.0f}", right, words, flush=True)
        if asked.out:
            asked.out.write_text(json.dumps(results))
    of_null = [r for r in results if r["side"] == "null"]
    clear = [r for r in results if r["lambda"] > 30]
    right = [r for r in clear if r.get("sides") == [r["side"]]]
    wrong = [r for r in of_null if r.get("sides", []) != ["null"]]
    ratios = np.abs([x for r in results if r.get("sides") == [r["side"]] for x in r["ratios"]])
    better = [r["hand_mm"] / min(r["solvers_mm"].values()) for r in results if "solvers_mm" in r]
    print(f"side right: {len(right)} of {len(clear)} at lambda > 30")
    print(f"false names: {len(wrong)} of {len(of_null)}")
    print(f"hand-eye error over that of the best solver of OpenCV: {np.median(better):.2f} (median)")
    print(f"hand-eye within 95 %: {np.mean(ratios < INTERVAL):.3f} of {len(ratios)}")
    print(f"seconds {np.median([r['seconds'] for r in results if 'seconds' in r]):.0f} (median)")


if __name__ == "__main__":
    main()
