"""Compiled programs in the cache: only one's own, only whole, and never a way in."""

import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from rollkane.codegen import NoCompilerError, cache
from rollkane.codegen import compiler as compilers

KEY = "0" * 32
ANOTHER = 12345  # a user without a name
# Loads a library by the module alone (without JAX: 0.2 s), as the user asked for. The
# interpreter need not be readable by that user: all that is needed is imported before.
CHILD = """
import ctypes, importlib.util, json, os, subprocess, sys
spec = importlib.util.spec_from_file_location("cache", sys.argv[1])
cache = importlib.util.module_from_spec(spec)
spec.loader.exec_module(cache)
made = []

def make(path):
    made.append(str(path))
    asked = [os.environ.get("CC", "cc"), "-shared", "-fPIC", "-x", "c", "-", "-o", path]
    text = b"int answer(void) { return 42; }"
    environment = os.environ | {"TMPDIR": str(path.parent)}
    done = subprocess.run(asked, input=text, capture_output=True, env=environment)
    if done.returncode:
        raise OSError("the compiler failed")

def load():
    library = cache.loaded("0" * 32, make)
    folder = os.path.dirname(library._name)
    print(json.dumps([library.answer(), len(made), folder]), flush=True)

user = int(sys.argv[2])
if user:
    os.setgroups([])
    os.setresgid(user, user, user)
    os.setresuid(user, user, user)
"""
pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="owners and modes as in POSIX"),
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"),
]
needs_root = pytest.mark.skipif(
    os.name == "nt" or os.geteuid() != 0, reason="root alone has a second user"
)


