"""Fits from records made by simulation: are their errors true, and what do they cost?

    python benchmarks/fit.py [--out FOLDER] [--seeds N] [--part NAME]

Records are 6 s of a gyro at 100 Hz whose noise is 1 % of the signal; guesses are off by
up to 10 % and 30 % in every coordinate. Parts (all without ``--part``, which may be
given several times; what other parts of an earlier run found stays):

- coverage: how often the truth lies in the joint 95 % region of a fit (chi2 risen by
  the quantile), in the ellipsoid of its covariance, in intervals of single numbers.
- scipy: ``scipy.optimize.least_squares`` with finite differences, on the same model and
  records, in the same coordinates and from the same guesses.
- sysid: ``mujoco.sysid`` on what both can do, two moments of inertia of a body in free
  flight; in an environment of its own (``make bench-fit`` makes it), or skipped.
- horizons: 20 s of a rattleback, by growing horizons and by one search over all of it.

Prints a table for each, writes JSON and a picture. Times of a fit are medians, without
the first one, which compiles. Seeds are the numbers from 0, the same for all.
"""

import argparse
import dataclasses
import json
import os
import platform
import statistics
import subprocess
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

from scipy.optimize import least_squares  # noqa: E402
from scipy.stats import beta, chi2  # noqa: E402

import rollkane as rk  # noqa: E402
from rollkane.files.scene_files import load_scene  # noqa: E402
from rollkane.identification.fitting import problem_of  # noqa: E402
from rollkane.simulation.run_options import RunOptions  # noqa: E402

RATE, LENGTH, LONG, NOISE = 100, 6.0, 20.0, 0.01  # [Hz], [s], [s], of the signal
OFFSETS = (0.1, 0.3)
RTOL, FINE = 1e-8, 1e-10  # of a fit's runs; of runs for finite differences
LEVEL = 0.95
# chi2 / degrees of freedom at the global minimum: one, with a deviation of sqrt(2 / N)
# for N samples, 0.03 of 1800
GLOBAL = 1.2
TRIES = 100  # points of a search of SciPy, besides P runs for derivatives at each
SPIN = rk.Free("start.angular_velocity")
SCENES = {  # parameters that the record can tell, says rollkane.identifiability
    "rattleback": (rk.Free("body.inertia"), rk.Free("body.surface.semi_axes"), SPIN),
    "rolling-disc": (rk.Free("body.inertia"), rk.Free("body.surface.radius"), SPIN),
    "routh-sphere": (
        rk.Free("body.inertia", form="scale"),
        rk.Free("body.surface.radius"),
        SPIN,
    ),
    "shell-with-pendulum": (
        rk.Free("body.inertia"),
        rk.Free("body.surface.radius"),
        SPIN,
    ),
}
HERE = Path(__file__).parent
SYSID = HERE.parent / ".venv-sysid" / "bin" / "python"
# In free flight: principal moments [kg m^2], the last one known, spin [rad/s], time [s]
FLIGHT = {"inertia": (0.0035, 0.0045, 0.005), "spin": (1.0, 6.0, 0.5), "duration": 3.0}


class Case:
    """A scene with the truth in it, and what its gyro reads without noise."""

    def __init__(self, name, length):
        """Of a built-in scene, for a time [s]."""
        file = load_scene(name)
        self.free, self.scene, self.start = SCENES[name], file.scene, file.start
        self.times = np.linspace(0.0, length, round(RATE * length) + 1)
        run = rk.simulate(self.scene, self.start, self.times, rtol=1e-10)
        self.read = np.asarray(run.state.angular_velocity)
        self.sigma = NOISE * np.sqrt(np.mean(self.read**2))

    def problem(self, scene, start, record):
        """Its least-squares problem."""
        return problem_of(scene, [start], [record], self.free, None, RunOptions(RTOL))

    def drawn(self, seed, offset):
        """A record with noise, and a guess."""
        random = np.random.default_rng(seed)
        noise = self.sigma * random.standard_normal(self.read.shape)
        gyro = rk.Gyro(self.read + noise, sigma=self.sigma)
        record = rk.Record(self.times, {"gyro": gyro})
        layout = self.problem(self.scene, self.start, record).layout
        away = offset * random.uniform(-1.0, 1.0, layout.size) * layout.scale
        guess = layout.model(0, layout.start + away)
        return record, guess.scene, guess.start

    def truth(self, record):
        """The problem of a record with the truth as its guess."""
        return self.problem(self.scene, self.start, record)


