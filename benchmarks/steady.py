"""What steady motions and their stability cost: first call, later calls, a branch.

    python benchmarks/steady.py [--out FOLDER] [--repeats N]

For built-in scenes: seconds of the first
``rk.steady_motion`` in a process of its own (tracing and compiling included, importing
and loading the scene apart), the median and the least of later calls (the least is
lengthened least by other work on the machine), and for the rolling disc a branch of
200 points. Prints a table, writes it as JSON.
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
import numpy as np

import rollkane as rk
from rollkane.files.scene_files import load_scene

jax.config.update("jax_enable_x64", True)

POINTS = 200
STILL = (0.0, 0.0, 0.0)
UPRIGHT, OVER = (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)
# built-in scene: orientation and angular velocity of the guess, or None: its own start;
# what is held
CASES = {
    "ball-on-plane": (None, ()),
    "ball-on-turntable": (None, ()),
    "ellipsoid-in-bowl": ((UPRIGHT, STILL), ()),
    "euler-disc": (None, ("tilt", "spin")),
    "rattleback": ((OVER, STILL), ("turn about z",)),
    "rolling-disc": (None, ("tilt", "spin")),
    "routh-sphere": ((UPRIGHT, (0.0, 0.0, 5.0)), ("turn about z",)),
    "shell-with-pendulum": ((UPRIGHT, STILL), ()),
}


def guessed(name):
    """A scene, and a guess of its steady motion."""
    file = load_scene(name)
    guess = CASES[name][0]
    if guess is None:
        return file.scene, file.start
    none = np.zeros(file.start.alpha.shape)
    return file.scene, rk.place(file.scene, *guess, STILL, none, none)


def alone(name, repeats):
    """One case in this process; its times as JSON."""
    (scene, start), hold = guessed(name), CASES[name][1]
    jax.block_until_ready(start)
    began, used = time.perf_counter(), time.process_time()
    motion = rk.steady_motion(scene, start, hold)
    row = {"first": time.perf_counter() - began, "cpu": time.process_time() - used}
    later = []
    for _ in range(repeats):
        began = time.perf_counter()
        rk.steady_motion(scene, start, hold)
        later.append(time.perf_counter() - began)
    row |= {"later": statistics.median(later), "least": min(later)}
    if name == "rolling-disc":
        row |= branch(scene, motion, repeats)
    print(json.dumps(row))


def branch(scene, motion, repeats):
    """A branch in the spin."""
    span = 1.0, 20.0
    times = []
    for _ in range(max(3, repeats // 4)):
        began = time.perf_counter()
        found = rk.steady_family(scene, motion, "hold.spin", span, points=POINTS)
        times.append(time.perf_counter() - began)
    return {
        "points": len(found.points),
        "branch, first": times[0],
        "branch": statistics.median(times[1:]),
    }


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=21)
    parser.add_argument("--alone", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.alone:
        alone(options.alone, options.repeats)
        return
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python "
    machine += f"{platform.python_version()}, jax {jax.__version__}"
    machine += f", load {os.getloadavg()[0]:.1f}"
    print(machine)
    table = {}
    for name in CASES:
        command = [sys.executable, __file__, "--alone", name]
        command += ["--repeats", str(options.repeats)]
        told = subprocess.run(command, capture_output=True, text=True, check=True)
        row = table[name] = json.loads(told.stdout.splitlines()[-1])
        print(
            f"{name:<20} first {row['first']:.2f} s ({row['cpu']:.2f} s of CPU), "
            f"later {1e3 * row['later']:.1f} ms, least {1e3 * row['least']:.1f} ms"
        )
        if "branch" in row:
            print(
                f"{'':<20} {row['points']} points: first {row['branch, first']:.2f} s, "
                f"later {row['branch']:.2f} s"
            )
    options.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": machine, "table": table}, indent=1)
    (options.out / "steady.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
