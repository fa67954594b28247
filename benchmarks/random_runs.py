"""Random runs that roll, slip, fly and land, each judged in one of three ways.

    python benchmarks/random_runs.py mechanics|batches|derivatives
        [--count N] [--seed S] [--out FOLDER]

Draws scenes of every body, base, motion and cargo that the tests know, and runs several
starts of each. ``mechanics``: Newton's and Euler's equations, friction, impacts and
changes of the contact, from outputs alone (``tests/outputs_with_modes.py``).
``batches``: a member of a batch against the same run alone. ``derivatives``: along a
random direction in mass, inertia, gravity, friction, restitution and speeds, forwards
and backwards, against central differences. A scene where something is wrong is printed
with its seed, and makes the command fail.

A start that cannot hold lands once more within nanometres, by chance of rounding: such
changes are told apart by what follows them, not counted. Next to a singular place, at
which a run ends with a code, no stencil may resolve its forces: its code stands beside.
"""

import argparse
import json
import os
import platform
import sys
import time
import warnings
from pathlib import Path

# the XLA setting that the command line uses, too (docs/speed.md)
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536",
)

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))
import rollkane as rk  # noqa: E402
from tests import outputs_alone  # noqa: E402
from tests.carried_systems import System  # noqa: E402
from tests.outputs_with_modes import Place, carrying, examined, released  # noqa: E402
from tests.physics.test_outputs_with_modes import limit  # noqa: E402

LAWS = ("rolling", "rolling", "rubber")
CARGO = ("", "", "", "", "spring", "pendulum", "two", "driven", "rotor")
# rad/s: of accelerations of 100 rad/s^2, which turn within 1e-5 s where a slip ends or
# begins (tests/outputs_with_modes.py), over the 7.5e-7 s that are continued
KICK = 7.5e-5
AT_ONCE = 1e-6  # s: changes so close are those of a start that cannot hold


class NoStartError(Exception):
    """A scene of which no random start is accepted."""


class Drawn:
    """A scene by its seed, and starts and modes for it."""

    def __init__(self, seed):
        """Draw what it is made of."""
        self.draw = np.random.default_rng([seed, 91])
        pick = lambda names: str(self.draw.choice(list(names)))
        self.law, self.body = pick(LAWS), pick(outputs_alone.BODIES)
        self.base, self.motion = pick(outputs_alone.BASES), pick(outputs_alone.MOTIONS)
        cargo = pick(CARGO)
        self.system = System((cargo,) if cargo else ())
        self.name = "-".join(
            x for x in (self.law, self.body, self.base, self.motion, cargo) if x
        )
        scene = outputs_alone.scene_of(self.law, self.body, self.base, self.motion)
        self.scene = carrying(scene, self.system)

    def start(self, seed):
        """In contact or above the base."""
        begin = outputs_alone.start_of if seed % 2 else released
        count = self.system.count
        inside = 0.1 * self.draw.normal(size=count), self.draw.normal(size=count)
        try:
            return begin(self.scene, self.base, seed, inside)
        except AssertionError as error:  # after 40 tries
            raise NoStartError(str(error)) from error

    def modes(self):
        """Friction that holds as much or more at rest, and a rebound."""
        mu, e = self.draw.uniform(0.02, 0.8), self.draw.uniform(0.0, 1.0)
        hold = mu * self.draw.choice([1.0, 1.3])
        return rk.Modes(friction=mu, static_friction=hold, restitution=e)


def mechanics(drawn, seed, wrong, codes):
    """Residuals of six starts that are too large, and how the runs ended."""
    for k in range(6):
        modes, start = drawn.modes(), drawn.start(10 * seed + k)
        names = drawn.law, drawn.body, drawn.base, drawn.motion
        run, found = examined(drawn.scene, start, Place(*names, modes, drawn.system))
        if np.any(np.diff(run.edges[:-1]) < AT_ONCE):
            found.pop("changes at other times", None)
        codes.append(run.code)
        most = lambda name: KICK if name == "kick" else limit(name)
        bad = {name: x for name, x in found.items() if not x < most(name)}
        if bad:
            wrong.append({"start": k, "code": run.code, **bad})


def batches(drawn, seed, wrong, codes, count=24):
    """Members of a batch that differ from their runs alone."""
    draw, start = drawn.draw, drawn.start(seed)
    mu, e = draw.uniform(0.02, 0.5, count), draw.uniform(0.0, 0.9, count)
    spins = start.angular_velocity + draw.normal(size=(count, 3))
    times = np.linspace(0.0, 0.6, 13)

    def run(mu, e, spin):
        at = eqx.tree_at(lambda y: y.angular_velocity, start, spin)
        modes = rk.Modes(friction=mu, restitution=e)
        found = rk.simulate(drawn.scene, at, times, modes=modes, rtol=1e-10)
        seen = found.position, found.orientation, found.angular_velocity
        return found.code, found.final_time, seen

    many = jax.jit(jax.vmap(run))(mu, e, spins)
    alone = jax.jit(run)
    codes += np.asarray(many[0]).tolist()
    for k in range(count):
        one, of_batch = alone(mu[k], e[k], spins[k]), jax.tree.map(lambda x: x[k], many)  # noqa: B023
        pairs = zip(jax.tree.leaves(one), jax.tree.leaves(of_batch), strict=True)
        # each within its own errors, of 1e-10 a step, which landings make larger
        if not all(
            np.allclose(a, b, rtol=0, atol=1e-7, equal_nan=True) for a, b in pairs
        ):
            wrong.append({"member": k, "codes": [int(one[0]), int(of_batch[0])]})


