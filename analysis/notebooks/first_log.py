# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A first joint log
#
# An arm was moved, and its positions and motor torques were logged. The nominal model of the arm does not
# predict the torques: masses, rotors and friction differ, and an effect is missing. `check` states what
# the log can show, `fit` estimates the arm, `diagnose` names the effect, and `plan` which motions
# to log next.
#
# This log is simulated by a program that shares no code with the model (`analysis.world.motion`). Friction of
# one joint grows with its load; the model lacks it.

# %%
import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: more threads are slower
sys.path.insert(0, str(Path.cwd().parents[1]))  # for the simulator, which is not installed

import matplotlib.pyplot as plt
import numpy as np

import bayescal as bc
from analysis.world.motion.build import make

SAMPLES = int(os.environ.get("BAYESCAL_NOTEBOOK_SAMPLES", "2000"))
MOTIONS = int(os.environ.get("BAYESCAL_NOTEBOOK_MOTIONS", "8"))
made = make(seed=5, number=4, kinds=("single",), motions=MOTIONS, length=8.0)
place = tempfile.TemporaryDirectory()
log = Path(place.name) / "arm-log"
log.mkdir()
for name, text in made.texts.items():
    (log / name).write_text(text)

# %% [markdown]
# ## What the log contains
#
# Nothing is fitted here. What is missing is named with the effects that cannot be assessed without it.

# %%
print(bc.check(log))

figure, axes = plt.subplots(2, 1, figsize=(9, 4.6), sharex=True, layout="constrained")
session = made.log.session
run = session.runs[0]
axes[0].plot(session.since[run], np.degrees(session.q[run]), lw=1)
axes[0].set(ylabel="position, deg")
axes[1].plot(session.since[run], made.log.torque[run], lw=1)
axes[1].set(xlabel="time, s", ylabel="torque, N m")
axes[0].set_title("first motion, all joints", loc="left")
plt.show()

# %% [markdown]
# ## The arm
#
# Masses, centres of mass, inertias, rotors, friction and times, each with its prior. Motions of the role
# `validate` are only predicted: their torque error is compared with what noise and u let expect.

# %%
result = bc.fit(log, samples=SAMPLES, seed=1)
print(result)
outside = [row.Index for row in result.withheld.itertuples() if row.rms_Nm > row.expected_interval95_Nm[1]]
print("larger than expected:", ", ".join(outside))

# %% [markdown]
# ## The missing effect
#
# The verdict names an effect only if it is more probable than all that could be in its place, and if it makes
# the withheld motions more probable.

# %%
gap = bc.diagnose(log)
print(gap)
shrinkage = gap.shrinkage

figure, axes = plt.subplots(figsize=(9, 3.2), layout="constrained")
bars = (
    ("before_rms_Nm", "#c3ccd5", "fitted model"),
    ("after_rms_Nm", "#1b4f72", "with the named effect"),
    ("floor_Nm", "#c0392b", "noise"),
)
for k, (key, colour, label) in enumerate(bars):
    places = np.arange(len(shrinkage)) + 0.27 * (k - 1)
    axes.bar(places, shrinkage[key] / shrinkage["floor_Nm"], 0.25, color=colour, label=label)
axes.set_xticks(range(len(shrinkage)), shrinkage.index)
axes.set(ylabel="torque error / noise", title="withheld motions")
axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
plt.show()

# %% [markdown]
# ## What to log next
#
# Motions that make the rest assessable, within the range of the log: commands at its rate, from its first
# pose. `bayescal plan arm-log` and `bayescal gap arm-log` write them as a table.

# %%
planned = bc.plan(log)
print(planned)

# %% [markdown]
# The ground truth, not used above:

# %%
for where in made.truth["where"]:
    print(made.truth["effects"], where, made.truth["amplitude"])
place.cleanup()
