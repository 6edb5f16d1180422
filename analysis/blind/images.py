"""Sessions of a camera in the blind check: an answer, its score against the truth, and the criteria."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from analysis.blind.card import Card
from analysis.blind.motions import CRASHED, FLAGGED, need
from analysis.blind.rates import proportion, value
from analysis.blind.rows import NONE, Row

BEGIN, END = "<!-- blind images: begin -->", "<!-- blind images: end -->"
CLEAR = 30.0
"""Lambda from which the side must be named."""
SIDES = {"camera": "camera", "board": "board", "tool": "mount", "base": "mount"}
"""Sides of sites where no effect is named; all others are of the arm."""
OF_EFFECT = {
    "focal-length": "camera", "image-centre": "camera", "lens-distortion": "camera", "board-scale": "board",
    "board-bow": "board", "step": "mount", "latency": "clock",
}  # fmt: skip
"""Sides of effects; all others are of the arm."""
OF_SIDE = ("arm", *dict.fromkeys(OF_EFFECT.values()))
INTERVAL = 1.96
MISS = {
    "world": "session",
    "truth": "truth",
    "lambda": "lambda",
    "verdict": "verdict",
    "named": "named",
    "sides": "side",
    "hand_mm": "hand-eye error (mm)",
    "detail": "detail",
}
"""Fields of a miss, and their columns on the page."""
Record = dict[str, Any]


def answer(folder: Path) -> dict[str, Any]:
    """The diagnosis of a session, its estimates with uncertainties, SI, and the origins of OpenCV's solvers.

    Parameters
    ----------
    folder : Path
        A session of one camera.
    """
    from bayescal.dataset import read_dataset
    from bayescal.gap.diagnose import diagnose
    from bayescal.methods.published import SOLVERS, on_flange
    from bayescal.model.scene import Scene
    from bayescal.reporting.gap.record import gap_record

    dataset = read_dataset(folder)
    found = diagnose(dataset)
    estimate = found.arm or found.calibrated
    assert estimate is not None
    model, scene = estimate.model, Scene(dataset)
    covariance = estimate.covariance if found.covariance is None else found.covariance
    u = np.sqrt(np.diag(covariance)) * np.concatenate([model.sd, *(b.sd for b in model.states)])
    values = model.physical(estimate.z)
    return {
        "gap": gap_record(found),
        "estimates": {n: [float(x), float(s)] for n, x, s in zip(model.names, values, u, strict=True)},
        "solvers": {s: on_flange(scene, 0, s)[:, 3].tolist() for s in SOLVERS},
    }


def sides(gap: Mapping[str, Any]) -> list[str]:
    """The sides that a diagnosis names, or where it sees an unmodelled effect; ``null`` for noise only."""
    if gap["verdict"] == "null":
        return ["null"]
    if gap["named"]:
        return sorted({OF_EFFECT.get(n["effect"], "arm") for n in gap["named"]})
    of = gap["class"]["site"].split(" and ") if gap.get("class") else [w["site"] for w in gap["where"][:1]]
    return sorted({SIDES.get(site.split()[0], "arm") for site in of})


def record(truth: Mapping[str, Any], given: Mapping[str, Any] | None) -> Record:
    """Compare an answer with the ground truth of its session, as `analysis.world.camera.build` returns it."""
    said, gap = given or {}, (given or {}).get("gap")
    out = {key: truth[key] for key in ("world", "side", "lambda")}
    out |= {
        "truth": "+".join([truth["side"], *truth["effects"]]), "verdict": gap["verdict"] if gap else CRASHED,
        "named": [n["model"] for n in gap["named"]] if gap else [], "sides": sides(gap) if gap else [],
        "hand_mm": None, "best_mm": None, "hand_off": [], "arm_off": [], "detail": said.get("error", ""),
        "seconds": said.get("seconds"),
    }  # fmt: skip
    out["right"] = out["sides"] == [truth["side"]] and out["verdict"] not in FLAGGED
    out["side_right"] = out["sides"] == [truth["side"]]
    if not gap:
        return out
    true = np.array(truth["on_flange"])[3:]
    hand = np.array([said["estimates"][f"on-flange {axis}"] for axis in "xyz"])
    arm = {n: x for n, x in said["estimates"].items() if n in truth["arm"]}
    out["hand_mm"] = 1e3 * float(np.linalg.norm(hand[:, 0] - true))
    out["best_mm"] = min(1e3 * float(np.linalg.norm(np.array(x) - true)) for x in said["solvers"].values())
    out["hand_off"] = ((hand[:, 0] - true) / hand[:, 1]).tolist()
    out["arm_off"] = [(x - truth["arm"][n]) / u for n, (x, u) in arm.items()]
    return out


def figures(records: Sequence[Record]) -> dict[str, Any]:
    """All results: shares as in `rates.share`; intervals of sessions whose side was right."""
    clear = [r for r in records if r["lambda"] > CLEAR]
    null = [r for r in records if r["side"] == "null"]
    solved = [r for r in records if r["best_mm"] is not None]
    of_arm = [r for r in solved if r["side"] == "arm"]
    known = [r for r in records if r["side_right"]]

    def part(chosen: Sequence[Record], key: str) -> dict[str, Any]:
        return proportion(sum(bool(r[key]) for r in chosen), len(chosen))

    def within(key: str) -> dict[str, Any]:
        every = np.abs([x for r in known for x in r[key]])
        return proportion(int(np.sum(every < INTERVAL)), len(every))

    def below(chosen: Sequence[Record], times: float) -> dict[str, Any]:
        return proportion(sum(r["hand_mm"] <= times * r["best_mm"] for r in chosen), len(chosen))

    return {
        "schema": "bayescal-blind-images/1",
        "worlds": len(records),
        "kinds": {s: sum(r["side"] == s for r in records) for s in ("null", *OF_SIDE)},
        "side": part(clear, "side_right"),
        "of_side": {s: part([r for r in clear if r["side"] == s], "side_right") for s in OF_SIDE},
        "complete": part(clear, "right"),
        "null_otherwise": proportion(sum(r["sides"] != ["null"] for r in null), len(null)),
        "hand_within": within("hand_off"),
        "arm_within": within("arm_off"),
        "better": below(solved, 1.0),
        "half": below(of_arm, 0.5),
        "ratio": float(np.median([r["hand_mm"] / r["best_mm"] for r in solved])) if solved else None,
        "seconds": float(np.median([r["seconds"] for r in records if r["seconds"]] or [0.0])),
        "crashed": {r["world"]: r["detail"] or "no answer" for r in records if r["verdict"] == CRASHED},
        "misses": [{key: r[key] for key in MISS} for r in records if not r["side_right"]],
    }  # fmt: skip


def rows(f: Mapping[str, Any]) -> list[Row]:
    """The criteria, with what is required."""
    each = "; ".join(f"{s} {p['hits']} of {p['count']}" for s, p in f["of_side"].items() if p["count"])
    ratio, crashed = f["ratio"], f["crashed"]

    def covered(label: str, share: Mapping[str, Any]) -> Row:
        plain, found = need(label, share, least=0.93), value(share)
        return Row(label, plain.found, "0.93 to 0.97", None if found is None else 0.93 <= found <= 0.97)

    return [
        need(f"right side, lambda from {CLEAR:g}", f["side"], least=0.95),
        Row("the same by side", each or NONE),
        need("right side, and nothing left unexplained", f["complete"]),
        need("noise only: called otherwise", f["null_otherwise"], most=0.02),
        covered("hand-eye within its 95 % interval", f["hand_within"]),
        covered("geometry of the arm within its 95 % interval", f["arm_within"]),
        need("hand-eye error at most that of the best OpenCV solver", f["better"], least=1.0),
        need("arm wrong: less than half of it", f["half"], least=1.0),
        Row("hand-eye error over that solver's, median", NONE if ratio is None else f"{ratio:.2f}"),
        Row("seconds per session, median", f"{f['seconds']:.1f}"),
        Row("crashes", "; ".join(f"{w}: {e}" for w, e in crashed.items()) or "none", "none", not crashed),
    ]


CARD = Card(
    record, figures, rows, (BEGIN, END), MISS,
    lambda found: ", ".join(f"{count} {side}" for side, count in found["kinds"].items() if count),
)  # fmt: skip
