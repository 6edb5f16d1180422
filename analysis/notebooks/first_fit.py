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
# # A first calibration
#
# A FANUC LR Mate 200iC has touched four faces of a 9-inch granite cube with a probe, each contact giving
# one equation: the distance of the ball's centre from a plane is the ball radius. The poses of the planes are
# unknown. The cube's certificate (two faces parallel, 228.6 mm apart, the others perpendicular to them) gives
# the scale. Datum spheres of 2 inches are not used in the fit: they validate the calibration.
#
# This session is simulated, so the ground truth is available. A measured session is read in the same way.

# %%
import json
import os
from collections import Counter
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import bayescal as bc

HERE = Path.cwd()
DATA = next(p / "data" / "lrmate200ic-cube" for p in (HERE, *HERE.parents) if (p / "data").is_dir())
SAMPLES = int(os.environ.get("BAYESCAL_NOTEBOOK_SAMPLES", "4000"))  # effective draws of every parameter

dataset = bc.read_dataset(DATA)
rows = dataset.measurements
count = Counter((str(role), dataset.targets[k].kind) for role, k in zip(rows.role, rows.target, strict=True))
for (role, kind), number in sorted(count.items()):
    print(f"{number:4d} contacts with a {kind} to {role}")

# %% [markdown]
# ## Fit
#
# The model has the identifiable DH parameters (18 of geometry, and the TCP offset) and a compliance for each
# joint that gravity loads: the joint rotates by compliance times torque. The prior of every parameter is as
# wide as the tolerances of small arms. `fit` estimates the model levels in turn (nominal, joint offsets,
# geometry, geometry + compliance) and samples the posterior of the last level with emcee.

# %%
result = bc.fit(dataset, ("geometry", "compliance"), samples=SAMPLES, seed=1)
calibration = result.data
draws = calibration.draws
noise = 1e6 * calibration.final.unexplained.fitted
print(f"noise of a contact {noise:.1f} µm, {len(calibration.final.estimate.rejected)} contacts rejected")
print(f"{draws.ess.min():.0f} effective draws or more, R-hat up to {np.nanmax(draws.rhat):.4f}")

# %% [markdown]
# ## The posterior
#
# Lengths in mm, angles in deg, compliances in µrad/(N m). Since axes 2 and 3 are parallel, d2 and d3 move the
# ball identically: only the combination d2 + d3 is identifiable.

# %%
data = result.inference_data()

import arviz as az

shown = ["a2", "a3", "d4", "theta3", "compliance_J2", "compliance_J3", "compliance_J5", "noise_scale"]
print(az.summary(data, var_names=shown).to_string())
for direction in calibration.identifiability.weak:
    print(direction.words)

# %% [markdown]
# Link lengths and compliances. A slanted cloud shows correlated parameters: to fit one without the other
# would bias it. Crosses mark the truth; of 25 parameters, one or two are expected outside their 95 %
# interval.

# %%
NAMES = {
    "a2": "a$_2$, mm",
    "a3": "a$_3$, mm",
    "compliance_J2": "J2, µrad/(N m)",
    "compliance_J3": "J3, µrad/(N m)",
    "compliance_J5": "J5, µrad/(N m)",
}
truth = {}
for item in json.loads((DATA / "truth.json").read_text(encoding="utf-8"))["parameters"]:
    truth[item["name"].replace(" ", "_")] = next(v for key, v in item.items() if key.startswith("value"))
draws_of = {name: np.asarray(data.posterior[name]).ravel() for name in truth}
bounds = {
    name: np.quantile(own, [0.025, 0.975]) for name, own in draws_of.items() if name not in ("d2", "d3")
}
held = sum(a <= truth[name] <= b for name, (a, b) in bounds.items())
print(f"{held} of {len(bounds)} true parameters within their 95 % interval")
values = {name: draws_of[name] for name in NAMES}
some = np.linspace(0, len(values["a2"]) - 1, 2000).astype(int)

