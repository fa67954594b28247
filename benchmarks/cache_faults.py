"""What happens to compiled loops when their cache is attacked, broken or not there.

    python benchmarks/cache_faults.py [--out FOLDER]

Each fault is made, and then a fresh process runs an ensemble of a ball and the gradient
of a run, as a user without a name where that can be (root starts it). Of each: whether
the numbers are those of an untroubled process, whether a library that another user had
planted was run, where the loops were kept (the cache folder, or a private one that is
gone with its process), what the package says about it (its log, or why it took another
way), and seconds. Faults that need root, or a disk of their own, are skipped by name
elsewhere.
"""

import argparse
import json
import os
import platform
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

ANOTHER = 12345  # a user without a name
IS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0

INNER = """
import json, logging, os, re
said = []
keep = logging.Handler()
keep.emit = lambda record: said.append(record.getMessage())
logging.getLogger("rollkane").addHandler(keep)
logging.getLogger("rollkane").setLevel(logging.INFO)
import jax
jax.config.update("jax_enable_x64", True)
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import rollkane as rk
from rollkane.files.scene_files import load_scene
file = load_scene("ball-on-plane")
times = [0.0, 0.1]
starts = jax.tree.map(lambda x: jnp.stack([x, 1.01 * x]), file.start)
runs = rk.ensemble(file.scene, starts, times)
def end(w):
    start = eqx.tree_at(lambda s: s.angular_velocity, file.start, w)
    return rk.simulate(file.scene, start, times).state.angular_velocity[-1, 0]
slope = jax.grad(end)(file.start.angular_velocity)
loaded = []
if os.path.exists("/proc/self/maps"):
    lines = [x.split() for x in open("/proc/self/maps") if ".so" in x]
    paths = {x[-1] for x in lines if "x" in x[1]}
    # the names of kept loops begin with their keys
    keyed = [x for x in paths if re.fullmatch("[0-9a-f]{32}", os.path.basename(x)[:32])]
    loaded = ["private" if "/rollkane-private-" in x else "cache" for x in keyed]
print(json.dumps({
    "numbers": [*np.ravel(runs.state.orientation).tolist(), *slope.tolist()],
    "method": runs.method,
    "why": runs.why,
    "said": said,
    "loaded": loaded,
}))
"""
# runs as soon as it is loaded, and leaves a file behind
PLANT = """
#include <stdio.h>
__attribute__((constructor)) static void planted(void) {
    FILE *f = fopen("%s", "w");
    if (f) fclose(f);
}
"""


class Place(NamedTuple):
    """Folders of one fault, and the processes in it.

    Attributes:
        folder: Others may enter it.
        kept: A cache folder as an untroubled process leaves it.
        environment: Of the processes.
        user: Who they are; 0 for whoever runs this.
    """

    folder: Path
    kept: Path
    environment: dict[str, str]
    user: int

    @property
    def home(self) -> Path:
        """The user's."""
        return self.folder / "home"

    @property
    def cache(self) -> Path:
        """Where the package keeps its loops."""
        return self.home / ".cache" / "rollkane"

    @property
    def temporary(self) -> Path:
        """For temporary files, like /tmp."""
        return self.folder / "tmp"

    @property
    def planted(self) -> Path:
        """Is there when planted code has run."""
        return self.temporary / "planted-code-ran"

    def fill(self) -> list[Path]:
        """Put the untroubled cache in its place."""
        self.cache.mkdir(parents=True, mode=0o700)
        for entry in self.kept.iterdir():
            shutil.copy(entry, self.cache)
        for path in (self.cache.parent, self.cache, *self.cache.iterdir()):
            self.own(path)
        return sorted(self.cache.iterdir())

    def own(self, path: Path, mode: int = 0o700) -> None:
        """Give a path to the user of the processes."""
        path.chmod(mode)
        if self.user:
            os.chown(path, self.user, self.user)

    def plant(self, folder: Path) -> list[Path]:
        """Put another user's libraries under the names that are looked for."""
        text = PLANT % self.planted
        made = folder / "planted.so"
        asked = ["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", str(made)]
        subprocess.run(asked, input=text.encode(), check=True)
        data = made.read_bytes()
        made.unlink()
        paths = []
        for entry in self.kept.iterdir():
            key = entry.name.split("-")[0].removesuffix(".so")
            names = {f"{key}.so", entry.name, _named(key, data)}
            paths += [folder / name for name in names]
        for path in paths:
            path.write_bytes(data)
            path.chmod(0o755)
            os.chown(path, ANOTHER + 1, ANOTHER + 1)
        return paths


