# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # How likely is a reversal? A Monte Carlo study
#
# A hand does not spin a stone twice alike. Let the spin, the tilt and the stone's mass
# centre be random: with which probability does it reverse within 3.4
# seconds, and when?

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk
from rollkane.dynamics.ready_observables import spin
from rollkane.files.scene_files import load_scene

jax.config.update("jax_enable_x64", True)
stone = load_scene("rattleback").scene.body

# %% [markdown]
# ## What is random, what is looked at
#
# `make` turns one draw into a scene and its start. The spin about the vertical ripples
# as the stone rocks, so that a zero of it is no reversal yet: the event is where it
# goes beyond 20 % of its mean at the start the other way, as summaries count them.


# %%
def make(draw):
    centre = draw["height"] * jnp.array([0.0, 0.0, 1.0])
    scene = rk.Scene(rk.Body(stone.mass, stone.inertia, stone.surface, centre))
    half = draw["tilt"] / 2  # about y; its z axis points down
    flipped = jnp.stack([0.0, jnp.cos(half), 0.0, -jnp.sin(half)])
    turning = draw["spin"] * jnp.array([0.0, 0.0, 1.0])
    return scene, rk.place(scene, flipped, turning, (0.0, 0.0, 0.0))


DISTRIBUTIONS = {
    "spin": rk.Normal(5.0, 0.5),  # rad/s
    "tilt": rk.Normal(0.01, 0.002),  # rad
    "height": rk.Uniform(0.009, 0.011),  # m
}


def beyond(scene, t, state):
    return spin(scene, t, state) + 0.2 * 5.0  # rad/s


reversal = rk.Event(beyond, direction=-1, name="reversal")
study = rk.Study(make, DISTRIBUTIONS, times=(0.0, 3.4), events=(reversal,))

# %% [markdown]
# ## A thousand stones
#
# Sobol samples cover the three numbers evenly; intervals say how sure the results are.

# %%
result = rk.monte_carlo(study, 1024, seed=1, sampling="sobol")
print(result)
probability = result.probability["reversal"]
low, high = result.interval("reversal")
print(f"reverses within 3.4 s: {probability:.3f}, between {low:.3f} and {high:.3f}")
assert 0.1 < low < probability < high < 0.99

# %% [markdown]
# ## When?
#
# Of those that reverse, the times, over the spin at the start.

# %%
first = np.asarray(result.values("reversal.time"))
first = first.reshape(len(first), -1)[:, 0]
spins = np.asarray(result.values("draw.spin"))
plt.scatter(spins, first, s=4)
plt.xlabel("spin at the start [rad/s]")
_ = plt.ylabel("reverses at [s]")

# %% [markdown]
# ## Which of the three decides?
#
# Sobol's indices share the variance of an output out among what is random: here the
# spin that is left after a second.

# %%
left = rk.Study(make, DISTRIBUTIONS, (0.0, 1.0), observe={"spin left": spin})
indices = rk.sobol_indices(left, 512, seed=1)
print(indices)
