"""What a study costs beside a bare ensemble: time, memory, workers.

    python benchmarks/monte_carlo.py [--out FOLDER] [--size N] [--large N] [--part PART]

Two studies: rattlebacks of 20 s whose spin and mass are random (does the spin pass
zero a second time?), and rolling isolators under 20 s of all three components of the
Kaikoura record at random strength (is contact lost?). Measured:

- rates: members a second of ``rk.monte_carlo`` into a store, and of ``rk.ensemble`` of
  the same members, which are made before its clock starts; alternately, least of the
  repeats;
- memory: the largest resident size of a process that does ``--size`` members, and of
  one that does ``--large``, each into a store;
- workers: members a second with 1 and 2 threads, and 2 processes (which compile anew);
- overhead: what a block costs besides its motions, and a member's place in a store.

Prints tables and writes them as JSON.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
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

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.kinematics.base_motion import AbstractBaseMotion, BaseKinematics

jax.config.update("jax_enable_x64", True)

TIMES = (0.0, 20.0)  # s
WINDOW = (42.0, 62.0)  # s of the record: its strong part
PARTS = "rates", "workers", "overhead", "memory"


class Scaled(AbstractBaseMotion):
    """A record at another strength."""

    motion: rk.RecordedMotion
    factor: jax.Array

    @property
    def kinks(self):
        """Sample times [s]."""
        return self.motion.kinks

    @property
    def span(self):
        """First and last sample time [s]."""
        return self.motion.span

    def at(self, t):
        """Of the record, times the factor."""
        known = self.motion.at(t)
        return BaseKinematics(
            position=self.factor * known.position,
            velocity=self.factor * known.velocity,
            acceleration=self.factor * known.acceleration,
        )


def spin(scene, t, state):
    """About the vertical [rad/s]."""
    contact = rk.contact_of(scene, t, state)
    return contact.rotation[2] @ contact.angular_velocity


def rattlebacks():
    """Kane and Levinson's, whose spin [rad/s] and mass [kg] are random."""
    file = load_scene("rattleback")
    known = file.scene
    contact = rk.contact_of(known, jnp.asarray(0.0), file.start)
    turning = contact.rotation @ file.start.angular_velocity
    orientation = file.start.orientation

    def make(draw):
        scene = eqx.tree_at(lambda s: s.body.mass, known, draw["mass"])
        faster = turning * draw["spin"] / 5.0
        return scene, rk.place(scene, orientation, faster, (0.0, 0.0, 0.0))

    random = {"spin": rk.Normal(3.0, 0.5), "mass": rk.Uniform(0.9, 1.1)}
    reversal = rk.Event(spin, name="reversal", most=4)
    return rk.Study(make, random, TIMES, {"spin": spin}, events=reversal)


def isolators():
    """Under a record of random strength [1]."""
    file = load_scene("isolator")
    record = rk.builtin_record("kaikoura-2016-wtmc").window(*WINDOW)
    shaken = rk.RecordedMotion(record.time, record.acceleration)

    def make(draw):
        moving = Scaled(shaken, draw["strength"])
        scene = eqx.tree_at(lambda s: s.base.motion, file.scene, moving)
        return scene, file.start

    random = {"strength": rk.LogNormal(1.0, 0.2)}
    seen = {"payload": lambda scene, t, state: state.alpha}
    return rk.Study(make, random, TIMES, seen, events="lift-off")


STUDIES = {"rattlebacks": rattlebacks, "isolators": isolators}