def estimated(found):
    """The numbers that a fit's covariance is of."""
    z = found.search.minimum.z
    return np.concatenate(
        [np.ravel(e.at(z).shown) for e in found.problem.layout.entries]
    )


def true_numbers(found, truth):
    """The same of the truth: a factor is over the fit's own guess."""
    pairs = zip(found.problem.layout.entries, truth.layout.entries, strict=True)
    numbers = [
        mine.transform.shown(jnp.asarray(true.at(truth.layout.start).value))
        for mine, true in pairs
    ]
    return np.concatenate([np.ravel(x) for x in numbers])


def judged(found, truth):
    """Where the truth lies: rise of chi2, Mahalanobis distance, standard errors."""
    apart = estimated(found) - true_numbers(found, truth)
    size = np.sqrt(np.diag(found.covariance))
    seen = size > 0.0
    scale, apart = size[seen], apart[seen] / size[seen]
    correlation = found.covariance[seen][:, seen] / np.outer(scale, scale)
    values, axes = np.linalg.eigh(correlation)
    kept = values > 1e-13 * values[-1]  # rounding of entries of order one, times 1e3
    rank, limit = int(kept.sum()), float(chi2.ppf(LEVEL, kept.sum()))
    distance = float(np.sum((axes[:, kept].T @ apart) ** 2 / values[kept]))
    at_truth = truth.evaluate(truth.layout.start).residual
    rise = float(at_truth @ at_truth) - found.chi2
    within = np.abs(apart) < np.sqrt(chi2.ppf(LEVEL, 1))
    return {
        "rank": rank,
        "rise": rise,
        "distance": distance,
        "in region": bool(rise < limit),
        "in ellipsoid": bool(distance < limit),
        "in intervals": int(within.sum()),
        "intervals": int(within.size),
    }


def one_fit(case, seed, offset, strategy="auto"):
    """What a fit found, and what it cost."""
    record, scene, start = case.drawn(seed, offset)
    began = time.perf_counter()
    found = rk.fit(scene, start, record, case.free, rtol=RTOL, strategy=strategy)
    seconds = time.perf_counter() - began
    return {
        "seed": seed,
        "chi2 / dof": found.chi2 / found.degrees_of_freedom,
        "rollouts": found.rollouts,
        "seconds": seconds,
        "converged": bool(found.converged),
    } | judged(found, case.truth(record))


def binomial(hits, of):
    """Range of a share that holds it with 95 % (Clopper and Pearson)."""
    low = beta.ppf(0.025, hits, of - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, of - hits) if hits < of else 1.0
    return float(low), float(high)


def summary(rows):
    """Of the fits of one kind."""
    good = [r for r in rows if r["chi2 / dof"] < GLOBAL]
    later = rows[1:] or rows
    row = {"found": len(good), "of": len(rows)}
    row["rollouts"] = statistics.median(r["rollouts"] for r in rows)
    row["most rollouts"] = max(r["rollouts"] for r in rows)
    # of searches that failed too: what a user who begins anew has to pay
    spent = sum(r["rollouts"] for r in rows)
    row["rollouts a find"] = spent / len(good) if good else None
    row["seconds"] = statistics.median(r["seconds"] for r in later)
    row["first, s"] = rows[0]["seconds"]
    return row, good


def covered(good):
    """Of fits that ended at the global minimum: how often what they say is true."""
    count = lambda what: sum(r[what] for r in good)
    spread = [r["chi2 / dof"] for r in good] or [float("nan")]
    hits = count("in region")
    low, high = binomial(hits, len(good))
    return {
        "in region": hits,
        "region low": low,
        "region high": high,
        "in ellipsoid": count("in ellipsoid"),
        "in intervals": count("in intervals") / max(count("intervals"), 1),
        "rise / rank": count("rise") / max(count("rank"), 1),
        "mean chi2 / dof": statistics.mean(spread),
        "least": min(spread),
        "most": max(spread),
    }


