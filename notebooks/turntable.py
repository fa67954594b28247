# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # A ball on a turntable, and the number 2/7
#
# Put a ball on a turning table and it does not fly off: it goes round a circle, at 2/7
# of the table's rate, wherever and however it was put down. The number is only the
# ball's inertia: with $I = k m r^2$ the rate is $\Omega\, k / (1 + k)$, and a
# homogeneous ball has $k = 2/5$.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)

MASS, RADIUS, RATE = 0.1, 0.025, 4.0  # kg, m, rad/s
TIMES = np.linspace(0.0, 5.0, 501)


def table(k):
    """A ball of inertia k m r^2 on a table that turns."""
    body = rk.Body(MASS, k * MASS * RADIUS**2 * jnp.eye(3), rk.Sphere(RADIUS))
    return rk.Scene(body, rk.Base(rk.Plane(), motion=rk.Spin(RATE)))


def thrown(k, speed=0.3):
    """How it moves when it is put down at (0.2, 0) m with a velocity along y [m/s]."""
    w = (-speed / RADIUS, 0.0, 0.0)
    return rk.simulate(
        table(k),
        rk.place(table(k), (1.0, 0.0, 0.0, 0.0), w, (0.2, 0.0, 0.0)),
        TIMES,
        rtol=1e-11,
    )


# %% [markdown]
# ## Circles
#
# Three throws of the same ball. Seen from the room all of them are circles, of one
# rate.

# %%
for speed in (0.1, 0.3, 0.6):
    path = np.asarray(thrown(0.4, speed).position)
    plt.plot(path[:, 0], path[:, 1], label=f"{speed} m/s")
plt.axis("equal")
plt.xlabel("x [m]")
plt.ylabel("y [m]")
_ = plt.legend()

# %% [markdown]
# ## The rate, for any inertia
#
# The velocity of a motion on a circle turns at its rate. From a massive centre ($k =
# 0$) to a thin shell ($k = 2/3$), all at once by `jax.vmap`.

# %%
inertias = jnp.linspace(0.1, 2.0 / 3.0, 8)


@jax.jit
def rate(k):
    v = thrown(k).velocity
    direction = jnp.unwrap(jnp.arctan2(v[:, 1], v[:, 0]))
    return (direction[-1] - direction[0]) / TIMES[-1]


rates = jax.vmap(rate)(inertias)
expected = RATE * inertias / (1.0 + inertias)
for k, found, formula in zip(inertias, rates, expected, strict=True):
    print(f"k = {k:.3f}: {found:.10f} rad/s, by the formula {formula:.10f}")
np.testing.assert_allclose(rates, expected, rtol=1e-8)  # rtol 1e-11, 5 s
print("a homogeneous ball:", float(rate(0.4)) / RATE, "is 2/7 =", 2 / 7)

# %% [markdown]
# ## What is kept
#
# The energy is not: the table does work. Kept is the moving energy $E - \Omega J_z$.

# %%
run = thrown(0.4)
energy, moving = np.asarray(run.energy), np.asarray(run.moving_energy)
print("energy from", energy.min(), "to", energy.max(), "J")
print("moving energy varies by", np.ptp(moving), "J")
assert np.ptp(moving) < 1e-9 * energy.max()
