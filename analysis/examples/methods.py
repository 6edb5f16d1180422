# %% [markdown]
# # One session by several published methods
#
# All methods fit the same contacts and are validated on the same distances.

# %%
import matplotlib.pyplot as plt

import bayescal as bc

session = bc.simulate(seed=3, contacts=120, later=0, repeats=0, spheres=3, placements=1)
methods = bc.compare(session).record["methods"]
rms = {m["name"]: m["heldout"]["distances_rms_um"] for m in methods if m["applies"]}

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
bars = axes.barh(list(rms), list(rms.values()), color="#1b4f72")
axes.bar_label(bars, fmt="%.0f", padding=3)
axes.set(xlabel="RMS error of sphere distances, µm", xscale="log")
axes.invert_yaxis()
plt.show()
