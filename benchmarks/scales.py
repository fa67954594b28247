"""Random scenes of 1e-9 to 1e9 m and 1e-12 to 1e12 kg: how exactly energy is kept.

    python benchmarks/scales.py [--out FOLDER] [--lanes N] [--seed S]

Runs ``--lanes`` scenes of each kind (``tests/stability/scales.py``) at the default
tolerances and prints, by kind, how they ended and the largest energy error over
tolerance and rounding. A run that completed with more than the limit, or with NaN, is
printed with its seed, and makes the command fail. Writes JSON and a picture.
"""

import argparse
import collections
import json
import os
import platform
import sys
import time
from pathlib import Path

# the XLA setting that the command line uses, too (docs/speed.md)
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536",
)

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))
import rollkane as rk  # noqa: E402
from tests.stability.scales import (  # noqa: E402
    KINDS,
    LIMIT,
    Energies,
    drawn_numbers,
    excess,
    failures,
    run,
)

NAMES = {value: name for name, value in vars(rk.Code).items() if name.isupper()}
EXACT = 1e-6  # shown for errors below


def measure(name: str, lanes: int, seed: int) -> tuple[dict, Energies]:
    """One kind: a row of the table, and all its runs."""
    began = time.perf_counter()
    found = run(name, drawn_numbers(name, lanes, seed))
    over = excess(found)[found.code == rk.Code.COMPLETED]
    row = {
        "kind": name,
        "scenes": lanes,
        "ended": dict(collections.Counter(NAMES.get(int(c), "?") for c in found.code)),
        "median": float(np.median(over)) if over.size else None,
        "worst": float(np.max(over)) if over.size else None,
        "seconds": time.perf_counter() - began,
        "failures": [{"scene": i, "what": what} for i, what in failures(found)],
    }
    return row, found


def show(row: dict) -> None:
    """A line of the table, and what is wrong."""
    ended = dict(row["ended"])
    completed = ended.pop("COMPLETED", 0)
    others = ", ".join(f"{name} {count}" for name, count in ended.items()) or "-"
    figures = "".join(
        f"{'-' if row[key] is None else format(row[key], '.2g'):>9}"
        for key in ("median", "worst")
    )
    print(
        f"{row['kind']:<36}{row['scenes']:>7}{completed:>10}{figures}"
        f"{row['seconds']:>7.0f}  {others}",
        flush=True,
    )
    for failure in row["failures"]:
        print(f"    scene {failure['scene']}: {failure['what']}", flush=True)


def draw(runs: dict[str, Energies], path: Path) -> None:
    """Energy errors against size and mass, and by kind."""
    from rollkane.pictures.plot_style import BLUE, RED, dress, new_figure, png

    figure = new_figure((13.0, 4.6))
    by_size, by_mass, by_kind = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.0))
    dots = {"marker": ".", "linestyle": "none", "color": BLUE, "alpha": 0.3}
    for height, found in zip(range(len(runs), 0, -1), runs.values(), strict=True):
        done = found.code == rk.Code.COMPLETED
        over = np.maximum(excess(found)[done], EXACT)
        by_size.loglog(found.size[done], over, **dots, markersize=4)
        by_mass.loglog(found.mass[done], over, **dots, markersize=4)
        by_kind.semilogx(over, np.full(over.shape, height), **dots, markersize=5)
        by_kind.plot(over.max(initial=EXACT), height, "|", color=BLUE, markersize=11)
    for panel, unit in ((by_size, "size of the body [m]"), (by_mass, "mass [kg]")):
        panel.axhline(LIMIT, color=RED, linewidth=1.2)
        panel.set_xlabel(unit)
        panel.set_ylim(0.3 * EXACT, 10.0 * LIMIT)
        dress(panel)
    by_size.set_ylabel("energy error over tolerance and rounding")
    by_size.text(1e-9, 1.5 * LIMIT, "limit", color=RED)
    by_kind.axvline(LIMIT, color=RED, linewidth=1.2)
    by_kind.set_xlim(0.3 * EXACT, 10.0 * LIMIT)
    by_kind.set_yticks(range(len(runs), 0, -1), list(runs))
    by_kind.set_xlabel("energy error over tolerance and rounding")
    dress(by_kind)
    path.write_bytes(png(figure))


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--lanes", type=int, default=250)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}"
    )
    print(f"{machine}; seed {options.seed}; limit {LIMIT:g}")
    print(
        f"{'kind':<36}{'scenes':>7}{'completed':>10}{'median':>9}{'worst':>9}{'s':>7}"
        "  other ends"
    )
    rows, runs = [], {}
    for name in KINDS:
        row, runs[name] = measure(name, options.lanes, options.seed)
        rows.append(row)
        show(row)
        jax.clear_caches()
    ends: collections.Counter = collections.Counter()
    for row in rows:
        ends.update(row["ended"])
    wrong = sum(len(row["failures"]) for row in rows)
    worst = max((row["worst"] for row in rows if row["worst"] is not None), default=0.0)
    print(
        f"{ends.total()} scenes: {dict(ends)}; worst {worst:.2g} of {LIMIT:g}; "
        f"failures: {wrong}"
    )
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {"machine": machine, "seed": options.seed, "limit": LIMIT, "rows": rows}
    (options.out / "scales.json").write_text(json.dumps(figures, indent=1) + "\n")
    draw(runs, options.out / "scales.png")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
