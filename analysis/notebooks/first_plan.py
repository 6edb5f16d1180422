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
# # How many contacts, and on which faces?
#
# A FANUC LR Mate 200iC shall measure distances in its volume to 0.05 mm (U, k = 2). It is calibrated by
# touching a 9-inch granite cube. How many contacts does it need, which faces must they be on, and what does
# it gain if they are chosen instead of taken at random?
#
# No answer needs a measurement: the covariance of the parameters follows from the poses of the contacts,
# their noise, the certificate of the cube and the priors. It holds **assuming the model is correct**:
# the second part of the notebook shows what that condition means.

# %%
import os
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

import bayescal as bc
from bayescal.dataset.types import Box
from bayescal.dataset.write import taken
from bayescal.planning.candidates import candidates
from bayescal.planning.exchange import mean_variance, select
from bayescal.planning.goals import goals
from bayescal.planning.pool import Pool, linearised
from bayescal.planning.setup import read_setup

HERE = Path.cwd()
DATA = next(p / "data" / "lrmate200ic-cube" for p in (HERE, *HERE.parents) if (p / "data").is_dir())
COUNT = int(os.environ.get("BAYESCAL_NOTEBOOK_CANDIDATES", "4000"))
COUNTS = [50, 70, 100, 150, 200, 300] if COUNT >= 4000 else [60, 90]
NOISES = [
    5.0,
    20.0,
]  # µm: a probe on an arm that stands still; the repeatability that the manufacturer states
TOLERANCE = 50.0  # µm
MODEL = ("geometry", "compliance")

# %% [markdown]
# ## The setup
#
# The volume of interest is a box in front of the arm, larger than the cube. Every candidate is reached
# within the joint limits, with a straight approach, and collides with nothing.

# %%
setup = read_setup(DATA)
volume = Box(np.array([0.40, 0.0, 0.25]), np.array([0.40, 0.80, 0.50]))
faces = [name for name in setup.regions if name.startswith("cube")]
pool = candidates(replace(setup, volume=volume), COUNT)
print(f"{len(pool.candidates)} candidates on {', '.join(faces)}")


# %% [markdown]
# ## Which faces
#
# The pool is restricted to some faces, 150 contacts are chosen for distances in the volume, and U follows.


# %%
def on_faces(pool: Pool, some: tuple[str, ...], noise_um: float) -> Pool:
    """The candidates on some faces, with another noise of a contact."""
    m = pool.session.measurements
    kept = [k for k, t in enumerate(pool.session.targets) if t.name in some]
    rows = pool.candidates[np.isin(m.target[pool.candidates], kept)]
    noise = replace(pool.session.noise, contact=1e-6 * noise_um)
    session = replace(pool.session, noise=noise, measurements=taken(m, rows))
    return replace(pool, session=session, approach=pool.approach[rows])


def expanded(pool: Pool, counts: list[int]) -> tuple[list[float], list[float]]:
    """U (k = 2), µm, of distances in the volume: of chosen contacts, and of random ones (median of 7)."""
    linear = linearised(pool, MODEL)
    goal = next(g for g in goals(pool, linear) if g.over == "volume of interest")
    rng = np.random.default_rng(0)

    def u(chosen: np.ndarray) -> float:
        return 2e6 * float(np.sqrt(mean_variance(goal.slopes, linear.covariance(chosen))))

    size = len(pool.candidates)
    chosen = [u(select(linear, [goal], n, rng, starts=1)) for n in counts]
    chance = [float(np.median([u(rng.permutation(size)[:n]) for _ in range(7)])) for n in counts]
    return chosen, chance


def plain(axis, ticks: list[float]) -> None:
    """Ticks of a logarithmic axis, as plain numbers."""
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