@pytest.fixture
def place():
    """A folder that other users can enter, with one for temporary files (``tmp``)."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder).resolve()
        place.chmod(0o755)
        (place / "tmp").mkdir()
        (place / "tmp").chmod(0o1777)
        yield place


def started(place, user=0, then="load()", before=(), **environment):
    """A process; user 0 stands for whoever runs the tests."""
    environment = {"PATH": os.environ["PATH"], "TMPDIR": f"{place}/tmp"} | environment
    return subprocess.Popen(
        [*before, sys.executable, "-c", CHILD + then, cache.__file__, str(user)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(child):
    said, complained = child.communicate(timeout=60)
    assert child.returncode == 0, complained
    return json.loads(said.splitlines()[-1])


def ask(place, **asked):
    """Another process loads it: the answer, how often it was made, and where."""
    asked = {"ROLLKANE_CACHE": str(place / "cache")} | asked
    return ended(started(place, **asked))


def is_private(folder, place):
    """Whether it was in a private folder, which went with its process."""
    parent, name = os.path.split(folder)
    is_there = os.path.exists(folder)
    return parent == f"{place}/tmp" and name.startswith(cache._PRIVATE) and not is_there


def entry_of(place):
    """The one file that a first process leaves."""
    assert ask(place) == [42, 1, str(place / "cache")]
    (entry,) = (place / "cache").iterdir()
    return entry


def another_answer(path):
    """A library with another answer, under the name of its content."""
    text = "int answer(void) { return 13; }"
    asked = ["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", str(path / "planted")]
    subprocess.run(asked, input=text.encode(), check=True)
    data = (path / "planted").read_bytes()
    return (path / "planted").rename(path / cache._name(KEY, data))


def test_it_is_kept_for_the_next_process(place):
    entry = entry_of(place)
    before = entry.stat()
    assert ask(place) == [42, 0, str(place / "cache")]
    assert entry.stat().st_mtime_ns == before.st_mtime_ns
    assert stat.S_IMODE(before.st_mode) == stat.S_IMODE(entry.parent.stat().st_mode)
    assert stat.S_IMODE(before.st_mode) == 0o700
    assert not list((place / "tmp").iterdir())


@pytest.mark.parametrize("left", [0.0, 0.125, 0.5, 0.75])
def test_cut_short(place, left):
    entry = entry_of(place)
    whole = entry.read_bytes()
    entry.write_bytes(whole[: int(left * len(whole))])
    assert ask(place) == [42, 1, str(place / "cache")]
    assert [x.read_bytes() for x in entry.parent.iterdir()] == [whole]
    assert ask(place) == [42, 0, str(place / "cache")]


@pytest.mark.parametrize("what", ["other bytes", "mode", "link", "pipe"])
def test_a_file_that_is_not_loaded_is_made_again(place, what):
    entry = entry_of(place)
    whole = entry.read_bytes()
    if what == "other bytes":
        entry.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    elif what == "mode":
        entry.chmod(0o770)
    else:
        entry.unlink()
        outside = place / entry.name
        outside.write_bytes(whole)
        entry.symlink_to(outside) if what == "link" else os.mkfifo(entry)
    assert ask(place) == [42, 1, str(place / "cache")]
    assert entry.read_bytes() == whole
    assert stat.S_IMODE(entry.lstat().st_mode) == 0o700


def test_a_folder_in_the_place_of_the_file(place):
    """It cannot be replaced in one step, so it is left alone."""
    entry = entry_of(place)
    entry.unlink()
    (entry / "of the user").mkdir(parents=True)
    answer, _, where = ask(place)
    assert answer == 42
    assert is_private(where, place)
    assert (entry / "of the user").is_dir()


@needs_root
@pytest.mark.parametrize("how", ["owner", "group", "link"])
def test_planted_in_the_cache_folder(place, how):
    """Its name is that of its content, so that only owner and mode tell."""
    entry = entry_of(place)
    entry.unlink()
    planted = another_answer(place if how == "link" else place / "cache")
    if how == "link":
        (place / "cache" / planted.name).symlink_to(planted)
    if how == "group":
        planted.chmod(0o660)
    else:
        os.chown(planted, ANOTHER, ANOTHER)
    assert ask(place) == [42, 1, str(place / "cache")]
    assert [x.name for x in (place / "cache").iterdir()] == [entry.name]


@needs_root
def test_planted_where_it_once_was_looked_for(place):
    """By a name in the shared folder for temporary files that anybody can tell."""
    for name in ("rollkane-0", "rollkane-user", cache._PRIVATE, cache._MAKING):
        (place / "tmp" / name).mkdir()
        planted = another_answer(place / "tmp" / name)
        shutil.copy(planted, planted.with_name(f"{KEY}.so"))
        shutil.chown(planted, ANOTHER, ANOTHER)
        shutil.chown(planted.parent, ANOTHER, ANOTHER)
    answer, made, where = ask(place, ROLLKANE_CACHE="/dev/null")
    assert (answer, made) == (42, 1)
    assert is_private(where, place)


def unsafe(place, how):
    """A cache folder in which others could put something."""
    folder = place / "cache"
    if how == "link":
        (place / "real").mkdir(mode=0o700)
        folder.symlink_to(place / "real")
        return folder
    if how == "file":
        folder.write_text("of the user")
        return folder
    if how == "below":
        folder.mkdir()
        folder.chmod(0o777)
        return folder / "deeper"
    folder.mkdir(mode=0o700)
    if how == "owner":
        os.chown(folder, ANOTHER, ANOTHER)
    elif how != "private":
        folder.chmod({"group": 0o770, "others": 0o707, "sticky": 0o1777}[how])
    return folder


@pytest.mark.parametrize(
    "how",
    [
        *("link", "file", "below", "group", "others", "sticky"),
        pytest.param("owner", marks=needs_root),
    ],
)
def test_a_folder_that_is_not_used(place, how):
    folder = unsafe(place, how)
    answer, made, where = ask(place, ROLLKANE_CACHE=str(folder))
    assert (answer, made) == (42, 1)
    assert is_private(where, place)
    if how == "below":
        assert not folder.exists()
    elif how != "file":
        assert not list(folder.iterdir())


def test_below_a_sticky_folder(place):
    """As in /tmp: others can write there, and replace nothing."""
    inside = place / "tmp" / "new" / "cache"
    assert ask(place, ROLLKANE_CACHE=str(inside)) == [42, 1, str(inside)]
    assert stat.S_IMODE(inside.parent.stat().st_mode) == 0o700


def test_a_group_of_ones_own(monkeypatch):
    """With umask 002 every folder above is written by a group of one user."""
    import grp
    import pwd

    user = SimpleNamespace(pw_uid=1000, pw_gid=1000, pw_name="ada")
    members, name = [], "ada"
    group = lambda number: SimpleNamespace(gr_name=name, gr_mem=members)
    monkeypatch.setattr(pwd, "getpwuid", lambda number: user)
    monkeypatch.setattr(grp, "getgrgid", group)
    above = SimpleNamespace(st_mode=0o40775, st_gid=1000)
    assert not cache._may_replace(above)
    assert cache._may_replace(SimpleNamespace(st_mode=0o40775, st_gid=1001))
    assert cache._may_replace(SimpleNamespace(st_mode=0o40777, st_gid=1000))
    members = ["ada", "eve"]
    assert cache._may_replace(above)
    members, name = [], "users"
    assert cache._may_replace(above)
    name, user.pw_uid = "ada", 0
    assert cache._may_replace(above)


@needs_root
@pytest.mark.parametrize(
    "home", ["none", "empty", "read only", "of another", "there is none"]
)
def test_a_user_without_a_home(place, home):
    """And without a name: that, too, is what containers give."""
    environment = {"ROLLKANE_CACHE": ""}
    if home != "none":
        environment["HOME"] = "" if home == "empty" else str(place / "home")
    if home in ("read only", "of another"):
        (place / "home").mkdir(mode=0o755 if home == "of another" else 0o500)
        os.chown(place / "home", *(2 * [0 if home == "of another" else ANOTHER]))
    answer, made, where = ask(place, user=ANOTHER, **environment)
    assert (answer, made) == (42, 1)
    assert is_private(where, place)


def test_the_folder_for_caches(place, monkeypatch):
    monkeypatch.delenv("ROLLKANE_CACHE")
    monkeypatch.setenv("HOME", str(place))
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache.cache_folder() == place / ".cache" / "rollkane"
    monkeypatch.setenv("XDG_CACHE_HOME", str(place / "caches"))
    assert cache.cache_folder() == place / "caches" / "rollkane"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "")  # which is not "/"
    assert cache._named_folder() is None


@needs_root
def test_two_users_of_one_folder(place):
    """Whose it is uses it."""
    (place / "cache").mkdir(mode=0o755)
    assert ask(place) == [42, 1, str(place / "cache")]
    answer, made, where = ask(place, user=ANOTHER)
    assert (answer, made) == (42, 1)
    assert is_private(where, place)


@pytest.mark.parametrize("before", ["nothing", "cut short"])
def test_four_processes_at_once(place, before):
    if before == "cut short":
        os.truncate(entry_of(place), 100)
    folder = str(place / "cache")
    four = [started(place, ROLLKANE_CACHE=folder) for _ in range(4)]
    found = [ended(child) for child in four]
    assert [(answer, where) for answer, _, where in found] == [(42, folder)] * 4
    assert len(list((place / "cache").iterdir())) == 1
    assert ask(place)[1] == 0


def test_killed_while_compiling(place):
    """The next process is not troubled, and what was left goes a day later."""
    slow = place / "slow"
    slow.write_text("#!/bin/sh\nexec sleep 5\n")
    slow.chmod(0o755)
    folder = place / "cache"
    child = started(place, ROLLKANE_CACHE=str(folder), CC=str(slow))
    while not list(folder.glob("*/")):
        assert child.poll() is None
        time.sleep(0.01)
    child.send_signal(signal.SIGKILL)
    child.communicate()
    (left,) = folder.iterdir()
    assert ask(place) == [42, 1, str(folder)]
    assert left.is_dir()
    (entry,) = (x for x in folder.iterdir() if x != left)
    entry.unlink()
    days_ago = time.time() - 2 * 86_400.0
    os.utime(left, (days_ago, days_ago))
    kept = folder / "days ago"  # of the user's own
    kept.mkdir()
    os.utime(kept, (days_ago, days_ago))
    assert ask(place) == [42, 1, str(folder)]
    assert sorted(folder.iterdir()) == sorted([entry, kept])


def test_private_folders_of_killed_processes(place):
    left = place / "tmp" / f"{cache._PRIVATE}x"
    left.mkdir(mode=0o700)
    (left / "a.so").write_text("")
    days_ago = time.time() - 2 * 86_400.0
    os.utime(left, (days_ago, days_ago))
    assert ask(place, ROLLKANE_CACHE="/dev/null")[0] == 42
    assert not left.exists()


def test_a_forked_process_has_a_private_folder_of_its_own(place):
    then = """
