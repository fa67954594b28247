"""Compiled programs, kept for the next process, and safe to load.

Who can write a library, or a folder on the way to it, runs code in every process that
loads it; and a library that was cut short ends the process that loads it. So folders
are looked at before, and files: nobody else can change them, and a file's name holds
the length and the hash of what it has to contain. One name says everything, so that
nothing can come apart: `os.replace` puts a whole file there in one step, however many
processes do it at once and whenever one of them is killed.
"""

import atexit
import contextlib
import ctypes
import hashlib
import logging
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

_LOG = logging.getLogger(__name__)
# Windows has neither owners of this kind nor these ways to open a file
_HAS_OWNERS = hasattr(os, "geteuid")
_AS_IT_IS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
_WRITABLE = stat.S_IWGRP | stat.S_IWOTH
_MAKING = "rollkane-making-"  # folder of one compilation, in a cache folder
_PRIVATE = "rollkane-private-"  # of one process, in the folder for temporary files
_LONG_AGO = 86_400.0  # after which nobody works in such a folder any more [s]
# By process: a forked one neither writes into its parent's nor removes it.
_private: dict[int, Path] = {}


class UnusableError(OSError):
    """A folder that is not used, or a library found in none; one sentence says why."""


def loaded(key: str, make: Callable[[Path], None]) -> ctypes.CDLL:
    """A library, from the cache folder or else from a private one, made where need be.

    Args:
        key: Of all that it comes from: letters and digits.
        make: Writes it to a path; raises OSError where it cannot.

    Raises:
        UnusableError: neither folder serves; its cause is the last failure.
    """
    failures: list[OSError] = []
    for folder in (cache_folder, private_folder):
        try:
            return _opened(_entry(folder(), key, make))
        except OSError as error:
            failures.append(error)
            _LOG.info("a compiled program was not kept: %s", _in_words(error))
    told = dict.fromkeys(map(_in_words, failures))
    raise UnusableError(", and ".join(told)) from failures[-1]


def read(key: str, make: Callable[[Path], None]) -> bytes:
    """What a file of the cache folder holds, made where need be.

    Args:
        key: Of all that it comes from: letters and digits.
        make: Writes it to a path; raises OSError where it cannot.

    Raises:
        UnusableError: the folder does not serve.
    """
    try:
        return _entry(cache_folder(), key, make).read_bytes()
    except OSError as error:
        raise UnusableError(_in_words(error)) from error


def _opened(path: Path) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:  # from a disk of mode noexec, or of a newer C library
        problem = str(error).removeprefix(f"{path}: ")
        raise UnusableError(f"{path.parent}: {problem}") from error


def cache_folder() -> Path:
    """The user's folder for compiled programs, made if need be.

    Raises:
        OSError: there is none that nobody else can change.
    """
    named = _named_folder()
    if named is None:
        raise UnusableError("the user has no home folder")
    if _HAS_OWNERS and os.geteuid() in _unknown_user():
        raise UnusableError("the user cannot be told from others in this namespace")
    folder = Path(os.path.realpath(named.parent), named.name)
    _refuse(folder)  # before anything is made below a folder that is not trusted
    _make(folder)
    _refuse(folder)
    return folder


def _named_folder() -> Path | None:
    """``ROLLKANE_CACHE``, or the place for caches; None without a home."""
    chosen = os.environ.get("ROLLKANE_CACHE")
    if chosen:
        return Path(os.path.abspath(chosen))
    caches = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(caches):  # others are void by its standard
        return Path(caches, "rollkane")
    # where Path.home() raises, and HOME is empty, this is no absolute path
    home = os.path.expanduser("~") if os.environ.get("HOME") != "" else ""
    return Path(home, ".cache", "rollkane") if os.path.isabs(home) else None


def private_folder() -> Path:
    """A temporary folder of this process, removed when it ends.

    Raises:
        OSError: there is no place for it, or others can change it.
    """
    process = os.getpid()
    folder = _private.get(process)
    if folder is None or not folder.is_dir():  # systems tidy up temporary files
        above = Path(os.path.realpath(tempfile.gettempdir()))
        _refuse_way((above, *above.parents))
        _sweep(above, _PRIVATE)
        folder = Path(tempfile.mkdtemp(prefix=_PRIVATE, dir=above))
        _private[process] = folder
        atexit.register(_remove, folder, process)
    _refuse(folder)
    return folder


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


def _make(folder: Path) -> None:
    """A folder and those above it, for oneself alone whatever the umask grants."""
    if not folder.parent.is_dir():
        _make(folder.parent)
    folder.mkdir(mode=0o700, exist_ok=True)


def _refuse(folder: Path) -> None:
    """Refuse a folder in which others could put something, or put another one there.

    Args:
        folder: By its real path; it need not exist.

    Raises:
        OSError: it is a link or no folder, or others can write it or replace it.
    """
    found = _folder_at(folder)
    if found is not None and _by_others(found):
        whose = found.st_uid == os.geteuid()
        problem = "can be written by others" if whose else "belongs to another user"
        raise UnusableError(f"{folder} {problem}")
    _refuse_way((*folder.parents,))


def _refuse_way(places: tuple[Path, ...]) -> None:
    """Refuse folders in which others could put something else for what is there."""
    trusted = _trusted()
    for place in places if _HAS_OWNERS else ():
        found = _folder_at(place)
        if found is None:
            continue
        if found.st_uid not in trusted:
            raise UnusableError(f"{place} belongs to another user")
        if _may_replace(found):
            raise UnusableError(f"{place} can be written by others")


