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
# # An effect of your own
#
# The cable package of an arm pulls joint 5 as joint 4 turns. No known effect has this form: the
# error acts at joint 5 and depends on the angle of joint 4. This notebook defines the effect, simulates an
# arm that has it, and calibrates the arm without and with the effect.

# %%
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: more threads are slower

import matplotlib.pyplot as plt
import numpy as np

import bayescal as bc
from bayescal.effects import Circumstances, Driver, Effect, Parameter, Term
from bayescal.effects.location import joint

# %% [markdown]
# ## The effect
#
# An effect is a name, one line, and its parameters in a session. Each parameter has an SI unit, a prior
# standard deviation and terms: which axis of which frame it displaces (here `rz` of frame 5: the angle of
# joint 5), and by which driver, one value for each row. The site and the driver are what a diagnosis
# reports.


# %%
def pulled(c: Circumstances) -> list[Parameter]:
    """Errors of joint 5 as the sine and cosine of the angle of joint 4."""
    waves = {"sin": np.sin(c.q[:, 3]), "cos": np.cos(c.q[:, 3])}
    return [
        Parameter(
            f"cable {name}",
            "rad",
            (Term(5, "rz", driver),),
            sd=1e-3,
            site=joint(5),
            driver=Driver("angle", 4, order=1.0),
        )
        for name, driver in waves.items()
    ]


CABLE = Effect(
    "cable",
    "the cable package pulls joint 5 as joint 4 turns",
    pulled,
    phrase=("joint 5", "is pulled by the cable package"),
    remedy="Give the cable package more slack between joints 4 and 5, and clamp it nearer to the axis.",
)
bc.effects.register(CABLE)

# %% [markdown]
# ## A simulated arm that has it

# %%
ARM = {"seed": 5, "contacts": 120, "later": 30, "repeats": 5, "spheres": 0}
session = bc.simulate(effects=("geometry", "compliance", "cable"), **ARM)
truth = {p["name"]: np.radians(p["value_deg"]) for p in session.truth["parameters"] if p["effect"] == "cable"}
for name, value in truth.items():
    print(f"{name}: {1e6 * value:+.0f} µrad")

# %% [markdown]
# ## Calibration without and with the effect
#
# `later` contacts are validation measurements: they are predicted, not fitted.

# %%
models = {"without": "geometry, compliance", "with": "geometry, compliance, cable"}
fits = {name: bc.fit(session, model, samples=0) for name, model in models.items()}
rms = {}
for name, result in fits.items():
    rows = [abs(r["calibrated_rms_um"]) for r in result.record["validation"]["planes"] if r["count"]]
    rms[name] = float(np.sqrt(np.mean(np.square(rows))))
    print(f"{name:8s} RMS of validation contacts {rms[name]:6.1f} µm")

# %%
table = fits["with"].parameters
table[table["effect"] == "cable"]

# %% [markdown]
# The estimates in units of their standard uncertainty, compared with the ground truth:

# %%
found = fits["with"].data.final.estimate
names = [p.name for p in found.model.parameters]
score = {}
for name, value in truth.items():
    k = names.index(name)
    estimate, u = found.arm[k], found.sd[k] * found.model.sd[k]
    score[name] = (estimate - value) / u
    print(f"{name}: {1e6 * estimate:+.0f} µrad, u {1e6 * u:.1f}; (estimate - truth) / u = {score[name]:+.1f}")

# %% [markdown]
# ## The residuals
#
# Residuals of the calibration without the effect, and the same contacts with it, along the angle of joint
# 4.

# %%
scene = found.model.scene
figure, axes = plt.subplots(figsize=(9, 3.8), layout="constrained")
for name, colour in (("without", "#c3ccd5"), ("with", "#1b4f72")):
    estimate = fits[name].data.final.estimate
    for block in estimate.model.blocks:
        angle = np.degrees(scene.q[block.rows, 3])
        label = f"{name} the effect" if block is estimate.model.blocks[0] else None
        axes.plot(angle, 1e6 * estimate.residuals(block)[0], ".", color=colour, label=label)
axes.set(xlabel="angle of joint 4, deg", ylabel="residual, µm")
axes.legend(frameon=False)
plt.show()

# %% [markdown]
# ## In a package
#
# A program registers its effect, as here. An installed package offers it to the command line by an entry
# point:
#
#     [project.entry-points."bayescal.effects"]
#     cable = "my_package.effects:CABLE"
#
# Then `bayescal fit --model geometry,compliance,cable` and `bayescal gap` know it.

# %%
bc.effects.unregister("cable")
