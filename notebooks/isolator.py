# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # An isolator in an earthquake
#
# A ball in a shallow bowl carries a payload on springs; the ground moves by a record of
# the Kaikoura earthquake of 2016 (GeoNet, New Zealand, CC BY). How much of the ground's
# acceleration reaches the payload?

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk
from rollkane.files.scene_files import load_scene

jax.config.update("jax_enable_x64", True)
device = load_scene("isolator")
print(device.description)
times = np.linspace(0.0, 20.0, 2001)
run = rk.simulate(device.scene, device.start, times, rtol=1e-10)
print(run.reason, "in", int(run.steps), "steps")

# %% [markdown]
# ## What the ground does, what the ball does
#
# Steps end on the record's samples, so an earthquake is integrated at full order.

# %%
ground, ball = np.asarray(run.base_position), np.asarray(run.position)
plt.plot(times, ground[:, 0], label="ground")
plt.plot(times, ball[:, 0], label="ball")
plt.xlabel("time [s]")
plt.ylabel("along x [m]")
_ = plt.legend()

# %% [markdown]
# ## Accelerations
#
# The ground's is that of the record; the ball's is the derivative of its velocity.

# %%
record = rk.builtin_record("kaikoura-2016-wtmc").window(42.0, 62.0)
shaken = 0.1 * record.acceleration[:, 0]  # a tenth of its strength, as in the scene
felt = np.gradient(np.asarray(run.velocity[:, 0]), times)
plt.plot(record.time, shaken, label="ground")
plt.plot(times, felt, label="ball")
plt.xlabel("time [s]")
plt.ylabel("acceleration along x [m/s$^2$]")
plt.legend()
peaks = np.abs(shaken).max(), np.abs(felt).max()
print(f"peak of the ground {peaks[0]:.3f} m/s^2, of the ball {peaks[1]:.3f} m/s^2")
assert peaks[1] < 0.7 * peaks[0]

# %% [markdown]
# ## Does it stay in contact?
#
# The contact is bilateral: a run goes on where the bowl would have to hold the ball.
# `first_pull` says whether that was so, `friction_ratio` how rough the bowl has to be.

# %%
print("first pull", float(run.first_pull), "(NaN: never)")
print("friction needed", float(run.friction_ratio.max()))
assert np.isnan(run.first_pull)
