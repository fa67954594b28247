"""rollkane and what users would pick instead, side by side in one run.

    python benchmarks/compare.py [--out FOLDER] [--repeats N] [--quick]

P1 (ball on a turntable), P2 (thin disc), P3 (rattleback): error against time of one
motion for all (rollkane's inside of a jitted function, as a program calls it); motions
per second at 1 to 100,000 motions; cost and truth of gradients.
Peers run in environments of their own (`make bench-peers` makes them); one that is not
there is skipped by name, with the reason. Prints tables, writes JSON and two diagrams.
"""

import argparse
import functools
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path

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

jax.config.update("jax_enable_x64", True)

from peers import c_dopri5, c_lanes, diffrax_usual  # noqa: E402
from peers.problems import INITIAL, PROBLEMS, end_error  # noqa: E402
from single import at_error, end_numbers, scene_of  # noqa: E402

import rollkane as rk  # noqa: E402

HERE = Path(__file__).parent
OTHERS = {  # script -> environment
    "sympy_rolling.py": None,
    "mujoco_rolling.py": ".venv-mujoco",
    "exudyn_rolling.py": ".venv-exudyn",
}
TOLERANCES = tuple(10.0**-k for k in range(4, 13))
COUNTS = (1, 100, 10_000, 100_000)
TITLES = {
    "P1": "P1: ball on a turntable, 10 s",
    "P2": "P2: thin disc, 10 s",
    "P3": "P3: rattleback, 5 s",
}
GRADIENTS = (("P2", 1.0), ("P2", 10.0), ("P3", 1.0), ("P3", 5.0))
# that a derivative has room for, however many a run takes
STEPS = 65536


def median(function, repeats: int):
    """Median seconds of a few calls, after one that compiles."""
    began = time.perf_counter()
    jax.block_until_ready(function())
    first = time.perf_counter() - began
    spans = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function())
        spans.append(time.perf_counter() - began)
    return statistics.median(spans), first


def ball_on_turntable():
    """P1, with the exact place of its centre at the end."""
    inertia = 0.4 * 0.1**2 * np.eye(3)
    scene = rk.Scene(
        rk.Body(1.0, inertia, rk.Sphere(0.1)), rk.Base(motion=rk.Spin(3.0))
    )
    # v + w x (-R z) = Omega z x r, with v = (0, 0.2) at r = (0.3, 0)
    spin = [-(0.2 - 3.0 * 0.3) / 0.1, 0.0, 0.0]
    start = rk.place(scene, [1.0, 0.0, 0.0, 0.0], spin, [0.3, 0.0, 0.0])
    rate = 2.0 / 7.0 * 3.0
    turn = rate * 10.0
    exact = [0.3 + 0.2 / rate * (np.cos(turn) - 1.0), 0.2 / rate * np.sin(turn)]
    return scene, start, np.array(exact)


def ours(repeats: int) -> list[dict]:
    """Error and time of one motion, by both methods and two solvers."""
    rows = []
    for name in ("P1", "P2", "P3"):
        for method in ("native", "diffrax"):
            for solver in ("Dopri5", "Dopri8"):
                rows += [our_run(name, method, solver, r, repeats) for r in TOLERANCES]
    return rows


def our_run(name: str, method: str, solver: str, rtol: float, repeats: int) -> dict:
    """One problem with one setting."""
    if name == "P1":
        scene, start, exact = ball_on_turntable()
        end = 10.0
    else:
        (scene, start), exact, end = scene_of(name), None, PROBLEMS[name]["t_end"]
    run = functools.partial(
        rk.simulate,
        scene,
        times=(0.0, end),
        solver=getattr(dfx, solver)(),
        method=method,
    )
    inside = _inside(name, method, solver, run)
    seconds, first = median(lambda: inside(start, rtol).final_state, repeats)
    bare, _ = median(lambda: run(start, rtol=rtol).final_state, repeats)
    result = run(start, rtol=rtol)
    if exact is not None:
        place = np.asarray(result.position[-1])[:2]
        error = float(np.linalg.norm(place - exact))
    else:
        apart = end_error(PROBLEMS[name], end_numbers(PROBLEMS[name], result))
        error = float(max(apart.position, apart.rotation))
    return {
        "problem": name,
        "peer": f"rollkane {method}, {solver}",
        "setting": f"rtol {rtol:.0e}",
        "error": error,
        "seconds": seconds,
        "bare": bare,
        "steps": int(result.steps + result.rejected_steps),
        "first": first,
    }