def stored(study, size, **options):
    """One run into a store that is thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        return rk.monte_carlo(study, size, 1, store=Path(folder) / "study", **options)


def bare(study, size):
    """Seconds that ``rk.ensemble`` takes for the same members."""
    from rollkane.uncertainty.made_members import MadeMembers
    from rollkane.uncertainty.sampling import sampler

    made = MadeMembers(study.make, study.draws)
    u = sampler("plain", study.draws.dimension, 1, size).uniforms(0, size)
    members = made.members(1)
    scene, starts = made.block(u)
    joined = np.asarray
    scene, starts = jax.tree.map(joined, (scene, starts))
    if not any(axis == 0 for axis in members.start_axes):
        # an ensemble asks for starts of its own
        repeated = lambda x: np.broadcast_to(x, (size, *np.shape(x)))
        starts = jax.tree.map(repeated, starts)
    axes = members.axes()[0]
    began = time.perf_counter()
    known = {"events": study.events, "scene_axes": axes}
    runs = rk.ensemble(scene, starts, study.times, **known)
    seconds = time.perf_counter() - began
    assert runs.method == "native", runs.why
    return seconds


def rates(size, repeats):
    """Members a second of both, and what the studies are about."""
    for name, make in STUDIES.items():
        study = make()
        stored(study, 2048)
        bare(study, 2048)
        own, plain = [], []
        for _ in range(repeats):
            found = stored(study, size)
            own.append(found.rates.members / found.rates.seconds)
            plain.append(size / bare(study, size))
        event = study.event_names[0]
        often = 2 if name == "rattlebacks" else 1
        share, low, high = (float(x) for x in found.at_least(event, often))
        row = {
            "study": name,
            "size": size,
            "monte_carlo": max(own),
            "ensemble": max(plain),
            "ratio": max(own) / max(plain),
            "event": f"{event}, {often} or more",
            "probability": share,
            "interval": [low, high],
            "failed": found.failed,
        }
        print(
            f"{name:<12}{size:>9,}  {row['monte_carlo']:>9,.0f}/s"
            f"{row['ensemble']:>9,.0f}/s bare{row['ratio']:>6.2f}   "
            f"P({row['event']}) = {share:.4f}, {low:.4f} to {high:.4f}, "
            f"{found.failed} failed",
            flush=True,
        )
        yield row


def overhead(blocks):
    """What a block costs besides its motions, which hardly last: into a store [s]."""
    file = load_scene("ball-on-plane")

    def make(draw):
        spin = jnp.array([0.0, 0.0, 1.0]) * draw["spin"]
        turned = eqx.tree_at(lambda s: s.angular_velocity, file.start, spin)
        return file.scene, turned

    seen = {"spin": spin}
    study = rk.Study(make, {"spin": rk.Normal(3.0, 0.5)}, (0.0, 1e-6), seen)
    for block in blocks:
        size = 16 * block
        times = []
        for _ in range(3):
            found = stored(study, size, block=block, workers=1)
            times.append(found.rates.seconds / 16)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "study"
            rk.monte_carlo(study, size, 1, store=path, block=block)
            used = sum(f.stat().st_size for f in path.rglob("*") if f.is_file())
            began = time.perf_counter()
            rk.read_study(path)
            read = time.perf_counter() - began
        row = {
            "block": block,
            "seconds": statistics.median(times),
            "bytes": used / size,
            "read": read / size,
        }
        print(
            f"block of {block:>6,}: {1e3 * row['seconds']:.1f} ms, "
            f"{1e6 * row['seconds'] / block:.2f} us and {row['bytes']:.0f} bytes a "
            f"member; read again {1e6 * row['read']:.2f} us a member",
            flush=True,
        )
        yield row


def memory(sizes):
    """Largest resident size of processes that do so many [MiB]."""
    for size in sizes:
        began = time.perf_counter()
        command = [sys.executable, __file__, "--alone", str(size)]
        told = subprocess.run(command, capture_output=True, text=True, check=True)
        row = json.loads(told.stdout.splitlines()[-1])
        row |= {"size": size, "seconds": time.perf_counter() - began}
        print(
            f"isolators   {size:>9,}  {row['MiB']:,.0f} MiB  {row['rate']:,.0f}/s  "
            f"{row['seconds']:.0f} s in all",
            flush=True,
        )
        yield row


def alone(size):
    """One study in this process; its memory as JSON."""
    found = stored(isolators(), size)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    share, low, high = (float(x) for x in found.at_least("lift-off", 1))
    rate = found.rates.members / found.rates.seconds
    row = {"MiB": peak, "rate": rate, "probability": share, "interval": [low, high]}
    print(json.dumps(row))


def workers(size):
    """Members a second with so many workers."""
    study = rattlebacks()
    for executor, count in ((None, 1), (None, 2), ("processes", 2)):
        stored(study, 2048, executor=executor, workers=count)
        found = stored(study, size, executor=executor, workers=count)
        rate = found.rates.members / found.rates.seconds
        row = {"executor": executor or "threads", "workers": count, "rate": rate}
        print(f"{row['executor']:<12}{count} workers {rate:>9,.0f}/s", flush=True)
        yield row


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--size", type=int, default=100_000)
    parser.add_argument("--large", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--part", choices=PARTS, action="append")
    parser.add_argument("--alone", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.alone:
        alone(options.alone)
        return
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python "
    machine += f"{platform.python_version()}, jax {jax.__version__}"
    print(f"{machine}, load {os.getloadavg()[0]:.1f}")
    sizes = options.size, options.large
    parts = {
        "rates": lambda: rates(options.size, options.repeats),
        "workers": lambda: workers(options.size // 4),
        "overhead": lambda: overhead((1024, 4096, 16384, 65536)),
        "memory": lambda: memory(sizes),
    }
    path = options.out / "monte_carlo.json"
    options.out.mkdir(parents=True, exist_ok=True)
    tables = json.loads(path.read_text())["tables"] if path.exists() else {}
    for part in options.part or parts:
        tables[part] = list(parts[part]())
        text = json.dumps({"machine": machine, "tables": tables}, indent=1)
        path.write_text(text + "\n")


if __name__ == "__main__":
    main()