def _named(key: str, data: bytes) -> str:
    try:
        from rollkane.codegen.cache import _name
    except ImportError:  # a release before this check
        return f"{key}.so"
    return _name(key, data)


def command(user: int, code: str) -> list[str]:
    """Of a process of a user, to whom the interpreter may have to be shown."""
    python = [sys.executable, "-c", code]
    if not user:
        return python
    who = ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups"]
    may_read = ["--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"]
    return [*who, *may_read, *python]


def started(place: Place, user: int | None = None, **changes: str) -> subprocess.Popen:
    """A process with this environment; an empty text takes a name away."""
    environment = {k: v for k, v in (place.environment | changes).items() if v}
    return subprocess.Popen(
        command(place.user if user is None else user, INNER),
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd="/",
    )


def ended(process: subprocess.Popen) -> dict:
    """What it found; after a crash the last thing that it said."""
    printed, complained = process.communicate(timeout=300)
    if process.returncode == 0:
        return json.loads(printed.splitlines()[-1])
    if process.returncode < 0:
        return {"failed": f"killed by {signal.Signals(-process.returncode).name}"}
    return {"failed": complained.strip().splitlines()[-1]}


def one(place: Place, **changes: str) -> list[dict]:
    return [ended(started(place, **changes))]


# Faults: each is made in a place, and gives what its processes found.


def nothing(place: Place) -> list[dict]:
    return one(place)


def second(place: Place) -> list[dict]:
    place.fill()
    return one(place)


def planted_in_tmp(place: Place) -> list[dict]:
    user = place.user or os.getuid()
    folder = place.temporary / f"rollkane-{user}"
    folder.mkdir()
    place.plant(folder)
    os.chown(folder, ANOTHER + 1, ANOTHER + 1)
    return one(place, HOME="/dev/null")


def planted_in_cache(place: Place) -> list[dict]:
    for entry in place.fill():
        entry.unlink()
    place.plant(place.cache)
    return one(place)


def planted_by_links(place: Place) -> list[dict]:
    for entry in place.fill():
        entry.unlink()
    outside = place.folder / "outside"
    outside.mkdir()
    for path in place.plant(outside):
        (place.cache / path.name).symlink_to(path)
    return one(place)


def folder_is_link(place: Place) -> list[dict]:
    place.fill()
    real = place.cache.rename(place.folder / "real")
    place.cache.symlink_to(real)
    return one(place)


def folder_of_another(place: Place) -> list[dict]:
    place.fill()
    place.plant(place.cache)
    os.chown(place.cache, ANOTHER + 1, ANOTHER + 1)
    place.cache.chmod(0o755)
    return one(place)


def with_mode(mode: int) -> Callable:
    def fault(place: Place) -> list[dict]:
        place.fill()
        place.cache.chmod(mode)
        return one(place)

    return fault


def way_open(place: Place) -> list[dict]:
    place.fill()
    place.cache.parent.chmod(0o777)
    return one(place)


def cut_short(left: float) -> Callable:
    def fault(place: Place) -> list[dict]:
        for entry in place.fill():
            os.truncate(entry, int(left * entry.stat().st_size))
        return one(place)

    return fault


