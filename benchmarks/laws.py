"""What each contact law and each load costs, alone and in pairs.

    python benchmarks/laws.py [--out FOLDER] [--repeats N]

An ellipsoid with an offset mass centre on a plane, under its weight: equations, time to
trace and compile, and time of one right-hand side, with every effect alone and with
every two that can be had together, beside the bare scene. Prints a table, writes it as
JSON and draws the times of the pairs.
"""

import argparse
import itertools
import json
import os
import platform
from pathlib import Path

from effects import BODY, EVALUATIONS, measure  # sets the XLA setting, too

import jax  # isort: skip
import jax.numpy as jnp

import rollkane as rk

CONTACTS = {
    "rubber": rk.RubberRolling(),
    "slipping, viscous": rk.Slipping(rk.ViscousFriction(0.1)),
    "slipping, Coulomb": rk.Slipping(rk.CoulombFriction(0.1)),
    "slipping, Stribeck": rk.Slipping(rk.StribeckFriction(0.2, 0.1, 0.1, 0.05)),
}
LOADS = {
    "force": rk.Force((0.1, 0.0, 0.0), (0.1, 0.0, 0.0)),
    "torque": rk.Torque((0.0, 0.01, 0.0)),
    "potential": rk.Potential(lambda p: jnp.sum(p * p)),
    "drag": rk.Drag(0.01, 0.01, 0.001),
    "rolling resistance": rk.RollingResistance(viscous=0.01),
    "rolling resistance, dry": rk.RollingResistance(dry=0.001),
    "spinning resistance, dry": rk.SpinningResistance(dry=0.001),
}


def scene_with(names):
    """The bare scene with some effects."""
    contact = [CONTACTS[name] for name in names if name in CONTACTS]
    loads = [LOADS[name] for name in names if name in LOADS]
    law = contact[0] if contact else None
    return rk.Scene(BODY, loads=(rk.Gravity(), *loads), contact=law)


def choices():
    """Nothing, every effect alone, every pair that is physically possible."""
    names = [*CONTACTS, *LOADS]
    yield ()
    yield from ((name,) for name in names)
    for pair in itertools.combinations(names, 2):
        if sum(name in CONTACTS for name in pair) < 2:
            yield pair


def print_table(rows):
    """A line for each effect alone, then the dearest pairs."""
    bare = rows[0]
    print(f"{'effects':44}{'equations':>10}{'compile s':>11}{'ns / rhs':>10}", end="")
    print(f"{'over bare':>11}")
    alone = [r for r in rows if len(r["effects"]) < 2]
    pairs = sorted(
        (r for r in rows if len(r["effects"]) == 2), key=lambda r: -r["seconds"]
    )
    for r in [*alone, *pairs[:8]]:
        name = " + ".join(r["effects"]) or "bare scene"
        print(
            f"{name:44}{r['equations']:10d}{r['compile']:11.2f}"
            f"{1e9 * r['seconds']:10.0f}{r['seconds'] / bare['seconds']:11.2f}"
        )


def draw(rows, path):
    """Time of a right-hand side over that of the bare scene, by pair."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = [*CONTACTS, *LOADS]
    found = {frozenset(r["effects"]): r["seconds"] for r in rows}
    bare = found[frozenset()]
    figure = Figure(figsize=(8.6, 7.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    grid = [
        [found.get(frozenset({a, b}), float("nan")) / bare for b in names]
        for a in names
    ]
    image = axes.imshow(grid, cmap="viridis", vmin=1.0)
    for i, row in enumerate(grid):
        for k, value in enumerate(row):
            if value == value:
                dark = value < 0.6 * image.norm.vmax
                axes.text(
                    k, i, f"{value:.1f}", ha="center", va="center", fontsize=8,
                    color="white" if dark else "black",
                )  # fmt: skip
    axes.set_xticks(range(len(names)), names, rotation=40, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.set_title("time of a right-hand side over the bare scene's; diagonal: alone")
    figure.colorbar(image, shrink=0.8)
    figure.savefig(path, dpi=120)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=9)
    options = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}, "
        f"median of {options.repeats} loops of {EVALUATIONS} right-hand sides"
    )
    rows = [
        {"effects": names} | measure(scene_with(names), "rolling", options.repeats)
        for names in choices()
    ]
    print_table(rows)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "laws.json").write_text(json.dumps(rows, indent=1) + "\n")
    draw(rows, options.out / "laws.png")
    print(f"written: {options.out / 'laws.json'}, {options.out / 'laws.png'}")


if __name__ == "__main__":
    main()
