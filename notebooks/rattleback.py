# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # The rattleback: a stone that prefers one sense of rotation
#
# Spun one way, Kane and Levinson's stone starts to rattle, stops, and reverses; spun
# the other way it goes on. Nothing is lost on the way: the spin turns into rocking and
# back.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk
from rollkane.files.scene_files import load_scene

jax.config.update("jax_enable_x64", True)
stone = load_scene("rattleback")
print(stone.description)

# %% [markdown]
# ## Against its grain
#
# Its spin about the vertical over 20 s, in outputs 1/300 s apart.

# %%
times = np.linspace(0.0, 20.0, 6001)
run = rk.simulate(stone.scene, stone.start, times, rtol=1e-10)
spin = np.asarray(run.angular_velocity[:, 2])
plt.plot(times, spin)
plt.xlabel("time [s]")
_ = plt.ylabel("spin about the vertical [rad/s]")

# %% [markdown]
# The spin ripples with the rocking, so that it is averaged over half a second before
# its sign is looked at. It reverses, and later reverses again: no friction takes
# the energy, so it comes out of the rocking once more.

# %%
smooth = np.convolve(spin, np.ones(150) / 150, mode="valid")
turns = times[75:-74][1:][np.diff(np.sign(smooth)) != 0]
print("the mean spin changes sign at", turns.round(2), "s")
energy = np.asarray(run.energy)
drift = np.ptp(energy) / energy[0]
print(f"relative drift of the energy: {drift:.1e}")
assert len(turns) == 2
assert drift < 1e-8  # 6000 outputs at rtol 1e-10

# %% [markdown]
# ## With its grain
#
# The same stone, spun the other way at the same rate. Now the other of its two rocking
# motions grows, and more slowly: it takes several times as long until the stone
# reverses.

# %%
other = rk.place(
    stone.scene, stone.start.orientation, -run.angular_velocity[0], (0.0, 0.0, 0.0)
)
with_grain = rk.simulate(stone.scene, other, times, rtol=1e-10).angular_velocity[:, 2]
plt.plot(times, spin, label="against its grain")
plt.plot(times, with_grain, label="with its grain")
plt.xlabel("time [s]")
plt.ylabel("spin about the vertical [rad/s]")
_ = plt.legend()

# %%
smooth = np.convolve(with_grain, np.ones(150) / 150, mode="valid")
later = times[75:-74][1:][np.diff(np.sign(smooth)) != 0]
print("with its grain it changes sign at", later.round(2), "s")
assert later[0] > 3.0 * turns[0]