def _folder_at(place: Path) -> os.stat_result | None:
    """What is known of a folder; None where there is nothing."""
    try:
        found = place.lstat()
    except FileNotFoundError:
        return None
    if not stat.S_ISDIR(found.st_mode):
        kind = "a link" if stat.S_ISLNK(found.st_mode) else "not a folder"
        raise UnusableError(f"{place} is {kind}")
    return found


def _may_replace(found: os.stat_result) -> bool:
    """Whether others can put something else in the place of what a folder holds.

    Where the sticky bit is set (/tmp), only owners can. A folder that its group may
    write is common: with umask 002 (Debian, Ubuntu, Fedora) every user has a group of
    the user's own, and ~/.cache is of mode 775. Only that group is no "others": the
    user's first one, of the user's name, without a further member. (It is what
    pam_umask and OpenSSH look at.) root's group is no such thing: users without a name
    are put into it by container systems. The cache folder itself is not excused: it is
    made with mode 700, so that one that a group can write was made by something else.
    """
    mode = found.st_mode
    if mode & stat.S_ISVTX:
        return False
    if mode & stat.S_IWOTH:
        return True
    return bool(mode & stat.S_IWGRP) and not _is_only_mine(found.st_gid)


def _is_only_mine(group: int) -> bool:
    """Whether a group has the user for its one member, by its name and its list."""
    import grp  # these two are not on Windows
    import pwd

    try:
        user, found = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return (
        user.pw_uid != 0
        and user.pw_gid == group
        and user.pw_name == found.gr_name
        and set(found.gr_mem) <= {user.pw_name}
    )


def _trusted() -> set[int]:
    """Who may own the folders above: the user, and root, who can do everything anyway.

    In a user namespace with few users (Apptainer, bubblewrap) the system's folders
    belong to root outside of it, whom it shows by the number for unknown users.
    """
    return {0, os.geteuid(), *_unknown_user()} if _HAS_OWNERS else set()


def _unknown_user() -> set[int]:
    """The number that stands for all users whom this namespace has no number for."""
    try:
        unknown = int(Path("/proc/sys/kernel/overflowuid").read_text())
        rows = Path("/proc/self/uid_map").read_text().splitlines()
        spans = [[int(x) for x in row.split()] for row in rows]
    except (OSError, ValueError):  # not Linux
        return set()
    known = any(first <= unknown < first + count for first, _, count in spans)
    return set() if known else {unknown}


def _entry(folder: Path, key: str, make: Callable[[Path], None]) -> Path:
    """The file with a key in a folder, made where none is whole.

    One that is not whole is replaced, not removed first: another process may have just
    put the whole one there.
    """
    names = [x for x in os.listdir(folder) if x.startswith(f"{key}-")]
    for name in sorted(names):
        if _is_whole(folder / name, key):
            return folder / name
    target = _kept(folder, key, make)
    for name in set(names) - {target.name}:
        with contextlib.suppress(OSError):
            (folder / name).unlink()
    _sweep(folder, _MAKING)
    return target


def _name(key: str, data: bytes) -> str:
    return f"{key}-{len(data)}-{hashlib.sha256(data).hexdigest()}.so"


def _is_whole(path: Path, key: str) -> bool:
    """Whether a file is one's own, and has the content that its name tells."""
    try:
        with open(path, "rb", opener=_as_it_is) as file:
            found = os.fstat(file.fileno())
            safe = stat.S_ISREG(found.st_mode) and not _by_others(found)
            return safe and path.name == _name(key, file.read())
    except OSError:  # a link, unreadable, or gone
        return False


def _by_others(found: os.stat_result) -> bool:
    """Whether a file is another user's, or can be written by another."""
    if not _HAS_OWNERS:
        return False
    return found.st_uid != os.geteuid() or bool(found.st_mode & _WRITABLE)


def _as_it_is(path: str, flags: int) -> int:
    return os.open(path, flags | _AS_IT_IS)


def _kept(folder: Path, key: str, make: Callable[[Path], None]) -> Path:
    """Make a file, and give it its name when all of it is on the disk."""
    with tempfile.TemporaryDirectory(
        prefix=_MAKING, dir=folder, ignore_cleanup_errors=True
    ) as part:
        made = Path(part, "made.so")
        make(made)
        made.chmod(0o700)  # with umask 002 a compiler's file can be written by a group
        with open(made, "r+b") as file:
            target = folder / _name(key, file.read())
            os.fsync(file.fileno())
        os.replace(made, target)
    # Some file systems cannot do this, nor Windows; what a loss of power then takes is
    # made again.
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    return target


def _sweep(folder: Path, prefix: str) -> None:
    """Remove what killed processes left, a day later.

    Whoever still lives there has its libraries loaded, and makes a new folder.
    """
    for left in folder.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):
            found = left.lstat()
            old = time.time() - found.st_mtime > _LONG_AGO
            if old and stat.S_ISDIR(found.st_mode) and not _by_others(found):
                shutil.rmtree(left, ignore_errors=True)


def _in_words(error: OSError) -> str:
    """What happened, without numbers of the system's."""
    if error.filename is None or error.strerror is None:
        return str(error)
    return f"{error.filename}: {error.strerror}"
