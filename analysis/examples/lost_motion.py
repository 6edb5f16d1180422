# %% [markdown]
# # The probability of every effect
#
# A simulated arm has backlash in every joint, and the calibrated model lacks it. `diagnose` states the
# probability of every effect, of the noise-only model and of an unmodelled effect.

# %%
import matplotlib.pyplot as plt

import bayescal as bc

session = bc.simulate(
    effects=("geometry", "compliance", "backlash"), seed=4, contacts=100, later=20, repeats=6, spheres=0
)
result = bc.diagnose(session)
probability = dict(sorted(result.record["probability"].items(), key=lambda item: item[1])[-6:])

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.barh(list(probability), list(probability.values()), color="#1b4f72")
axes.set(xlim=(0, 1), xlabel="probability", ylabel="effect")
plt.show()
