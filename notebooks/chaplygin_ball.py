# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # Chaplygin's ball: integrable, and still wandering
#
# A balanced ball (its mass centre in the middle) with three different moments of
# inertia rolls on a plane. Chaplygin solved it in 1903: besides the energy, the angular
# momentum about the contact point stays constant on the fixed axes.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk
from rollkane.files.scene_files import load_scene

jax.config.update("jax_enable_x64", True)
ball = load_scene("chaplygin-ball")
times = np.linspace(0.0, 20.0, 2001)
run = rk.simulate(ball.scene, ball.start, times, rtol=1e-11)

# %% [markdown]
# ## What is kept
#
# Four integrals, of a motion that was integrated without knowing of them.

# %%
from rollkane.dynamics.observables import contact_angular_momentum

momentum = np.asarray(run.each(contact_angular_momentum))
energy = np.asarray(run.energy)
print("energy", energy[0], "varies by", np.ptp(energy))
print(
    "angular momentum about the contact",
    momentum[0],
    "varies by",
    np.ptp(momentum, axis=0),
)
assert np.ptp(energy) < 1e-9 * energy[0]  # rtol 1e-11 over 20 s
assert np.ptp(momentum, axis=0).max() < 1e-9 * np.abs(momentum[0]).max()

# %% [markdown]
# ## Where it goes
#
# Straight on for the eye, but its speed along the way and across it never settles.

# %%
path = np.asarray(run.position)
along = path[-1, :2] / np.linalg.norm(path[-1, :2])
across = path[:, :2] @ np.array([-along[1], along[0]])
figure, (upper, lower) = plt.subplots(2)
upper.plot(path[:, 0], path[:, 1])
upper.set_xlabel("x [m]")
upper.set_ylabel("y [m]")
lower.plot(times, across)
lower.set_xlabel("time [s]")
_ = lower.set_ylabel("off the straight line [m]")

# %% [markdown]
# ## Is it chaotic?
#
# An integrable motion has no positive Lyapunov exponent. Neighbours part in proportion
# to the time, not exponentially: the distance of a neighbour, over time.

# %%
near = rk.place(
    ball.scene,
    ball.start.orientation,
    run.angular_velocity[0] * (1.0 + 1e-7),
    (0.0, 0.0, 0.0),
)
apart = rk.simulate(ball.scene, near, times, rtol=1e-11).position - run.position
distance = np.linalg.norm(np.asarray(apart), axis=1)
plt.loglog(times[1:], distance[1:])
plt.xlabel("time [s]")
_ = plt.ylabel("distance of a neighbour [m]")

# %%
growth = distance[-1] / distance[100]
print(f"from 1 s to 20 s the distance grows {growth:.1f} times")
assert growth < 60.0
