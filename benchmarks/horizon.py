"""Long horizons: which method keeps the energy over 10^5 revolutions, at what cost.

    python benchmarks/horizon.py [--out FOLDER] [--revolutions N] [--docs FOLDER]

The Routh sphere (a ball with its mass centre off its middle, 6 rad/s) and the
rattleback (5 rad/s), by adaptive explicit methods, by Gauss's implicit methods of order
2 (the midpoint rule) and 6 with constant steps, and by an explicit method whose every
step is brought back onto the start's energy (``rk.Keeping``). The pose follows from the
contact, so no method leaves the surface. Prints a table, writes JSON and a plot of
energy error against time.
"""

import argparse
import json
import os
import platform
import time
from pathlib import Path
from typing import ClassVar

# the XLA setting that the command line uses, too (docs/speed.md)
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536",
)

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk

jax.config.update("jax_enable_x64", True)

POINTS = 41  # outputs, over which the largest energy error is taken
SWEEPS = 10  # of the fixed point of a step: below rounding for steps of 0.1 rad


class Gauss(dfx.AbstractSolver):
    """Gauss's collocation with s stages, order 2 s: symmetric in time."""

    stages: int = eqx.field(static=True)
    term_structure: ClassVar = dfx.ODETerm
    interpolation_cls: ClassVar = dfx.LocalLinearInterpolation

    def order(self, terms):
        """Twice the stages."""
        return 2 * self.stages

    def init(self, terms, t0, t1, y0, args):
        """Nothing to remember."""

    def func(self, terms, t0, y0, args):
        """The rates."""
        return terms.vf(t0, y0, args)

    def _tableau(self):
        nodes, weights = np.polynomial.legendre.leggauss(self.stages)
        c, b = 0.5 * (nodes + 1.0), 0.5 * weights
        powers = np.arange(1, self.stages + 1)
        V = c[:, None] ** (powers - 1)
        A = (c[:, None] ** powers / powers) @ np.linalg.inv(V)
        return A, b, c

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """One step, by a fixed number of sweeps."""
        A, b, c = self._tableau()
        h, times = terms.contr(t0, t1), t0 + c * (t1 - t0)
        rates = jax.vmap(lambda t, y: terms.vf(t, y, args))
        K = jnp.broadcast_to(terms.vf(t0, y0, args), (self.stages, y0.shape[0]))
        K = jax.lax.fori_loop(0, SWEEPS, lambda _, K: rates(times, y0 + h * (A @ K)), K)
        y1 = y0 + h * (b @ K)
        return y1, None, {"y0": y0, "y1": y1}, None, dfx.RESULTS.successful


def routh():
    """A ball whose mass centre is off its middle; its spin [rad/s]."""
    body = rk.Body(
        0.5, np.diag([1.6e-3, 1.6e-3, 2.1e-3]), rk.Sphere(0.1), (0.0, 0.0, -0.02)
    )
    scene = rk.Scene(body)
    half = 0.5 * np.deg2rad(50.0)
    q = (np.cos(half), np.sin(half), 0.0, 0.0)
    return scene, rk.place(scene, q, (0.4, -0.7, 6.0), (0.0, 0.0, 0.0)), 6.0


def rattleback():
    """Kane and Levinson's; its spin [rad/s]."""
    from rollkane.files.scene_files import load_scene

    file = load_scene("rattleback")
    return file.scene, file.start, 5.0


def choices(scene, start, spin):
    """Methods: name and arguments of a run."""
    for rtol in (1e-9, 1e-11, 1e-13):
        yield f"Dopri8, rtol {rtol:.0e}", {"rtol": rtol, "solver": dfx.Dopri8()}
    yield "Tsit5, rtol 1e-09", {"rtol": 1e-9, "solver": dfx.Tsit5()}
    kept = rk.keeping_energy(scene, start)
    yield "Dopri8 on the energy, rtol 1e-09", {"rtol": 1e-9, "solver": kept}
    for stages, turn in ((1, 0.01), (3, 0.03)):
        yield (
            f"Gauss, order {2 * stages}, {turn} rad a step",
            {
                "solver": Gauss(stages),
                "stepsize_controller": dfx.ConstantStepSize(),
                "dt0": turn / spin,
            },
        )


def measure(problem, revolutions: int) -> list[dict]:
    """Energy error, return error and time of every method."""
    scene, start, spin = problem()
    end = revolutions * 2.0 * np.pi / spin
    rows = []
    for name, how in choices(scene, start, spin):
        how = how | {"max_steps": 2**31 - 1, "method": "diffrax"}
        times = np.linspace(0.0, end, POINTS)
        short = np.linspace(0.0, end / revolutions, POINTS)
        jax.block_until_ready(rk.simulate(scene, start, short, **how).state)  # compile
        began = time.perf_counter()
        run = jax.block_until_ready(rk.simulate(scene, start, times, **how))
        taken = time.perf_counter() - began
        energy = np.asarray(run.energy)
        # there and back, over a hundredth: the error of a method that is not symmetric
        away = rk.simulate(scene, start, [0.0, 0.01 * end], **how)
        home = rk.simulate(scene, away.final_state, [0.01 * end, 0.0], **how)
        gone = np.abs(home.final_state.angular_velocity - start.angular_velocity).max()
        rows.append(
            {
                "method": name,
                "reached": bool(run.succeeded),
                "steps": int(run.steps),
                "energy": float(np.abs(energy / energy[0] - 1.0).max()),
                "return": float(gone),
                "seconds": taken,
            }
        )
        print(
            f"  {name:<36} {rows[-1]['steps']:>10} steps {taken:8.2f} s   energy "
            f"{rows[-1]['energy']:.1e}   back {gone:.1e} rad/s"
            + ("" if rows[-1]["reached"] else f"   {run.reason}"),
            flush=True,
        )
    return rows


def draw(found: dict, path: Path) -> None:
    """Energy error against time, a panel for each scene."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    fig, axes = plt.subplots(
        1, len(found), figsize=(10, 4.6), sharey=True, layout="constrained"
    )
    for ax, (name, rows) in zip(axes, found.items(), strict=True):
        for row in rows:
            error = max(row["energy"], 1e-16)
            ax.loglog(row["seconds"], error, "o", markersize=8, label=row["method"])
        ax.set_title(name)
        ax.set_xlabel("time of the run [s]")
        ax.set_xlim(1.0, 1000.0)
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.grid(color="0.93")
    axes[0].set_ylabel("largest energy error, relative")
    handles, labels = axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    fig.savefig(path, dpi=110)
    plt.close(fig)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--revolutions", type=int, default=100_000)
    options = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}; one run each, compiled "
        f"before; {options.revolutions} revolutions"
    )
    found = {}
    for name, problem in (("Routh sphere", routh), ("rattleback", rattleback)):
        print(name)
        found[name] = measure(problem, options.revolutions)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "horizon.json").write_text(json.dumps(found, indent=1) + "\n")
    draw(found, options.docs / "images" / "horizon.png")
    print(f"written: {options.out / 'horizon.json'}")


if __name__ == "__main__":
    main()
