"""What each effect of a scene costs: equations and time of one right-hand side.

    python benchmarks/effects.py [--out FOLDER] [--repeats N]

An ellipsoid with an offset mass centre on a plane: alone, on a base that translates,
that turns, with one and with three carried masses, with a carried rigid body, and with
all of it; each in every formulation. Prints a table, writes it as JSON and draws it.

The time is that of one evaluation inside a compiled loop of many, as an integrator
makes them (median of the repeats); tracing and compiling is reported apart.
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

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.geometry.rotations import rotation_matrix
from rollkane.kinematics.coordinates import pack, unpack
from rollkane.paper.euler_lagrange import EQUATIONS

jax.config.update("jax_enable_x64", True)

FORMULATIONS = ("rolling", "rolling, Voronets", *(f"E-L ({e})" for e in EQUATIONS))
EVALUATIONS = 2000
BODY = rk.Body(
    1.0,
    np.diag([0.010, 0.012, 0.015]),
    rk.Ellipsoid((0.2, 0.15, 0.1)),
    (0.0, 0.01, -0.02),
)


def shake(t):
    """Three components of shaking [m]."""
    return 0.1 * jnp.stack([jnp.sin(3.0 * t), jnp.cos(2.0 * t), jnp.sin(5.0 * t)])


def swing(t):
    """A rotation about a direction that changes [1]."""
    return rotation_matrix(
        jnp.stack([jnp.cos(t), 0.1 * jnp.sin(t), 0.2 * jnp.cos(2.0 * t), jnp.sin(t)])
    )


def bead(a):
    """One mass on a helix [m]."""
    return 0.05 * jnp.stack([jnp.cos(a[0]), jnp.sin(a[0]), a[0]])[None]


def beads(a):
    """Three masses with two coordinates [m]."""
    x, y = a[0], a[1]
    return 0.05 * jnp.stack(
        [
            jnp.stack([jnp.cos(x), jnp.sin(x), 0.3 * y]),
            jnp.stack([x * y, jnp.cos(y), jnp.sin(x)]),
            jnp.stack([x - y, x * x, jnp.cos(y)]),
        ]
    )


def hub(a):
    """Mass centre of a carried flywheel [m]."""
    return 0.03 * jnp.stack([jnp.cos(a[0]), jnp.sin(a[0]), jnp.ones_like(a[0])])


def tilt(a):
    """Its rotation, from its own to the body's axes [1]."""
    return rotation_matrix(
        jnp.stack([jnp.cos(0.5 * a[0]), 0.0 * a[0], jnp.sin(0.5 * a[0]), 0.0 * a[0]])
    )


def scenes():
    """Name of an effect, and a scene with it."""
    translates = rk.BaseMotion(position=shake)
    moves = rk.BaseMotion(position=shake, rotation=swing)
    one, three = rk.PointMasses((0.1,), bead), rk.PointMasses((0.1, 0.2, 0.1), beads)
    wheel = rk.SupportedBody(0.2, 1e-4 * np.eye(3), hub, tilt)

    def scene(motion=None, *parts):
        return rk.Scene(BODY, rk.Base(rk.Plane(), motion=motion), supported=parts)

    return {
        "fixed base": scene(),
        "+ translation": scene(translates),
        "+ translation, rotation": scene(moves),
        "+ 1 mass": scene(None, one),
        "+ 3 masses, 2 coordinates": scene(None, three),
        "+ supported body": scene(None, wheel),
        "all of it": scene(moves, three, wheel),
    }


def start_of(scene, formulation):
    """A state that touches in a place without symmetry."""
    rest = 0.3 + 0.2 * np.arange(scene.coordinate_count)
    turned, spin = np.array([0.9, 0.2, 0.3, 0.1]), (0.4, -0.3, 2.0)
    turned /= np.linalg.norm(turned)
    start = rk.place(scene, turned, spin, (0.0, 0.0, 0.0), rest, rest)
    if formulation == "rolling":
        return start
    return rk.to_voronets(scene, start, 0.0, 1)


