# %% [markdown]
# # Which contacts to measure
#
# 60 contacts chosen among candidates on a cube, and the uncertainty of distances that they give, compared
# with random contacts.

# %%
from pathlib import Path

import matplotlib.pyplot as plt

import bayescal as bc

HERE = Path.cwd()
DATA = next(p / "data" / "lrmate200ic-cube" for p in (HERE, *HERE.parents) if (p / "data").is_dir())
plan = bc.plan(DATA, contacts=60, purpose="distances", candidates=300)
print(plan)

# %%
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for name, u in plan.curve.items():
    axes.plot(u.index, 2 * u, "o-", label=name)
axes.set(xlabel="contacts", ylabel="U (k = 2) of a distance, µm", yscale="log")
axes.legend(frameon=False)
plt.show()
