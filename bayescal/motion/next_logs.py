"""What to log next, so that a cause that is left open shows itself: what a person does for each quantity."""

from __future__ import annotations

import re

from bayescal.motion.effects import Form

PAUSE = "log one motion after a pause of a minute, and again at once after other motions"
WARM = "log one motion cold, and again after 20 minutes of motion"
SMALL = "move {who} alone, slowly, with reversals of 0.1, 1 and 10 deg, and from rest"
TO_DO = (
    ("waves a turn", "move {who} alone, slowly, over its whole range in both directions, twice"),
    ("oscillation", "log one motion at half and at full speed, and look for what swings, as a stand"),
    ("since the reversal", SMALL),
    ("since the start", SMALL),
    ("time since the motion began", PAUSE),
    ("time within a motion", PAUSE),
    ("single events", "log one motion three times: events of the arm come back at one place"),
    ("rate of torque times", "log torque and position of one message, or with stamps of one clock"),
    ("force on the tool", "log one motion with the cables and hoses of the tool, and again without them"),
    ("earlier torque", "hold {who} for 10 s in poses of low and high torque, and move it slowly from each"),
    ("change of torque", "move {who} alone, to and fro about poses of low and of high torque"),
    ("side of the torque", "move {who} alone through poses in which its torque changes sign"),
    ("temperature", WARM),
    ("heat", WARM),
    ("power", "log one motion at half and at full speed, with and without a payload"),
    ("payload", "log one motion with and without the payload, in turn"),
    ("time", "log one motion at the beginning, in the middle and at the end of a log"),
    ("motion", "log one motion three times, each time after another motion"),
    ("acceleration", "log one motion of {who} at half and at full speed"),
    ("speed", "move {who} alone at three speeds, in both directions"),
    ("angle of joint", "move {who} alone, with {other} at three angles"),
    ("angle", "move {who} alone, slowly, over its whole range in both directions"),
    ("torque", "log one motion of {who} from other poses, in which gravity loads it more and less"),
    (".*", "move {who} alone at constant speed, in both directions"),
)
"""Words in the name of a quantity, a regular expression, and what a person does; the first counts. `who` is
the joint of the error, `other` another one whose angle it depends on."""


def to_do(form: Form) -> str:
    """What to log, for an error that varies with a quantity at a site."""
    who = form.site if form.site.startswith("joint ") else "each joint"
    of = re.search(r"\bof (joint \d+)", form.driver)
    other = of[1] if of else who
    driver = form.driver.replace(f" of {other}", "") if other == form.site else form.driver
    what = next(text for words, text in TO_DO if re.search(rf"\b{words}\b", driver))
    site = f" at {form.site}" if who == form.site else ""
    return f"{what.format(who=who, other=other)} (to tell what varies with {form.driver}{site})"
