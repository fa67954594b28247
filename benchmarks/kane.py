"""From writing a system down to its numbers: rollkane's Kane engine beside SymPy's.

    python benchmarks/kane.py [--out FOLDER] [--repeats N] [--without-sympy]

Two tasks, each in a process of its own that is started afresh for every repeat:

* Whipple's bicycle, from its definition to the matrices of its linear model at 0, 1, 5
  and 10 m/s. SymPy twice: the same model as rollkane's, and the model of SymPy's own
  test suite (with that test's comparisons).
* An ellipsoid with a particle on it that rolls on a hill, from nothing to 10 s of
  motion at rtol 1e-11: by the rolling core, as a Kane system made from its scene, and
  as a Kane system written down by hand.

Prints a table (median of the repeats, loading of the packages apart, compiling
included), writes it as JSON and draws it.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path

BEGAN = time.perf_counter()
ROOT = Path(__file__).parents[1]
SPEEDS = (0.0, 1.0, 5.0, 10.0)


def bicycle():
    """By rollkane."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from rollkane import kane

    loaded = time.perf_counter()
    system = kane.whipple_bicycle()
    found = [
        kane.linearize(
            system, 0.0, kane.bicycle_state(v), kane.LEAN_AND_STEER, (1, 3)
        ).A.tolist()
        for v in SPEEDS
    ]
    return loaded, found


def bicycle_sympy():
    """The same model by SymPy's KanesMethod."""
    from peers import sympy_bicycle

    loaded = time.perf_counter()
    return loaded, sympy_bicycle.matrices(SPEEDS)


def bicycle_sympy_test():
    """The model of SymPy's own test."""
    from sympy.physics.mechanics.tests.test_kane3 import test_bicycle

    loaded = time.perf_counter()
    test_bicycle()
    return loaded, None


def hill(way):
    """Where the ellipsoid is after 10 s."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp

    import rollkane as rk

    sys.path.insert(0, str(ROOT))
    from tests.kane_by_hand import by_hand, with_the_core

    times = jnp.linspace(0.0, 10.0, 101)
    loaded = time.perf_counter()
    if way == "hand":
        run = rk.kane.simulate(*by_hand(), times, rtol=1e-11)
        end = run.q[-1, 4:]
    elif way == "scene":
        scene, start = with_the_core()
        system = rk.kane.rolling_system(scene, start)
        own = rk.kane.kane_state(start)
        run = rk.kane.simulate(system, own, times, rtol=1e-11)
        end = run.q[-1, 4:6]
    else:
        run = rk.simulate(*with_the_core(), times, rtol=1e-11)
        end = run.contact_on_base[-1, :2]
    return loaded, end.tolist()


TASKS = {
    "bicycle, rollkane": bicycle,
    "bicycle, SymPy, same model": bicycle_sympy,
    "bicycle, SymPy's own test": bicycle_sympy_test,
    "hill, rolling core": lambda: hill("core"),
    "hill, Kane from the scene": lambda: hill("scene"),
    "hill, Kane by hand": lambda: hill("hand"),
}


def one(name):
    """Do one task here and print what it took."""
    loaded, found = TASKS[name]()
    ended = time.perf_counter()
    print(
        json.dumps(
            {"loading": loaded - BEGAN, "seconds": ended - loaded, "found": found}
        )
    )


def measure(name, repeats):
    """Times of fresh processes."""
    rows = []
    for _ in range(repeats):
        command = [sys.executable, __file__, "--one", name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{name}: {done.stderr[-2000:]}")
        rows.append(json.loads(done.stdout.splitlines()[-1]))
    return {
        "task": name,
        "repeats": repeats,
        "loading": statistics.median(r["loading"] for r in rows),
        "seconds": statistics.median(r["seconds"] for r in rows),
        "found": rows[0]["found"],
    }


def largest_difference(a, b):
    """Between two nests of lists."""
    if isinstance(a, list):
        return max(largest_difference(x, y) for x, y in zip(a, b, strict=True))
    return abs(a - b)


def draw(rows, path):
    """Bars of seconds on a logarithmic axis."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for k, row in enumerate(rows):
        colour = "C1" if "SymPy" in row["task"] else "C0"
        axes.barh(k, row["seconds"], color=colour)
        axes.text(1.05 * row["seconds"], k, f"{row['seconds']:.1f} s", va="center")
    axes.set_yticks(range(len(rows)), [row["task"] for row in rows])
    axes.set_xscale("log")
    axes.set_xlim(1.0, 2.5 * max(row["seconds"] for row in rows))
    axes.invert_yaxis()
    axes.set_xlabel("from the definition to the numbers, compiling included [s]")
    axes.grid(True, axis="x", alpha=0.3)
    figure.savefig(path, dpi=120)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--without-sympy", action="store_true")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        one(options.one)
        return
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, median of {options.repeats} processes "
        "(SymPy: one)"
    )
    rows = []
    for name in TASKS:
        slow = "SymPy" in name
        if not (slow and options.without_sympy):
            rows.append(measure(name, 1 if slow else options.repeats))
    by_task = {row["task"]: row for row in rows}
    ours = by_task["bicycle, rollkane"]
    print(f"{'task':30}{'loading [s]':>12}{'then [s]':>10}{'x rollkane':>12}")
    for row in rows:
        ratio = ""
        if row["task"].startswith("bicycle"):
            row["ratio"] = row["seconds"] / ours["seconds"]
            ratio = f"{row['ratio']:.1f}"
        print(
            f"{row['task']:30}{row['loading']:12.2f}{row['seconds']:10.2f}{ratio:>12}"
        )
    twin = by_task.get("bicycle, SymPy, same model")
    if twin:
        difference = largest_difference(ours["found"], twin["found"])
        print(f"matrices of rollkane and SymPy differ by at most {difference:.1e}")
    ends = [row["found"] for row in rows if row["task"].startswith("hill")]
    difference = max(largest_difference(ends[0], end) for end in ends[1:])
    print(f"ends on the hill differ by at most {difference:.1e} m")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "kane.json").write_text(json.dumps(rows, indent=1) + "\n")
    draw(rows, options.out / "kane.png")
    print(f"written: {options.out / 'kane.json'}, {options.out / 'kane.png'}")


if __name__ == "__main__":
    main()