def derivative_of(formulation):
    """The right-hand side of a formulation."""
    if formulation.startswith("rolling"):
        return rk.rolling_derivative
    equations = formulation[len("E-L (") : -1]
    return lambda *args: rk.euler_lagrange_derivative(*args, equations=equations)


def measure(scene, formulation, repeats):
    """Equations, trace and compile time, and time of one right-hand side."""
    derivative, start = derivative_of(formulation), start_of(scene, formulation)
    clock = jnp.asarray(0.1)
    equations = len(jax.make_jaxpr(derivative)(scene, clock, start).eqns)

    # every evaluation needs the one before; state and time hardly move, but they do, so
    # that nothing of an evaluation can be taken out of the loop
    @jax.jit
    def many(scene, y):
        def once(_, carried):
            t, y = carried
            rates = derivative(scene, t, unpack(y, start))
            return t + 1e-9, y + 1e-12 * pack(rates)

        return jax.lax.fori_loop(0, EVALUATIONS, once, (clock, y))[1]

    y = pack(start)
    began = time.perf_counter()
    compiled = many.lower(scene, y).compile()
    built = time.perf_counter() - began
    assert np.isfinite(np.asarray(compiled(scene, y))).all()
    spans = []
    for _ in range(repeats):
        began = time.perf_counter()
        compiled(scene, y).block_until_ready()
        spans.append((time.perf_counter() - began) / EVALUATIONS)
    return {
        "equations": equations,
        "compile": built,
        "seconds": statistics.median(spans),
        "fastest": min(spans),
    }


def print_table(rows):
    """A line for each scene and formulation, beside the scene without the effect."""
    print(f"{'scene':28}{'formulation':20}{'equations':>10}{'compile s':>11}", end="")
    print(f"{'us / rhs':>10}{'over fixed':>12}{'over rolling':>14}")
    found = {(r["scene"], r["formulation"]): r["seconds"] for r in rows}
    for r in rows:
        fixed = r["seconds"] / found["fixed base", r["formulation"]]
        plain = r["seconds"] / found[r["scene"], "rolling"]
        print(
            f"{r['scene']:28}{r['formulation']:20}{r['equations']:10d}"
            f"{r['compile']:11.2f}{1e6 * r['seconds']:10.2f}{fixed:12.2f}{plain:14.2f}"
        )


def draw(rows, path):
    """Equations and time, by scene, a colour for each formulation."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, sharey=True)
    names = list(dict.fromkeys(r["scene"] for r in rows))
    thick = 0.8 / len(FORMULATIONS)
    for panel, key, factor, label in (
        (panels[0], "equations", 1, "equations of the right-hand side"),
        (panels[1], "seconds", 1e6, "time of one right-hand side [µs]"),
    ):
        for k, formulation in enumerate(FORMULATIONS):
            chosen = [r for r in rows if r["formulation"] == formulation]
            places = [names.index(r["scene"]) + (k - 2) * thick for r in chosen]
            values = [factor * r[key] for r in chosen]
            bars = panel.barh(places, values, thick, label=formulation, color=f"C{k}")
            panel.bar_label(
                bars, [f"{v:.3g}" if v < 100 else f"{v:.0f}" for v in values],
                padding=2, fontsize=6.5,
            )  # fmt: skip
        panel.set_xscale("log")
        panel.set_xlabel(label)
        panel.margins(x=0.12)
        panel.grid(True, axis="x", alpha=0.3)
        panel.set_axisbelow(True)
    panels[0].set_yticks(range(len(names)), names)
    panels[0].invert_yaxis()
    handles, labels = panels[1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, fontsize=9)
    figure.savefig(path, dpi=120)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}, "
        f"median of {options.repeats} loops of {EVALUATIONS} right-hand sides"
    )
    rows = [
        {"scene": name, "formulation": formulation}
        | measure(scene, formulation, options.repeats)
        for name, scene in scenes().items()
        for formulation in FORMULATIONS
    ]
    print_table(rows)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "effects.json").write_text(json.dumps(rows, indent=1) + "\n")
    draw(rows, options.out / "effects.png")
    print(f"written: {options.out / 'effects.json'}, {options.out / 'effects.png'}")


if __name__ == "__main__":
    main()
