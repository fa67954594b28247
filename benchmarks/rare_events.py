"""Rare events with known probabilities: how near they come, and at what cost.

    python benchmarks/rare_events.py [--out FOLDER] [--runs N] [--docs FOLDER]

A ball rolls over a hump with a random speed, and the hump's height is random: the
contact is lost on the crest with a probability that is a quadrature over the height
(near 1e-6). Every motion is rolled by the ensemble. Beside it, functions of standard
normal numbers with known probabilities, in 1 to 100 dimensions, and subset simulation
by itself with as many motions. Prints a table, writes JSON and, with ``--docs``, the
table into the page.
"""

import argparse
import json
import os
import platform
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad
from scipy.special import ndtr
from scipy.stats import chi2

import rollkane as rk

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.rolling_models import Hump

jax.config.update("jax_enable_x64", True)


def normal_model(function, count):
    """A function of so many standard normal numbers."""
    normals = {"z": rk.Normal(np.zeros(count), 1.0)}
    return rk.FunctionModel(lambda drawn: function(drawn["z"]), normals)


def curved(beta, bend):
    """Probability of x + bend y^2 >= beta, by quadrature."""
    density = lambda y: np.exp(-0.5 * y * y) / np.sqrt(2.0 * np.pi)
    over = lambda y: ndtr(bend * y * y - beta) * density(y)
    return quad(over, -12.0, 12.0, points=[-4.0, 0.0, 4.0], epsrel=1e-10)[0]


def problems():
    """By name: model, output, threshold, whether below, probability."""
    hump, turned = Hump(), {"q": rk.UniformOrientation()}
    found = {
        "ball on a hump": (hump, "pressed", 0.0, True, hump.probability()),
        "two sides, 2 numbers": (
            *(normal_model(lambda z: abs(z[0]), 2), "value", 4.75, False),
            2.0 * ndtr(-4.75),
        ),
        "curved, 2 numbers": (
            *(normal_model(lambda z: z[0] + 0.2 * z[1] ** 2, 2), "value", 6.0, False),
            curved(6.0, 0.2),
        ),
        "all around, 3 numbers": (
            *(normal_model(lambda z: z @ z, 3), "value", 30.0, False),
            chi2.sf(30.0, 3),
        ),
        "a given orientation to 0.02 rad": (
            rk.FunctionModel(lambda drawn: drawn["q"][0] ** 2, turned),
            *("value", np.cos(0.01) ** 2, False),
            (0.02 - np.sin(0.02)) / np.pi,  # Haar's measure of smaller angles
        ),
    }
    for count in (1, 10, 50, 100):
        mean = lambda z: jnp.sum(z) / np.sqrt(len(z))
        found[f"linear, {count} numbers"] = (
            *(normal_model(mean, count), "value", 4.75, False),
            ndtr(-4.75),
        )
    return found


def measured(model, of, threshold, below, probability, runs):
    """Errors of runs, what they say of them, and what they cost."""
    begin = time.perf_counter()
    found = [
        rk.subset_simulation(model, of, threshold, below=below, seed=seed)
        for seed in range(runs)
    ]
    seconds = (time.perf_counter() - begin) / runs
    # as many motions in subset simulation alone
    motions = float(np.mean([run.motions for run in found]))
    levels = np.mean([len(run.levels) for run in found])
    size = round(motions / 4.0 / (1.0 + 0.9 * (levels - 1.0)), -1)
    alone = [
        rk.subset_simulation(
            *(model, of, threshold, int(size)), below=below, seed=seed, precision=1.0
        )
        for seed in range(runs)
    ]
    errors = np.array([run.probability / probability - 1.0 for run in found])
    apart = np.array([np.log(run.subset.probability / probability) for run in alone])
    covered = [run.interval[0] <= probability <= run.interval[1] for run in found]
    return {
        "probability": probability,
        "within 10 %": int((abs(errors) < 0.1).sum()),
        "runs": runs,
        "rms error": float(np.sqrt((errors**2).mean())),
        "largest error": float(abs(errors).max()),
        "said": float(np.median([run.estimate.relative for run in found])),
        "covered": int(np.sum(covered)),
        "importance sampling": sum(run.method[0] == "i" for run in found),
        "motions": motions,
        "most motions": max(run.motions for run in found),
        "failed": sum(run.failed for run in found),
        "seconds": seconds,
        "alone: motions": float(np.mean([run.motions for run in alone])),
        "alone: rms error": float(np.sqrt((np.expm1(apart) ** 2).mean())),
        "alone: said": float(np.median([run.subset.relative for run in alone])),
    }


def described(rows, runs):
    """The table, in Markdown."""
    yield (
        "| event | probability | within 10 % | rms error | said | motions, mean (most) "
        "| subset simulation alone: rms error | of motions |"
    )
    yield "|---|--:|--:|--:|--:|--:|--:|--:|"
    for name, row in rows.items():
        cells = [
            name,
            f"{row['probability']:.3e}",
            f"{row['within 10 %']} of {runs}",
            f"{100 * row['rms error']:.1f} %",
            f"{100 * row['said']:.1f} %",
            f"{row['motions']:,.0f} ({row['most motions']:,})",
            f"{100 * row['alone: rms error']:.0f} %",
            f"{row['alone: motions']:,.0f}",
        ]
        yield f"| {' | '.join(cells)} |"


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--docs", type=Path)
    parser.add_argument("--runs", type=int, default=20)
    options = parser.parse_args()
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}"
    )
    rows = {
        name: measured(*problem, options.runs) for name, problem in problems().items()
    }
    text = "\n".join(described(rows, options.runs))
    print(f"{machine}; {options.runs} runs each")
    print(text)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "rare_events.json"
    figures = {"machine": machine, "table": rows}
    path.write_text(json.dumps(figures, indent=1) + "\n")
    print(f"written: {path}")
    if options.docs is not None:
        page = options.docs / "sensitivity_indices.md"
        begin, end = "<!-- rare: begin -->", "<!-- rare: end -->"
        before, rest = page.read_text().split(begin)
        page.write_text(f"{before}{begin}\n{text}\n{end}{rest.split(end)[1]}")


if __name__ == "__main__":
    main()
