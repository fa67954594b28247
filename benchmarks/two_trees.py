"""Two states of the source side by side: is any run slower than it was?

    git worktree add ../before COMMIT
    python benchmarks/two_trees.py ../before . [--rounds N]

Built-in scenes over 2 s at rtol 1e-8, by both methods, inside of jit; a gradient; a
batch of 256 by ``ensemble``; the wait for the first result. Each figure is measured in
processes of its own, those of both trees in turn. It is the least of all repeats and
rounds: what other work on the machine adds is no part of the program. Prints a table of
times and their ratio.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCENES = ("rolling-disc", "rattleback", "shell-with-pendulum", "isolator")
REPEATS, MEMBERS = 101, 256


def least_time(call):
    """Of a call [ms]."""
    import jax

    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        jax.block_until_ready(call())
        times.append(1e3 * (time.perf_counter() - began))
    return min(times)


def measured(name):
    """All figures of a scene [ms], with the tree that Python's path begins with."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import equinox as eqx
    import jax.numpy as jnp
    import numpy as np

    import rollkane as rk

    try:
        from rollkane.files.scene_files import load_scene
    except ImportError:  # as it was called before it was in a folder
        from rollkane.scene_files import load_scene
    file = load_scene(name)
    scene, start, times = file.scene, file.start, np.array([0.0, 2.0])

    def last(start, method):
        run = rk.simulate(scene, start, times, rtol=1e-8, method=method)
        return run.state.angular_velocity[-1]

    found = {}
    for method in ("native", "diffrax"):
        run = eqx.filter_jit(lambda s, method=method: last(s, method))
        began = time.perf_counter()
        jax.block_until_ready(run(start))
        found[f"{method}, first"] = 1e3 * (time.perf_counter() - began)
        found[method] = least_time(lambda run=run: run(start))
    slope = eqx.filter_jit(eqx.filter_grad(lambda s: jnp.sum(last(s, "native"))))
    jax.block_until_ready(slope(start))
    found["gradient"] = least_time(lambda: slope(start))
    same = lambda x: jnp.broadcast_to(x, (MEMBERS, *jnp.shape(x)))
    starts = jax.tree.map(same, start)
    batch = lambda: rk.ensemble(scene, starts, times, rtol=1e-8).final_state
    jax.block_until_ready(batch())
    found[f"{MEMBERS} by ensemble"] = least_time(batch)
    return found


def of_tree(tree, name):
    """The same in a process of its own, with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        places = {"PYTHONPATH": str(tree / "src"), "XDG_CACHE_HOME": cache}
        run = subprocess.run(
            [sys.executable, str(Path(__file__).resolve()), "--one", name],
            env=os.environ | places,
            capture_output=True,
            text=True,
        )
    if run.returncode:
        raise SystemExit(run.stderr)
    return json.loads(run.stdout.splitlines()[-1])


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trees", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measured(options.one)))
        return
    before, after = (tree.resolve() for tree in options.trees)
    print(f"{'':22}{'':18}{'before, ms':>12}{'after, ms':>12}{'ratio':>8}")
    for name in SCENES:
        rounds = [
            [of_tree(tree, name) for tree in (before, after)]
            for _ in range(options.rounds)
        ]
        for key in rounds[0][0]:
            old, new = (min(r[i][key] for r in rounds) for i in (0, 1))
            row = f"{name:22}{key:18}{old:12.3f}{new:12.3f}{new / old:8.3f}"
            print(row, flush=True)


if __name__ == "__main__":
    main()
