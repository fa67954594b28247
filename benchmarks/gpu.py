"""Ensembles on an NVIDIA GPU beside diffrax there, and beside all processors.

    python benchmarks/gpu.py [--out FOLDER] [--repeats N] [--most MEMBERS]

Prints tables, writes them as JSON and draws one: motions a second of P2 (thin disc), P3
(rattleback) and the isolator on its record at 1e-8, of one member to ten millions; the
Lorenz benchmark of DiffEqGPU (768,000 members, 1,000 steps of RK4 in single precision);
by what the GPU's results differ from the processor's; `ensemble` and `monte_carlo`;
derivatives; what the order of members matters. Members are in random order. Medians of
the repeats; everything in one run on one machine. Needs `jax[cuda13]`.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

from engine import HORIZON, show, timed
from single import scene_of

SCENES = ("P2", "P3", "isolator")
RTOL, SPREAD = 1e-8, 0.1
LORENZ = {"members": 768_000, "steps": 1000, "step": 1e-3, "published, ms": 14.6}
SHORT = 100_000  # members up to which diffrax and the processors are asked


def case(name, members, in_order=False):
    """A scene, and so many starts that differ by a tenth."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from rollkane.files.scene_files.loading import load_scene

    if name == "isolator":
        file = load_scene(name)
        scene, start, what = file.scene, file.start, lambda s: s.alpha_dot
        moved = lambda x: start.alpha_dot + 0.01 * x
    else:
        scene, start = scene_of(name)
        what, w = (lambda s: s.angular_velocity), start.angular_velocity
        moved = lambda x: w * (1.0 + SPREAD * x)
    numbers = jnp.linspace(-1.0, 1.0, members)
    if not in_order:
        numbers = jax.random.permutation(jax.random.key(0), numbers)
    starts = jax.vmap(lambda x: eqx.tree_at(what, start, moved(x)))(numbers)
    return scene, starts


def mapped(scene, method="auto"):
    """Ends of motions, as one program."""
    import jax

    import rollkane as rk

    def one(start):
        run = rk.simulate(scene, start, (0.0, HORIZON), rtol=RTOL, method=method)
        return run.final_state, run.code, run.steps

    return jax.jit(jax.vmap(one))


def throughput(name, sizes, repeats, method="auto", in_order=False):
    """Motions a second for each number of members, and the first result [s]."""
    import jax

    rows = []
    for members in sizes:
        scene, starts = case(name, members, in_order)
        run = mapped(scene, method)
        began = time.perf_counter()
        jax.block_until_ready(run(starts))
        first = time.perf_counter() - began
        seconds = timed(lambda run=run, starts=starts: run(starts), repeats)
        rows.append((members / seconds, first))
    return rows


def on_processors(repeats, most):
    """Motions a second of ``ensemble`` on all processors; a process of its own."""
    import rollkane as rk

    found = {}
    for name in SCENES:
        for members in sizes_to(min(most, SHORT)):
            scene, starts = case(name, members)
            every = lambda scene=scene, starts=starts: (
                rk.ensemble(scene, starts, (0.0, HORIZON), rtol=RTOL).final_state
            )
            found[f"{name} {members}"] = members / timed(every, repeats)
    return found | {"lorenz": lorenz(repeats)}


def sizes_to(most):
    """One, and powers of ten from a thousand on."""
    sizes = [1, 1000]
    while 10 * sizes[-1] <= most:
        sizes.append(10 * sizes[-1])
    return sizes


def of_processors(repeats, most):
    """What :func:`on_processors` finds in a process without a GPU."""
    given = "--inner", "--repeats", str(repeats), "--most", str(most)
    return json.loads(
        subprocess.run(
            [sys.executable, __file__, *given],
            env=os.environ | {"JAX_PLATFORMS": "cpu"},
            capture_output=True,
            check=True,
            text=True,
        ).stdout.splitlines()[-1]
    )


def members_table(repeats, most, processors):
    """Of each scene and number of members."""
    rows = []
    for name in SCENES:
        sizes = sizes_to(most)
        own = throughput(name, sizes, repeats)
        few = [n for n in sizes if n <= SHORT]
        theirs = throughput(name, few, min(repeats, 3), "diffrax")
        for i, members in enumerate(sizes):
            by_diffrax = theirs[i] if i < len(few) else (None, None)
            by_processors = processors.get(f"{name} {members}")
            rows.append(
                {
                    "scene": name,
                    "members": members,
                    "a second": own[i][0],
                    "diffrax there": by_diffrax[0],
                    "processors": by_processors,
                    "/ diffrax": by_diffrax[0] and own[i][0] / by_diffrax[0],
                    "/ processors": by_processors and own[i][0] / by_processors,
                    "first result, s": own[i][1],
                    "of diffrax": by_diffrax[1],
                }
            )
            print(rows[-1], flush=True)
    return rows