load()
child = os.fork()
load()
if child:
    os.waitpid(child, 0)
    load()
"""
    child = started(place, then=then, ROLLKANE_CACHE="/dev/null")
    said, complained = child.communicate(timeout=60)
    assert child.returncode == 0, complained
    found = [json.loads(line) for line in said.splitlines()]
    assert [answer for answer, _, _ in found] == [42] * 4
    # the parent finds its own again, after the child has removed the child's
    assert sorted(made for _, made, _ in found) == [1, 1, 1, 2]
    assert len({where for _, _, where in found}) == 2
    assert not list((place / "tmp").iterdir())


def test_a_private_folder_that_was_tidied_up(place):
    then = """
load()
import shutil
shutil.rmtree(cache.private_folder())
load()
"""
    child = started(place, then=then, ROLLKANE_CACHE="/dev/null")
    assert ended(child)[:2] == [42, 2]


@pytest.fixture
def small_disk(place):
    """A full disk, and one from which nothing may be loaded, as root can have them."""
    made = []

    def mount(name, options):
        (place / name).mkdir()
        asked = ["mount", "-t", "tmpfs", "-o", f"mode=700,{options}", "tmpfs"]
        done = subprocess.run([*asked, str(place / name)], capture_output=True)
        if done.returncode:
            pytest.skip("no disk of a test's own can be mounted here")
        made.append(str(place / name))
        return place / name

    yield mount
    for disk in made:
        subprocess.run(["umount", "-l", disk], check=True)


@needs_root
@pytest.mark.parametrize("what", ["full", "noexec"])
def test_a_disk_that_does_not_serve(place, small_disk, what):
    disk = small_disk("disk", "size=32k" if what == "full" else "size=4m,noexec")
    if what == "full":
        with pytest.raises(OSError, match="No space"):
            (disk / "much").write_bytes(bytes(100_000))
    answer, _, where = ask(place, ROLLKANE_CACHE=str(disk / "cache"))
    assert answer == 42
    assert is_private(where, place)
    both = started(place, ROLLKANE_CACHE=str(disk / "cache"), TMPDIR=str(disk))
    if what == "full":  # tempfile goes on to /tmp
        assert ended(both)[0] == 42
        return
    said = both.communicate(timeout=60)[1].splitlines()[-1]
    assert both.returncode == 1
    assert said.startswith("cache.UnusableError")
    assert "failed to map" in said


def test_files_may_not_grow(place, monkeypatch):
    """Quotas and limits: the compiler fails, in one sentence."""
    monkeypatch.setenv("ROLLKANE_CACHE", str(place / "cache"))
    limited = place / "limited"
    limited.write_text('#!/bin/sh\ncase "$*" in *-E*) ;; *) ulimit -f 1 ;; esac\n')
    with limited.open("a") as file:
        file.write('exec cc "$@"\n')
    limited.chmod(0o755)
    monkeypatch.setenv("CC", str(limited))
    with pytest.raises(NoCompilerError, match="the C compiler failed") as caught:
        compilers.Program.of("int answer(void) { return 42; }").loaded()
    assert "\n" not in str(caught.value)
    assert not list((place / "cache").iterdir())


def test_what_a_compiler_says(place, monkeypatch):
    """One sentence; all of it is a note of the cause."""
    monkeypatch.setenv("ROLLKANE_CACHE", str(place / "cache"))
    with pytest.raises(NoCompilerError, match=r"error: .*anything") as caught:
        compilers.Program.of("int answer(void) { return anything; }").loaded()
    assert "\n" not in str(caught.value)
    slow = place / "slow"
    slow.write_text('#!/bin/sh\ncase "$*" in *-E*) ;; *) sleep 5 ;; esac\n')
    slow.chmod(0o755)
    monkeypatch.setenv("CC", str(slow))
    monkeypatch.setattr(compilers, "_PATIENCE", 0.2)
    with pytest.raises(NoCompilerError, match="did not end within"):
        compilers.Program.of("").loaded()
    slow.write_text("no program")
    slow.chmod(0o755)
    with pytest.raises(NoCompilerError, match="Exec format error"):
        compilers._run((str(slow),))


def test_no_folder_serves(place, monkeypatch):
    monkeypatch.setenv("ROLLKANE_CACHE", str(unsafe(place, "others")))
    monkeypatch.setattr(tempfile, "tempdir", str(place / "none"))
    monkeypatch.setattr(cache, "_private", {})
    with pytest.raises(NoCompilerError, match="only you can write") as caught:
        compilers.Program.of("int answer(void) { return 42; }").loaded()
    assert "can be written by others" in str(caught.value)
    assert "No such file or directory" in str(caught.value)


def test_the_key_tells_programs_apart(place, monkeypatch):
    monkeypatch.setenv("ROLLKANE_CACHE", str(place / "cache"))
    one, two, again = (
        compilers.Program.of(f"int f(void) {{ return {x}; }}") for x in (1, 2, 1)
    )
    assert (one.loaded().f(), two.loaded().f()) == (1, 2)
    assert one.key != two.key
    assert one.key == again.key
    assert {x.name[:32] for x in (place / "cache").iterdir()} == {one.key, two.key}


@pytest.mark.parametrize("known", ["nobody", "the user"])
def test_in_a_user_namespace(place, known):
    """As in Apptainer and bubblewrap: there, "/" belongs to a user without a number."""
    before = ["unshare", "--user", *(["--map-root-user"] if known != "nobody" else [])]
    python = [*before, sys.executable, "-c", ""]
    if not shutil.which("unshare") or subprocess.run(python).returncode:
        pytest.skip("no user namespaces here, or Python cannot be read in them")
    if os.geteuid() == 0:  # what root owns is known in root's namespaces
        (place / "cache").mkdir(mode=0o700)
        os.chown(place, ANOTHER, ANOTHER)
    answer, made, where = ask(place, before=before)
    assert (answer, made) == (42, 1)
    if known == "nobody":  # all owners look the same
        assert is_private(where, place)
    else:
        assert where == str(place / "cache")


def test_a_system_without_owners(place):
    """As Windows: the content is looked at, and that nothing is a link."""
    then = """
