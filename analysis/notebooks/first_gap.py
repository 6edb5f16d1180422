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
# # Where does the gap come from?
#
# An arm has been calibrated, with its stiffness, and still errs by more than noise. `diagnose` says how big
# that gap is, where it lies, which effect causes it, and how far it shrinks once the effect is in the model.
#
# This session is simulated. Play in the gears is hidden in it, of half-widths up to a tenth of a milliradian,
# drawn from the seed; the model does not know of it.

# %%
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: more threads only wait

import matplotlib.pyplot as plt
import numpy as np

import bayescal as bc

HIDDEN = "backlash"
session = bc.simulate(effects=("geometry", "compliance", HIDDEN), seed=4, contacts=300, placements=3)
result = bc.diagnose(session, ("geometry", "compliance"), seed=1)
gap = result.data

# %% [markdown]
# ## How big
#
# What the calibrated model, simulating this very session, expects of held-out contacts and sphere distances,
# beside what was measured. The noise is that of contacts made again and again.

# %%
size = gap.magnitude
low, high = (1e6 * v for v in size.excess_interval95)
print(f"noise {1e6 * size.noise:.1f} um (from {size.noise_from}), excess {1e6 * size.excess:.1f} um "
      f"({low:.1f} to {high:.1f})")  # fmt: skip
for m in size.measured:
    low, high = (1e6 * v for v in m.predicted_interval95)
    print(f"{m.what}: measured {1e6 * m.rms:.1f} um rms, the model expects {low:.1f} to {high:.1f}")

# %% [markdown]
# ## Where
#
# A place is a site (a joint, the base, the probe, a face) and a driver (what the error varies with). It
# comes before any name: the place is often right where the name is not.

# %%
for p in gap.where:
    name = f"  <- {p.explained_by}" if p.explained_by else ""
    print(f"{f'{p.site}, {p.driver.text}':42s} {1e6 * p.rms:5.1f} um, p {p.family_p_value:7.1g}{name}")

first = gap.where[0]
curve = first.curve
figure, axes = plt.subplots(figsize=(9, 3.8), layout="constrained")
axes.plot(curve.x, 1e6 * curve.residual, ".", ms=4, color="#c3ccd5", label="without it")
order = np.argsort(curve.x)
axes.plot(curve.x[order], 1e6 * curve.fitted[order], ".", ms=4, color="#c0392b", label="what it explains")
axes.set(xlabel=curve.coordinate, ylabel="residual, µm")
axes.set_title(f"{first.site}, {first.driver.text}", loc="left")
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# ## Which
#
# The probability of every effect, of 'nothing' and of 'something else'. The 90 % set holds what these data
# cannot tell apart.

# %%
print(result)
named = {n.effect for n in gap.verdict.named}
print("90 % set:", ", ".join(gap.verdict.credible_set90))
ranked = sorted(gap.verdict.probability.items(), key=lambda item: item[1])[-6:]

figure, axes = plt.subplots(figsize=(9, 2.6), layout="constrained")
axes.barh([n for n, _ in ranked], [p for _, p in ranked], color="#1b4f72")
axes.set(xlim=(0, 1), xlabel="probability (effects may be there together)", ylabel="effect")
plt.show()

# %% [markdown]
# ## How far it shrinks
#
# The model is fitted again with what was named. Only held-out measurements count: contacts made later, and
# distances between spheres that no fit has seen. The floor is what noise alone would leave.

# %%
for s in gap.shrinkage:
    print(f"{s.what:10s} {1e6 * s.before:5.1f} -> {1e6 * s.after:5.1f} um (floor {1e6 * s.floor:.1f})")

figure, axes = plt.subplots(figsize=(9, 3.2), layout="constrained")
rungs = ["nominal" if s.model == ("nominal",) else f"+ {s.model[-1]}" for s in gap.levels]
for values, colour, label in (
    ([s.validation_rms for s in gap.levels], "#1b4f72", "held-out planes"),
    ([s.distance_rms for s in gap.levels], "#c0392b", "sphere distances"),
):
    axes.plot(rungs, 1e6 * np.array(values), "o-", color=colour, label=label)
axes.axhline(1e6 * size.noise, color="#7b8794", lw=0.8, ls="--", label="noise of a contact")
axes.set(yscale="log", ylabel="rms error, µm")
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# The truth, which `diagnose` never saw:

# %%
play = {i["name"]: i["value_deg"] for i in session.truth["parameters"] if i["effect"] == HIDDEN}
for name, value in play.items():
    print(f"{name}: {1e3 * np.radians(value):+.3f} mrad")