def one_bit(place: Place) -> list[dict]:
    for entry in place.fill():
        data = bytearray(entry.read_bytes())
        data[len(data) // 2] ^= 1
        entry.write_bytes(data)
    return one(place)


def read_only(place: Place) -> list[dict]:
    place.own(place.home, 0o500)
    return one(place)


def without_home(place: Place) -> list[dict]:
    return one(place, HOME="")


def home_is_root(place: Place) -> list[dict]:
    return one(place, HOME="/")


def two_users(place: Place) -> list[dict]:
    shared = place.folder / "shared"
    shared.mkdir()
    place.own(shared, 0o755)
    first = one(place, ROLLKANE_CACHE=str(shared))
    other = started(place, user=ANOTHER + 1, ROLLKANE_CACHE=str(shared))
    return [*first, ended(other)]


def four_at_once(place: Place) -> list[dict]:
    return [ended(x) for x in [started(place) for _ in range(4)]]


def killed(place: Place) -> list[dict]:
    slow = place.folder / "slow"
    slow.write_text(
        '#!/bin/sh\ncase "$*" in *-E*) exec cc "$@" ;; esac\nexec sleep 9\n'
    )
    slow.chmod(0o755)
    process = started(place, CC=str(slow))
    while not list(place.cache.glob("*")) and process.poll() is None:
        time.sleep(0.02)
    process.kill()
    process.communicate()
    return one(place)


@contextmanager
def disk(place: Place, options: str) -> Iterator[Path]:
    """A disk of its own."""
    folder = place.folder / "disk"
    folder.mkdir()
    asked = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if subprocess.run(asked, capture_output=True, check=False).returncode:
        raise PermissionError("no disk of its own can be mounted here")
    try:
        place.own(folder)
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def full(place: Place) -> list[dict]:
    with disk(place, "size=64k") as folder:
        _fill(folder)
        return one(place, ROLLKANE_CACHE=str(folder / "cache"))


def _fill(folder: Path) -> None:
    try:
        (folder / "much").write_bytes(bytes(1_000_000))
    except OSError:
        return
    raise RuntimeError("the disk is larger than asked for")


def limited(place: Place) -> list[dict]:
    """All disks: no file may grow beyond a block."""
    script = place.folder / "limited"
    limit = 'case "$*" in *-E*) ;; *) ulimit -f 1 ;; esac'
    script.write_text(f'#!/bin/sh\n{limit}\nexec cc "$@"\n')
    script.chmod(0o755)
    return one(place, CC=str(script))


def noexec(both: bool) -> Callable:
    def fault(place: Place) -> list[dict]:
        with disk(place, "size=9m,noexec") as folder:
            changes = {"TMPDIR": str(folder)} if both else {}
            return one(place, ROLLKANE_CACHE=str(folder / "cache"), **changes)

    return fault


class Fault(NamedTuple):
    """What is done, and whether root has to do it."""

    name: str
    make: Callable[[Place], list[dict]]
    by_root: bool = False


FAULTS = (
    Fault("none: first process", nothing),
    Fault("none: second process", second),
    Fault("planted: /tmp/rollkane-<uid>", planted_in_tmp, True),
    Fault("planted: files in the cache", planted_in_cache, True),
    Fault("planted: links in the cache", planted_by_links, True),
    Fault("folder: of another user", folder_of_another, True),
    Fault("folder: a link", folder_is_link),
    Fault("folder: its group may write", with_mode(0o770)),
    Fault("folder: all may write", with_mode(0o777)),
    Fault("folder: above it all may write", way_open),
    Fault("cut short at 0", cut_short(0.0)),
    Fault("cut short at 1/8", cut_short(0.125)),
    Fault("cut short at 1/2", cut_short(0.5)),
    Fault("cut short at 3/4", cut_short(0.75)),
    Fault("one bit changed", one_bit),
    Fault("read-only HOME", read_only, True),
    Fault("no HOME, no passwd entry", without_home, True),
    Fault("HOME=/, no passwd entry", home_is_root, True),
    Fault("two users, one folder", two_users, True),
    Fault("four processes at once", four_at_once),
    Fault("killed while compiling", killed),
    Fault("full disk", full, True),
    Fault("no file may grow", limited),
    Fault("noexec: the cache", noexec(False), True),
    Fault("noexec: temporary folder, too", noexec(True), True),
)


def measure(fault: Fault, kept: Path, healthy: list[float] | None) -> dict:
    """One fault in a place of its own."""
    row: dict = {"fault": fault.name}
    if fault.by_root and not IS_ROOT:
        return row | {"skipped": "root alone can make it"}
    user = ANOTHER if IS_ROOT else 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        environment = {
            "PATH": os.environ["PATH"],
            "HOME": f"{folder}/home",
            "TMPDIR": f"{folder}/tmp",
            "JAX_TRACEBACK_FILTERING": "off",  # it hides the last line
            "PYTHONPATH": os.environ.get("PYTHONPATH", ""),
        }
        place = Place(Path(folder).resolve(), kept, environment, user)
        place.folder.chmod(0o755)
        place.home.mkdir()
        place.own(place.home, 0o755)
        place.temporary.mkdir()
        place.temporary.chmod(0o1777)
        began = time.perf_counter()
        try:
            found = fault.make(place)
        except PermissionError as error:
            return row | {"skipped": str(error)}
        row["seconds"] = time.perf_counter() - began
        row |= judged(found, healthy, place)
        if fault.make is nothing and "failed" not in row:
            for entry in place.cache.glob("*.so"):
                shutil.copy(entry, kept)
            row["numbers"] = found[0]["numbers"]
    return row


def judged(found: list[dict], healthy: list[float] | None, place: Place) -> dict:
    """What became of the processes of a fault."""
    said = [text.split(": ", 1)[1] for x in found for text in x.get("said", [])]
    said += [x[key] for x in found for key in ("why", "failed") if x.get(key)]
    named = {str(place.cache): "CACHE", str(place.temporary): "TMP"}
    for path, name in (*named.items(), (str(place.folder), "")):
        said = [text.replace(path, name) for text in said]
    said = list(dict.fromkeys(said))  # each sentence is said for each loop
    left = place.temporary.glob("rollkane-private-*")
    row = {
        "processes": len(found),
        "methods": sorted({x.get("method", "failed") for x in found}),
        "same_numbers": all(
            healthy is None or x.get("numbers") == healthy for x in found
        ),
        "planted_code_ran": place.planted.exists(),
        "loaded_from": sorted({name for x in found for name in x.get("loaded", [])}),
        "kept": kept_in(place),
        "private_folders_left": len(list(left)),
        "said": said,
    }
    failed = [x["failed"] for x in found if "failed" in x]
    return row | ({"failed": failed[0]} if failed else {})


def kept_in(place: Place) -> int:
    """How many whole libraries of the user's are in the cache folders."""
    count = 0
    for folder in (place.cache, place.folder / "shared"):
        if not folder.is_dir() or folder.is_symlink():
            continue
        for entry in folder.glob("*.so"):
            told = entry.lstat()
            own = told.st_uid == (place.user or os.geteuid())
            count += own and stat.S_ISREG(told.st_mode)
    return count


def outcome(row: dict) -> str:
    """In a word or two."""
    if "skipped" in row:
        return "skipped"
    if row["planted_code_ran"]:
        return "RUNS PLANTED CODE"
    if "failed" in row:
        return "FAILS"
    if row["methods"] != ["native"]:
        return "runs by " + ", ".join(row["methods"]) + ", says why"
    return "runs natively" if row["same_numbers"] else "OTHER NUMBERS"


def show(row: dict) -> None:
    """A line of the table, with the last sentence: it says the most."""
    seconds = f"{row['seconds']:.1f}" if "seconds" in row else "-"
    said = row.get("said", [])[-1:] or [row.get("skipped", "")]
    loaded = ", ".join(row.get("loaded_from", ())) or "-"
    print(
        f"{row['fault']:<32}{outcome(row):<27}{loaded:<15}{row.get('kept', '-'):>4}"
        f"{seconds:>6}  {said[0]}",
        flush=True,
    )


def main() -> None:
    """Make every fault, print the table, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    options = parser.parse_args()
    machine = (
        f"{platform.system()}, {platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}"
    )
    print(f"{machine}; a ball: an ensemble and a gradient, in fresh processes")
    print(
        f"{'fault':<32}{'outcome':<27}{'loops from':<15}{'kept':>4}{'s':>6}"
        "  what is said"
    )
    rows, healthy = [], None
    with tempfile.TemporaryDirectory() as kept:
        for fault in FAULTS:
            row = measure(fault, Path(kept), healthy)
            healthy = row.pop("numbers", healthy)
            rows.append(row | {"outcome": outcome(row)})
            show(row)
            if healthy is None:
                raise SystemExit("without a fault it has to run")
    options.out.mkdir(parents=True, exist_ok=True)
    figures = {"machine": machine, "rows": rows}
    (options.out / "cache_faults.json").write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
