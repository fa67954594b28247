"""The loop in C as users meet it: by default, mapped, differentiated, the first time.

    python benchmarks/engine.py [--out FOLDER] [--repeats N]

Prints six tables, writes them as JSON and draws the first. Everything is measured in
one run on this machine, without any setting, in processes that know of none: medians of
the repeats; first results in processes of their own, with an empty folder for compiled
programs and with the one that the first left.
"""

import argparse
import compileall
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

import changes
from peers import c_dop853, c_dopri5
from peers.problems import PROBLEMS, end_error
from single import at_error, draw, end_numbers, scene_of

TOLERANCES = tuple(10.0**-k for k in (6, 7, 8, 9, 10, 11))
TARGET = 1e-8
MOTIONS, GRADIENTS, HORIZON = 10_000, 256, 1.0
MASSES = (1, 4, 8, 16, 32, 64)
SCENES = ("rolling-disc", "rattleback", "isolator", "shell-with-pendulum")


def timed(function, repeats):
    """Median time of a call [s], after one."""
    import jax

    spans = []
    for i in range(repeats + 1):
        began = time.perf_counter()
        jax.block_until_ready(function())
        if i:
            spans.append(time.perf_counter() - began)
    return statistics.median(spans)


def timed_in_turn(functions, repeats):
    """Times of calls [s], one row a turn: as the machine is for one it is for all."""
    import jax

    rows = []
    for i in range(repeats + 1):
        row = []
        for function in functions:
            began = time.perf_counter()
            jax.block_until_ready(function())
            row.append(time.perf_counter() - began)
        rows += [row] if i else []
    return rows


def singles(repeats):
    """One trajectory, final state only: C, and ``simulate`` without an argument."""
    import diffrax
    import jax

    import rollkane as rk

    rows = []
    peers = {"C DOPRI5": c_dopri5.load(), "C DOP853": c_dop853.load()}
    for name, problem in PROBLEMS.items():
        scene, start = scene_of(name)
        times = (0.0, problem["t_end"])

        def add(peer, rtol, end, seconds, steps, name=name, problem=problem):
            error = end_error(problem, end)
            error = max(error.position, error.rotation)
            row = {"problem": name, "peer": peer, "rtol": rtol, "error": error}
            rows.append(row | {"seconds": seconds, "steps": steps})

        for peer, (library, _) in peers.items():
            for rtol in TOLERANCES if library is not None else ():
                found = library.solve(name, rtol, 0.01 * rtol)
                spans = library.seconds(name, rtol, 0.01 * rtol, 20, repeats)
                steps = found.accepted + found.rejected
                add(peer, rtol, found.y_end, statistics.median(spans), steps)
        for label, how in (
            ("default", {}),
            ("Dopri5", {"solver": diffrax.Dopri5()}),
            ("default by diffrax", {"method": "diffrax"}),
        ):

            def bare(rtol, how=how, scene=scene, start=start, times=times):
                return rk.simulate(scene, start, times, rtol=rtol, **how)

            inside = jax.jit(bare)
            # without a solver a bare call takes Tsit5 from 1e-6 on: one method a row
            for rtol in TOLERANCES if "solver" in how else TOLERANCES[1:]:
                run = bare(rtol)
                end = end_numbers(problem, run)
                steps = int(run.steps + run.rejected_steps)
                calls = inside, bare
                both = [lambda c=call, r=rtol: c(r).final_state for call in calls]
                spans = timed_in_turn(both, repeats)
                median = lambda of: statistics.median(map(of, spans))  # noqa: B023
                add(f"rollkane {label}", rtol, end, median(lambda s: s[0]), steps)
                called = f"rollkane {label}, bare call"
                add(called, rtol, end, median(lambda s: s[1]), steps)
                rows[-1]["more than inside"] = median(lambda s: s[1] - s[0])
    return rows