def told(label, row):
    """One line, as soon as it is known."""
    cells = (
        f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()
    )
    print(f"  {label:32}{'  '.join(cells)}", flush=True)


def coverage(seeds):
    """Every scene, every offset."""
    for name in SCENES:
        case = Case(name, LENGTH)
        for offset in OFFSETS:
            rows = [one_fit(case, seed, offset) for seed in range(seeds)]
            row, good = summary(rows)
            row |= covered(good)
            told(f"{name}, {offset:.0%} off", row)
            yield {"scene": name, "offset": offset} | row | {"fits": rows}


@eqx.filter_jit
def misfits(slots, model, times, gyro, z):
    """What finite differences are taken of: a run, without derivatives."""
    known = slots.applied(model, z)
    run = rk.simulate(known.scene, known.start, times, rtol=FINE)
    apart = (gyro.values - run.state.angular_velocity) / gyro.sigma
    # as a fit of rollkane counts what a run does not reach
    lost = 10.0 + 2.0 * jnp.sqrt(jnp.mean(gyro.values**2)) / gyro.sigma
    return jnp.where(jnp.isfinite(apart), apart, lost).ravel()


def one_scipy(case, seed, offset):
    """The same by SciPy."""
    record, scene, start = case.drawn(seed, offset)
    layout = case.problem(scene, start, record).layout
    slots, _ = layout.of_record(0)
    runs = 0

    def residual(z):
        nonlocal runs
        runs += 1
        gyro = record.channels["gyro"]
        return np.asarray(
            misfits(slots, layout.models[0], record.time, gyro, jnp.asarray(z))
        )

    began = time.perf_counter()
    found = least_squares(
        residual, layout.start, method="trf", x_scale="jac", max_nfev=TRIES
    )
    seconds = time.perf_counter() - began
    freedom = case.read.size - layout.size
    row = {"seed": seed, "chi2 / dof": 2.0 * float(found.cost) / freedom}
    row |= {"rollouts": runs, "seconds": seconds}
    return row | {"converged": bool(found.status > 0)}


def scipy(seeds):
    """Every scene, every offset, by SciPy."""
    for name in SCENES:
        case = Case(name, LENGTH)
        for offset in OFFSETS:
            rows = [one_scipy(case, seed, offset) for seed in range(seeds)]
            row, _ = summary(rows)
            told(f"{name}, {offset:.0%} off", row)
            yield {"scene": name, "offset": offset} | row | {"fits": rows}


def horizons(seeds):
    """A long record of a motion whose neighbours part, by both strategies."""
    case = Case("rattleback", LONG)
    for strategy in ("progressive", "single"):
        rows = [one_fit(case, seed, OFFSETS[-1], strategy) for seed in range(seeds)]
        row, good = summary(rows)
        row["in region"] = sum(r["in region"] for r in good)
        told(strategy, row)
        yield {"strategy": strategy} | row | {"fits": rows}


def flight():
    """A scene without a contact, and a start above its base."""
    body = rk.Body(1.0, np.diag(FLIGHT["inertia"]), rk.Sphere(0.05))
    scene = rk.Scene(body, loads=())
    upright, here = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    rolling = rk.place(scene, upright, FLIGHT["spin"], here)
    parts = {f.name: getattr(rolling, f.name) for f in dataclasses.fields(rolling)}
    above = {"position": jnp.array([0.0, 0.0, 1.0]), "velocity": jnp.zeros(3)}
    return scene, rk.FlyingState(**parts, **above)


def flights(seeds):
    """Times, and of each seed: what a gyro reads in flight, its noise, a guess."""
    times = np.linspace(0.0, FLIGHT["duration"], round(RATE * FLIGHT["duration"]) + 1)
    scene, start = flight()
    run = rk.simulate(scene, start, times, modes=rk.Modes(), rtol=1e-12)
    read = np.asarray(run.state.angular_velocity)
    sigma = NOISE * np.sqrt(np.mean(read**2))
    records = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        values = read + sigma * random.standard_normal(read.shape)
        factors = 1.0 + OFFSETS[-1] * random.uniform(-1.0, 1.0, 2)
        records.append((values, sigma, factors * FLIGHT["inertia"][:2]))
    return times, records


