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
# # A first diagnosis
#
# An arm has been calibrated, with its compliance, and its error is still larger than the noise. `diagnose`
# states the size of the difference between model and machine, its location, the effect, and the error after
# the effect is added to the model.
#
# This session is simulated. The arm has backlash with half-widths up to a tenth of a milliradian, drawn from
# the seed; the model lacks it.

# %%
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: more threads are slower

import matplotlib.pyplot as plt
import numpy as np

import bayescal as bc

HIDDEN = "backlash"
CONTACTS = int(os.environ.get("BAYESCAL_NOTEBOOK_CONTACTS", "300"))
session = bc.simulate(effects=("geometry", "compliance", HIDDEN), seed=4, contacts=CONTACTS, placements=3)
result = bc.diagnose(session, ("geometry", "compliance"), seed=1)
gap = result.data

# %% [markdown]
# ## Size
#
# The validation errors of contacts and sphere distances that a correct model would have, and the measured
# errors. The noise is estimated from repeated contacts.

# %%
size = gap.magnitude
low, high = (1e6 * v for v in size.excess_interval95)
print(f"noise {1e6 * size.noise:.1f} µm (from {size.noise_from}), excess {1e6 * size.excess:.1f} µm "
      f"({low:.1f} to {high:.1f})")  # fmt: skip
for m in size.measured:
    low, high = (1e6 * v for v in m.predicted_interval95)
    print(
        f"{m.what}: measured {1e6 * m.rms:.1f} µm RMS, expected for a correct model {low:.1f} to {high:.1f}"
    )

# %% [markdown]
# ## Location
#
# A location is a site (a joint, the base, the probe, a face) and a driver (the quantity on which the error
# depends). The location is often correct even where the name of the effect is not.

# %%
for p in gap.where:
    name = f"  <- {p.explained_by}" if p.explained_by else ""
    print(f"{f'{p.site}, {p.driver.text}':42s} {1e6 * p.rms:5.1f} µm, p {p.family_p_value:7.1g}{name}")

first = gap.where[0]
curve = first.curve
figure, axes = plt.subplots(figsize=(9, 3.8), layout="constrained")
axes.plot(curve.x, 1e6 * curve.residual, ".", ms=4, color="#c3ccd5", label="without this effect")
order = np.argsort(curve.x)
axes.plot(curve.x[order], 1e6 * curve.fitted[order], ".", ms=4, color="#c0392b", label="explained by it")
axes.set(xlabel=curve.coordinate, ylabel="residual, µm")
axes.set_title(f"{first.site}, {first.driver.text}", loc="left")
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# ## Effect
#
# The probability of every known effect, of the noise-only model and of an effect not in that list.
# The 90 % set contains the effects that these data do not distinguish.

# %%
print(result)
named = {n.effect for n in gap.verdict.named}
print("90 % set:", ", ".join(gap.verdict.credible_set90))
ranked = sorted(gap.verdict.probability.items(), key=lambda item: item[1])[-6:]

figure, axes = plt.subplots(figsize=(9, 2.6), layout="constrained")
axes.barh([n for n, _ in ranked], [p for _, p in ranked], color="#1b4f72")
axes.set(xlim=(0, 1), xlabel="probability (several effects may be present)", ylabel="effect")
plt.show()

# %% [markdown]
# ## Reduction of the error
#
# The model is fitted again with the named effects. Only validation measurements count: contacts made later,
# and distances between spheres that are not used in a fit. The expected RMS is that of a correct model.

# %%
for s in gap.shrinkage:
    print(f"{s.what:10s} {1e6 * s.before:5.1f} -> {1e6 * s.after:5.1f} µm (expected {1e6 * s.floor:.1f})")

figure, axes = plt.subplots(figsize=(9, 3.2), layout="constrained")
levels = ["nominal" if s.model == ("nominal",) else f"+ {s.model[-1]}" for s in gap.levels]
for values, colour, label in (
    ([s.validation_rms for s in gap.levels], "#1b4f72", "validation contacts, planes"),
    ([s.distance_rms for s in gap.levels], "#c0392b", "sphere distances"),
):
    axes.plot(levels, 1e6 * np.array(values), "o-", color=colour, label=label)
axes.axhline(1e6 * size.noise, color="#7b8794", lw=0.8, ls="--", label="noise of a contact")
axes.set(yscale="log", ylabel="RMS error, µm")
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# The ground truth, not used by `diagnose`:

# %%
backlash = {i["name"]: i["value_deg"] for i in session.truth["parameters"] if i["effect"] == HIDDEN}
for name, value in backlash.items():
    print(f"{name}: {1e3 * np.radians(value):+.3f} mrad")
