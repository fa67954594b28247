"""One trajectory at equal end error: rollkane's XLA loop, C, SciPy, in one run.

    python benchmarks/single.py [--out FOLDER] [--repeats N]

Prints a table for P2 (thin disc) and P3 (rattleback), writes it as JSON and draws
error against time. Each rollkane figure is measured in a process of its own, with and
without the XLA setting that the command line uses (docs/speed.md); trace and compile
time is reported apart from run time. Medians of the repeats.
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

from peers import c_dopri5, scipy_dop853
from peers.problems import PROBLEMS, end_error

SETTING = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536"
TARGETS = (1e-8, 1e-10)
TOLERANCES = tuple(10.0**-k for k in (7, 8, 9, 10, 11, 12))
ARRAY_TOLERANCES = (1e-8, 1e-9, 1e-10, 1e-11)
SOLVERS = ("Tsit5", "Dopri5", "Dopri8")


def scene_of(name):
    """The problem in rollkane's terms, and its start."""
    import numpy as np

    import rollkane as rk
    from rollkane.geometry.rotations import rotation_matrix

    problem = PROBLEMS[name]
    surface = problem["surface"]
    shape = (
        rk.DiscEdge(surface["radius"])
        if surface["kind"] == "rim"
        else rk.Ellipsoid(surface["semi_axes"])
    )
    scene = rk.Scene(
        rk.Body(problem["mass"], problem["inertia"], shape, problem["com"])
    )
    q = np.asarray(problem["orientation"])
    R = np.asarray(rotation_matrix(q))
    rho = np.asarray(shape.point_with_normal(-R[2]))
    contact = np.asarray(problem["position"]) + R @ (rho - np.asarray(problem["com"]))
    start = rk.place(
        scene, q, R @ np.asarray(problem["omega"]), [contact[0], contact[1], 0.0]
    )
    return scene, start


def end_numbers(problem, result):
    """Quaternion, body angular velocity, x and y of the mass centre at the end."""
    import numpy as np

    from rollkane.geometry.rotations import rotation_matrix

    q = np.asarray(result.orientation[-1])
    centre = np.asarray(result.position[-1]) + np.asarray(rotation_matrix(q)) @ (
        np.asarray(problem["com"])
    )
    return [*q, *np.asarray(result.state.angular_velocity[-1]), *centre[:2]]