def orders(repeats):
    """Members in the order of their lengths over those in random order."""
    rows = []
    for name in SCENES:
        row = {"scene": name, "members": 10 * SHORT}
        for what, in_order in (("random", False), ("in order", True)):
            of = throughput(name, [10 * SHORT], repeats, in_order=in_order)
            row[f"{what}, a second"] = of[0][0]
        rows.append(row)
    return rows


def by_name(members, repeats):
    """``ensemble`` and ``monte_carlo`` of the rattleback, which know nothing of it."""
    import rollkane as rk

    scene, starts = case("P3", members)
    times = (0.0, HORIZON)
    every = lambda: rk.ensemble(scene, starts, times, rtol=RTOL)
    found = every()
    seconds = timed(lambda: every().final_state, repeats)
    rows = [{"call": "ensemble", "method": found.method, "a second": members / seconds}]
    _, start = scene_of("P3")
    study = rk.Study(
        lambda draw: (scene, _spun(start, draw["spin"])),
        {"spin": rk.Normal(1.0, 0.05)},
        times,
        {"spin": lambda scene, t, state: state.angular_velocity[2]},
        rtol=RTOL,
    )
    rk.monte_carlo(study, members, seed=1)
    began = time.perf_counter()
    study = rk.monte_carlo(study, members, seed=2)
    seconds = time.perf_counter() - began
    about = {"call": "monte_carlo", "method": study.rates.method}
    return [*rows, about | {"a second": members / seconds}]


def _spun(start, scale):
    import equinox as eqx

    return eqx.tree_at(
        lambda s: s.angular_velocity, start, start.angular_velocity * scale
    )


# Runge and Kutta's method; its end's rates are the next step's first
_ROWS = (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)
_NODES = 0.5, 0.5, 1.0, 1.0


def _lorenz_rates(t, y, rho):
    import jax.numpy as jnp

    x, y, z = y
    return jnp.stack([10.0 * (y - x), x * (rho - z) - y, x * y - 8.0 / 3.0 * z])


def lorenz_natively(start, end, rho):
    """One member: where it ends, and its steps."""
    import jax.numpy as jnp

    from rollkane.codegen import Course, RunLoop
    from rollkane.codegen.tableau import Weights

    number = lambda x: jnp.asarray(x, jnp.float32)
    rk4 = Weights(_ROWS, _NODES, (0.0,) * 5, 4)
    loop, step = RunLoop(_lorenz_rates, start, [rho], rk4), number(LORENZ["step"])
    course = Course(
        *(number(0.0), number(1.0), number(0.1), jnp.ones(3, jnp.float32)),
        *(number(0.0), step, step, number([end]), number([end]), number([end])),
    )
    ended = loop(start, course, 2 * LORENZ["steps"])
    return ended.final_y, ended.steps


def lorenz_by_diffrax(start, end, rho):
    """The same."""
    import diffrax as dfx
    import numpy as np

    class Rk4(dfx.Bosh3):
        tableau = dfx.ButcherTableau(
            c=np.array(_NODES),
            b_sol=np.array([*_ROWS[-1], 0.0]),
            b_error=np.zeros(5),
            a_lower=tuple(map(np.array, _ROWS)),
        )

    solution = dfx.diffeqsolve(
        *(dfx.ODETerm(_lorenz_rates), Rk4(), 0.0, end, LORENZ["step"], start, rho),
        max_steps=2 * LORENZ["steps"],
        adjoint=dfx.ForwardMode(),
    )
    return solution.ys[-1], solution.stats["num_steps"]


def lorenz(repeats, by=lorenz_natively):
    """The published benchmark: fixed steps, in single precision."""
    import jax
    import jax.numpy as jnp

    start, end = jnp.asarray([1.0, 0.0, 0.0], jnp.float32), 1.0
    assert end == LORENZ["step"] * LORENZ["steps"]
    run = jax.jit(jax.vmap(lambda rho: by(start, end, rho)))
    numbers = jnp.linspace(0.0, 21.0, LORENZ["members"], dtype=jnp.float32)
    ends, steps = run(numbers)
    seconds = timed(lambda: run(numbers), repeats)
    at = "({:.4f}, {:.4f}, {:.4f})".format(*map(float, ends[-1]))
    return {"ms": 1e3 * seconds, "steps": int(steps[-1]), "end": at}


def lorenz_table(repeats, processors):
    """Of all who make it, one in a row."""
    rows = [{"by": "rollkane"} | lorenz(repeats)]
    rows.append({"by": "diffrax, vmapped"} | lorenz(2, lorenz_by_diffrax))
    rows.append({"by": "rollkane, all processors"} | processors["lorenz"])
    published = {"ms": LORENZ["published, ms"], "steps": LORENZ["steps"], "end": "-"}
    return [*rows, {"by": "DiffEqGPU, published, another GPU"} | published]


