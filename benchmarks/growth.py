"""How time and memory grow: with motions, horizon, masses, parameters and outputs.

    python benchmarks/growth.py [--out FOLDER] [--repeats N]

Prints a table for each, with the exponent of a power law fitted to its upper half
(where what does not grow no longer counts), writes JSON and a picture. Peak memory is
that of a process of its own for each figure.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

# the XLA setting that the command line uses, too (docs/speed.md)
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1048576",
)

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

from single import scene_of  # noqa: E402

import rollkane as rk  # noqa: E402

MOTIONS = (1, 10, 100, 1_000, 10_000, 100_000, 1_000_000)
HORIZONS = (1.0, 10.0, 100.0, 1000.0)
MASSES = (0, 1, 2, 4, 8, 16, 32, 64)
PARAMETERS = (1, 3, 10, 30, 100)
OUTPUTS = (2, 10, 100, 1_000, 10_000, 100_000)


def timed(function, repeats: int) -> tuple[float, float]:
    """Median seconds, and those of the first call."""
    spans = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        jax.block_until_ready(function())
        spans.append(time.perf_counter() - began)
    return statistics.median(spans[1:]), spans[0]


def motions(count: int, repeats: int) -> dict:
    """Discs of 1 s, made from their numbers and streamed by block."""
    scene, start = scene_of("P2")

    def make(i):
        share = jax.random.uniform(jax.random.fold_in(jax.random.key(0), i))
        spin = start.angular_velocity * (0.9 + 0.2 * share)
        return eqx.tree_at(lambda s: s.angular_velocity, start, spin)

    def run():
        blocks = rk.ensemble_blocks(scene, make, (0.0, 1.0), count=count, rtol=1e-8)
        return sum(int(block.succeeded.sum()) for block in blocks)

    seconds, first = timed(run, repeats if count < 10_000 else 1)
    return {"seconds": seconds, "first": first}


def horizon(end: float, repeats: int) -> dict:
    """One disc for longer and longer."""
    scene, start = scene_of("P2")
    seconds = {}
    for method in ("native", "diffrax"):
        how = {"rtol": 1e-8, "solver": dfx.Dopri8(), "method": method}
        run = lambda how=how: rk.simulate(scene, start, (0.0, end), **how).final_state
        seconds[method], _ = timed(run, repeats)
    return {"seconds": seconds["native"], "diffrax": seconds["diffrax"]}


def masses(count: int, repeats: int) -> dict:
    """A ball with masses on springs inside, each with a coordinate of its own."""
    supported = ()
    if count:
        turns = jnp.linspace(0.0, 2.0 * jnp.pi, count, endpoint=False)
        axes = jnp.stack([jnp.cos(turns), jnp.sin(turns), 0.3 + 0.0 * turns], axis=1)
        supported = (
            rk.PointMasses(
                np.full(count, 0.5 / count),
                lambda a, p: 0.05 * p + a[:, None] * p,
                potential=lambda a, p: 20.0 * jnp.sum(a * a) / a.shape[0],
                parameters=axes,
                coordinates=count,
            ),
        )
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(body, supported=supported)
    rest = [np.zeros(count)] * 2 if count else [(), ()]
    start = rk.place(
        *(scene, [1.0, 0.0, 0.0, 0.0], [0.5, 2.0, 1.0], [0.0, 0.0, 0.0]),
        alpha=rest[0],
        alpha_dot=rest[1],
    )
    # steps of fixed length: the same number for all
    how = {"dt0": 1e-3, "stepsize_controller": dfx.ConstantStepSize()}
    run = lambda: rk.simulate(scene, start, (0.0, 1.0), solver=dfx.Dopri5(), **how)
    seconds, first = timed(lambda: run().final_state, repeats)
    result = run()
    steps = int(result.steps + result.rejected_steps)
    return {"seconds": seconds / steps, "first": first, "steps": steps}


def parameters(count: int, repeats: int) -> dict:
    """Derivatives of an end by the heights of a ground's first waves."""

    def ground(x, y, p):
        waves = jnp.arange(1, p.shape[0] + 1, dtype=p.dtype)
        # by the square: the ground's curvature stays below 1/m, a tenth of the ball's
        return jnp.sum(p * jnp.sin(waves * x) / (waves * waves))

    heights = 0.01 * jnp.ones(100)
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))

    def scene_of_heights(p):
        return rk.Scene(body, rk.Base(rk.Graph(ground, parameters=p)))

    start = rk.place(
        scene_of_heights(heights), [1.0, 0.0, 0.0, 0.0], [0.5, 2.0, 1.0], [0.0] * 3
    )

    def end(chosen):
        scene = scene_of_heights(heights.at[:count].set(chosen))
        run = rk.simulate(scene, start, (0.0, 1.0), rtol=1e-8, solver=dfx.Dopri5())
        return run.state.angular_velocity[-1, 0]

    chosen = heights[:count]
    plain = jax.jit(end)
    base, _ = timed(lambda: plain(chosen), repeats)
    forward = jax.jit(jax.jacfwd(end))
    reverse = jax.jit(jax.grad(end))
    ahead, _ = timed(lambda: forward(chosen), repeats)
    back, _ = timed(lambda: reverse(chosen), repeats)
    apart = jnp.max(jnp.abs(forward(chosen) - reverse(chosen)))
    return {
        "seconds": ahead,
        "forward_solves": ahead / base,
        "reverse_solves": back / base,
        "apart": float(apart),
    }


