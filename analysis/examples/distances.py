# %% [markdown]
# # Error of distances before and after a calibration
#
# The maximum error of sphere distances that were not used in the fit, for each model level.

# %%
import matplotlib.pyplot as plt

import bayescal as bc

session = bc.simulate(seed=3, contacts=120, later=0, repeats=0, spheres=3, placements=1)
result = bc.fit(session, samples=0)
levels = dict(
    zip(("nominal", "joint offsets", "geometry", "geometry + compliance"), result.data.levels, strict=True)
)
errors = {name: 1e6 * level.validation.distance_errors.maximum for name, level in levels.items()}

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
bars = axes.barh(list(errors), list(errors.values()), color="#1b4f72")
axes.bar_label(bars, fmt="%.0f", padding=3)
axes.set(xscale="log", xlabel="maximum error of a sphere distance, µm")
axes.invert_yaxis()
plt.show()
