"""How the error of a mean falls with the number of motions: plain, Latin, Sobol.

    python benchmarks/convergence.py [--out FOLDER] [--docs FOLDER] [--repeats N]

An ellipsoid rolls on a plane for 0.5 s from a start of which four numbers are random:
its angular velocity and its tilt, normally distributed. Observed are where its contact
point is then, a smooth function of the four, and whether it is farther than 5 cm along
y. Means of many studies, each of another seed, are compared with Gauss-Hermite
quadrature of 14 points in each number (how far 12 points differ is shown); the
probability with a Sobol sample 64 times as large as the largest study. Beside the error
stands what the studies themselves tell: their standard errors, and how many of their
95 % intervals hold the truth. Prints a table, writes JSON and a picture.
"""

import argparse
import json
import os
import platform
from itertools import product
from pathlib import Path
from statistics import NormalDist

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.uncertainty.draws import Draws
from rollkane.uncertainty.sampling import sampler
from rollkane.uncertainty.statistics import Statistics

jax.config.update("jax_enable_x64", True)

KINDS = ("plain", "latin", "sobol")
SIZES = tuple(2**k for k in range(6, 15))
NAMES = ("x", "y", "far")
FAR = 0.05  # [m]
BLOCK = 65536

DRAWS = Draws(
    {
        "roll": rk.Normal(3.0, 0.3),  # rad/s
        "pitch": rk.Normal(-1.0, 0.3),  # rad/s
        "spin": rk.Normal(2.0, 0.3),  # rad/s
        "tilt": rk.Normal(0.0, 0.1),  # rad
    }
)
SCENE = rk.Scene(
    rk.Body(1.0, np.diag([2.6e-3, 3.4e-3, 5.0e-3]), rk.Ellipsoid((0.15, 0.13, 0.1)))
)


def start_of(u):
    """The start that belongs to four numbers between 0 and 1."""
    drawn = DRAWS.draw(u)
    half, zero = 0.5 * drawn["tilt"], 0.0 * drawn["tilt"]
    orientation = jnp.stack([jnp.cos(half), jnp.sin(half), zero, zero])
    spin = jnp.stack([drawn["roll"], drawn["pitch"], drawn["spin"]])
    return rk.place(SCENE, orientation, spin, (0.0, 0.0, 0.0))


starts_of = jax.jit(jax.vmap(start_of))


def ends(u):
    """Where the contact is after 0.5 s [m], shape (n, 2)."""
    found = []
    for first in range(0, len(u), BLOCK):
        part = np.concatenate([u[first : first + BLOCK], np.full((BLOCK, 4), 0.5)])
        run = rk.ensemble(SCENE, starts_of(part[:BLOCK]), (0.0, 0.5), rtol=1e-9)
        assert run.succeeded.all()
        found.append(np.asarray(run.state.contact_on_base)[:, -1, :2])
    return np.concatenate(found)[: len(u)]


