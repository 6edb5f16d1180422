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
# # What correlations mean
#
# A calibration states values with standard uncertainties. The uncertainties of two parameters are rarely
# independent: an error of one is compensated by the other. This notebook shows three cases: a combination
# that is identifiable while its parts are not, a correlation that makes a derived quantity *better* known
# than its parts, and the cost of fixing a correlated parameter at its nominal value.

# %%
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: more threads are slower

import matplotlib.pyplot as plt
import numpy as np

import bayescal as bc

SAMPLES = int(os.environ.get("BAYESCAL_NOTEBOOK_SAMPLES", "4000"))  # effective draws of every parameter
session = bc.simulate(seed=2, contacts=150, later=10, repeats=5, spheres=2, placements=1)
result = bc.fit(session, ("geometry", "compliance"), samples=SAMPLES, seed=1)
data = result.inference_data()
draws = {name: np.asarray(data.posterior[name]).ravel() for name in data.posterior.data_vars}
print(f"{len(next(iter(draws.values())))} draws of {len(draws)} quantities")

# %% [markdown]
# ## A combination that is identifiable, and its parts that are not
#
# Axes 2 and 3 of this arm are parallel. A shift d2 along the one and d3 along the other move the ball in
# the same way: every contact determines d2 + d3. The draws lie on a line. Across the line the data are
# precise; along the line only the priors (0.3 mm each) limit the draws.

# %%
total = draws["d2"] + draws["d3"]
for name, values in (("d2", draws["d2"]), ("d3", draws["d3"]), ("d2 + d3", total)):
    print(f"u({name}) = {1e3 * np.std(values):6.1f} µm")

figure, axes = plt.subplots(figsize=(5, 4.6), layout="constrained")
axes.plot(draws["d2"], draws["d3"], ".", ms=2, alpha=0.3, color="#1b4f72")
axes.set(xlabel="d2, mm", ylabel="d3, mm", aspect="equal")
axes.set_title(f"r = {np.corrcoef(draws['d2'], draws['d3'])[0, 1]:+.4f}", loc="left")
plt.show()

# %% [markdown]
# A table that states d2 and d3 alone, each with its u, suggests that the arm is known to 0.2 mm. It is not
# so: whatever depends on d2 + d3 is known to micrometres.
#
# ## The correlation matrix
#
# Most parameters are correlated with their neighbours in the chain. Pairs near 1 or -1 are the combinations
# that `fit` lists as weakly identifiable, or would with fewer contacts.

# %%
arm = [n for n in draws if n[0] in "adbt" and n[-1].isdigit()] + [n for n in draws if n.startswith("compl")]
matrix = np.corrcoef([draws[name] for name in arm])
figure, axes = plt.subplots(figsize=(7.5, 6.5), layout="constrained")
image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
axes.set_xticks(range(len(arm)), arm, rotation=90, fontsize=8)
axes.set_yticks(range(len(arm)), arm, fontsize=8)
axes.set_ylabel("parameter")
figure.colorbar(image, label="correlation")
plt.show()

off = np.abs(matrix - np.eye(len(arm)))
pairs = sorted(
    ((off[i, j], arm[i], arm[j]) for i in range(len(arm)) for j in range(i)), key=lambda item: -item[0]
)
for value, one, other in pairs[:6]:
    print(f"|r| = {value:.3f}  {one}, {other}")

# %% [markdown]
# ## A point is known better than the parameters suggest
#
# The predicted error of a point is a sum of many terms, each a parameter times its sensitivity. With the
# correlations, the terms partly compensate each other. Without them (adding the variances of the single
# terms) the predicted uncertainty is too large.

# %%
estimate = result.data.final.estimate
model = estimate.model
block = max(model.blocks, key=lambda b: len(b.rows))
still = model.deviations(estimate.z[model.slices["arm"]])
_, by_arm, _ = block.linearise(still, estimate.z[model.slices[block.target]])
slopes = by_arm[:, : len(model.parameters)] * model.sd  # per whitened parameter, m
own = estimate.covariance[model.slices["arm"], model.slices["arm"]]
with_them = np.sqrt(np.einsum("ri,ij,rj->r", slopes, own, slopes))
without = np.sqrt(np.einsum("ri,i,ri->r", slopes, np.diag(own), slopes))
factor = float(np.median(without / with_them))
print(f"u of the ball at the contacts, median: {1e6 * np.median(with_them):.1f} µm with the correlations,")
print(f"{1e6 * np.median(without):.1f} µm without: {factor:.1f} times as much")

# %% [markdown]
# So use the draws (`posterior.nc`) or the covariance, not the list of u, to predict anything from a
# calibration.
#
# ## A correlated parameter that is fixed at nominal
#
# The model without compliance fits the same contacts. Geometry then compensates for gravity where it can:
# the estimates move by many of their own standard uncertainties, which nevertheless look small.

# %%
rigid = bc.fit(session, "geometry", samples=0)
full = result.parameters
moved = {}
for name in rigid.parameters.index:
    if name in full.index and rigid.parameters.loc[name, "effect"] == "geometry":
        both = rigid.parameters.loc[name], full.loc[name]
        moved[name] = (both[0]["estimate"] - both[1]["estimate"]) / both[1]["u"]
leading = sorted(moved, key=lambda name: -abs(moved[name]))[:6]
for name in leading:
    print(f"{name:8s} differs by {moved[name]:+6.1f} u")