def derivatives(drawn, seed, wrong, codes):
    """Tangents unlike differences, or gradients unlike tangents."""
    times, modes = np.linspace(0.0, 0.5, 6), drawn.modes()
    given = {"mass": 0.0, "friction": 0.0, "restitution": 0.0, "gravity": np.zeros(3)}
    zero = jax.tree.map(jnp.asarray, given | {"spin": np.zeros(3)})

    @eqx.filter_jit
    def run(x, start):
        body = drawn.scene.body
        parts = lambda scene: (scene.body.mass, scene.loads[0])
        gravity = rk.Gravity(outputs_alone.GRAVITY + x["gravity"])
        changed = body.mass * (1.0 + x["mass"]), gravity
        scene = eqx.tree_at(parts, drawn.scene, changed)
        mu = 1.0 + x["friction"]
        how = rk.Modes(
            friction=modes.friction * mu,
            static_friction=modes.static_friction * mu,
            restitution=modes.restitution * (1.0 - x["restitution"]),
        )
        spin = start.angular_velocity + x["spin"]
        start = eqx.tree_at(lambda y: y.angular_velocity, start, spin)
        found = rk.simulate(scene, start, times, modes=how, rtol=1e-12, atol=1e-14)
        seen = found.position.ravel(), found.angular_velocity.ravel()
        return jnp.concatenate(seen), (found.code, found.switches.after)

    values = lambda start: lambda x: run(x, start)[0]
    for k in range(4):
        start = drawn.start(10 * seed + k)
        way = jax.tree.map(lambda x: jnp.asarray(drawn.draw.normal(size=x.shape)), zero)
        h = 2e-5
        runs = [run(along(way, c * h), start) for c in (-2.0, -1.0, 1.0, 2.0)]
        sequence = np.stack([np.append(code, after) for _, (code, after) in runs])
        codes.append(int(runs[0][1][0]))
        if codes[-1] != rk.Code.COMPLETED or np.ptp(sequence, axis=0).any():
            continue  # the mode changes otherwise beside it: no derivative is there
        a, b, c, d = (np.asarray(found) for found, _ in runs)
        wanted = (8.0 * (c - b) - (d - a)) / (12.0 * h)
        tangent = np.asarray(jax.jvp(values(start), (zero,), (way,))[1])
        back = drawn.draw.normal(size=tangent.shape)
        gradient = jax.vjp(values(start), zero)[1](jnp.asarray(back))[0]
        both = zip(jax.tree.leaves(gradient), jax.tree.leaves(way), strict=True)
        size = 1.0 + np.abs(wanted).max()
        off = np.abs(tangent - wanted).max() / size
        pulled = sum(float(jnp.vdot(x, y)) for x, y in both)
        turned = abs(pulled - back @ tangent) / (size * np.abs(back).sum())
        # errors of 1e-12 a step over h, and h^4 of a fifth derivative of a run
        if not (off < 1e-4 and turned < 1e-8):
            wrong.append({"start": k, "tangent": off, "gradient": turned})


def along(way, h):
    """So far along a direction."""
    return jax.tree.map(lambda x: h * x, way)


KINDS = {"mechanics": mechanics, "batches": batches, "derivatives": derivatives}


def main():
    """Draw, run, judge."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    version = platform.python_version()
    print(f"{platform.machine()}, Python {version}, jax {jax.__version__}")
    warnings.simplefilter("ignore")  # contacts that pull, codes: told below
    rows = []
    for seed in range(options.seed, options.seed + options.count):
        drawn, began = Drawn(seed), time.perf_counter()
        wrong, codes = [], []
        row = {"seed": seed, "scene": drawn.name, "wrong": wrong, "codes": codes}
        try:
            KINDS[options.kind](drawn, seed, wrong, codes)
        except (NoStartError, rk.FieldError) as error:  # an edge on an edge
            row["refused"] = str(error)
        rows.append(row)
        taken = time.perf_counter() - began
        told = f"{codes} {row.get('refused', '')}"
        print(
            f"{seed:4d} {taken:5.0f} s  {drawn.name}: {told} {wrong or ''}", flush=True
        )
        if seed % 4 == 3:
            jax.clear_caches()
    bad = sum(bool(row["wrong"]) for row in rows)
    print(f"{len(rows)} scenes, {bad} with something wrong")
    options.out.mkdir(parents=True, exist_ok=True)
    target = options.out / f"random_{options.kind}.json"
    target.write_text(json.dumps(rows, indent=1, default=float) + "\n")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
