"""What befalls runs of studies, and what is left of them.

    python benchmarks/faults.py [--out FOLDER] [--kills N] [--seed N] [--only ...]

A study of rolling ellipsoids is written to a store, undisturbed; then the same study is

- killed (SIGKILL) at random moments, and gone on with after each; a store that came to
  its end is compared and begun anew, until there were as many kills as asked for;
- read and gone on with after one chunk was cut, lost or changed in one byte, at random;
- written to a disk that is full: a small tmpfs of a mount namespace of its own
  (``unshare -rm``), made larger before it is gone on with;
- computed by a pool of processes, and by a Dask cluster, of which a worker is killed
  while it computes;
- written by two shards at once, and interrupted (SIGINT, as by Ctrl-C).

Of each: how often it was tried, how often it was noticed, how often all files of the
store were byte for byte those of the undisturbed one in the end, and what was said.
What a machine does not have is skipped by name.
"""

import argparse
import functools
import hashlib
import json
import multiprocessing
import os
import platform
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import rollkane as rk  # noqa: E402
from rollkane.dynamics.observables import energy  # noqa: E402
from rollkane.dynamics.ready_observables import position  # noqa: E402

HERE = Path(__file__).resolve()
SMALL, LARGE = "1536k", "64m"  # of the tmpfs
SLOW = 40.0  # s of motion, where workers are to be met at work


class Row(NamedTuple):
    fault: str
    tried: int
    noticed: int
    identical: int
    seconds: float
    said: str


def turned(draw: dict[str, Any]) -> tuple[Any, Any]:
    body = rk.Body(
        1.0, np.diag([0.0026, 0.004, 0.005]), rk.Ellipsoid((0.12, 0.1, 0.08))
    )
    scene = rk.Scene(body, loads=(rk.Gravity(),))
    turning = jnp.stack([jnp.asarray(0.3), draw["rate"], jnp.asarray(2.0)])
    return scene, rk.place(scene, draw["orientation"], turning, (0.0, 0.0, 0.0))


@functools.cache  # so that it compiles once
def study(until: float) -> rk.Study:
    drawn = {"rate": rk.Normal(3.0, 1.0), "orientation": rk.UniformOrientation()}
    far = rk.Event(lambda *at: position(*at)[0] - 0.2, name="far")
    seen = {"end": position, "energy": energy}
    return rk.Study(turned, drawn, [0.0, until], seen, events=far)


def run(store: Path, size: int, block: int, until: float = 0.5, **how: Any) -> Any:
    return rk.monte_carlo(
        study(until), size, seed=1, store=store, resume=True, block=block, **how
    )


QUICK: dict[str, Any] = {"size": 8192, "block": 32}


def tree(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in files
    }


def begun(store: Path, *options: str) -> subprocess.Popen[str]:
    """A process of its own that writes the store."""
    command = [sys.executable, str(HERE), "--child", str(store), *options]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


@contextmanager
def timed() -> Iterator[Callable[[], float]]:
    first = time.monotonic()
    yield lambda: round(time.monotonic() - first, 1)


def until_it_writes(store: Path, child: subprocess.Popen[str]) -> None:
    """Wait until another block is there than at first."""
    marks = lambda: len(list((store / "checksum" / "c").glob("*")))
    first = marks()
    while marks() == first and child.poll() is None:
        time.sleep(0.005)


def killed(folder: Path, whole: dict[str, str], count: int, dice: random.Random) -> Row:
    store, kills, ends, same = folder / "killed.zarr", 0, 0, 0
    with timed() as seconds:
        while kills < count:
            child = begun(store)
            until_it_writes(store, child)
            time.sleep(dice.uniform(0.0, 0.6))
            child.kill()
            child.communicate()
            kills += child.returncode == -signal.SIGKILL
            if child.returncode not in (0, -signal.SIGKILL):
                raise SystemExit("a run failed that nobody had disturbed")
            if child.returncode == 0:
                ends, same = ends + 1, same + (tree(store) == whole)
                shutil.rmtree(store)
        run(store, **QUICK)
        ends, same = ends + 1, same + (tree(store) == whole)
        shutil.rmtree(store)
        said = f"{ends} stores came to their ends through these"
        good = kills if same == ends else 0
        return Row("process killed (SIGKILL)", kills, kills, good, seconds(), said)


