"""What events cost: ensembles that stop early, and single runs, against plain ones.

    python benchmarks/events.py [--members 10000] [--repeats 5] [--out FOLDER]

A ball rolls off a ball, in the compiled loop on one core, best of some repeats of the
loop alone: time for each tried and for each accepted step, of a plain ensemble over as
long as the stopped ones take on average, of one that is watched and of ones whose
members stop; then what a watched single run costs. Prints a table, writes it as JSON.
"""

import argparse
import json
import platform
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.codegen import LaneLoop

jax.config.update("jax_enable_x64", True)

BALL = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
SCENE = rk.Scene(BALL, rk.Base(rk.Sphere(1.0)))
SECTION = rk.Event.section((0.0, 0.0, 1.0), 0.9, -1, stop=True)


def start_of(angle):
    where = jnp.stack([jnp.sin(angle), 0.0 * angle, jnp.cos(angle)])
    return rk.place(SCENE, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), where)


def best(run, repeats):
    """Result, and the shortest time that the compiled loop took [s]."""
    spent = [0.0]
    loop = LaneLoop.run

    def timed(self, *given):
        begun = time.perf_counter()
        found = loop(self, *given)
        spent[0] += time.perf_counter() - begun
        return found

    LaneLoop.run = timed
    times = []
    try:
        for _ in range(repeats + 1):
            spent[0] = 0.0
            found = run()
            times.append(spent[0])
    finally:
        LaneLoop.run = loop
    return found, min(times[1:])


def ensembles(members, repeats):
    starts = jax.vmap(start_of)(jnp.linspace(1e-3, 0.3, members))
    stopped = rk.ensemble(SCENE, starts, (0.0, 4.0), rtol=1e-9, stop="lift-off")
    end = float(np.mean(stopped.final_time))
    cases = {
        "plain": {"times": (0.0, end)},
        "watched": {"times": (0.0, end), "events": "lift-off"},
        "stop at lift-off": {"times": (0.0, 4.0), "stop": "lift-off"},
        "stop at a section": {"times": (0.0, 4.0), "stop": SECTION},
    }
    found = {}
    for name, how in cases.items():
        run = lambda how=how: rk.ensemble(SCENE, starts, rtol=1e-9, workers=1, **how)
        result, spent = best(run, repeats)
        steps = int(np.sum(result.steps))
        tried = steps + int(np.sum(result.rejected_steps))
        found[name] = {
            "steps": steps / members,
            "tried": tried / members,
            "ns per try": spent / tried * 1e9,
            "ns per step": spent / steps * 1e9,
        }
    return found


def alone(repeats):
    start = start_of(jnp.asarray(0.05))
    found = {}
    for name, how in {"plain": {}, "watched": {"events": "lift-off"}}.items():
        times = []
        for _ in range(20 * repeats):
            begun = time.perf_counter()
            rk.simulate(SCENE, start, (0.0, 2.0), **how).code.block_until_ready()
            times.append(time.perf_counter() - begun)
        found[name] = min(times[1:])
    return found


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--members", type=int, default=10_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    lanes, single = ensembles(given.members, given.repeats), alone(given.repeats)
    print("| | steps | tried | ns per try | ns per step |\n|---|--:|--:|--:|--:|")
    for name, row in lanes.items():
        print(f"| {name} | " + " | ".join(f"{x:.1f}" for x in row.values()) + " |")
    for name, spent in single.items():
        print(f"single run, {name}: {spent * 1e3:.3f} ms")
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        told = {"machine": platform.machine(), "ensembles": lanes, "single": single}
        (given.out / "events.json").write_text(json.dumps(told, indent=1))


if __name__ == "__main__":
    main()
