# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
# ---

# %% [markdown]
# # Kane's method, on the rolling disc
#
# The rolling core of rollkane solves one problem. `rollkane.kane` solves any: you
# write down how the velocities of a system depend on the speeds that you chose, and
# it finds the equations of motion. Here we do that for a disc that rolls on a table,
# look at each of Kane's quantities on the way, and end with the contact force and
# with the speed at which the disc begins to stand.

# %%
import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane import kane
from rollkane.geometry.rotations import about_axis

jax.config.update("jax_enable_x64", True)
MASS, RADIUS, G = 2.0, 0.5, 9.81
ACROSS, ALONG = MASS * RADIUS**2 / 4, MASS * RADIUS**2 / 2  # a diameter, the axle

# %% [markdown]
# ## Coordinates, and speeds
#
# Five coordinates say where the disc is: the contact point (x, y), the heading, the
# lean (0 is upright) and the turn about the axle. It has only three degrees of
# freedom in its velocities, because it does not slip: so three *generalized speeds* u
# are enough. Kane's freedom is to choose them. We take the angular velocity on "lean
# axes": along the path, along the axle, and along the radius away from the contact.
#
# The *kinematic equations* say how the coordinates change: q' = Y(q) u.


# %%
def kinematics(t, q, u):
    heading_rate = u[2] / jnp.cos(q[3])
    turn_rate = u[1] - heading_rate * jnp.sin(q[3])
    forward = RADIUS * turn_rate  # of the contact point along its path
    x_rate, y_rate = forward * jnp.cos(q[2]), forward * jnp.sin(q[2])
    return [x_rate, y_rate, heading_rate, u[0], turn_rate]


# %% [markdown]
# ## Velocities
#
# For each body: the velocity of its mass centre (on fixed axes) and its angular
# velocity (on its own axes). Rolling is in them already: the point at the contact is
# at rest, so that the centre's velocity is the angular velocity times the radius.


# %%
def to_fixed(q):
    """Lean axes to fixed axes."""
    return about_axis(2, q[2]) @ about_axis(0, q[3])


def velocity(t, q, u):
    return to_fixed(q) @ (RADIUS * jnp.stack([u[1], -u[0], 0.0 * u[2]]))


def spin(t, q, u):
    return about_axis(1, q[4]).T @ u[:3]


def weight(t, q, u):
    return jnp.array([0.0, 0.0, -MASS * G])


disc = kane.KaneSystem(
    coordinates=5,
    speeds=3,
    kinematics=kinematics,
    parts=[kane.RigidBody(MASS, np.diag([ACROSS, ALONG, ACROSS]), velocity, spin)],
    loads=[kane.Load(velocity, weight)],
)

# %% [markdown]
# ## Partial velocities and Kane's equations
#
# The velocities are linear in the speeds. Their coefficients are the *partial
# velocities*: the r-th says how the disc moves when only u_r is one. By hand they are
# picked out of long expressions; here they are derivatives.

# %%
q = jnp.array([0.0, 0.0, 0.3, 0.4, 0.0])
u = jnp.array([0.3, 4.5, 1.1])
partial = jax.jacfwd(velocity, argnums=2)(0.0, q, u)
print("partial velocities of the centre (columns):\n", np.round(partial, 3))

# %% [markdown]
# Forces count by what they do along the partial velocities: F_r = sum of force times
# partial velocity, the *generalized active forces*. The same with -m a and the rate
# of the angular momentum gives F_r*. Their sum is zero. What comes out is linear in
# u': `mass_matrix @ u' = forcing`.

# %%
equations = kane.kane_equations(disc, 0.0, q, u)
print("F_r:        ", np.round(equations.fr, 4))
print("mass matrix:\n", np.round(equations.mass_matrix, 4))
print("forcing:    ", np.round(equations.forcing, 4))
by_hand = np.array([MASS * G * RADIUS * np.sin(0.4), 0.0, 0.0])
np.testing.assert_allclose(equations.fr, by_hand, atol=1e-12)

# %% [markdown]
# The contact force is nowhere in this: it does nothing along a partial velocity,
# because the contact point does not move. That is what the method is for.
#
# ## Motion

# %%
times = np.linspace(0.0, 3.0, 301)
run = kane.simulate(disc, kane.KaneState(q, u), times, rtol=1e-11)
height = RADIUS * np.cos(run.q[:, 3])
energy = np.asarray(run.kinetic_energy) + MASS * G * height
print(run.reason, "in", int(run.steps), "steps; energy", np.ptp(energy) / energy[0])
assert np.ptp(energy) < 1e-9 * energy[0]

# %% [markdown]
# ## Other speeds, the same disc
#
# Rates of the coordinates as speeds, or the angular velocity on axes that turn with
# the disc: other equations, the same motion. `kane.rolling_disc` has all three.