def compared(rows):
    """All at one error, over C.

    A step costs what time grows by with their number, over all tolerances: what a call
    costs besides is in the time.
    """
    import numpy as np

    table = []
    bare = {r["peer"] for r in rows if "more than inside" in r}
    for problem in PROBLEMS:
        of = {peer: [] for peer in dict.fromkeys(r["peer"] for r in rows)}
        for r in rows:
            of[r["peer"]] += [r] if r["problem"] == problem else []
        found = {}
        for peer, own in of.items():
            steps, seconds = ([r[k] for r in own] for k in ("steps", "seconds"))
            at = at_error(rows, problem, peer, TARGET)
            # weights: each run's time is as uncertain as it is long
            slope = np.polyfit(steps, seconds, 1, w=1.0 / np.array(seconds))[0]
            found[peer] = at and (at[0], float(slope))
        for peer, it in found.items():
            row = {"problem": problem, "peer": peer, "error": TARGET}
            row["seconds"], row["a step, s"] = it or (None, None)
            for c in ("C DOPRI5", "C DOP853"):
                for k, what in enumerate(("time", "step")):
                    both = it and found.get(c)
                    row[f"{what} / {c}"] = it[k] / found[c][k] if both else None
            more = [1e6 * r["more than inside"] for r in of[peer] if r["peer"] in bare]
            row["more than inside, us"] = statistics.median(more) if more else None
            table.append(row)
    return table


def variants(name):
    """A scene, many starts, and the times."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from rollkane.files.scene_files.loading import load_scene

    if name == "isolator":
        file = load_scene(name)
        scene, start, what = file.scene, file.start, lambda s: s.alpha_dot
        moved = lambda x: start.alpha_dot + 1e-3 * x
    else:
        scene, start = scene_of(name)
        what, w = (lambda s: s.angular_velocity), start.angular_velocity
        moved = lambda x: w * (1.0 + 0.01 * x)
    numbers = jnp.linspace(-1.0, 1.0, MOTIONS)
    starts = jax.vmap(lambda x: eqx.tree_at(what, start, moved(x)))(numbers)
    return scene, starts


def batch_of(name, repeats):
    """``jax.vmap(simulate)`` and gradients, over ``ensemble`` and over diffrax."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    import rollkane as rk

    scene, starts = variants(name)
    times, rtol = (0.0, HORIZON), 1e-8
    one = lambda s: rk.simulate(scene, s, times, rtol=rtol).final_state
    mapped = jax.jit(jax.vmap(one))
    every = lambda: rk.ensemble(scene, starts, times, rtol=rtol).final_state
    by_map, by_ensemble = timed(lambda: mapped(starts), repeats), timed(every, repeats)

    def end(mass, s, method):
        changed = eqx.tree_at(lambda x: x.body.mass, scene, mass)
        run = rk.simulate(changed, s, times, rtol=rtol, method=method)
        return jnp.sum(run.final_state.angular_velocity)

    some, mass = jax.tree.map(lambda x: x[:GRADIENTS], starts), scene.body.mass
    spans, firsts = {}, {}
    for method in ("auto", "diffrax"):
        slope = jax.grad(lambda m, s, method=method: end(m, s, method))
        many = jax.jit(jax.vmap(slope, (None, 0)))
        began = time.perf_counter()
        jax.block_until_ready(many(mass, some))
        firsts[method] = time.perf_counter() - began
        spans[method] = timed(lambda many=many: many(mass, some), repeats)
    return {
        "scene": name,
        "mapped, a second": MOTIONS / by_map,
        "ensemble, a second": MOTIONS / by_ensemble,
        "mapped / ensemble": by_ensemble / by_map,
        "256 gradients, ms": 1e3 * spans["auto"],
        "by diffrax / it": spans["diffrax"] / spans["auto"],
        "first gradients, s": firsts["auto"],
    }


def batches(repeats):
    """Of each scene."""
    return [batch_of(name, repeats) for name in (*PROBLEMS, "isolator")]


