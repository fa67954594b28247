# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # Euler's disc: why a coin rings ever faster
#
# A coin that has nearly lain down runs round on its edge, and the faster the flatter it
# is. With its centre at rest a disc of radius $R$ at the angle $\alpha$ off lying flat
# has
#
# $$
# \Omega^2 \sin\alpha = \frac{4 g}{R}
# $$
#
# for the rate $\Omega$ at which the contact runs round (a thin homogeneous disc).

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)

G, R, M = 9.81, 0.0375, 0.4  # m/s^2, m, kg
INERTIA = 0.25 * M * R**2 * np.diag([1.0, 1.0, 2.0])

# %% [markdown]
# ## The formula, from simulations
#
# A start with exactly this rate is steady: the contact goes round at $\Omega$ and the
# angle stays.

# %%
disc = rk.Scene(rk.Body(M, INERTIA, rk.DiscEdge(R)))
times = np.linspace(0.0, 0.2, 2001)


def start(tilt, scene=disc):
    """Steady, at an angle off lying flat [rad], with the centre at rest."""
    rate = np.sqrt(4 * G / (R * np.sin(tilt)))
    orientation = np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0
    turn = rate * np.sin(tilt)  # about the radius to the contact
    w = 0.0, turn * np.cos(tilt), turn * np.sin(tilt)
    return rk.place(scene, orientation, w, (0.0, -R * np.cos(tilt), 0.0)), rate


for degrees in (30.0, 10.0, 3.0, 1.0):
    placed, rate = start(np.deg2rad(degrees))
    run = rk.simulate(disc, placed, times, rtol=1e-11)
    place = np.asarray(run.contact_on_base)
    angle = np.unwrap(np.arctan2(place[:, 1], place[:, 0]))
    measured = abs(angle[-1] - angle[0]) / times[-1]
    print(f"{degrees:4.0f} degrees: {measured:9.4f} rad/s, by the formula {rate:9.4f}")
    assert abs(measured / rate - 1.0) < 1e-5

# %% [markdown]
# ## With losses
#
# Let a moment $f N$ work against rolling, $N$ the normal force. The energy of a nearly
# flat disc is $\tfrac32 m g R \alpha$, the power that is lost is
# $f N \Omega \sin\alpha$, so that $\sqrt\alpha$ falls in proportion to the time and is
# gone after
#
# $$
# T = \frac{3 R}{2 f} \sqrt{\frac{R \alpha_0}{g}}
# $$
#
# In between its rate grows without bound: a ring that rises, and stops at once.

# %%
ARM, TILT = 2e-4, 0.1  # m, rad
loads = rk.Gravity(), rk.RollingResistance(dry=ARM)
lossy = rk.Scene(rk.Body(M, INERTIA, rk.DiscEdge(R)), loads=loads)
ends = 1.5 * R / ARM * np.sqrt(R * TILT / G)
times = np.linspace(0.0, 0.98 * ends, 4001)
run = rk.simulate(lossy, start(TILT, lossy)[0], times, rtol=1e-9)
q = np.asarray(run.orientation)
tilt = 2.0 * np.arcsin(np.hypot(q[:, 1], q[:, 2]))
plt.plot(times, np.sqrt(tilt), label="simulated")
plt.plot([0.0, ends], [np.sqrt(TILT), 0.0], "--", label="nearly flat")
plt.xlabel("time [s]")
plt.ylabel("root of the angle off lying flat [rad$^{1/2}$]")
_ = plt.legend()
print(run.reason, f"at {float(run.final_time):.3f} s; flat at about {ends:.3f} s")
line = np.sqrt(TILT) * (1.0 - times / ends)
print("largest difference", np.nanmax(np.abs(np.sqrt(tilt) - line)))
