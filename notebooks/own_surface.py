# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # A surface of your own
#
# A surface is a function: a height, a profile, a parametrization, or a level set. What
# the equations need of it (frames, curvatures, their derivatives) follows by automatic
# differentiation.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)
TIMES = np.linspace(0.0, 3.0, 301)

# %% [markdown]
# ## A landscape
#
# A ball on z = f(x, y): hills, as a height.


# %%
def height(x, y):
    """Of the ground [m]."""
    return 0.1 * jnp.sin(2.0 * x) * jnp.cos(2.0 * y) + 0.02 * (x**2 + y**2)


ball = rk.Body(1.0, 0.4 * 0.05**2 * np.eye(3), rk.Sphere(0.05))
hills = rk.Scene(ball, rk.Base(rk.Graph(height, domain=((-3, 3), (-3, 3)))))
there = (0.5, 0.2, float(height(0.5, 0.2)))
start = rk.place(hills, (1.0, 0.0, 0.0, 0.0), (0.0, 10.0, 0.0), there)
run = rk.simulate(hills, start, TIMES)
x, y = np.meshgrid(np.linspace(-1.5, 1.5, 90), np.linspace(-1.5, 1.5, 90))
plt.contourf(x, y, height(x, y), 20, cmap="Greys")
plt.plot(*np.asarray(run.contact_on_base)[:, :2].T)
plt.axis("equal")
plt.xlabel("x [m]")
plt.ylabel("y [m]")
energy = np.asarray(run.energy)
print("energy varies by", np.ptp(energy), "J; first pull:", float(run.first_pull))
assert np.ptp(energy) < 1e-6 * np.abs(energy).max()

# %% [markdown]
# ## One body in three ways
#
# An ellipsoid that is ready, the same as a level set, and as a parametrization: the
# same motion.

# %%
a, b, c = 0.10, 0.08, 0.06
inertia = 0.2 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])


def at(q1, q2):
    """Longitude and latitude -> a point of the ellipsoid [m]."""
    round_axis = a * jnp.cos(q1) * jnp.cos(q2), b * jnp.sin(q1) * jnp.cos(q2)
    return jnp.stack([*round_axis, c * jnp.sin(q2)])


def level(x, y, z):
    """Below zero in the material."""
    return (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 - 1.0


surfaces = {
    "ready": rk.Ellipsoid((a, b, c)),
    "level set": rk.Implicit(level, size=0.2),
    "parametrized": rk.Parametric(at),
}
ends = {}
for name, surface in surfaces.items():
    scene = rk.Scene(rk.Body(1.0, inertia, surface))
    leaning = (np.cos(0.5), np.sin(0.5), 0.0, 0.0)
    start = rk.place(scene, leaning, (1.0, 2.0, 0.5), (0.0, 0.0, 0.0))
    ends[name] = rk.simulate(scene, start, (0.0, 1.0), rtol=1e-10).position[-1]
    print(f"{name:12s}", ends[name])
for end in ends.values():  # rtol 1e-10, lengths of order one
    np.testing.assert_allclose(end, ends["ready"], rtol=0, atol=1e-7)

# %% [markdown]
# ## A surface with a parameter
#
# Derivatives go through the surface, too: how does the end depend on the height of the
# hills?


# %%
def wave(x, y, size):
    """A height that depends on a number of its own."""
    return size * jnp.sin(x) + 0.0 * y


def end_of(size):
    """Where the ball is after a second [m]."""
    scene = rk.Scene(ball, rk.Base(rk.Graph(wave, size)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 0.0))
    return rk.simulate(scene, start, jnp.array([0.0, 1.0]), rtol=1e-10).position[-1, 0]


slope = jax.grad(end_of)(0.1)
difference = (end_of(0.1 + 1e-4) - end_of(0.1 - 1e-4)) / 2e-4
print(f"{slope:.8f}, by differences {difference:.8f}")
assert abs(slope - difference) < 1e-5