def measure_rollkane(repeats):
    """All rollkane rows of this process, as JSON on standard output."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import diffrax

    import rollkane as rk

    rows = []
    for name, problem in PROBLEMS.items():
        scene, start = scene_of(name)
        rhs = jax.make_jaxpr(
            lambda s, scene=scene: rk.rolling_derivative(scene, 0.0, s)
        )
        equations = len(rhs(start).eqns)
        times = (0.0, problem["t_end"])
        for solver in SOLVERS:
            method = getattr(diffrax, solver)()

            def run(rtol, scene=scene, start=start, times=times, method=method):
                how = {"rtol": rtol, "solver": method, "method": "diffrax"}
                result = rk.simulate(scene, start, times, **how)
                jax.block_until_ready(result.state)
                return result

            began = time.perf_counter()
            run(1e-3)
            first = time.perf_counter() - began
            began = time.perf_counter()
            run(1e-3)
            compile_time = first - (time.perf_counter() - began)
            for rtol in TOLERANCES:
                if solver != "Dopri8" and rtol < 1e-11:
                    continue
                result = run(rtol)
                spans = []
                for _ in range(repeats):
                    began = time.perf_counter()
                    run(rtol)
                    spans.append(time.perf_counter() - began)
                error = end_error(problem, end_numbers(problem, result))
                rows.append(
                    {
                        "problem": name,
                        "peer": f"rollkane {solver}",
                        "rtol": rtol,
                        "error": max(error.position, error.rotation),
                        "seconds": statistics.median(spans),
                        "steps": int(result.steps + result.rejected_steps),
                        "compile": compile_time,
                        "equations": equations,
                    }
                )
    print(json.dumps(rows))


def rollkane_rows(setting, repeats):
    """Rows of a process with or without the XLA setting."""
    environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
    if setting:
        environment["XLA_FLAGS"] = SETTING
    run = subprocess.run(
        [sys.executable, __file__, "--inner", "--repeats", str(repeats)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    rows = json.loads(run.stdout.splitlines()[-1])
    if not setting:
        for row in rows:
            row["peer"] += ", no setting"
    return rows


def peer_rows(repeats):
    """Rows of the peers; those that cannot run are left out, with the reason."""
    rows, notes = [], []
    library, reason = c_dopri5.load()
    if library is None:
        notes.append(f"C DOPRI5 skipped: {reason}")
    for name, problem in PROBLEMS.items():
        for rtol in TOLERANCES:
            found = []
            if library is not None:
                result = library.solve(name, rtol, 0.01 * rtol)
                spans = library.seconds(name, rtol, 0.01 * rtol, 20, repeats)
                found.append(("C DOPRI5", result, spans))
            for arrays in (False, True):
                if arrays and rtol not in ARRAY_TOLERANCES:
                    continue  # 10 s a solve
                samples = 1 if arrays else max(3, repeats // 5)
                result = scipy_dop853.solve(name, rtol, 0.01 * rtol, arrays)
                spans = scipy_dop853.seconds(name, rtol, 0.01 * rtol, samples, arrays)
                peer = "SciPy DOP853, " + ("NumPy arrays" if arrays else "scalars")
                found.append((peer, result, spans))
            for peer, result, spans in found:
                error = end_error(problem, result.y_end)
                rows.append(
                    {
                        "problem": name,
                        "peer": peer,
                        "rtol": rtol,
                        "error": max(error.position, error.rotation),
                        "seconds": statistics.median(spans),
                        "steps": result.accepted + result.rejected,
                    }
                )
    return rows, notes


def at_error(rows, problem, peer, target):
    """Time of a solve and of a step at a wanted end error, log-log interpolated."""
    import numpy as np

    chosen = [r for r in rows if r["problem"] == problem and r["peer"] == peer]
    chosen.sort(key=lambda r: -r["error"])
    errors = np.log([r["error"] for r in chosen])
    if not chosen or target < np.exp(errors[-1]) or target > np.exp(errors[0]):
        return None
    want = np.log(target)
    back = [np.log([r[k] for r in chosen])[::-1] for k in ("seconds", "steps")]
    seconds, steps = (float(np.exp(np.interp(want, errors[::-1], b))) for b in back)
    return seconds, seconds / steps


def print_runs(rows):
    """Every run."""
    head = f"{'problem':8}{'peer':28}{'rtol':>7}{'end error':>11}{'ms':>10}"
    print(head + f"{'steps':>8}{'us/step':>9}{'compile s':>11}{'equations':>11}")
    for r in rows:
        line = f"{r['problem']:8}{r['peer']:28}{r['rtol']:7.0e}{r['error']:11.1e}"
        line += f"{1e3 * r['seconds']:10.3f}{r['steps']:8d}"
        line += f"{1e6 * r['seconds'] / r['steps']:9.3f}"
        if "compile" in r:
            line += f"{r['compile']:11.2f}{r['equations']:11d}"
        print(line)


def compare(rows, problem, target):
    """All peers at one end error, against C and against both SciPy peers."""
    peers = list(dict.fromkeys(r["peer"] for r in rows))
    found = {peer: at_error(rows, problem, peer, target) for peer in peers}

    def over(a, b, k):
        return a[k] / b[k] if a and b else None

    c = found.get("C DOPRI5")
    scalars, arrays = (
        found.get(f"SciPy DOP853, {x}") for x in ("scalars", "NumPy arrays")
    )
    return [
        {
            "problem": problem,
            "error": target,
            "peer": peer,
            "seconds": it[0],
            "seconds_per_step": it[1],
            "time_over_c": over(it, c, 0),
            "step_over_c": over(it, c, 1),
            "scipy_scalars_over_it": over(scalars, it, 0),
            "scipy_arrays_over_it": over(arrays, it, 0),
        }
        for peer, it in found.items()
        if it
    ]


def print_comparison(equal):
    """The comparison at equal end error as a table."""
    print("\nAt equal end error (larger of position [m] and rotation [rad]):")
    head = f"{'problem':8}{'error':>7}  {'peer':28}{'ms':>10}{'us/step':>9}"
    print(head + f"{'time/C':>9}{'step/C':>9}{'scalars/it':>12}{'arrays/it':>12}")
    for row in equal:
        line = f"{row['problem']:8}{row['error']:7.0e}  {row['peer']:28}"
        line += f"{1e3 * row['seconds']:10.3f}{1e6 * row['seconds_per_step']:9.3f}"
        for key, width in (
            ("time_over_c", 9),
            ("step_over_c", 9),
            ("scipy_scalars_over_it", 12),
            ("scipy_arrays_over_it", 12),
        ):
            ratio = row[key]
            line += " " * (width - 1) + "-" if ratio is None else f"{ratio:{width}.2f}"
        print(line)


def draw(rows, path, plain="no setting"):
    """Error against time, both logarithmic, a panel for each problem.

    Peers with ``plain`` in their names are dashed.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(PROBLEMS), sharey=True)
    peers = list(dict.fromkeys(r["peer"] for r in rows))
    for axis, (name, problem) in zip(axes, PROBLEMS.items(), strict=True):
        for i, peer in enumerate(peers):
            chosen = [r for r in rows if r["problem"] == name and r["peer"] == peer]
            axis.loglog(
                [r["error"] for r in chosen],
                [r["seconds"] for r in chosen],
                marker="os^Dv<>"[i % 7],
                ls="--" if plain in peer else "-",
                color=f"C{[p.split(',')[0] for p in peers].index(peer.split(',')[0])}",
                markersize=4,
                label=peer,
            )
        axis.set_title(f"{name}: {problem['title']}", fontsize=10)
        axis.set_xlabel("end error: position [m] or rotation [rad], the larger")
        axis.grid(True, which="major", alpha=0.3)
    axes[0].set_ylabel("time of a solve [s]")
    axes[-1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1.01, 0.5))
    figure.savefig(path, dpi=120)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--inner", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inner:
        measure_rollkane(options.repeats)
        return
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, median of {options.repeats}"
    )
    rows, notes = peer_rows(options.repeats)
    for setting in (True, False):
        rows += rollkane_rows(setting, options.repeats)
    print_runs(rows)
    equal = [row for p in PROBLEMS for t in TARGETS for row in compare(rows, p, t)]
    print_comparison(equal)
    for note in notes:
        print(note)
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {"runs": rows, "equal_error": equal, "notes": notes}
    (options.out / "single.json").write_text(json.dumps(figures, indent=1))
    draw(rows, options.out / "single.png")
    print(f"written: {options.out / 'single.json'}, {options.out / 'single.png'}")


if __name__ == "__main__":
    main()
