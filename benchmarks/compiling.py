"""What the user waits for before the first result, and what a second process saves.

    python benchmarks/compiling.py [--out FOLDER]

For scenes of several kinds, each figure from a fresh process: loading the packages, the
first call of `simulate` by either method, cold and with what an earlier process left in
the caches (rollkane's for compiled loops, JAX's persistent compilation cache), and the
first derivative.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

SCENES = (
    "ball-on-plane",
    "rattleback",
    "ellipsoid-in-bowl",
    "ellipsoid-on-six-axis-table",
    "isolator",
)
SETTING = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536"

INNER = """
import sys, time
began = time.perf_counter()
import jax
jax.config.update("jax_enable_x64", True)
if {cache!r}:
    jax.config.update("jax_compilation_cache_dir", {cache!r})
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
import rollkane as rk
from rollkane.files.scene_files import load_scene
file = load_scene({scene!r})
loaded = time.perf_counter()
times = [0.0, 0.1]
run = lambda w: rk.simulate(file.scene, w, times, method={method!r}).state
if {what!r} == "run":
    jax.block_until_ready(run(file.start))
else:
    import equinox as eqx
    def end(w):
        start = eqx.tree_at(lambda s: s.angular_velocity, file.start, w)
        return run(start).angular_velocity[-1, 0]
    transform = jax.grad if {what!r} == "grad" else jax.jacfwd
    jax.block_until_ready(transform(end)(file.start.angular_velocity))
print(loaded - began, time.perf_counter() - loaded)
"""


def first(scene: str, method: str, what: str, cache: str, loops: str) -> list[float]:
    """Seconds to load, and to the first result, of one fresh process."""
    code = INNER.format(scene=scene, method=method, what=what, cache=cache)
    environment = os.environ | {"XLA_FLAGS": SETTING, "ROLLKANE_CACHE": loops}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        return []
    return [float(x) for x in done.stdout.split()[-2:]]


def measure(scene: str) -> dict:
    """All figures of one scene."""
    row: dict = {"scene": scene}
    with tempfile.TemporaryDirectory() as folder:
        for method in ("native", "diffrax"):
            cache = f"{folder}/jax" if method == "diffrax" else ""
            for when in ("cold", "warm"):
                found = first(scene, method, "run", cache, f"{folder}/loops")
                row[f"{method}, {when}"] = found[1] if found else None
                if found:
                    row["loading"] = found[0]
        for what in ("jacfwd", "grad"):
            for when in ("cold", "warm"):
                found = first(scene, "diffrax", what, f"{folder}/{what}", folder)
                row[f"{what}, {when}"] = found[1] if found else None
    return row


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    options = parser.parse_args()
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}"
    )
    print(f"{machine}; seconds to the first result")
    rows = []
    for scene in SCENES:
        rows.append(measure(scene))
        keys = [key for key in rows[0] if key != "scene"]
        if len(rows) == 1:
            print(f"{'scene':<30}" + "".join(f"{key:>16}" for key in keys))
        shown = [rows[-1].get(key) for key in keys]
        print(
            f"{scene:<30}"
            + "".join(f"{'-' if x is None else f'{x:.2f}':>16}" for x in shown),
            flush=True,
        )
    loading = statistics.median(row["loading"] for row in rows)
    print(f"loading the packages: {loading:.2f} s")
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {"machine": machine, "rows": rows}
    (options.out / "compiling.json").write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
