"""What accuracy costs, for six built-in scenes: the page of the documentation.

    python benchmarks/accuracy.py [--out FOLDER] [--docs FOLDER]

Measures each scene by `rollkane.work_precision`, writes JSON, a diagram for each, and
puts the tables into ``docs/accuracy.md``.
"""

import argparse
import json
import os
import platform
import sys
from pathlib import Path

# the XLA setting that the command line uses, too (docs/speed.md)
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536",
)

import jax

jax.config.update("jax_enable_x64", True)

import rollkane as rk  # noqa: E402
from rollkane.files.scene_files import load_scene  # noqa: E402

SCENES: dict[str, dict] = {
    "rolling-disc": {"steps": (300, 1000, 3000), "precisions": ("double", "single")},
    "rattleback": {},
    "ball-on-turntable": {},
    "ellipsoid-in-bowl": {
        "solvers": ("Dopri8",),
        "coordinates": ("pole-free", "voronets"),
        "formulations": ("rolling", "euler_lagrange"),
    },
    "shell-with-pendulum": {
        "solvers": ("Tsit5", "Dopri8", "Kvaerno5"),
        "tolerances": tuple(10.0**-k for k in range(3, 10)),
    },
    "isolator": {"methods": ("diffrax",)},
}
ASKED = (1e-4, 1e-6, 1e-8)
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def told(work: rk.WorkPrecision) -> list[str]:
    """A scene's part of the page."""
    lines = [
        f"### {work.name}, {work.horizon:g} s",
        "",
        f"![Error against time](images/accuracy-{work.name}.png)",
        "",
        f"Errors below {work.certainty:.0e} are unknown.",
        "",
        "| asked end error | fastest that meets it | setting | its error | ms |",
        "|--:|---|--:|--:|--:|",
    ]
    for error in ASKED:
        try:
            best = work.recommend(error)
        except rk.FieldError as refused:
            lines.append(f"| {error:.0e} | none: {refused.problem} | | | |")
            continue
        lines.append(
            f"| {error:.0e} | {best.setting.series} | {best.setting.how} | "
            f"{best.error:.1e} | {1e3 * best.seconds:.2f} |"
        )
    return [*lines, ""]


def main() -> None:
    """Measure, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}, "
        f"medians of {options.repeats}"
    )
    options.out.mkdir(parents=True, exist_ok=True)
    figures, lines = {"machine": machine}, [f"Measured on {machine}.", ""]
    for name, choices in SCENES.items():
        print(f"{name} ...", file=sys.stderr, flush=True)
        work = rk.work_precision(load_scene(name), repeats=options.repeats, **choices)
        print(f"\n{name}\n{work.table()}", flush=True)
        figures[name] = json.loads(work.to_json())
        work.plot(options.docs / "images" / f"accuracy-{name}.png")
        lines += told(work)
    (options.out / "accuracy.json").write_text(json.dumps(figures, indent=1))
    page = options.docs / "accuracy.md"
    before, rest = page.read_text().split(BEGIN)
    after = rest.split(END)[1]
    page.write_text(before + "\n".join([BEGIN, "", *lines, END]) + after)
    print(f"written: {page}")


if __name__ == "__main__":
    main()
