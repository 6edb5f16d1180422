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
# # A real arm
#
# A UR10 and a laser tracker: public measurements of a real arm. The data are not part of this repository;
# without them the notebook ends after the next cell. `BAYESCAL_REAL` names the folder that contains them.

# %%
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: more threads are slower

import matplotlib.pyplot as plt
import numpy as np

import bayescal as bc

HERE = Path.cwd()
NEAR = [p / "shared" / "data" / "real" for p in HERE.parents]
REAL = [Path(os.environ["BAYESCAL_REAL"])] if "BAYESCAL_REAL" in os.environ else NEAR
DATA = next((p / "ur10-lasertracker" for p in REAL if (p / "ur10-lasertracker").is_dir()), None)
if DATA is None:
    raise SystemExit("no data of the real arm here: set BAYESCAL_REAL to their folder")
dataset = bc.read_dataset(os.path.relpath(DATA))
roles, counts = np.unique(dataset.measurements.role, return_counts=True)
print(
    f"{dataset.robot.name}: "
    + ", ".join(f"{n} rows to {role}" for role, n in zip(roles, counts, strict=True))
)

# %% [markdown]
# ## Calibration

# %%
result = bc.fit(dataset, ("geometry", "compliance"), samples=0)
print(result)

# %% [markdown]
# ## Errors of the validation points by model level
#
# The length of the error vector of each point that was not fitted.

# %%
levels = ("nominal", "joint offsets", "geometry", "geometry + compliance")
errors = {}
for name, level in zip(levels, result.data.levels, strict=True):
    errors[name] = 1e3 * np.concatenate(
        [np.linalg.norm(p.residuals, axis=0) for p in level.validation.points]
    )
figure, axes = plt.subplots(figsize=(9, 3.8), layout="constrained")
for (name, own), colour in zip(errors.items(), ("#c0392b", "#8e5ea2", "#d68910", "#1b4f72"), strict=True):
    axes.step(np.sort(own), (np.arange(len(own)) + 1) / len(own), where="post", color=colour, label=name)
axes.set(xscale="log", xlabel="error of a point, mm", ylabel="share of points")
axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
axes.legend(frameon=False)
plt.show()