def difference(name, members):
    """Of the GPU's ends, codes and steps from those of the processor."""
    import jax
    import numpy as np

    scene, starts = case(name, members)
    there = jax.tree.map(np.asarray, mapped(scene)(starts))
    (cpu, *_) = jax.devices("cpu")
    scene, starts = jax.device_put((scene, starts), cpu)
    here = jax.tree.map(np.asarray, mapped(scene)(starts))
    pairs = zip(*map(jax.tree.leaves, (there[0], here[0])), strict=True)
    rows = [np.abs(a - b).reshape(members, -1) for a, b in pairs]
    gap = np.max(np.concatenate(rows, axis=1), axis=1)
    differ = lambda i: int(np.sum(there[i] != here[i]))
    return {
        "scene": name,
        "members": members,
        "largest difference": float(np.max(gap)),
        "not the same": int(np.sum(gap != 0)),
        "codes differ": differ(1),
        "steps differ": differ(2),
        "of steps": int(np.sum(here[2])),
    }


def derivatives(name, members, repeats):
    """Tangents and gradients of ends by the mass, a member each."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    import rollkane as rk

    scene, starts = case(name, members)

    def end(mass, start, method):
        changed = eqx.tree_at(lambda x: x.body.mass, scene, mass)
        times = 0.0, HORIZON
        run = rk.simulate(
            changed, start, times, rtol=RTOL, method=method, max_steps=2000
        )
        return jnp.sum(run.final_state.angular_velocity)

    row = {"scene": name, "members": members}
    for kind, slope in (("tangents", jax.jacfwd), ("gradients", jax.grad)):
        many = {}
        for method in ("auto", "diffrax"):
            of = jax.vmap(
                slope(lambda m, s, method=method: end(m, s, method)), (None, 0)
            )
            many[method] = jax.jit(of)
        found = {how: run(scene.body.mass, starts) for how, run in many.items()}
        gap = jnp.max(jnp.abs(found["auto"] - found["diffrax"]))
        size = jnp.max(jnp.abs(found["diffrax"]))
        spans = {
            how: timed(lambda run=run: run(scene.body.mass, starts), repeats)
            for how, run in many.items()
        }
        row |= {
            f"{kind} a second": members / spans["auto"],
            f"{kind} / diffrax": spans["diffrax"] / spans["auto"],
            f"{kind} differ": float(gap / size),
        }
    return row


def draw(rows, path):
    """Motions a second over the number of members."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(SCENES), figsize=(11, 3.6), sharey=True)
    kinds = ("a second", "rollkane, GPU"), ("diffrax there", "diffrax vmapped, GPU")
    for ax, name in zip(axes, SCENES, strict=True):
        own = [row for row in rows if row["scene"] == name]
        for key, label in (*kinds, ("processors", "rollkane, processors")):
            known = [(row["members"], row[key]) for row in own if row[key]]
            ax.loglog(*zip(*known, strict=True), "o-", label=label)
        ax.set_title(name)
        ax.set_xlabel("members")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("motions of 1 s, a second")
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=150)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--most", type=int, default=10_000_000)
    parser.add_argument("--inner", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    if options.inner:
        print(json.dumps(on_processors(options.repeats, options.most)))
        return
    device = jax.devices()[0]
    print(
        f"{device.device_kind}; {os.cpu_count()} cores of {platform.machine()}, Python "
        f"{platform.python_version()}, JAX {jax.__version__}, medians of "
        f"{options.repeats}"
    )
    options.out.mkdir(parents=True, exist_ok=True)
    repeats, tables = options.repeats, {}
    processors = of_processors(repeats, options.most)
    for title, table in {
        "Beside the processor": lambda: [difference(x, SHORT) for x in SCENES],
        "Lorenz, 768,000 times 1,000 steps of RK4": lambda: lorenz_table(
            repeats, processors
        ),
        "Motions a second": lambda: members_table(repeats, options.most, processors),
        "By name": lambda: by_name(10 * SHORT, repeats),
        "Order of members": lambda: orders(repeats),
        "Derivatives": lambda: [derivatives("P2", 4096, repeats)],
    }.items():
        tables[title] = table()
        show(title, tables[title])
        figures = {"device": device.device_kind, "tables": tables}
        (options.out / "gpu.json").write_text(json.dumps(figures, indent=1))
    draw(tables["Motions a second"], options.out / "gpu.png")
    print(f"written: {options.out / 'gpu.json'}, {options.out / 'gpu.png'}")


if __name__ == "__main__":
    main()
