# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # First steps: a coin that rolls, and how its path depends on the spin
#
# A thin coin of radius 25 cm rolls on a plane. We place it, simulate it, look at what
# the plane has to do to hold it, and differentiate its path by the spin.

# %%
import jax
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)
RADIUS, MASS, END = 0.25, 1.0, 3.0

# %% [markdown]
# The body is its mass, its inertia about the mass centre and its surface: here the
# sharp rim of a disc in the plane z = 0 of the body. Base and loads are left out, which
# means a horizontal plane at rest and gravity.

# %%
coin = rk.Body(
    mass=MASS,
    inertia=np.diag([0.25, 0.25, 0.5]) * MASS * RADIUS**2,
    surface=rk.DiscEdge(RADIUS),
)
scene = rk.Scene(coin)

# %% [markdown]
# `place` finds the contact. The orientation is a unit quaternion, scalar first, that
# takes body to fixed axes; here the coin leans 20 degrees. The angular velocity is on
# fixed axes.

# %%
half = np.deg2rad(70.0) / 2
lean = (np.cos(half), np.sin(half), 0.0, 0.0)


def run(spin):
    """Roll with a given spin about the coin's own axis [rad/s]."""
    axis = jax.numpy.array([0.0, -np.sin(2 * half), np.cos(2 * half)])
    start = rk.place(scene, lean, spin * axis, (0.0, 0.0, 0.0))
    return rk.simulate(scene, start, np.linspace(0.0, END, 301), rtol=1e-10)


result = run(6.0)
print(result.reason, "in", int(result.steps), "steps")

# %% [markdown]
# Energy is kept to what the tolerance promises, and the contact never pulls.

# %%
energy = np.asarray(result.energy)
print("energy drift", np.ptp(energy) / energy[0])
print("least normal force [N]", float(result.normal_force.min()))
print("friction needed", float(result.friction_ratio.max()))
assert np.ptp(energy) < 1e-8 * energy[0]
assert np.isnan(result.first_pull)

# %% [markdown]
# How far does the end of the path move with the spin? One forward derivative.

# %%
end, slope = jax.jvp(lambda spin: run(spin).position[-1], (6.0,), (1.0,))
print("end [m]", end, "by spin [m s]", slope)
step = 1e-4
difference = (run(6.0 + step).position[-1] - run(6.0 - step).position[-1]) / (2 * step)
assert np.allclose(slope, difference, atol=1e-6)

# %% [markdown]
# Many spins at once: `vmap` over whatever changes.

# %%
spins = jax.numpy.linspace(5.0, 8.0, 4)
ends = jax.vmap(lambda spin: run(spin).position[-1])(spins)
for spin, place in zip(spins, ends, strict=True):
    print(f"spin {float(spin):.1f} rad/s ends at", np.round(np.asarray(place), 4))