def interrupted(folder: Path, whole: dict[str, str]) -> Row:
    store = folder / "interrupted.zarr"
    with timed() as seconds:
        child = begun(store)
        until_it_writes(store, child)
        child.send_signal(signal.SIGINT)
        _, said = child.communicate()
        found = rk.read_study(store)
        run(store, **QUICK)
        same = tree(store) == whole
        last = said.strip().splitlines()[-1] if said.strip() else ""
        noticed = int(child.returncode != 0 and not found.complete)
        return Row("interrupted (SIGINT)", 1, noticed, int(same), seconds(), last)


def damages() -> dict[str, Callable[[Path, random.Random], None]]:
    def cut(file: Path, dice: random.Random) -> None:
        data = file.read_bytes()
        file.write_bytes(data[: dice.randrange(len(data))])

    def lost(file: Path, dice: random.Random) -> None:
        file.unlink()

    def changed(file: Path, dice: random.Random) -> None:
        data = bytearray(file.read_bytes())
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
        file.write_bytes(data)

    return {"chunk cut": cut, "chunk lost": lost, "byte changed": changed}


def damaged(
    fault: str, undisturbed: Path, folder: Path, count: int, dice: random.Random
) -> Row:
    store, whole, noticed, same = folder / "damaged.zarr", tree(undisturbed), 0, 0
    chunks = [name for name in sorted(whole) if "/c/" in name and "time/" not in name]
    said = ""
    with timed() as seconds:
        shutil.copytree(undisturbed, store)
        for _ in range(count):
            damages()[fault](store / dice.choice(chunks), dice)
            found = rk.read_study(store)
            noticed += not found.complete
            said = found.note or said
            run(store, **QUICK)
            same += tree(store) == whole
        shutil.rmtree(store)
        return Row(fault, count, noticed, same, seconds(), said)


def full_disk(folder: Path, undisturbed: Path) -> Row | None:
    """The run in a mount namespace, as it tells it; None where there is none."""
    place = folder / "full"
    place.mkdir()
    inside = [sys.executable, str(HERE), "--full-disk", str(place), str(undisturbed)]
    with timed() as seconds:
        ran = subprocess.run(
            ["unshare", "-rm", *inside], capture_output=True, text=True, check=False
        )
        if ran.returncode:
            print("full disk: skipped,", ran.stderr.strip().splitlines()[-1])
            return None
        told = json.loads(ran.stdout.strip().splitlines()[-1])
        return Row("disk full (tmpfs)", 1, *told[:2], seconds(), told[2])


def on_full_disk(place: Path, undisturbed: Path) -> None:
    """Inside of the namespace."""
    mount = "mount", "-t", "tmpfs", "-o"
    subprocess.run([*mount, f"size={SMALL}", "none", str(place)], check=True)
    store = place / "s.zarr"
    child = begun(store)
    _, said = child.communicate()
    found = rk.read_study(store)
    kept = f"{found.size} members kept; {said.strip().splitlines()[-1]}"
    subprocess.run([*mount, f"remount,size={LARGE}", "none", str(place)], check=True)
    run(store, **QUICK)
    noticed = child.returncode != 0 and "No space left" in said and found.size > 0
    print(json.dumps([int(noticed), int(tree(store) == tree(undisturbed)), kept]))