for name in ("geteuid", "getuid", "O_NOFOLLOW"):
    delattr(os, name)
sys.modules["grp"] = sys.modules["pwd"] = None
spec.loader.exec_module(cache)
load()
"""
    found = [ask(place, then=then) for _ in range(2)]
    assert found == [[42, made, str(place / "cache")] for made in (1, 0)]


END_TO_END = """
import jax
jax.config.update("jax_enable_x64", True)
import equinox as eqx
import rollkane as rk
from rollkane.files.scene_files import load_scene
file = load_scene("ball-on-plane")
def end(w):
    start = eqx.tree_at(lambda s: s.angular_velocity, file.start, w)
    run = rk.simulate(file.scene, start, [0.0, 0.1], method="native")
    return run.state.angular_velocity[-1, 0]
print(jax.grad(end)(file.start.angular_velocity)[0])
"""


@needs_root
def test_a_gradient_without_a_home(place):
    """Of a user without a name, to whom the interpreter may have to be shown."""
    environment = {"PATH": os.environ["PATH"], "TMPDIR": f"{place}/tmp"}
    may_read = ["--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"]
    who = ["setpriv", f"--reuid={ANOTHER}", f"--regid={ANOTHER}", "--clear-groups"]
    asked = [*who, *may_read, sys.executable]
    if subprocess.run([*asked, "-c", ""], capture_output=True).returncode:
        pytest.skip("setpriv cannot start Python for a second user")
    done = subprocess.run(
        [*asked, "-c", END_TO_END],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == pytest.approx(1.0)
    assert not list((place / "tmp").glob(f"{cache._PRIVATE}*"))