def masses_of(count, repeats):
    """A step of a ball with supported masses, by default and by diffrax."""
    import jax.numpy as jnp
    import numpy as np

    import rollkane as rk

    turns = jnp.linspace(0.0, 2.0 * jnp.pi, count, endpoint=False)
    axes = jnp.stack([jnp.cos(turns), jnp.sin(turns), 0.3 + 0.0 * turns], axis=1)
    part = rk.PointMasses(
        np.full(count, 0.5 / count),
        lambda a, p: 0.05 * p + a[:, None] * p,
        potential=lambda a, p: 20.0 * jnp.sum(a * a) / a.shape[0],
        parameters=axes,
        coordinates=count,
    )
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)), supported=part)
    rest = {"alpha": np.zeros(count), "alpha_dot": np.zeros(count)}
    upright = [1.0, 0.0, 0.0, 0.0]
    start = rk.place(scene, upright, [0.5, 2.0, 1.0], [0.0, 0.0, 0.0], **rest)
    row = {"masses": count}
    for method in ("auto", "diffrax"):
        run = lambda method=method: rk.simulate(
            scene, start, (0.0, 5.0), rtol=1e-10, method=method
        )
        began = time.perf_counter()
        found = run()
        steps = int(found.steps + found.rejected_steps)
        first = time.perf_counter() - began
        a_step = 1e6 * timed(lambda run=run: run().final_state, repeats) / steps
        row |= {f"{method}, us a step": a_step, f"{method}, first s": first}
        row |= {"went": found.method} if method == "auto" else {}
    return row | {"ratio": row["diffrax, us a step"] / row["auto, us a step"]}


def masses(repeats):
    """Of each number of them."""
    return [masses_of(count, repeats) for count in MASSES]


def first_result(name):
    """From a loaded library to a result [s], in this process."""
    import jax

    from rollkane.files.scene_files.loading import load_scene
    from rollkane.simulation.run import simulate

    file = load_scene(name)
    began = time.perf_counter()
    run = simulate(file.scene, file.start, file.times, rtol=file.rtol)
    jax.block_until_ready(run.final_state)
    return time.perf_counter() - began


def inner(what, *options, cache=None):
    """A part of this benchmark in a process without settings."""
    settings = "XLA_FLAGS", "PYTHONDONTWRITEBYTECODE"
    environment = {k: v for k, v in os.environ.items() if k not in settings}
    if cache is not None:
        environment["ROLLKANE_CACHE"] = str(cache)
    words = [sys.executable, __file__, "--inner", what, *map(str, options)]
    run = subprocess.run(
        words, env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(run.stdout.splitlines()[-1])


def firsts():
    """First results, cold and in the next process."""
    rows = []
    for name in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            cold, warm = (inner("first", name, cache=folder) for _ in range(2))
        rows.append({"scene": name, "empty folder, s": cold, "next process, s": warm})
    return rows


def show(title, rows):
    """A table."""
    print(f"\n{title}")
    names = list(rows[0])
    text = lambda x: (
        "-" if x is None else f"{x:.4g}" if isinstance(x, float) else str(x)
    )
    cells = [names, *([text(row[k]) for k in names] for row in rows)]
    wide = [max(len(line[i]) for line in cells) for i in range(len(names))]
    for line in cells:
        print("  ".join(x.rjust(w) for x, w in zip(line, wide, strict=True)))


def of_changes(given, cache):
    """What :mod:`changes` measures, in a process of its own."""
    return inner("changes", given, cache=cache)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--inner", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inner:
        import jax

        jax.config.update("jax_enable_x64", True)
        what, given = options.inner
        parts = {"singles": singles, "batches": batches, "masses": masses}
        named = {"first": first_result, "changes": changes.measured}
        found = named[what](given) if what in named else parts[what](int(given))
        print(json.dumps(found))
        return
    # as pip leaves it: no first result waits for Python's own compiler
    (package,) = find_spec("rollkane").submodule_search_locations
    compileall.compile_dir(package, quiet=1)
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, medians of {options.repeats}"
    )
    rows = inner("singles", options.repeats)
    tables = {
        f"One trajectory, at an end error of {TARGET:g}": compared(rows),
        f"{MOTIONS} motions of {HORIZON:g} s, rtol 1e-8": inner(
            "batches", options.repeats
        ),
        "Supported masses, rtol 1e-10": inner("masses", options.repeats),
        "First results": firsts(),
        "Changes of contact, rtol 1e-9": changes.table(of_changes),
        "The same, motions a second": changes.batches(of_changes),
    }
    for title, table in tables.items():
        show(title, table)
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {"runs": rows, "tables": tables}
    (options.out / "engine.json").write_text(json.dumps(figures, indent=1))
    draw(rows, options.out / "engine.png", "bare")
    print(f"written: {options.out / 'engine.json'}, {options.out / 'engine.png'}")


if __name__ == "__main__":
    main()
