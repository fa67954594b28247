"""What it costs to miss no change of the contact: steps and time of runs with modes.

    python benchmarks/contact_changes.py [--before CHECKOUT] [--out FOLDER]

Flights, bounces, slides and rolling with ``modes``: accepted and rejected steps,
changes found, and the time of a compiled run; with ``--before`` the same by the library
of another checkout, in a process of its own. Prints a table, writes it as JSON and
draws the steps.
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

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
R, MASS = 0.11, 6.0
BALL = rk.Body(MASS, 0.4 * MASS * R**2 * np.eye(3), rk.Sphere(R))
ROD = rk.Body(1.0, np.diag([0.02, 0.02, 0.001]), rk.Ellipsoid((0.03, 0.03, 0.4)))
LANE = rk.Scene(BALL)
BOWL = rk.Scene(BALL, rk.Base(rk.Graph(lambda x, y: 0.5 * (x * x + y * y))))
HILLS = rk.Scene(
    BALL, rk.Base(rk.Graph(lambda x, y: 0.03 * jnp.cos(9.0 * x) * jnp.cos(9.0 * y)))
)


def shaken(amplitude, frequency, way):
    rate = 2.0 * np.pi * frequency
    moves = lambda t: amplitude * jnp.sin(rate * t) * jnp.array(way)
    return rk.Scene(BALL, rk.Base(rk.Plane(), rk.BaseMotion(moves)))


def released(scene, height, velocity=STILL, spin=STILL):
    return rk.release(scene, UP, spin, (0.0, 0.0, height), velocity)


def thrown(speed):
    slips = rk.Scene(BALL, contact=rk.Slipping(rk.CoulombFriction(0.2)))
    return rk.place(slips, UP, STILL, STILL, velocity=(speed, 0.0, 0.0))


BOUNCES = {"friction": 0.3, "restitution": 0.5}
PLATE = shaken(0.02, 8.6115, (0.0, 0.0, 1.0))
ASIDE = shaken(0.02, 3.0, (1.0, 0.0, 0.0))
# name: scene, start, end [s], modes
RUNS = {
    "high flight": (LANE, released(LANE, 3.0, (1.0, 0.0, 4.0)), 1.0, BOUNCES),
    "high flight of a tumbling rod": (
        rk.Scene(ROD),
        released(rk.Scene(ROD), 3.0, (1.0, 0.0, 4.0), (9.0, 0.0, 1.0)),
        1.0,
        BOUNCES,
    ),
    "high flight over hills": (
        HILLS, released(HILLS, 3.0, (1.0, 0.0, 4.0)), 1.0, BOUNCES,
    ),
    "bounces on a plane": (LANE, released(LANE, 0.6), 1.5, BOUNCES),
    "bounces on a shaken plate": (PLATE, released(PLATE, R + 0.03), 1.0, BOUNCES),
    "bounces in a bowl": (BOWL, released(BOWL, 0.6, (0.5, 0.0, 0.0)), 1.0, BOUNCES),
    "bowling ball": (LANE, thrown(8.0), 3.0, {"friction": 0.2}),
    "rolls on a plane": (
        LANE, rk.place(LANE, UP, (0.0, 9.0, 2.0), STILL), 2.0, {"friction": 0.3},
    ),
    "rolls in a bowl": (
        BOWL,
        rk.place(BOWL, UP, (0.5, 3.0, 2.0), (0.2, 0.0, 0.02)),
        2.0,
        {"friction": 0.6},
    ),
    "rolls on a shaken plate, held": (
        ASIDE, rk.place(ASIDE, UP, (0.5, 3.0, 2.0), STILL), 2.0, {"friction": 0.6},
    ),
}  # fmt: skip


def measured(repeats):
    """Rows of this process's library."""
    rows = {}
    for name, (scene, start, end, modes) in RUNS.items():
        run = jax.jit(
            lambda y, scene=scene, end=end, modes=modes: rk.simulate(
                scene, y, jnp.array([0.0, end]), modes=rk.Modes(**modes), rtol=1e-9
            )
        )
        begun = time.perf_counter()
        found = jax.block_until_ready(run(start))
        first, times = time.perf_counter() - begun, []
        for _ in range(repeats):
            begun = time.perf_counter()
            jax.block_until_ready(run(start).final_time)
            times.append(time.perf_counter() - begun)
        rows[name] = {
            "code": int(found.code),
            "changes": int(found.switches.count),
            "accepted": int(found.steps),
            "rejected": int(found.rejected_steps),
            "first_s": first,
            "median_s": statistics.median(times),
        }
    return rows


def of_checkout(path, repeats):
    """Rows of another checkout's library."""
    code = f"import runpy; m = runpy.run_path({__file__!r}); import json;"
    code += f"print(json.dumps(m['measured']({repeats})))"
    setting = os.environ | {"PYTHONPATH": str(Path(path).resolve() / "src")}
    found = subprocess.run(
        [sys.executable, "-c", code], env=setting, check=True, capture_output=True
    )
    return json.loads(found.stdout.splitlines()[-1])


def print_table(table):
    heads = "changes", "accepted", "rejected", "run ms", "first s"
    width = max(len(name) for name in RUNS) + 2
    print(" " * width + "".join(f"{h:>20}" for h in heads))
    for name in RUNS:
        cells = []
        for key, scale, form in (
            ("changes", 1, "d"), ("accepted", 1, "d"), ("rejected", 1, "d"),
            ("median_s", 1e3, ".2f"), ("first_s", 1, ".1f"),
        ):  # fmt: skip
            values = [table[side][name][key] * scale for side in table]
            cells.append(" -> ".join(f"{v:{form}}" for v in values))
        print(f"{name:{width}}" + "".join(f"{cell:>20}" for cell in cells))


def draw(table, path):
    """Tried steps, before and after."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    place = np.arange(len(RUNS))
    sides = list(table)
    for k, side in enumerate(sides):
        for key, alpha, below in (("accepted", 1.0, None), ("rejected", 0.45, "a")):
            rows = table[side].values()
            left = None if below is None else [r["accepted"] for r in rows]
            axes.barh(
                place + 0.4 * (k - 0.5 * (len(sides) - 1)),
                [r[key] for r in table[side].values()],
                0.36,
                left=left,
                color=f"C{k}",
                alpha=alpha,
                label=f"{side}, {key}",
            )
    axes.set_yticks(place, list(RUNS))
    axes.invert_yaxis()
    axes.set_xlabel("steps tried")
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=31)
    options = parser.parse_args()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, jax {jax.__version__}"
    print(f"{machine}, rtol 1e-9, median of {options.repeats} runs")
    table = {}
    if options.before is not None:
        table["before"] = of_checkout(options.before, options.repeats)
    table["now"] = measured(options.repeats)
    print_table(table)
    options.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": machine, "rows": table}, indent=1)
    (options.out / "contact_changes.json").write_text(text + "\n")
    draw(table, options.out / "contact_changes.png")


if __name__ == "__main__":
    main()