U_TICKS = [10.0, 20.0, 50.0, 100.0, 200.0, 500.0]
CONTACTS = COUNTS[len(COUNTS) // 2]
by_faces = {}
for number in range(1, len(faces) + 1):
    for some in combinations(faces, number):
        try:
            by_faces[some] = expanded(on_faces(pool, some, 20.0), [CONTACTS])[0][0]
        except bc.BayescalError as error:
            print(f"{' '.join(some)}: {error}")
names = {some: " ".join(name.removeprefix("cube.") for name in some) for some in by_faces}
for some, value in sorted(by_faces.items(), key=lambda item: item[1]):
    print(f"{names[some]:16s} U = {value:6.1f} µm of {CONTACTS} contacts with a noise of 20 µm")

fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
order = sorted(by_faces, key=lambda some: by_faces[some])
ax.barh([names[some] for some in order], [by_faces[some] for some in order], color="#1b4f72")
ax.axvline(TOLERANCE, color="#d68910", ls="--", label="0.05 mm")
ax.set_xscale("log")
plain(ax.xaxis, U_TICKS)
ax.set_xlabel(f"U (k = 2) of distances in the volume, µm, {CONTACTS} contacts with a noise of 20 µm")
ax.set_ylabel("faces")
ax.invert_yaxis()
ax.legend()
plt.show()

# %% [markdown]
# Without both faces of a certified distance nothing says how long the arm is: the scale follows from the
# tolerances of its links alone, and U is some 0.5 mm whatever the number of contacts. With both, each
# further face reduces U.
#
# ## How many contacts

# %%
every = {noise: expanded(on_faces(pool, tuple(faces), noise), COUNTS) for noise in NOISES}
fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
for (noise, (chosen, chance)), colour in zip(every.items(), ("#1b4f72", "#d68910"), strict=True):
    ax.plot(COUNTS, chosen, "o-", color=colour, label=f"chosen, noise {noise:.0f} µm")
    ax.plot(COUNTS, chance, "s--", color=colour, label=f"random, noise {noise:.0f} µm")
ax.axhline(TOLERANCE, color="black", lw=0.8, label="0.05 mm")
ax.set_xscale("log")
ax.set_yscale("log")
plain(ax.xaxis, COUNTS)
plain(ax.yaxis, U_TICKS)
ax.set_xlabel("contacts")
ax.set_ylabel("U (k = 2) of distances in the volume, µm")
ax.legend()
plt.show()

needed = {}
for noise, curves in every.items():
    for how, curve in zip(("chosen", "random"), curves, strict=True):
        enough = [n for n, value in zip(COUNTS, curve, strict=True) if value <= TOLERANCE]
        needed[noise, how] = enough[0] if enough else None
        text = f"{enough[0]} contacts or fewer" if enough else f"more than {COUNTS[-1]} contacts"
        print(f"noise {noise:.0f} µm, {how}: {text} for 0.05 mm")

# %% [markdown]
# ## Assuming the model is correct
#
# Real arms are not quite like any model: the real sessions of `docs/real_sessions.md` have errors that
# geometry and compliance leave, of the size of the tolerance. They do not fall with the number of contacts.
# Half of a plan is therefore chosen to show them (`bayescal plan --for both`): here are the smallest
# amplitudes that the same number of contacts shows, chosen for distances alone and for both.

# %%
few = {"contacts": CONTACTS, "candidates": COUNT // 2}
alone = bc.plan(DATA, purpose="distances", **few)
both = bc.plan(DATA, purpose="both", **few)
print(both)
ratio = {}
for a, b in zip(alone.data.detectable, both.data.detectable, strict=True):
    if np.isfinite(a.smallest) and np.isfinite(b.smallest):
        ratio.setdefault(a.effect, []).append(np.log(b.smallest / a.smallest))
ratio = {effect: float(np.exp(np.mean(logs))) for effect, logs in ratio.items()}
fig, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
order = sorted(ratio, key=lambda effect: ratio[effect])
ax.barh(order, [ratio[effect] for effect in order], color="#1b4f72")
ax.axvline(1.0, color="black", lw=0.8)
ax.set_xlabel("smallest detectable amplitude, of both purposes relative to distances")
ax.set_ylabel("effect")
ax.invert_yaxis()
plt.show()
cost = both.data.expected[-1].u / alone.data.expected[-1].u
shown = float(np.exp(np.mean(np.log(list(ratio.values())))))
print(f"both: amplitudes {shown:.2f} of those of a plan for distances; U of distances {cost:.2f} of it")
