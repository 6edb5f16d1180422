"""What `bayescal.arm.kernel.points` computes for one contact, counted from a motion's own terms.

Additions, subtractions, multiplications and divisions of float64; a fused multiply and add is two.
Every line stands for a loop of the kernel; what the kernel does once for all contacts (matrices,
sines of constants) is left out.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from bayescal.arm.motion import Motion
from bayescal.arm.transforms import AXES

MAP = 18  # 3 x 4 matrix times a point: 9 multiplications, 9 additions
TURN = 6  # two coordinates by a known sine and cosine: 4 multiplications, 2 additions
SUM_OF_ANGLES = 6  # sine and cosine of the nominal angle plus a small one
SERIES = 16  # x^2, then sine to x^7 (7) and cosine to x^8 (8)
TERM = 2  # value times driver, added
ADD = 1


def kernel_flops(motion: Motion) -> int:
    """Floating-point operations of the value kernel for one contact and one parameter vector."""
    n = motion.chain.n
    varying: Counter[tuple[int, str]] = Counter()
    constant: set[tuple[int, str]] = set()
    for _, term in motion.terms:
        driver = np.broadcast_to(np.asarray(term.driver, float), (motion.count,))
        if np.all(driver == 1.0):
            constant.add((term.frame, term.axis))
        elif np.any(driver):
            varying[term.frame, term.axis] += 1

    def general(frame: int) -> bool:
        """More than the joint's own angle varies in this frame."""
        own = "rz" if 1 <= frame <= n else None
        turned = any((n + 1, axis) in constant for axis in AXES if axis[0] == "r")
        return any((frame, axis) in varying and axis != own for axis in AXES) or (frame == n + 1 and turned)

    def displaced(frame: int, pairs: str) -> int:
        """`_out_displaced`: slides, and turns where there are any."""
        count = 0
        for axis in pairs:
            count += ADD + TERM * varying[frame, f"t{axis}"]
            if terms := varying[frame, f"r{axis}"]:
                count += TERM * terms + SERIES + TURN
            elif (frame, f"r{axis}") in constant:
                count += TURN
        return count

    def angle(frame: int) -> int:
        """`_joint_angle`."""
        terms = varying[frame, "rz"]
        return SUM_OF_ANGLES + (TERM * terms + SERIES if terms else 0)

    total = 3 * ADD + (displaced(n + 1, "yxz") if general(n + 1) else 0)  # the ball in the flange frame
    for frame in range(1, n + 1):
        total += MAP + angle(frame) + TURN
        if general(frame):
            total += displaced(frame, "yx") + ADD + TERM * varying[frame, "tz"]
    return total + MAP + displaced(0, "yxz") + MAP  # from the first link to the base, and to F0
