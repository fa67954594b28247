"""Random scenes with extreme numbers: every run ends, and says how.

    python benchmarks/fuzz.py [--out FOLDER] [--count N] [--lanes N] [--seed S]

Draws kinds of scenes, and ``--lanes`` scenes of each (``tests/stability/fuzzing.py``),
runs them in batches, and counts how they ended. A scene that ends without a known code,
with a NaN that its code does not explain, or not at all, is printed with its seed, and
makes the command fail.
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

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))
import rollkane as rk  # noqa: E402
from tests.stability.fuzzing import (  # noqa: E402
    drawn_kind,
    drawn_numbers,
    run,
    unexplained,
)

NAMES = {value: name for name, value in vars(rk.Code).items() if name.isupper()}


def main():
    """Draw, run, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--lanes", type=int, default=250)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}; seed {options.seed}"
    )
    ends: collections.Counter = collections.Counter()
    wrong, began = [], time.perf_counter()
    for seed in range(options.seed, options.seed + options.count // options.lanes):
        kind, started = drawn_kind(seed), time.perf_counter()
        found = run(kind, drawn_numbers(seed, options.lanes))
        counts = collections.Counter(NAMES.get(int(c), "?") for c in found.code)
        ends.update(counts)
        taken = time.perf_counter() - started
        print(
            f"{seed:4d} {taken:6.1f} s  {', '.join(kind)}: {dict(counts)}", flush=True
        )
        for lane, what in unexplained(found):
            wrong.append({"seed": seed, "lane": lane, "kind": kind, "what": what})
            print(f"     seed {seed}, scene {lane}: {what}", flush=True)
        jax.clear_caches()
    total, taken = sum(ends.values()), time.perf_counter() - began
    print(
        f"{total} scenes in {taken:.0f} s ({total / taken:.1f} a second with compiling)"
    )
    print(f"ended: {dict(ends)}; unexplained: {len(wrong)}")
    options.out.mkdir(parents=True, exist_ok=True)
    results = {
        "seed": options.seed,
        "scenes": total,
        "seconds": taken,
        "ended": dict(ends),
        "unexplained": wrong,
    }
    (options.out / "fuzz.json").write_text(json.dumps(results, indent=1) + "\n")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
