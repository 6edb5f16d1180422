# %% [markdown]
# # Corrected targets for a robot program
#
# The calibrated arm is not at its nominal place. `compensate` gives the readings that put it there.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import bayescal as bc

session = bc.simulate(seed=3, contacts=120, later=0, repeats=0, spheres=0)
with tempfile.TemporaryDirectory() as folder:
    run, targets = Path(folder) / "run", Path(folder) / "targets.csv"
    bc.fit(session, samples=0).save(run, pictures=False)
    readings = np.degrees(session.dataset.measurements.readings[::10])
    header = ",".join(f"j{k}_deg" for k in range(1, 7))
    np.savetxt(targets, readings, fmt="%.4f", delimiter=",", header=header, comments="")
    corrected = bc.compensate(run, targets)
change = np.degrees(corrected.readings) - readings
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.boxplot(1e3 * change, tick_labels=[f"J{k}" for k in range(1, 7)])
axes.set(ylabel="correction, mdeg", xlabel="joint")
plt.show()