_compiled = {}


def _inside(name: str, method: str, solver: str, run):
    """A run inside of a jitted function, one for all tolerances."""
    key = name, method, solver
    if key not in _compiled:
        _compiled[key] = jax.jit(lambda start, rtol: run(start, rtol=rtol))
    return _compiled[key]


def c_and_diffrax(repeats: int) -> tuple[list[dict], list[str]]:
    """Hand-written C, and diffrax the usual way."""
    rows, notes = [], []
    library, why = c_dopri5.load()
    if library is None:
        notes.append(f"C skipped: {why}")
    for name, problem in PROBLEMS.items():
        for rtol in TOLERANCES:
            found = []
            if library is not None:
                result = library.solve(name, rtol, 0.01 * rtol)
                spans = library.seconds(name, rtol, 0.01 * rtol, 20, repeats)
                steps = result.accepted + result.rejected
                found.append(
                    ("C DOPRI5", result.y_end, statistics.median(spans), steps)
                )
            if rtol > 1e-11:
                solve = jax.jit(diffrax_usual.solver_of(name, problem["t_end"], rtol))
                start = jnp.array(INITIAL[name])
                seconds, _ = median(lambda s=solve, y=start: s(y), max(3, repeats // 3))
                y, steps = solve(start)
                peer = "diffrax Tsit5, usual style"
                found.append((peer, diffrax_usual.end_of(y), seconds, int(steps)))
            for peer, y, seconds, steps in found:
                error = end_error(problem, y)
                rows.append(
                    {
                        "problem": name,
                        "peer": peer,
                        "setting": f"rtol {rtol:.0e}",
                        "error": max(error.position, error.rotation),
                        "seconds": seconds,
                        "steps": steps,
                    }
                )
    return rows, notes


def others() -> tuple[list[dict], list[str]]:
    """Peers with environments of their own."""
    rows, notes = [], []
    for script, environment in OTHERS.items():
        python = sys.executable
        if environment is not None:
            python = str(HERE.parent / environment / "bin" / "python")
            if not Path(python).exists():
                notes.append(f"{script} skipped: no {environment} (make bench-peers)")
                continue
        command = [python, str(HERE / "peers" / script)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            reason = done.stderr.strip().splitlines()[-1:]
            notes.append(f"{script} skipped: {' '.join(reason)}")
            continue
        rows += json.loads(done.stdout.splitlines()[-1])
    return rows, notes


def spread(name: str, count: int) -> np.ndarray:
    """Starts of a batch as the peers' nine numbers: spins within 10 %."""
    random = np.random.default_rng(0)
    starts = np.tile(np.array(INITIAL[name]), (count, 1))
    starts[:, 4:7] *= 1.0 + 0.1 * random.uniform(-1.0, 1.0, (count, 1))
    return starts


def throughput(repeats: int, counts) -> tuple[list[dict], list[str]]:
    """Motions of 1 s at rtol 1e-8, per second of the whole machine and of a core."""
    rows, notes = [], []
    lanes, why = c_lanes.load()
    if lanes is None:
        notes.append(f"C skipped: {why}")
    for name in PROBLEMS:
        usual = jax.jit(jax.vmap(diffrax_usual.solver_of(name, 1.0, 1e-8)))
        for count in counts:
            times = {10_000: 3, 100_000: 1}.get(count, repeats)
            for peer, run in batches(name, count, usual, lanes).items():
                run()  # compiles
                cpu = time.process_time()
                seconds, _ = median(run, times)
                cpu = (time.process_time() - cpu) / (times + 1)
                rows.append(
                    {
                        "problem": name,
                        "peer": peer,
                        "count": count,
                        "per_second": count / seconds,
                        "per_core_second": count / max(cpu, 1e-9),
                    }
                )
    return rows, notes


def batches(name: str, count: int, usual, lanes) -> dict:
    """Functions that run a batch, by peer."""
    scene, start = scene_of(name)
    numbers = spread(name, count)
    put = lambda w: eqx.tree_at(lambda s: s.angular_velocity, start, w)
    starts = jax.vmap(put)(jnp.asarray(numbers[:, 4:7]))

    def ensemble(solver, **how):
        return lambda: (
            rk.ensemble(
                scene, starts, (0.0, 1.0), rtol=1e-8, solver=solver, **how
            ).final_state
        )

    runs = {
        "rollkane native, Dopri5, 1 worker": ensemble(dfx.Dopri5(), workers=1),
        "rollkane native, Dopri8, 1 worker": ensemble(dfx.Dopri8(), workers=1),
        "rollkane native, Dopri5": ensemble(dfx.Dopri5()),
        "rollkane native, Dopri8": ensemble(dfx.Dopri8()),
    }
    if count <= 10_000:
        runs["rollkane diffrax, Dopri5"] = ensemble(dfx.Dopri5(), method="diffrax")
        runs["diffrax Tsit5, usual style"] = lambda: usual(jnp.asarray(numbers))
    if lanes is not None:
        scalar, _ = c_dopri5.load()
        how = numbers, 1.0, 1e-8, 1e-10
        runs["C lanes, hand-vectorised"] = lambda: lanes.solve(name, *how)
        runs["C scalar"] = lambda: scalar.solve_each(name, *how)
    return runs


def end_number(name: str, end: float, method: str = "diffrax", rtol: float = 1e-10):
    """One number at the end, of eight: spin, mass, inertia, height of the mass [cm]."""
    scene, start = scene_of(name)

    def value(p):
        body = scene.body
        changed = (
            body.mass * (1.0 + p[3]),
            body.inertia * (1.0 + jnp.diag(p[4:7])),
            body.center_of_mass + 0.01 * jnp.stack([0.0 * p[7], 0.0 * p[7], p[7]]),
        )
        where = lambda s: (s.body.mass, s.body.inertia, s.body.center_of_mass)
        spin = start.angular_velocity + p[:3]
        begun = eqx.tree_at(lambda s: s.angular_velocity, start, spin)
        moved = eqx.tree_at(where, scene, changed)
        run = rk.simulate(moved, begun, (0.0, end), rtol=rtol, method=method)
        if name == "P2":
            return run.position[-1, 0]
        return run.angular_velocity[-1, 2]

    return value


def richardson(name: str, end: float) -> np.ndarray:
    """Derivatives by differences of runs at rtol 1e-12.

    With steps of 1e-4 and twice that: the first term that is left of the series has the
    fourth power of the step, 1e-16, and the runs' errors are 1e-12 over the step, 1e-8.
    """
    value = jax.jit(end_number(name, end, rtol=1e-12))
    h, found = 1e-4, []
    for unit in np.eye(8):
        at = [float(value(jnp.asarray(k * h * unit))) for k in (-2, -1, 1, 2)]
        found.append((8.0 * (at[2] - at[1]) - (at[3] - at[0])) / (12.0 * h))
    return np.array(found)


def gradients(name: str, end: float, method: str, repeats: int) -> list[dict]:
    """Cost in forward solves, truth and memory of derivatives by one and eight."""
    value = end_number(name, end, method)
    exact = richardson(name, end)
    nought = jnp.zeros(8)
    plain = jax.jit(value)
    base, _ = median(lambda: plain(nought), repeats)

    def by_spin(x):
        return value(nought.at[2].set(x))

    rows = []
    for label, function, point, wanted in (
        ("forward, 1", jax.jacfwd(by_spin), nought[2], exact[2]),
        ("forward, 8", jax.jacfwd(value), nought, exact),
        ("reverse, 1", jax.grad(by_spin), nought[2], exact[2]),
        ("reverse, 8", jax.grad(value), nought, exact),
    ):
        run = jax.jit(function)
        seconds, first = median(lambda f=run, x=point: f(x), repeats)
        off = np.max(np.abs(run(point) - wanted)) / np.max(np.abs(wanted))
        memory = run.lower(point).compile().memory_analysis()
        rows.append(
            {
                "problem": name,
                "end": end,
                "method": method,
                "mode": label,
                "seconds": seconds,
                "solves": seconds / base,
                "off": float(off),
                "first": first,
                "temporaries": memory.temp_size_in_bytes,
            }
        )
    return rows


def show_single(rows: list[dict]) -> list[dict]:
    """Every peer at equal errors, over C and over rollkane's fastest."""
    equal = []
    print("\nOne motion at equal end error (time / time of C, step / step of C):")
    for problem in ("P1", "P2", "P3"):
        peers = list(dict.fromkeys(r["peer"] for r in rows if r["problem"] == problem))
        for target in (1e-4, 1e-6, 1e-8):
            found = {p: at_error(rows, problem, p, target) for p in peers}
            c = found.get("C DOPRI5")
            for peer, it in found.items():
                if it is None:
                    continue
                row = {"problem": problem, "error": target, "peer": peer}
                row |= {"seconds": it[0], "per_step": it[1]}
                row |= (
                    {"over_c": it[0] / c[0], "step_over_c": it[1] / c[1]} if c else {}
                )
                equal.append(row)
                over = f"{row['over_c']:10.2f}{row['step_over_c']:10.2f}" if c else ""
                print(
                    f"{problem:4}{target:8.0e}  {peer:32}{1e3 * it[0]:11.3f} ms"
                    f"{1e6 * it[1]:10.3f} us/step{over}"
                )
    return equal


def show_rest(batch: list[dict], slopes: list[dict]) -> None:
    """Throughput and gradients."""
    print("\nMotions of 1 s at rtol 1e-8, per second (and per core second):")
    for row in batch:
        print(
            f"{row['problem']:4}{row['count']:>8}  {row['peer']:36}"
            f"{row['per_second']:12.0f}{row['per_core_second']:12.0f}"
        )
    print("\nDerivatives of an end by 1 and by 8 parameters, in solves at rtol 1e-10:")
    for row in slopes:
        print(
            f"{row['problem']:4}{row['end']:4.0f} s  {row['method']:8}{row['mode']:12}"
            f"{1e3 * row['seconds']:9.3f} ms, {row['solves']:.2f} solves, "
            f"off by {row['off']:.1e}, "
            f"first call {row['first']:.1f} s, "
            f"{row['temporaries'] / STEPS:5.0f} bytes a step"
        )


def draw(rows: list[dict], path: Path) -> None:
    """Error against time of all peers, a panel for each problem."""
    from rollkane.pictures.plot_style import dress, new_figure, png

    figure = new_figure((13.0, 4.8))
    panels = figure.subplots(1, 3, sharey=True)
    peers = list(dict.fromkeys(r["peer"] for r in rows))
    for panel, problem in zip(panels, TITLES, strict=True):
        for i, peer in enumerate(peers):
            mine = [r for r in rows if r["peer"] == peer and r["problem"] == problem]
            if not mine:
                continue
            panel.loglog(
                [r["error"] for r in mine],
                [r["seconds"] for r in mine],
                marker="osD^vP<>X*"[i % 10],
                markersize=4,
                linewidth=2.0 if peer.startswith("rollkane native") else 1.0,
                color=f"C{i}" if i < 10 else "black",
                label=peer,
            )
        panel.set_title(TITLES[problem], fontsize=11)
        panel.set_xlabel("end error [m] or [rad], the larger")
        dress(panel)
    panels[0].set_ylabel("time of a run [s]")
    handles, labels = {}, []
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    labels = list(handles)
    figure.legend(
        [handles[x] for x in labels],
        labels,
        loc="outside right center",
        fontsize=8,
        frameon=False,
    )
    path.write_bytes(png(figure))


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--quick", action="store_true", help="small batches only")
    options = parser.parse_args()
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}, "
        f"medians of {options.repeats}"
    )
    print(machine)
    rows, notes = c_and_diffrax(options.repeats)
    rows = ours(options.repeats) + rows
    more, why = others()
    rows, notes = rows + more, notes + why
    equal = show_single(rows)
    counts = COUNTS[:2] if options.quick else COUNTS
    batch, why = throughput(options.repeats, counts)
    slopes = [
        row
        for case in GRADIENTS
        for method in ("diffrax", "native")
        for row in gradients(*case, method, options.repeats)
    ]
    show_rest(batch, slopes)
    notes += why
    for method in ("diffrax", "native"):
        mine = [r for r in rows if method in r["peer"] and "bare" in r]
        more = statistics.median(r["bare"] - r["seconds"] for r in mine)
        notes.append(f"A bare call by {method} takes {1e3 * more:.2f} ms more.")
    for note in notes:
        print(note)
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {
        "machine": machine,
        "runs": rows,
        "equal_error": equal,
        "throughput": batch,
        "gradients": slopes,
        "notes": notes,
    }
    (options.out / "compare.json").write_text(json.dumps(figures, indent=1))
    draw(rows, options.out / "compare.png")


if __name__ == "__main__":
    main()
