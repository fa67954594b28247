"""What a body that rolls in or on the rolling body costs, and SymPy beside it.

    python benchmarks/rolling_bodies.py [--out FOLDER] [--repeats N]

A shell on a plane alone, with a ball that rolls in it, with an ellipsoid, with two
balls, with a shell in which a ball rolls, and a ball with a ball on top. Time a step of
a native run (Dopri8 at rtol 1e-9, least of the repeats, of 10 s), first result and
first gradient in a process of its own with an empty cache, and equations of the
right-hand side. The ball in the shell by SymPy's Kane's method and SciPy, derived and
run, too. Prints a table and writes it as JSON.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)

SECONDS = 10.0
LEVEL = (1.0, 0.0, 0.0, 0.0)
PEER = Path(__file__).parent / "peers" / "sympy_ball_in_shell.py"


def cavity(radius):
    """A spherical cavity."""
    return rk.Sphere(radius, inside=True)


def ball(mass, radius, center=(0.0, 0.0, 0.0)):
    """A homogeneous ball, or one with its mass centre moved."""
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    return rk.Body(mass, inertia, rk.Sphere(radius), center)


def scenes():
    """Name -> the parts that roll on the shell, and the state of each."""
    heavy = ball(0.7, 0.1, (0.01, 0.02, -0.015))
    egg = rk.Body(0.5, 2e-3 * np.eye(3), rk.Ellipsoid((0.08, 0.1, 0.12)))
    one = rk.RollingBody(heavy, cavity(0.3))
    small = rk.RollingBody(ball(0.3, 0.08), cavity(0.18))
    nested = rk.RollingBody(ball(0.6, 0.2), cavity(0.3), small)
    spin, bottom = (1.3, 0.7, -0.5), (0.0, 0.0, -0.3)
    own = one.place(LEVEL, spin, bottom)
    other = rk.RollingBody(ball(0.2, 0.05), cavity(0.3))
    inside = small.place(LEVEL, spin, (0.0, 0.0, -0.18))
    on_top = rk.RollingBody(heavy, rk.Sphere(0.3))
    in_cavity = rk.RollingBody(egg, cavity(0.3))
    return {
        "shell alone": ((), ()),
        "ball in it": (one, own),
        "ellipsoid in it": (in_cavity, in_cavity.place(LEVEL, spin, bottom)),
        "two balls in it": (
            (one, other),
            (own, other.place(LEVEL, spin, (0.0, 0.3, 0.0))),
        ),
        "ball in a shell in it": (
            nested,
            nested.place(LEVEL, spin, bottom, supported=inside),
        ),
        "ball on it": (on_top, on_top.place(LEVEL, spin, (0.0, 0.0, 0.3))),
    }


def scene_of(name):
    """A scene and its start."""
    parts, states = scenes()[name]
    shell = rk.Body(1.0, np.diag([0.05, 0.045, 0.055]), rk.Sphere(0.3))
    scene = rk.Scene(shell, supported=parts)
    start = rk.place(scene, LEVEL, (0.5, 1.0, 2.0), (0.0, 0.0, 0.0), supported=states)
    return scene, start


def first(name):
    """Seconds to the first result and, after it, to the first gradient; own process."""
    scene, start = scene_of(name)
    began = time.perf_counter()
    jax.block_until_ready(rk.simulate(scene, start, [0.0, 1.0]).state)
    result = time.perf_counter() - began

    def height(start):
        return rk.simulate(scene, start, [0.0, 1.0]).state.contact_on_base[-1, 0]

    began = time.perf_counter()
    jax.block_until_ready(jax.grad(height)(start))
    return {"first": result, "gradient": time.perf_counter() - began}


def apart(name):
    """``first`` in a process of its own, with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        command = [sys.executable, __file__, "--first", name]
        done = subprocess.run(
            command,
            env=os.environ | {"ROLLKANE_CACHE": cache},
            check=True,
            capture_output=True,
            text=True,
        )
    return json.loads(done.stdout.splitlines()[-1])


def measure(name, repeats):
    """A row of the table."""
    scene, start = scene_of(name)
    run = jax.jit(lambda start: rk.simulate(scene, start, [0.0, SECONDS], rtol=1e-9))
    result = jax.block_until_ready(run(start))
    assert result.method == "native"
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(run(start))
        times.append(time.perf_counter() - began)
    steps = int(result.steps) + int(result.rejected_steps)
    clock = jnp.asarray(0.0)
    equations = len(jax.make_jaxpr(rk.rolling_derivative)(scene, clock, start).eqns)
    return {
        "steps": steps,
        "step": min(times) / steps,
        "run": min(times),
        "equations": equations,
        **apart(name),
    }


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--repeats", type=int, default=51)
    parser.add_argument("--first", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.first:
        print(json.dumps(first(given.first)))
        return
    rows = {name: measure(name, given.repeats) for name in scenes()}
    bare = rows["shell alone"]["step"]
    print(
        f"{'':24}{'us a step':>10}{'ratio':>7}{'steps':>7}{'first s':>9}{'grad s':>8}"
    )
    for name, row in rows.items():
        print(
            f"{name:24}{1e6 * row['step']:10.2f}{row['step'] / bare:7.2f}"
            f"{row['steps']:7d}{row['first']:9.2f}{row['gradient']:8.2f}"
        )
    command = [sys.executable, str(PEER), "--seconds", str(SECONDS)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    peer = json.loads(done.stdout)
    scene, start = scene_of("ball in it")
    seen = rk.simulate(scene, start, [0.0, SECONDS], rtol=1e-11).rolling_body(0)
    apart_by = float(np.abs(np.asarray(seen.position[-1]) - peer["ball"]).max())
    ours = rows["ball in it"]
    print(
        f"ball in a shell by SymPy: derived in {peer['build']:.2f} s, {SECONDS:g} s of "
        f"motion in {peer['run']:.2f} s (here {ours['first']:.2f} s and "
        f"{ours['run']:.2g} s); the ball's places differ by {apart_by:.1e} m"
    )
    if given.out:
        machine = {"machine": platform.machine(), "cores": os.cpu_count()}
        found = {"rows": rows, "sympy": peer, "differ": apart_by, **machine}
        text = json.dumps(found, indent=1) + "\n"
        (given.out / "rolling_bodies.json").write_text(text)


if __name__ == "__main__":
    main()