# %%
rates = kinematics(0.0, q, u)[2:]
for choice in kane.DISC_SPEEDS:
    other = kane.rolling_disc(MASS, RADIUS, (ACROSS, ALONG), choice, G)
    start = kane.disc_state(q, jnp.stack(rates), choice)
    end = kane.simulate(other, start, times, rtol=1e-11).q[-1]
    print(f"{choice:18}", np.abs(end - run.q[-1]).max())
    np.testing.assert_allclose(end, run.q[-1], atol=1e-8)

# %% [markdown]
# ## The other way to roll: constraints
#
# One can also write a disc that may slip, with the velocity of its centre as two more
# speeds, and let velocity constraints take them away again: `dependent` speeds,
# SymPy's `u_dep`.


# %%
def free_velocity(t, q, u):
    """Of the centre: level parts are speeds of their own, height follows the lean."""
    rise = -RADIUS * u[0] * jnp.sin(q[3])
    return jnp.stack([u[3], u[4], rise])


def slip(t, q, u):
    """Level velocity of the disc's point at the contact."""
    return (free_velocity(t, q, u) - velocity(t, q, u))[:2]


constrained = kane.KaneSystem(
    coordinates=5,
    speeds=5,
    kinematics=kinematics,
    parts=[kane.RigidBody(MASS, np.diag([ACROSS, ALONG, ACROSS]), free_velocity, spin)],
    loads=[kane.Load(free_velocity, weight)],
    constraints=slip,
    dependent=(3, 4),
)
same = kane.kane_derivative(constrained, 0.0, kane.KaneState(q, u))
free = kane.kane_derivative(disc, 0.0, kane.KaneState(q, u))
np.testing.assert_allclose(same.u, free.u, rtol=1e-12)
print("u' either way:", np.round(free.u, 4))

# %% [markdown]
# ## The contact force, by auxiliary speeds
#
# Let the contact point move, in thought, with three *auxiliary speeds*. They stay
# zero; but now the contact force has partial velocities, and the equations of the
# auxiliary speeds give it.


# %%
def lifted(t, q, u):
    return velocity(t, q, u) + u[3:]


with_force = kane.KaneSystem(
    coordinates=5,
    speeds=3,
    kinematics=kinematics,
    parts=[kane.RigidBody(MASS, np.diag([ACROSS, ALONG, ACROSS]), lifted, spin)],
    loads=[kane.Load(lifted, weight)],
    auxiliary=3,
)
force = kane.reactions(with_force, 0.0, kane.KaneState(q, u))
print("contact force [N]:", np.round(force, 4))

# %% [markdown]
# The rolling core says the same. Its disc has the axle along z, so the orientation is
# another one.

# %%
coin = rk.Body(MASS, np.diag([ACROSS, ACROSS, ALONG]), rk.DiscEdge(RADIUS))
scene = rk.Scene(coin)
turn = np.asarray(to_fixed(q) @ about_axis(0, jnp.asarray(-np.pi / 2)))
scalar = 0.5 * np.sqrt(1.0 + np.trace(turn))
axis = np.array(
    [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
)
orientation = np.array([scalar, *(axis / (4.0 * scalar))])
placed = rk.place(scene, orientation, to_fixed(q) @ u, (0.0, 0.0, 0.0))
core = rk.simulate(scene, placed, [0.0, 0.1]).contact_force[0]
print("rolling core:     ", np.round(core, 4))
np.testing.assert_allclose(force, core, atol=1e-10)

# %% [markdown]
# ## Does it stand?
#
# `linearize` gives the dense matrices about a state, with what is dependent
# eliminated. An upright disc rolls straight ahead at any speed, but only above v =
# sqrt(g r / 3) do small leans stay small.


# %%
def growth(v):
    """Growth rate of small leans at speed v [1/s]."""
    ahead = kane.KaneState(jnp.zeros(5), jnp.array([0.0, v / RADIUS, 0.0]))
    A = kane.linearize(disc, 0.0, ahead, q_ind=(3,)).A
    return np.linalg.eigvals(np.asarray(A)).real.max()


critical = np.sqrt(G * RADIUS / 3.0)
for v in (0.9 * critical, 0.99 * critical, 1.01 * critical, 1.1 * critical):
    print(f"{v:.3f} m/s: leans grow by {growth(v):.3g} 1/s")
assert growth(0.99 * critical) > 0.1
assert growth(1.01 * critical) < 1e-6  # a double zero beside the oscillation

# %% [markdown]
# ## Derivatives
#
# Everything above is a function of its numbers. How does the end of the path move
# with the start's spin about the axle?


# %%
def end_of_path(turn_rate):
    start = kane.KaneState(q, u.at[1].set(turn_rate))
    return kane.simulate(disc, start, times[::30], rtol=1e-10).q[-1, :2]


slope = jax.jacfwd(end_of_path)(4.5)
step = 1e-4
difference = (end_of_path(4.5 + step) - end_of_path(4.5 - step)) / (2 * step)
print("by derivative:", slope, "by differences:", difference)
np.testing.assert_allclose(slope, difference, rtol=1e-4)