def worker_killed(kind: str, folder: Path, whole: dict[str, str]) -> Row:
    """One of two workers, once two blocks are there."""
    store, victims = folder / f"{kind}.zarr", []

    def kill(done: Any) -> None:
        if done.members >= 1024 and not victims:
            at_work = [p for p in multiprocessing.active_children() if p.pid]
            victims.append(at_work[0].pid)
            os.kill(victims[0], signal.SIGKILL)

    with timed() as seconds:
        how: dict[str, Any] = {"executor": kind, "workers": 2, "progress": kill}
        found = run(store, 4096, 512, SLOW, **how)
        same = tree(store) == whole
        said = f"{found.rates.members} members computed, none lost"
        name = {"processes": "worker of the pool", "dask": "worker of Dask"}[kind]
        return Row(f"{name} killed", 1, len(victims), int(same), seconds(), said)


def two_shards(folder: Path, whole: dict[str, str]) -> Row:
    store = folder / "shards.zarr"
    with timed() as seconds:
        both = [begun(store, "--shard", str(i), "2") for i in (1, 2)]
        said = [child.communicate()[1] for child in both]
        good = all(child.returncode == 0 for child in both)
        same = tree(store) == whole
        text = "; ".join(filter(None, said)) or "both came to their ends"
        return Row("two shards at once", 1, int(good), int(same), seconds(), text)


def child(store: Path, shard: tuple[int, int] | None) -> int:
    # which a shell's background processes ignore
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        run(store, **QUICK, shard=shard)
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return 0


def everything(
    folder: Path, kills: int, seed: int
) -> dict[str, Callable[[], Row | None]]:
    dice = random.Random(seed)

    @functools.cache
    def undisturbed() -> Path:
        run(folder / "undisturbed.zarr", **QUICK)
        return folder / "undisturbed.zarr"

    @functools.cache
    def slow() -> dict[str, str]:
        run(folder / "slow.zarr", 4096, 512, SLOW)
        return tree(folder / "slow.zarr")

    def damage(fault: str) -> Callable[[], Row]:
        return lambda: damaged(fault, undisturbed(), folder, kills, dice)

    return {
        "kill": lambda: killed(folder, tree(undisturbed()), kills, dice),
        "interrupt": lambda: interrupted(folder, tree(undisturbed())),
        **{fault: damage(fault) for fault in damages()},
        "full": lambda: full_disk(folder, undisturbed()),
        "shards": lambda: two_shards(folder, tree(undisturbed())),
        "processes": lambda: worker_killed("processes", folder, slow()),
        "dask": lambda: worker_killed("dask", folder, slow()),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", help="some of them: kill, interrupt, ...")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--shard", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--full-disk", type=Path, nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        return child(given.child, tuple(given.shard) if given.shard else None)
    if given.full_disk:
        on_full_disk(*given.full_disk)
        return 0
    rows: dict[str, Any] = {}
    print(f"{'':28}tried  noticed  identical       s  said")
    with tempfile.TemporaryDirectory() as folder:
        measures = everything(Path(folder), given.kills, given.seed)
        for name in given.only or measures:
            row = measures[name]()
            if row is not None:
                rows[name] = row._asdict()
                numbers = f"{row.tried:5}{row.noticed:9}{row.identical:11}"
                line = f"{row.fault:28}{numbers}{row.seconds:8.1f}  {row.said}"
                print(line, flush=True)
    if given.out:
        written(given.out / "faults.json", rows)
    counts = "tried", "noticed", "identical"
    return int(any(len({row[n] for n in counts}) > 1 for row in rows.values()))


def written(file: Path, rows: dict[str, Any]) -> None:
    """With what was measured before of the other faults."""
    known = json.loads(file.read_text())["rows"] if file.exists() else {}
    machine = {"machine": platform.machine(), "python": platform.python_version()}
    machine |= {"jax": jax.__version__, "processors": os.cpu_count()}
    text = json.dumps(machine | {"rows": known | rows}, indent=1)
    file.write_text(text + "\n")


if __name__ == "__main__":
    sys.exit(main())
