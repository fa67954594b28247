# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # A spherical robot: a shell with a pendulum
#
# A shell with a driven pendulum inside rolls by shifting its weight. The pendulum's
# coordinate is its angle in the shell; a motor on the axle turns it.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)

ARM, BOB, SHELL, RADIUS = 0.08, 0.5, 0.8, 0.12  # m, kg, kg, m


def bob(alpha):
    """Where the bob is, on body axes [m]; the axle is y."""
    return ARM * jnp.stack([jnp.sin(alpha), 0.0 * alpha, -jnp.cos(alpha)], axis=1)


def motor(t, alpha, alpha_dot):
    """Its torque on the pendulum [N m]: a push at 1.5 s, and a brake all the time."""
    return 0.15 * jnp.exp(-(((t - 1.5) / 0.6) ** 2)) - 0.01 * alpha_dot


body = rk.Body(SHELL, 2 / 3 * SHELL * RADIUS**2 * np.eye(3), rk.Sphere(RADIUS))
robot = rk.Scene(body, supported=rk.PointMasses(BOB, bob, force=motor))

# %% [markdown]
# ## A start from rest
#
# The motor's torque holds the pendulum forward; the shell rolls under it, and the brake
# slows both.

# %%
start = rk.place(
    robot, (1, 0, 0, 0), (0, 0, 0), (0, 0, 0), alpha=np.zeros(1), alpha_dot=np.zeros(1)
)
times = np.linspace(0.0, 6.0, 601)
run = rk.simulate(robot, start, times, rtol=1e-10)
figure, (upper, lower) = plt.subplots(2, sharex=True)
upper.plot(times, run.velocity[:, 0])
upper.set_ylabel("speed [m/s]")
lean = np.unwrap(np.asarray(run.alpha[:, 0]))
lower.plot(times, lean)
lower.set_ylabel("pendulum in the shell [rad]")
_ = lower.set_xlabel("time [s]")

# %% [markdown]
# ## What the motor did
#
# All of the energy that the robot has is the motor's: `power` is the rate of the energy
# by what does work inside, and its integral is the change of the energy. Both have the
# same course.

# %%
energy, power = np.asarray(run.energy), np.asarray(run.power)
means = 0.5 * (power[1:] + power[:-1])
work = np.concatenate([[0.0], np.cumsum(means * np.diff(times))])
print(
    f"most that it has: {energy.max() - energy[0]:.6f} J, of the motor {work.max():.6f}"
)
# the trapezoidal rule on intervals of 0.01 s, of powers that change over 0.1 s
assert np.abs(energy - energy[0] - work).max() < 2e-3 * work.max()
print("friction needed", float(run.friction_ratio.max()))
print("least normal force", float(run.normal_force.min()), "N")

# %% [markdown]
# ## A gradient through the motion
#
# How far does it get with a stronger motor? The torque is a parameter, so there is a
# derivative.


# %%
def push(t, state, torque):
    """No torque on the shell, one on the pendulum [N m]."""
    return torque * jnp.array([0.0, 0.0, 0.0, 1.0])


def reach(torque):
    """Place after three seconds [m]."""
    driven = rk.with_feedback(
        rk.Scene(body, supported=rk.PointMasses(BOB, bob)),
        push,
        torque,
    )
    return rk.simulate(driven, start, jnp.array([0.0, 3.0]), rtol=1e-10).position[-1, 0]


slope = jax.grad(reach)(0.1)
difference = (reach(0.1001) - reach(0.0999)) / 2e-4
print(f"{slope:.6f} m per N m; by differences {difference:.6f}")
assert abs(slope / difference - 1.0) < 1e-4
