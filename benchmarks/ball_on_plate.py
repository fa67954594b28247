"""A ball that a tilting plate takes round a square, from rest to rest at each corner.

    python benchmarks/ball_on_plate.py [--out FOLDER]

The plate tilts about two axes by smooth functions of time with twelve numbers for each;
Newton's method with the least change finds them by exact derivatives of the runs, 24
tangents at a time. Prints how long that took, after compiling, and what is left of the
errors; writes it as JSON and draws the path and the tilts.
"""

import argparse
import json
import os
import platform
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)

SIDE, EDGE, WAVES = 0.3, 1.5, 3  # of the square [m], of an edge's time [s]
RADIUS = 0.02
CORNERS = SIDE * np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
TIMES = EDGE * np.arange(5.0)
BALL = rk.Body(0.2, 0.4 * 0.2 * RADIUS**2 * np.eye(3), rk.Sphere(RADIUS))


def tilts(t, numbers):
    """Angles of the plate about x and y [rad]: level, with its rates, at corners."""
    found = 0.0
    for edge in range(4):
        share = t / EDGE - edge
        angle = 2.0 * jnp.pi * share
        shapes = jnp.ones_like(angle), jnp.sin(angle), jnp.sin(2.0 * angle)
        waves = jnp.stack(shapes)
        on = jnp.where((share > 0.0) & (share < 1.0), 1.0 - jnp.cos(angle), 0.0)
        found = found + on * jnp.sum(numbers[edge] * waves[None], axis=1)
    return found


def tilted(t, numbers):
    """Rotation of the plate, to fixed axes."""
    a, b = tilts(t, numbers)
    zero = jnp.zeros_like(a)
    rows = [
        [jnp.cos(b), zero, jnp.sin(b)],
        [jnp.sin(a) * jnp.sin(b), jnp.cos(a), -jnp.sin(a) * jnp.cos(b)],
        [-jnp.cos(a) * jnp.sin(b), jnp.sin(a), jnp.cos(a) * jnp.cos(b)],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def moved(numbers, times=TIMES):
    """The run with given numbers of the tilts."""
    plate = rk.Base(rk.Plane(), rk.BaseMotion(rotation=tilted, parameters=numbers))
    scene = rk.Scene(BALL, plate)
    still = (0.0, 0.0, 0.0)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), still, still)
    return rk.simulate(scene, start, times, rtol=1e-10)


def errors(numbers):
    """Places and velocities at the corners, less what they should be [m], [m/s]."""
    run = moved(numbers)
    places = run.contact_on_base[1:, :2] - CORNERS
    speeds = RADIUS * run.angular_velocity[1:, :2]
    return jnp.concatenate([places, speeds], axis=1).reshape(-1)


@jax.jit
def looked_at(numbers):
    """Errors and their derivatives."""
    return errors(numbers), jax.jacfwd(errors)(numbers)


def solved(most=20):
    """Numbers that leave no error, and how often the derivatives were looked at."""
    numbers = np.zeros((4, 2, WAVES))
    for count in range(1, most + 1):
        left, slopes = (np.asarray(x) for x in looked_at(numbers))
        if np.abs(left).max() < 1e-10:
            return numbers, left, count
        change = np.linalg.lstsq(slopes.reshape(left.size, -1), -left, rcond=1e-8)[0]
        size = np.abs(change).max()
        numbers = numbers + min(1.0, 0.05 / size) * change.reshape(numbers.shape)
    raise SystemExit(f"not solved: {np.abs(left).max():.1e} left")


def drawn(numbers, path):
    """Path on the plate and tilts, as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    times = np.linspace(0.0, TIMES[-1], 601)
    run = moved(numbers, times)
    place = np.asarray(run.contact_on_base)
    angles = np.degrees(jax.vmap(lambda t: tilts(t, numbers))(jnp.asarray(times)))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9.0, 3.8), layout="constrained", width_ratios=(1, 1.5)
    )
    left.plot(place[:, 0], place[:, 1], color="#1f4e9b")
    left.plot(*np.vstack([CORNERS, CORNERS[:1]]).T, "o", color="#c8501e")
    left.set(xlabel="x on the plate (m)", ylabel="y (m)", aspect="equal")
    for k, (name, style) in enumerate((("about x", "-"), ("about y", "--"))):
        right.plot(times, angles[:, k], style, color="#1f4e9b", label=name)
    right.set(xlabel="time (s)", ylabel="tilt (degrees)")
    right.legend(frameon=False, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    for corner in TIMES[1:-1]:
        right.axvline(corner, color="#c0c4cc", zorder=0)
    figure.savefig(path, dpi=150)


def main():
    """Solve, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path)
    out = parser.parse_args().out
    began = time.perf_counter()
    jax.block_until_ready(looked_at(np.zeros((4, 2, WAVES))))
    compiled = time.perf_counter() - began
    times = []
    for _ in range(5):
        began = time.perf_counter()
        numbers, left, count = solved()
        times.append(time.perf_counter() - began)
    taken = float(np.median(times))
    all_times = jnp.linspace(0.0, TIMES[-1], 601)
    angles = jax.vmap(lambda t: tilts(t, numbers))(all_times)
    steepest = float(np.degrees(np.abs(angles).max()))
    spin = float(moved(numbers).angular_velocity[-1, 2])
    print(
        f"solved in {taken:.3f} s (median of 5), {count} runs with 24 tangents; first "
        f"one {compiled:.1f} s; errors below {np.abs(left).max():.1e} m and m/s; tilts "
        f"up to {steepest:.1f} degrees; the ball spins by {spin:.1e} rad/s in the end"
    )
    if out:
        found = {
            "solved": taken,
            "first": compiled,
            "looks": count,
            "left": float(np.abs(left).max()),
            "steepest": steepest,
            "spin": spin,
            "machine": platform.machine(),
            "cores": os.cpu_count(),
        }
        text = json.dumps(found, indent=1) + "\n"
        (out / "ball_on_plate.json").write_text(text)
        drawn(numbers, out / "ball_on_plate.png")


if __name__ == "__main__":
    main()
