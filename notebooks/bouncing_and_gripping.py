# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # Bouncing and gripping
#
# With `Modes` a run changes between rolling, slipping and flight as the contact
# demands. Each change is an event of the integration, located to rounding, and
# derivatives go through it.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)
G, RADIUS = 9.81, 0.11
ball = rk.Body(6.0, 0.4 * 6.0 * RADIUS**2 * np.eye(3), rk.Sphere(RADIUS))
scene = rk.Scene(ball)
LEVEL, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)

# %% [markdown]
# ## A bowling ball grips
#
# Thrown at 8 m/s without turning it slides; friction slows it and turns it until it
# grips at $2 v / (7 \mu g)$, with 5/7 of its speed.

# %%
MU, SPEED = 0.2, 8.0
sliding = rk.Scene(ball, contact=rk.Slipping(rk.CoulombFriction(MU)))
start = rk.place(sliding, LEVEL, STILL, STILL, velocity=(SPEED, 0.0, 0.0))
times = np.linspace(0.0, 2.0, 201)
run = rk.simulate(scene, start, times, modes=rk.Modes(friction=MU))
print(run.switches)
grips = float(run.switches.time[0])
print("by the formula", 2 * SPEED / (7 * MU * G))
assert abs(grips - 2 * SPEED / (7 * MU * G)) < 1e-10
assert abs(run.velocity[-1, 0] - 5 / 7 * SPEED) < 1e-8
plt.plot(times, run.velocity[:, 0], label="centre")
plt.plot(times, RADIUS * run.angular_velocity[:, 1], label="radius times turning")
plt.xlabel("time [s]")
plt.ylabel("[m/s]")
_ = plt.legend()

# %% [markdown]
# ## The time of gripping has a derivative
#
# By the coefficient of friction, through the event: $-2 v / (7 \mu^2 g)$.


# %%
def gripping(mu):
    """When the ball grips [s]."""
    run = rk.simulate(scene, start, jnp.array([0.0, 2.0]), modes=rk.Modes(friction=mu))
    return run.switches.time[0]


slope = jax.jacfwd(gripping)(MU)
print(float(slope), "by the formula", -2 * SPEED / (7 * MU**2 * G))
assert abs(slope / (-2 * SPEED / (7 * MU**2 * G)) - 1.0) < 1e-8

# %% [markdown]
# ## Backspin
#
# Let go with backspin a ball bounces, and each bounce rubs: the spin turns it back.
# Energy goes at each landing, by restitution and friction, until it rolls.

# %%
up = rk.release(scene, LEVEL, (0.0, -80.0, 0.0), (0.0, 0.0, 0.5), (2.0, 0.0, 0.0))
times = np.linspace(0.0, 4.0, 801)
modes = rk.Modes(friction=0.3, restitution=0.7)
run = rk.simulate(scene, up, times, modes=modes)
print(run.switches)
figure, (upper, lower) = plt.subplots(2)
upper.plot(run.position[:, 0], run.position[:, 2])
upper.set_xlabel("x [m]")
upper.set_ylabel("z [m]")
lower.plot(times, run.energy)
lower.set_xlabel("time [s]")
_ = lower.set_ylabel("energy [J]")
energy = np.asarray(run.energy)
assert (np.diff(energy) < 1e-9 * energy[0]).all()
