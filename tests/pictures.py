"""Motions to draw, put together by hand: pictures need states, not a solve.

Flights do: their runs have modes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.simulation.trajectory import Code

ROWS = 24  # one number of states for all: their programs are compiled once


def ball(radius=0.1, offset=0.03) -> rk.Body:
    return rk.Body(
        mass=0.5,
        inertia=0.002 * np.eye(3),
        surface=rk.Sphere(radius),
        center_of_mass=(0.0, 0.0, offset),
    )


def motion(
    scene: rk.Scene,
    on_base: np.ndarray,
    spin: float = 5.0,
    reached: int | None = None,
    dtype=jnp.float64,
    on_body: np.ndarray | None = None,
) -> rk.Trajectory:
    """States of a body along given contact coordinates, shape (T, k).

    They obey no law, but every picture's quantity is defined in them. From row
    ``reached`` on, a run that stopped there. At spins above 10 the contact pulls.
    """
    count = len(on_base)
    time = np.linspace(0.0, 2.0, count)
    turn = np.stack([np.cos(3 * time), np.sin(3 * time), 0.4 * np.sin(time), 0 * time])
    spins = np.stack([0 * time, 0.8 * spin * np.cos(time), spin * np.sin(2 * time)])
    nothing = np.zeros((count, 0))
    on_body = nothing if on_body is None else on_body
    columns = [turn.T, spins.T, on_base, on_body, nothing, nothing.copy()]
    if reached is not None:
        for column in columns:
            column[reached:] = np.nan
    state = rk.State(*(jnp.asarray(column, dtype) for column in columns))
    scene = jax.tree.map(lambda x: x.astype(dtype), scene)
    stopped = reached is not None
    return rk.Trajectory(
        time=jnp.asarray(time, dtype),
        state=state,
        scene=scene,
        code=jnp.asarray(Code.STEP_TOO_SMALL if stopped else Code.COMPLETED),
        final_time=jnp.asarray(time[(reached or count) - 1], dtype),
        final_state=rk.State(
            *(jnp.asarray(column[(reached or count) - 1], dtype) for column in columns)
        ),
        steps=jnp.asarray(10),
        rejected_steps=jnp.asarray(0),
    )


def circle(count: int, radius: float = 0.3) -> np.ndarray:
    angle = np.linspace(0.0, 4.0, count)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def on_sphere(count: int) -> np.ndarray:
    """Normals that wind over the upper part of a sphere."""
    angle, lean = np.linspace(0.0, 5.0, count), np.linspace(0.2, 1.3, count)
    ring = np.sin(lean)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), np.cos(lean)], axis=1)


def rolling_on_plane(count: int = ROWS, **options) -> rk.Trajectory:
    return motion(rk.Scene(ball()), circle(count), **options)


def rolling_on_sphere(count: int = ROWS, **options) -> rk.Trajectory:
    scene = rk.Scene(ball(), rk.Base(rk.Sphere(0.5)))
    return motion(scene, on_sphere(count), **options)


def rolling_in_bowl(count: int = ROWS) -> rk.Trajectory:
    scene = rk.Scene(ball(), rk.Base(rk.Graph(lambda x, y: x * x + 0.5 * y * y)))
    return motion(scene, circle(count))


@functools.cache
def dropped_disc() -> rk.Trajectory:
    """A run with modes of a leaning disc that is let fall, bounces and rolls on."""
    inertia = np.diag([2.5e-3, 2.5e-3, 5e-3])
    scene = rk.Scene(rk.Body(1.0, inertia, rk.DiscEdge(0.1)))
    half = 0.5 * np.radians(70.0)
    start = rk.release(
        scene,
        (np.cos(half), np.sin(half), 0.0, 0.0),
        (0.0, 1.0, 8.0),
        (0.0, 0.0, 0.15),
        (0.0, 0.0, 0.0),
    )
    modes = rk.Modes(friction=0.8, restitution=0.3)
    return rk.simulate(scene, start, np.linspace(0.0, 0.5, 51), modes=modes)


@functools.cache
def thrown_disc() -> rk.Trajectory:
    """A run with modes that leaves its base at once, and nothing lands."""
    inertia = np.diag([2.5e-3, 2.5e-3, 5e-3])
    hill = rk.Base(rk.Graph(lambda x, y: -0.5 * x * x))
    scene = rk.Scene(rk.Body(1.0, inertia, rk.DiscEdge(0.1)), hill)
    half = 0.5 * np.radians(80.0)
    leaning = np.cos(half), np.sin(half), 0.0, 0.0
    start = rk.place(scene, leaning, (0.0, -40.0, 8.0), (0.0, 0.0, 0.0))
    modes = rk.Modes(friction=0.8)
    return rk.simulate(scene, start, np.linspace(0.0, 0.3, 31), modes=modes)
