"""Sobol indices with known values: how often intervals cover them, SALib beside it.

    python benchmarks/sobol_indices.py [--out FOLDER] [--repetitions N] [--docs FOLDER]

The Ishigami function (a = 7, b = 0.1), and the distance that a ball rolls down an
inclined plane (slope, inertia ratio and first speed random; rolled by the ensemble; the
indices have a closed form), without failures and with 5 % of the motions failing at
random. SALib gets the same outputs of the same Sobol designs, with NaN where motions
failed, and once more with the mean of the others in place of NaN; it runs in
``.venv-salib`` (made by ``make bench-sensitivity``) or is left out. Prints a table,
writes JSON and, with ``--docs``, the table into the page.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.model_failures import Failing
from tests.rolling_models import Inclined

jax.config.update("jax_enable_x64", True)

ROWS = 1024
A, B = 7.0, 0.1
HERE = Path(__file__).parent
SALIB = HERE.parent / ".venv-salib" / "bin" / "python"
ANALYZE = """
import importlib.metadata, json, sys, warnings
import numpy as np
from SALib.analyze import sobol
warnings.simplefilter("ignore")
given = np.load(sys.argv[1])
Y, k = given["Y"], int(given["factors"])
problem = {"num_vars": k, "names": [str(i) for i in range(k)], "bounds": [[0, 1]] * k}
found = []
for one in Y:
    S = sobol.analyze(problem, one, calc_second_order=False, num_resamples=200, seed=1)
    names = "S1", "S1_conf", "ST", "ST_conf"
    found.append([np.asarray(S[n]).tolist() for n in names])