def outputs(count: int, repeats: int) -> dict:
    """States of one disc at more and more times of 10 s."""
    scene, start = scene_of("P2")
    times = np.linspace(0.0, 10.0, count)
    seconds = {}
    for method in ("native", "diffrax"):
        how = {"rtol": 1e-8, "solver": dfx.Dopri8(), "method": method}
        run = lambda how=how: rk.simulate(scene, start, times, **how).final_state
        seconds[method], _ = timed(run, repeats)
    return {"seconds": seconds["native"], "diffrax": seconds["diffrax"]}


TABLES = {
    "motions": (motions, MOTIONS),
    "horizon": (horizon, HORIZONS),
    "masses": (masses, MASSES),
    "parameters": (parameters, PARAMETERS),
    "outputs": (outputs, OUTPUTS),
}


def exponent(sizes, values) -> float:
    """Of a power law through the upper half of a table."""
    known = [(s, v) for s, v in zip(sizes, values, strict=True) if s and v]
    upper = known[len(known) // 2 :]
    return float(np.polyfit(*np.log(np.array(upper)).T, 1)[0])


def table(name: str, sizes, repeats: int) -> dict:
    """One table, each row from a process of its own."""
    rows = []
    for size in sizes:
        command = [sys.executable, __file__, "--inner", name, str(size)]
        done = subprocess.run(
            [*command, "--repeats", str(repeats)],
            capture_output=True,
            text=True,
            check=True,
        )
        rows.append({"size": size} | json.loads(done.stdout.splitlines()[-1]))
        shown = (f"{k} {v:.4g}" for k, v in rows[-1].items())
        print(f"{name:12}{'  '.join(shown)}", flush=True)
    fitted = {
        key: exponent(sizes, [row[key] for row in rows])
        for key in rows[0]
        if key not in ("size", "first", "steps", "apart")
    }
    told = ", ".join(f"{key} {value:.2f}" for key, value in fitted.items())
    print(f"{name:12}exponents: {told}\n")
    return {"rows": rows, "exponents": fitted}


def draw(tables: dict, path: Path) -> None:
    """Time against size, a panel for each table."""
    from rollkane.pictures.plot_style import BLUE, dress, new_figure, png

    figure = new_figure((15.0, 3.6))
    panels = figure.subplots(1, len(tables))
    for panel, (name, found) in zip(panels, tables.items(), strict=True):
        rows = [row for row in found["rows"] if row["size"]]
        panel.loglog(
            [row["size"] for row in rows],
            [row["seconds"] for row in rows],
            color=BLUE,
            marker="o",
        )
        panel.set_title(f"{name}: exponent {found['exponents']['seconds']:.2f}")
        panel.set_xlabel(name)
        dress(panel)
    panels[0].set_ylabel("time [s]")
    path.write_bytes(png(figure))


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", choices=TABLES)
    parser.add_argument("--inner", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inner:
        name, size = options.inner
        measure, sizes = TABLES[name]
        row = measure(type(sizes[0])(size), options.repeats)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(json.dumps(row | {"peak_mib": peak}))
        return
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, medians of {options.repeats}"
    )
    print(machine)
    chosen = [options.only] if options.only else list(TABLES)
    tables = {n: table(n, TABLES[n][1], options.repeats) for n in chosen}
    if options.only:
        return
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {"machine": machine, "tables": tables}
    (options.out / "growth.json").write_text(json.dumps(figures, indent=1))
    draw(tables, options.out / "growth.png")


if __name__ == "__main__":
    main()