figure, grid = plt.subplots(len(NAMES), len(NAMES), figsize=(9, 9), sharex="col", layout="constrained")
for i, (row, row_label) in enumerate(NAMES.items()):
    for j, (column, column_label) in enumerate(NAMES.items()):
        axes = grid[i, j]
        if j > i:
            axes.set_axis_off()
            continue
        axes.locator_params(axis="x", nbins=2)
        axes.locator_params(axis="y", nbins=3)
        axes.ticklabel_format(useOffset=False)
        if i == j:
            axes.hist(values[row], bins=50, color="#2166ac", alpha=0.8)
            axes.axvline(truth[row], color="#b2182b", lw=1.2)
            axes.set_yticks([])
        else:
            axes.plot(values[column][some], values[row][some], ".", ms=1.5, alpha=0.25, color="#2166ac")
            axes.plot(truth[column], truth[row], "+", ms=12, mew=1.6, color="#b2182b")
            r = np.corrcoef(values[column], values[row])[0, 1]
            axes.set_title(f"r = {r:+.2f}", fontsize=8, loc="right", pad=2)
            if j == 0:
                axes.set_ylabel(row_label)
            else:
                axes.set_yticklabels([])
        if i == len(NAMES) - 1:
            axes.set_xlabel(column_label)
plt.show()

# %% [markdown]
# ## Sphere distances, predicted and measured
#
# Each sphere's centre is located from its own contacts, for every posterior draw, with the noise of the
# contacts. The spread over draws predicts the error of a distance: about 19 of 20 measured errors should lie
# within their bars.

# %%
checks = calibration.final.validation.distances
low, high = 1e6 * np.quantile([d.predicted for d in checks], [0.025, 0.975], axis=1)
error = np.array([1e6 * d.error for d in checks])
inside = (low <= error) & (error <= high)
at = np.arange(len(checks))

figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
axes.vlines(at, low, high, color="#2166ac", alpha=0.35, lw=7, label="predicted, 95 %")
axes.plot(at[inside], error[inside], "o", ms=5, color="#222222", label="measured - certified")
axes.plot(at[~inside], error[~inside], "o", ms=5, color="#b2182b")
axes.axhline(0, color="#9aa0a6", lw=0.8)
axes.set_xticks(at, [" - ".join(d.between).replace("ball.", "") for d in checks], rotation=60, ha="right")
axes.set_ylabel("error of the distance, µm")
axes.set_title(f"{inside.sum()} of {len(checks)} within their 95 % interval", loc="left")
axes.legend(frameon=False, ncols=2)
plt.show()

# %% [markdown]
# ## The error of each model level
#
# The same distances by the nominal model, with joint offsets, with geometry, and with geometry and
# compliance. (For the real arm Joubair and Bonev, 2015, state 1.321 mm nominal and 0.274 mm calibrated with
# compliance: a real arm has further errors; this simulated arm has errors of geometry and compliance only.)

# %%
NAMES_OF_LEVELS = ("nominal", "joint offsets", "geometry", "geometry + compliance")
LEVELS = dict(zip(NAMES_OF_LEVELS, calibration.levels, strict=True))
errors = {name: 1e3 * np.array([abs(d.error) for d in r.validation.distances]) for name, r in LEVELS.items()}
print("distance error, mm          mean    maximum")
for name, own in errors.items():
    print(f"{name:24s} {own.mean():8.4f} {own.max():9.4f}")

figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
for (name, own), colour in zip(errors.items(), ("#b2182b", "#8c6bb1", "#e08214", "#2166ac"), strict=True):
    axes.step(np.append(own.min() / 1.3, np.sort(own)), np.arange(len(own) + 1) / len(own), where="post",
              color=colour, label=name)  # fmt: skip
axes.set(xscale="log", ylim=(0, 1.02), xlabel="error of a sphere distance, mm", ylabel="share of distances")
axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
axes.legend(frameon=False)
plt.show()