def quadrature(points):
    """Means of both numbers by Gauss-Hermite quadrature."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(points)
    share = weights / weights.sum()
    # normal numbers, told as the uniform ones that draws take
    uniform = np.array([NormalDist().cdf(x) for x in nodes])
    rows = np.array(list(product(uniform, repeat=4)))
    weight = np.prod(list(product(share, repeat=4)), axis=1)
    return weight @ ends(rows)


def values_of(end):
    """What a study observes."""
    return {"x": end[:, 0], "y": end[:, 1], "far": end[:, 1] > FAR}


def truth():
    """Means, the probability, and how sure each is."""
    fine, coarse = quadrature(14), quadrature(12)
    size = 64 * SIZES[-1]
    design = sampler("sobol", 4, 987654321, size)
    found = Statistics(design.group_count)
    values = values_of(ends(design.uniforms(0, size)))
    found.add(values, np.ones(size, bool), design.groups(0, size))
    sure = np.abs(fine - coarse)
    return (
        {"x": fine[0], "y": fine[1], "far": float(found.probability["far"])},
        {"x": sure[0], "y": sure[1], "far": float(found.standard_error["far"])},
    )


def study(kind, size, repeats, true):
    """Errors of many studies of one size."""
    designs = [sampler(kind, 4, seed, size) for seed in range(repeats)]
    end = ends(np.concatenate([x.uniforms(0, size) for x in designs]))
    errors, told, inside = [], [], []
    for k, design in enumerate(designs):
        found = Statistics(design.group_count)
        values = values_of(end[k * size : (k + 1) * size])
        found.add(values, np.ones(size, bool), design.groups(0, size))
        middle = {**found.mean, **found.probability}
        errors.append([middle[name] - true[name] for name in NAMES])
        told.append([found.standard_error[name] for name in NAMES])
        held = [found.interval(name) for name in NAMES]
        inside.append(
            [a <= true[n] <= b for n, (a, b) in zip(NAMES, held, strict=True)]
        )
    root = lambda rows: np.sqrt(np.mean(np.square(rows), axis=0)).tolist()
    return {
        "kind": kind,
        "size": size,
        "error": dict(zip(NAMES, root(errors), strict=True)),
        "told": dict(zip(NAMES, root(told), strict=True)),
        "held": dict(zip(NAMES, np.sum(inside, axis=0).tolist(), strict=True)),
    }


def slope(rows, name):
    """Power of N with which an error falls."""
    sizes, errors = zip(*((r["size"], r["error"][name]) for r in rows), strict=True)
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def draw(found: dict, path: Path) -> None:
    """Errors against the number of motions; dashed what studies told."""
    import matplotlib.pyplot as plt

    titles = {"x": "mean of x [m]", "far": f"probability of y > {FAR} m"}
    fig, axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
    for ax, (name, title) in zip(axes, titles.items(), strict=True):
        for kind, colour in zip(KINDS, ("#1f5fa8", "#2a7f62", "#c23b3b"), strict=True):
            rows = [row for row in found["rows"] if row["kind"] == kind]
            sizes = [row["size"] for row in rows]
            label = f"{kind}: N^{slope(rows, name):.2f}"
            errors = [row["error"][name] for row in rows]
            ax.loglog(sizes, errors, "o-", color=colour, label=label, markersize=4)
            told = [row["told"][name] for row in rows]
            ax.loglog(sizes, told, "--", color=colour, linewidth=1)
        ax.set_title(title)
        ax.set_xlabel("motions N")
        ax.grid(color="0.93")
        ax.legend(frameon=False)
    axes[0].set_ylabel("error (RMS over studies); dashed: as told")
    fig.savefig(path, dpi=110)
    plt.close(fig)


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--repeats", type=int, default=100)
    options = parser.parse_args()
    machine = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, jax {jax.__version__}"
    )
    print(machine)
    true, sure = truth()
    for name in NAMES:
        print(f"{name}: {true[name]:.12g}, sure to {sure[name]:.1e}")
    found = {
        "machine": machine,
        "repeats": options.repeats,
        "truth": true,
        "sure": sure,
    }
    found["rows"] = []
    print(f"{options.repeats} studies each: error, as told, intervals that held")
    for kind, size in product(KINDS, SIZES):
        row = study(kind, size, options.repeats, true)
        found["rows"].append(row)
        cells = (
            f"{name} {row['error'][name]:.2e} {row['told'][name]:.2e} "
            f"{row['held'][name]:3d}"
            for name in NAMES
        )
        print(f"{kind:6} {size:6d}   " + "   ".join(cells), flush=True)
    for kind in KINDS:
        rows = [row for row in found["rows"] if row["kind"] == kind]
        falls = ", ".join(f"{name} N^{slope(rows, name):.2f}" for name in NAMES)
        print(f"{kind}: {falls}")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "convergence.json").write_text(json.dumps(found, indent=1) + "\n")
    draw(found, options.docs / "images" / "convergence.png")
    print(f"written: {options.out / 'convergence.json'}")


if __name__ == "__main__":
    main()