def own_flight(times, values, sigma, guess):
    """Two moments by rollkane."""
    scene, start = flight()
    moments = np.diag([*guess, FLIGHT["inertia"][2]])
    scene = eqx.tree_at(lambda s: s.body.inertia, scene, jnp.asarray(moments))
    record = rk.Record(times, {"gyro": rk.Gyro(values, sigma=sigma)})
    # in free flight moments show by their ratios, to the third here, which is known
    free = rk.Free("body.inertia", form="diagonal ratios")
    began = time.perf_counter()
    found = rk.fit(scene, start, record, free, modes=rk.Modes(), rtol=RTOL)
    seconds = time.perf_counter() - began
    inertia, known = found.estimates["body.inertia"], FLIGHT["inertia"][2]
    places = [found.names.index(f"body.inertia.{axis}") for axis in ("xx", "yy", "zz")]
    covariance = found.covariance[np.ix_(places, places)]
    moments, errors = [], []
    for i in range(2):
        ratio = inertia[i, i] / inertia[2, 2]
        slope = known / inertia[2, 2] * (np.eye(3)[i] - ratio * np.eye(3)[2])
        moments.append(float(known * ratio))
        errors.append(float(np.sqrt(slope @ covariance @ slope)))
    row = {"moments": moments, "errors": errors, "seconds": seconds}
    return row | {"rollouts": found.rollouts}


def peer_flights(times, records):
    """The same by mujoco.sysid; why not, where it is not there."""
    problem = {"step": 1.0 / RATE, "duration": float(times[-1])}
    problem |= {"fixed": FLIGHT["inertia"][2], "spin": FLIGHT["spin"]}
    problem["records"] = [
        {"guess": guess.tolist(), "values": values.tolist()}
        for values, _, guess in records
    ]
    script = HERE / "peers" / "mujoco_sysid.py"
    if not SYSID.exists():
        return [], "no environment .venv-sysid: make bench-fit"
    run = subprocess.run(
        [str(SYSID), str(script)],
        input=json.dumps(problem),
        capture_output=True,
        text=True,
    )
    if run.returncode:
        return [], (run.stderr.splitlines() or ["failed"])[-1]
    return json.loads(run.stdout.splitlines()[-1]), ""


def sysid(seeds):
    """Both, on the same records from the same guesses."""
    times, records = flights(seeds)
    ours = [own_flight(times, *record) for record in records]
    theirs, why = peer_flights(times, records)
    if why:
        print(f"  mujoco.sysid: skipped, {why}")
    errors = np.array([r["errors"] for r in ours])
    for peer, rows in (("rollkane", ours), ("mujoco.sysid", theirs)):
        if not rows:
            continue
        away = np.array([r["moments"] for r in rows]) - np.array(FLIGHT["inertia"][:2])
        # of a right estimate one in 1e6 is as far away
        right = np.all(np.abs(away) < 5.0 * errors, axis=1)
        off = (away / errors)[right]
        row = {
            "found": int(right.sum()),
            "of": len(rows),
            "off, standard errors": float(np.sqrt(np.mean(off**2))),
            "rollouts": statistics.median(r["rollouts"] for r in rows),
            "seconds": statistics.median(r["seconds"] for r in rows[1:] or rows),
            "first, s": rows[0]["seconds"],
        }
        told(peer, row)
        yield {"peer": peer} | row | {"fits": rows}


BELOW = (0.5, -0.14)  # legends, in the panel's axes


def draw(tables, path):
    """Coverage, rollouts beside SciPy's, and ends of searches by both strategies."""
    from rollkane.pictures.plot_style import dress, new_figure, png

    figure = new_figure((13.5, 4.8))
    shown = {"coverage": draw_coverage, "scipy": draw_scipy, "horizons": draw_horizons}
    if not all(part in tables for part in shown):
        return
    for panel, part in zip(figure.subplots(1, len(shown)), shown, strict=True):
        dress(panel)
        shown[part](panel, tables)
    path.write_bytes(png(figure))


def labels(rows):
    """Scenes and offsets of a table."""
    return [f"{r['scene']}, {r['offset']:.0%}" for r in rows]


