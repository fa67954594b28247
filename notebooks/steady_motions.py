# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # Steady motions: when does a disc stay upright, and a top asleep?
#
# A steady motion is one that a symmetry makes: every instant looks like the first, from
# a frame that glides and turns along. We find some, ask whether they are stable, and
# follow them through a parameter.

# %%
import jax
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)
G, RADIUS = 9.81, 0.3

# %% [markdown]
# ## A disc that rolls upright
#
# On a horizontal plane it may be moved along x and y, turned about the vertical, and
# turned about its own axle: four symmetries, which are found by numbers.

# %%
disc = rk.Scene(
    rk.Body(1.0, RADIUS**2 * np.diag([0.25, 0.25, 0.5]), rk.DiscEdge(RADIUS))
)
print(rk.symmetries(disc).names)
edgewise = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
guess = rk.place(disc, edgewise, (0.0, 5.0, 0.0), (0.0, 0.0, 0.0))
motion = rk.steady_motion(disc, guess, {"speed": 1.5, "tilt": np.pi / 2})
print(motion)

# %% [markdown]
# It is stable at 1.5 m/s. How slow may it be? The branch in the speed has one zero
# crossing, at `v^2 = g a / 3`.

# %%
branch = rk.steady_family(disc, motion, "hold.speed", (0.3, 3.0))
print(branch)
assert abs(branch.critical[0].value ** 2 - G * RADIUS / 3.0) < 1e-12
branch.plot("disc.png")

# %% [markdown]
# ## A spheroid that sleeps on its tip
#
# Here two pairs of eigenvalues meet on the imaginary axis and leave it: the spin that
# holds it up has a closed form.

# %%
a, c = 0.2, 0.3
A, C, h, r = 0.2 * (a * a + c * c), 0.4 * a * a, c, a * a / c
egg = rk.Scene(rk.Body(1.0, np.diag([A, A, C]), rk.Ellipsoid((a, a, c))))
start = rk.place(egg, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 60.0), (0.0, 0.0, 0.0))
asleep = rk.steady_motion(egg, start, ("spin",))
tops = rk.steady_family(egg, asleep, "hold.spin", (5.0, 60.0))
print(tops)
threshold = 2.0 * np.sqrt((A + h * h) * G * (h - r)) / (C + h * r)
assert abs(tops.critical[0].value - threshold) < 1e-9

# %% [markdown]
# ## The nonlinear motion agrees
#
# A touch beside the steady motion grows or does not, as the eigenvalues say.

# %%
for spin in (0.8 * threshold, 1.2 * threshold):
    beside = rk.place(egg, (1.0, 1e-4, 0.0, 0.0), (0.0, 0.0, spin), (0.0, 0.0, 0.0))
    run = rk.simulate(egg, beside, np.linspace(0.0, 2.0, 201))
    q = np.asarray(run.orientation)
    lean = 2.0 * np.hypot(q[:, 1], q[:, 2]).max()
    print(f"spin {spin:.2f} rad/s: largest lean {lean:.2g} rad")
