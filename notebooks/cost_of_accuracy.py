# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # What accuracy costs
#
# Every solver gives a motion at every tolerance, and none says how wrong it is. Work
# and precision on your own scene: error against time, from which a setting is chosen.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk
from rollkane.files.scene_files import load_scene

jax.config.update("jax_enable_x64", True)
disc = load_scene("rolling-disc")

# %% [markdown]
# ## By hand
#
# The error of runs against one at a far tighter tolerance; the energy's drift beside
# it. It is a hint only: a motion can keep its energy and be wrong.

# %%
end = np.array([0.0, 2.0])
exact = rk.simulate(disc.scene, disc.start, end, rtol=1e-13, atol=1e-15).position[-1]
print("rtol      error [m]   energy drift   steps")
errors = []
for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
    run = rk.simulate(disc.scene, disc.start, end, rtol=rtol)
    errors.append(float(np.linalg.norm(run.position[-1] - exact)))
    drift = abs(float(run.energy[-1] / run.energy[0]) - 1.0)
    print(f"{rtol:.0e}   {errors[-1]:.1e}     {drift:.1e}        {int(run.steps)}")
assert errors[-1] < 1e-7 < errors[0]

# %% [markdown]
# ## Measured
#
# `work_precision` takes every combination that is asked for, against a reference of its
# own in higher precision, and times it.

# %%
work = rk.work_precision(
    disc, horizon=1.0, solvers=("Dopri5", "Dopri8"), methods=("native",), repeats=3
)
print(work.table())

# %% [markdown]
# A steeper line is a higher order: it wins where the error has to be small. Calls take
# a third of a millisecond of Python's, so short motions are as fast at a tight
# tolerance as at a loose one.

# %%
work.plot("cost.png")
figure = plt.figure(figsize=(9, 6))
plt.imshow(plt.imread("cost.png"))
_ = plt.axis("off")

# %% [markdown]
# ## Recommended
#
# The fastest setting whose measured error meets the one that is asked for.

# %%
best = rk.recommend(disc, horizon=1.0, error=1e-6, repeats=3)
print(best.setting.series, best.setting.how, "error", best.error)
assert best.error <= 1e-6
