"""Order of integration on a recorded earthquake: told of the sample times, or not.

    python benchmarks/isolator.py [--out FOLDER] [--repeats N]

The built-in isolator: a ball in a bowl, a payload on springs inside, 20 s of a record
of the Kaikoura earthquake. The record is linear between samples, so its jerk jumps at
each. ``RecordedMotion`` tells the integrator where (it ends a step there); the same
motion that keeps this to itself is run beside it. Prints a table, writes it as JSON and
draws the end error against tolerance and against the number of steps.

Errors are those of the body's position and of the payload's [m], the largest of all
outputs (one each second), against a run of sixteen equal steps between two samples by a
method of order 8.
"""

import argparse
import json
import os
import platform
import statistics
import time
from pathlib import Path

# the XLA setting that the command line uses, too (docs/speed.md)
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536",
)

import diffrax
import equinox as eqx
import jax
import numpy as np

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.kinematics.base_motion import AbstractBaseMotion

jax.config.update("jax_enable_x64", True)

TOLERANCES = tuple(10.0**-k for k in range(3, 14))
SOLVERS = ("Tsit5", "Dopri8")
PER_SAMPLE = 16  # steps between two samples of the run that the others are held against


class Untold(AbstractBaseMotion):
    """The same motion, whose sample times are kept from the integrator."""

    motion: rk.RecordedMotion

    def at(self, t):
        """Of the record."""
        return self.motion.at(t)


def seen(result):
    """What an error is measured of: positions of body and payload [m]."""
    return np.concatenate(
        [np.asarray(result.position), np.asarray(result.alpha)], axis=1
    )


def exact(scene, start, times):
    """The run that the others are held against: equal steps that end on samples."""
    record = np.asarray(scene.base.motion.time)
    count = (len(record) - 1) * PER_SAMPLE + 1
    share = np.arange(count) / PER_SAMPLE
    steps = np.interp(share, np.arange(len(record)), record)  # samples are among them
    result = rk.simulate(
        scene,
        start,
        times,
        solver=diffrax.Dopri8(),
        stepsize_controller=diffrax.StepTo(steps),
        max_steps=count,
    )
    return seen(result)


def measure(scene, start, times, solver, truth, repeats):
    """Errors, steps and times at all tolerances."""
    rows = []

    def run(rtol):
        how = {"rtol": rtol, "atol": 1e-2 * rtol, "solver": solver}
        result = rk.simulate(scene, start, times, method="diffrax", **how)
        jax.block_until_ready(result.state)
        return result

    run(1e-2)
    for rtol in TOLERANCES:
        result = run(rtol)
        assert bool(result.succeeded), result.reason
        spans = []
        for _ in range(repeats):
            began = time.perf_counter()
            run(rtol)
            spans.append(time.perf_counter() - began)
        rows.append(
            {
                "rtol": rtol,
                "error": float(np.abs(seen(result) - truth).max()),
                "steps": int(result.steps),
                "rejected": int(result.rejected_steps),
                "seconds": statistics.median(spans),
            }
        )
    return rows


def print_table(rows):
    """Every run."""
    print(f"{'method':10}{'samples':10}{'rtol':>8}{'error [m]':>12}", end="")
    print(f"{'steps':>8}{'rejected':>10}{'ms':>9}")
    for r in rows:
        print(
            f"{r['method']:10}{r['samples']:10}{r['rtol']:8.0e}{r['error']:12.1e}"
            f"{r['steps']:8d}{r['rejected']:10d}{1e3 * r['seconds']:9.2f}"
        )


def draw(rows, path):
    """Error against tolerance, and against evaluated steps with the methods' orders."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    for k, method in enumerate(SOLVERS):
        for samples, style in (("told", "o-"), ("not told", "s--")):
            chosen = [
                r for r in rows if (r["method"], r["samples"]) == (method, samples)
            ]
            errors = [r["error"] for r in chosen]
            label = f"{method}, {samples}"
            given = dict(color=f"C{k}", markersize=4, label=label)
            left.loglog([r["rtol"] for r in chosen], errors, style, **given)
            tried = [r["steps"] + r["rejected"] for r in chosen]
            right.loglog(tried, errors, style, **given)
    tolerances = np.array(TOLERANCES)
    left.loglog(tolerances, tolerances, ":", color="0.5", label="error = rtol")
    # of Dopri8 no order can be seen: one step from sample to sample is exact enough
    told = [r for r in rows if (r["method"], r["samples"]) == ("Tsit5", "told")]
    tried = np.array([r["steps"] + r["rejected"] for r in told if r["rtol"] < 1e-6])
    middle = next(r for r in told if r["rtol"] < 1e-9)
    order = (
        0.2 * middle["error"] * (tried / (middle["steps"] + middle["rejected"])) ** -5.0
    )
    right.loglog(tried, order, ":", color="0.5", label="order 5")
    left.invert_xaxis()
    left.set_xlabel("rtol")
    left.set_ylabel("largest error of body and payload [m]")
    right.set_xlabel("steps, rejected ones too")
    for panel in (left, right):
        panel.grid(True, alpha=0.3)
        panel.legend(fontsize=8)
    figure.savefig(path, dpi=120)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}, "
        f"median of {options.repeats}"
    )
    loaded = load_scene("isolator")
    told, start = loaded.scene, loaded.start
    untold = eqx.tree_at(lambda s: s.base.motion, told, Untold(told.base.motion))
    first, last = (float(t) for t in told.base.motion.span)
    times = np.linspace(first, last, 21)
    truth = exact(told, start, times)
    rows = []
    for method in SOLVERS:
        for samples, scene in (("told", told), ("not told", untold)):
            solver = getattr(diffrax, method)()
            found = measure(scene, start, times, solver, truth, options.repeats)
            rows += [{"method": method, "samples": samples} | row for row in found]
    print_table(rows)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "isolator.json").write_text(json.dumps(rows, indent=1) + "\n")
    draw(rows, options.out / "isolator.png")
    print(f"written: {options.out / 'isolator.json'}, {options.out / 'isolator.png'}")


if __name__ == "__main__":
    main()
