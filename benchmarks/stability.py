"""Hard cases: what breaks others, what is promised, and what was measured.

    python benchmarks/stability.py [--out FOLDER] [--docs FOLDER]

Runs every case of ``tests/stability/hard_cases.py`` (the tests hold them to the same
limits), prints a table, writes it as JSON, draws each figure beside its limit, and puts
table and picture into ``docs/stability.md``.
"""

import argparse
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

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.stability.hard_cases import CASES  # noqa: E402

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def measure() -> list[dict]:
    """Every case, with its figure and what it took, compiling included [s]."""
    rows = []
    for case in CASES.values():
        began = time.perf_counter()
        figure = case.measure()
        rows.append(
            {
                "case": case.name,
                "others": case.breaks,
                "promise": case.promise,
                "limit": case.limit,
                "why": case.why,
                "figure": figure,
                "seconds": time.perf_counter() - began,
            }
        )
        kept = "kept" if figure <= case.limit else "BROKEN"
        print(f"{case.name:<64} {figure:8.1e} of {case.limit:.0e}  {kept}", flush=True)
    return rows


def table(rows: list[dict], machine: str) -> str:
    """For the page."""
    lines = [
        BEGIN,
        f"Measured by `make stability` on {machine}.",
        "",
        "| case | what it does to others | promised | limit | measured |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {r['case']} | {r['others']} | {r['promise']} | {r['limit']:.0e} "
        f"| {r['figure']:.1e} |"
        for r in rows
    ]
    return "\n".join([*lines, "", "![Figures and limits](images/stability.png)", END])


def draw(rows: list[dict], path: Path) -> None:
    """Each figure beside its limit."""
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(9.5, 0.3 * len(rows) + 1.2), layout="constrained")
    heights = range(len(rows), 0, -1)
    limits = [r["limit"] for r in rows]
    figures = [max(r["figure"], 1e-17) for r in rows]
    ax.hlines(heights, figures, limits, color="0.8", linewidth=1.5)
    ax.plot(limits, heights, "|", color="tab:red", markersize=11, label="promised")
    ax.plot(figures, heights, "o", color="tab:blue", label="measured")
    ax.set_yticks(list(heights), [r["case"] for r in rows])
    ax.set_xscale("log")
    ax.set_xlabel("figure of the case (1e-17: exact)")
    ax.grid(axis="x", color="0.93")
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, 1.0))
    fig.savefig(path, dpi=110)
    plt.close(fig)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    options = parser.parse_args()
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}"
    )
    print(machine)
    rows = measure()
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "stability.json").write_text(json.dumps(rows, indent=1) + "\n")
    draw(rows, options.docs / "images" / "stability.png")
    page = options.docs / "stability.md"
    text = page.read_text(encoding="utf-8")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    page.write_text(before + table(rows, machine) + after, encoding="utf-8")
    print(f"written: {options.out / 'stability.json'}, {page}")


if __name__ == "__main__":
    main()