print(json.dumps({"version": importlib.metadata.version("SALib"), "found": found}))
"""


def ishigami():
    """Model, its indices."""
    ranges = {name: rk.Uniform(-np.pi, np.pi) for name in "xyz"}

    def output(drawn):
        x, y, z = drawn["x"], drawn["y"], drawn["z"]
        return jnp.sin(x) + A * jnp.sin(y) ** 2 + B * z**4 * jnp.sin(x)

    x = 0.5 * (1.0 + B * np.pi**4 / 5.0) ** 2
    both = B**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    first = np.array([x, A**2 / 8.0, 0.0])
    total = np.array([x + both, A**2 / 8.0, both])
    variance = first.sum() + both
    return rk.FunctionModel(output, ranges), (first / variance, total / variance)


class Kept:
    """A model that keeps the outputs of its last design."""

    def __init__(self, model):
        """Of a model with one output."""
        self.model, self.draws, self.last = model, model.draws, None

    def evaluate(self, u):
        """As the model."""
        found = self.model.evaluate(u)
        (self.last,) = found.values.values()
        return found


def measured(model, truth, share, sampling, repetitions):
    """Coverage, errors and widths over repetitions; all outputs, rows of designs."""
    first, total = truth
    inside, errors, widths, outputs = [], [], [], []
    bounded, dropped = [], []
    begin = time.perf_counter()
    for seed in range(repetitions):
        kept = Kept(Failing(model, share, seed))
        found = rk.sobol_indices(kept, ROWS, seed=seed, sampling=sampling)
        (name,) = found.first
        pairs = (
            (found.first, found.first_interval, found.first_bounds, first),
            (found.total, found.total_interval, found.total_bounds, total),
        )
        inside.append([(e[name][0] <= x) & (x <= e[name][1]) for _, e, _, x in pairs])
        bounded.append([(b[name][0] <= x) & (x <= b[name][1]) for _, _, b, x in pairs])
        errors.append([value[name] - x for value, _, _, x in pairs])
        widths.append([e[name][1] - e[name][0] for _, e, _, _ in pairs])
        dropped.append(found.dropped[name] / ROWS)
        outputs.append(kept.last)
    row = {
        "covered per 100": (100.0 * np.mean(inside, axis=0)).tolist(),
        "bounds hold per 100": (100.0 * np.mean(bounded, axis=0)).tolist(),
        "rms error": np.sqrt(np.mean(np.square(errors), axis=0)).tolist(),
        "mean width": np.mean(widths, axis=0).tolist(),
        "rows dropped": float(np.mean(dropped)),
        "seconds a study": (time.perf_counter() - begin) / repetitions,
    }
    return row, np.array(outputs)


def by_salib(outputs, truth):
    """The same of SALib, of NaN as they are and of the mean in their place."""
    if not SALIB.exists():
        return {}
    count, factors = len(outputs), len(truth[0])
    # by blocks in rollkane: A, B, A with each factor; by rows in SALib: A, ..., B
    blocks = outputs.reshape(count, factors + 2, ROWS)
    order = [0, *range(2, factors + 2), 1]
    rows = np.moveaxis(blocks[:, order], 1, 2).reshape(count, -1)
    mean = np.nanmean(rows, axis=1, keepdims=True)
    kinds = {"as they are": rows}
    if np.isnan(rows).any():
        kinds["mean in place of NaN"] = np.where(np.isnan(rows), mean, rows)
    found = {}
    for kind, Y in kinds.items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "outputs.npz"
            np.savez(path, Y=Y, factors=factors)
            ran = subprocess.run(
                [str(SALIB), "-c", ANALYZE, str(path)],
                capture_output=True,
                text=True,
                check=True,
            )
        told = json.loads(ran.stdout)
        S = np.array(told["found"], float)
        apart = np.stack([S[:, 0] - truth[0], S[:, 2] - truth[1]], axis=1)
        with np.errstate(invalid="ignore"):
            inside = abs(apart) <= np.stack([S[:, 1], S[:, 3]], axis=1)
        found[kind] = {
            "version": told["version"],
            "covered per 100": (100.0 * inside.mean(axis=0)).tolist(),
            "rms error": np.sqrt((apart**2).mean(axis=0)).tolist(),
            "NaN per 100": float(100.0 * np.isnan(apart).any(axis=(1, 2)).mean()),
        }
    return found


def described(rows):
    """The table, in Markdown."""
    yield "| problem | fail | by | covered per 100: first | total | largest rms error |"
    yield "|---|--:|---|---|---|--:|"
    for row in rows:
        kinds = {f"rollkane, {row['sampling']}": row}
        kinds |= {f"SALib, {kind}": one for kind, one in row["SALib"].items()}
        for kind, one in kinds.items():
            first, total = (
                ", ".join(f"{x:.0f}" for x in part) for part in one["covered per 100"]
            )
            error = f"{np.max(one['rms error']):.3f}"
            if one.get("NaN per 100"):
                first = total = error = "NaN"
            share = f"{100 * row['share']:.0f} %"
            cells = row["problem"], share, kind, first, total, error
            yield f"| {' | '.join(cells)} |"


def machine():
    """What it ran on."""
    return (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}"
    )


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--docs", type=Path)
    parser.add_argument("--repetitions", type=int, default=400)
    options = parser.parse_args()
    rolling = Inclined()
    problems = {
        "Ishigami": ishigami(),
        "ball down a plane": (rolling, rolling.indices()),
    }
    rows = []
    for problem, (model, truth) in problems.items():
        for share in (0.0, 0.05):
            for sampling in ("sobol", "plain"):
                row, outputs = measured(
                    model, truth, share, sampling, options.repetitions
                )
                peers = by_salib(outputs, truth) if sampling == "sobol" else {}
                rows.append(
                    {
                        "problem": problem,
                        "share": share,
                        "sampling": sampling,
                        "first": truth[0].tolist(),
                        "total": truth[1].tolist(),
                        **row,
                        "SALib": peers,
                    }
                )
    text = "\n".join(described(rows))
    print(f"{machine()}; {ROWS} rows, {options.repetitions} repetitions")
    print(text)
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {"machine": machine(), "rows": ROWS, "table": rows}
    figures["repetitions"] = options.repetitions
    path = options.out / "sobol_indices.json"
    path.write_text(json.dumps(figures, indent=1) + "\n")
    print(f"written: {path}")
    if options.docs is not None:
        page = options.docs / "sensitivity_indices.md"
        begin, end = "<!-- sobol: begin -->", "<!-- sobol: end -->"
        before, rest = page.read_text().split(begin)
        page.write_text(f"{before}{begin}\n{text}\n{end}{rest.split(end)[1]}")


if __name__ == "__main__":
    main()
