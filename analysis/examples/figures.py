# %% [markdown]
# # A figure of a result
#
# `bc.plot` draws the figures of a result: each is a function of a result and returns a Matplotlib figure, or
# draws into given axes.

# %%
import matplotlib.pyplot as plt

import bayescal as bc

session = bc.simulate(seed=3, contacts=120, later=0, repeats=0, spheres=3, placements=1)
result = bc.fit(session, samples=0)
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
bc.plot.distances(result, ax=axes)
plt.show()