def draw_coverage(panel, tables):
    """Shares of fits in whose region the truth lies."""
    from rollkane.pictures.plot_style import BLUE, INK, RED

    rows = tables["coverage"]
    places, of = np.arange(len(rows)), np.array([r["found"] for r in rows])
    region = np.array([r["in region"] for r in rows]) / of
    ends = np.array([[r["region low"], r["region high"]] for r in rows]).T
    bars = np.abs(ends - region)
    style = {"fmt": "o", "color": BLUE, "label": "chi2 risen by the quantile"}
    panel.errorbar(region, places, xerr=bars, **style)
    ellipsoid = np.array([r["in ellipsoid"] for r in rows]) / of
    panel.plot(ellipsoid, places + 0.2, "x", color=RED, label="ellipsoid of covariance")
    intervals = [r["in intervals"] for r in rows]
    panel.plot(intervals, places - 0.2, "|", color=INK, label="single numbers")
    panel.axvline(LEVEL, color=INK, linewidth=0.8, linestyle="--")
    panel.set_yticks(places, labels(rows))
    panel.invert_yaxis()
    panel.set_xlabel("share that holds the truth [1]")
    panel.set_title("joint 95 % regions", fontsize=10)
    panel.legend(fontsize=8, loc="upper center", bbox_to_anchor=BELOW)


def draw_scipy(panel, tables):
    """Rollouts of a fit."""
    from rollkane.pictures.plot_style import BLUE, RED

    names = labels(tables["coverage"])
    for shift, label, colour, part in (
        (-0.2, "rollkane, each with its derivatives", BLUE, "coverage"),
        (0.2, "SciPy, finite differences", RED, "scipy"),
    ):
        rows = tables[part]
        places = np.arange(len(rows)) + shift
        panel.barh(
            places, [r["rollouts"] for r in rows], 0.36, color=colour, label=label
        )
        for place, row in zip(places, rows, strict=True):
            text = f" {row['found']} of {row['of']}"
            panel.text(row["rollouts"], place, text, va="center", fontsize=7)
    panel.set_xscale("log")
    panel.set_xlim(5, 3e4)
    panel.set_yticks(range(len(names)), names)
    panel.invert_yaxis()
    panel.set_xlabel("rollouts of a fit (median)")
    panel.set_title("rollouts, and ends at the global minimum", fontsize=10)
    panel.legend(fontsize=8, loc="upper center", bbox_to_anchor=BELOW)


def draw_horizons(panel, tables):
    """Where searches end, from the best to the worst."""
    from rollkane.pictures.plot_style import BLUE, RED

    for row, colour in zip(tables["horizons"], (BLUE, RED), strict=True):
        ends = np.sort([fit["chi2 / dof"] for fit in row["fits"]])
        label = f"{row['strategy']}: {row['found']} of {row['of']}"
        panel.semilogy(
            np.arange(1, ends.size + 1), ends, "o-", color=colour, label=label
        )
    panel.set_xlabel("guesses, by where they end")
    panel.set_ylabel("chi2 / degrees of freedom [1]")
    panel.set_title("20 s of a rattleback, guesses 30 % off", fontsize=10)
    panel.xaxis.get_major_locator().set_params(integer=True)
    panel.legend(fontsize=8, loc="upper center", bbox_to_anchor=BELOW)


PARTS = {"coverage": coverage, "scipy": scipy, "sysid": sysid, "horizons": horizons}


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--part", choices=PARTS, action="append")
    options = parser.parse_args()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python "
    machine += f"{platform.python_version()}, jax {jax.__version__}"
    print(f"{machine}, {options.seeds} seeds")
    tables = {}
    path = options.out / "fit.json"
    if path.exists():
        tables = json.loads(path.read_text())["tables"]
    options.out.mkdir(parents=True, exist_ok=True)
    for part in options.part or PARTS:
        print(part)
        tables[part] = []
        for row in PARTS[part](options.seeds):
            tables[part].append(row)
            figures = {"machine": machine, "tables": tables}
            path.write_text(json.dumps(figures, indent=1) + "\n")
    draw(tables, options.out / "fit.png")


if __name__ == "__main__":
    main()
