# %% [markdown]
# # Two sessions of one arm
#
# The same arm, probed in May and in June. Both sessions are fitted together, and each alone: do they agree?

# %%
import matplotlib.pyplot as plt

import bayescal as bc

ARM = {"arm_seed": 3, "contacts": 70, "later": 0, "repeats": 0, "spheres": 0}
may, june = (bc.simulate(seed=seed, name=name, **ARM) for seed, name in ((3, "may"), (4, "june")))
single = {name: bc.fit(session, samples=0).parameters for name, session in (("may", may), ("june", june))}
both = bc.fit([may, june], samples=0)
names = [
    n
    for n in ("a1", "a2", "a3", "d4", "alpha1", "theta3", "compliance J2", "compliance J3")
    if n in both.parameters.index
]

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for k, (session, table) in enumerate(single.items()):
    difference = (table["estimate"] - both.parameters["estimate"]).loc[names] / table["u"].loc[names]
    axes.errorbar(
        [i + 0.15 * (k - 0.5) for i in range(len(names))], difference, yerr=1, fmt="o", label=session
    )
axes.axhline(0, color="#7b8794", lw=0.8)
axes.set_xticks(range(len(names)), names, rotation=30, ha="right")
axes.set(ylabel="difference from both together / u", xlabel="parameter")
axes.legend(frameon=False)
plt.show()
