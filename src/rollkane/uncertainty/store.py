"""A study's members on disk: a Zarr store that survives what ends a run.

One chunk of every array is one block of members, and one block is written by one
process at a time. The block's chunk of ``checksum`` is written last; a block counts
only where it is there and fits the bytes of the others. So a killed process, a full
disk or a chunk that is cut or lost costs the blocks that they touch, which are computed
again.
"""

import contextlib
import hashlib
import itertools
import json
import os
import shutil
import signal
import threading
import uuid
from collections.abc import Container, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..validation.checks import FieldError
from .unit_runs import Column, Columns

if TYPE_CHECKING:
    import xarray

_OPENING = threading.Lock()
_DIGEST = 32  # bytes
_FORMAT = 1
_UNITS = {"final_time": "s", "event time": "s"}


class StoreError(ValueError):
    """A store that cannot be used as asked."""

    def __init__(self, message: str):
        """Say what is wrong, and what to do.

        Args:
            message: Both, in a sentence or two.
        """
        super().__init__(message)


class Store:
    """Blocks of members in a folder.

    Attributes:
        path: The folder, a Zarr v3 group.
        about: Its attributes: provenance of the study.
        size: How many members it has places for.
        block: Members of a block; the last one may have fewer.
        columns: What is kept of each member, by name.
    """

    def __init__(self, path: str | os.PathLike[str]):
        """Open a store that is there.

        Raises:
            StoreError: there is none, or it is not one of a study.
            ImportError: Zarr is not installed.
        """
        self.path = Path(path)
        zarr = _zarr()
        remedy = "give the folder that rollkane.monte_carlo(store=) wrote"
        try:
            self._group: Any = zarr.open_group(str(self.path), mode="r+")
            self.about: dict[str, Any] = dict(self._group.attrs)
            kept: dict[str, Any] = self.about["columns"]
        except Exception as error:  # whatever is found where a study should be
            raise StoreError(f"{self.path} holds no study: {remedy}") from error
        if self.about.get("format") != _FORMAT:
            version = self.about.get("format")
            problem = f"{self.path} has format {version}, not {_FORMAT}"
            raise StoreError(f"{problem}: use the rollkane that wrote it")
        self._arrays: dict[str, Any] = {}
        # a chunk of nothing but fill values must be there like any other; the setting
        # is of all threads, and the first to leave it would take it from the others
        with _OPENING, zarr.config.set({"array.write_empty_chunks": True}):
            for name in (*kept, "checksum", "time"):
                self._arrays[name] = self._array(name)
        self.size = int(self.about.get("ended", self.about["size"]))
        self.block = int(self.about["block"])
        self.columns = {
            name: Column(tuple(c["shape"]), np.dtype(c["dtype"]), c["kind"])
            for name, c in kept.items()
        }

    def _array(self, name: str) -> Any:
        try:
            return self._group[name]
        except Exception as error:  # as above
            file = self.path / name / "zarr.json"
            problem = f"{file} is missing or damaged"
            remedy = "put the file back that a copy of the store has, or begin anew"
            raise StoreError(f"{problem}: {remedy}") from error

    @property
    def block_count(self) -> int:
        """How many blocks it has places for."""
        return -(-self.size // self.block)

    def span(self, k: int) -> tuple[int, int]:
        """First member of a block, and one behind its last."""
        return k * self.block, min((k + 1) * self.block, self.size)

    def write(self, k: int, columns: Columns) -> None:
        """Write one block, its checksum last.

        Raises:
            OSError: the system refuses, for example as the disk is full; the block does
                not count.
        """
        first, last = self.span(k)
        with _uninterrupted():
            self._forget(k)
            for name in self.columns:
                self._arrays[name][first:last] = columns[name]
            digest = np.frombuffer(self._digest(k), np.uint8)
            self._arrays["checksum"][k] = digest

    def read(self, k: int) -> Columns:
        """One block."""
        first, last = self.span(k)
        return {
            name: np.asarray(self._arrays[name][first:last]) for name in self.columns
        }

    def problem(self, k: int) -> str | None:
        """Why a block does not count; None: it does; empty: it is not there."""
        mark = self._chunk("checksum", k)
        if not mark.is_file():
            return ""
        try:
            kept = bytes(np.asarray(self._arrays["checksum"][k]))
        except Exception:  # whatever a codec makes of bytes that are cut
            return f"block {k}: its checksum cannot be read"
        missing = [n for n in self.columns if not self._chunk(n, k).is_file()]
        if missing:
            return f"block {k}: the chunk of {missing[0]} is missing"
        if self._digest(k) != kept:
            return f"block {k}: its bytes do not fit their checksum"
        return None

    def end_at(self, size: int) -> None:
        """Cut off places behind the last member of a study that ended early."""
        self._put(self.about | {"ended": size})
        self.settle()

    def grow_to(self, size: int) -> None:
        """Make places for more members; a last, shorter block does not count then."""
        if self.size % self.block:
            self._forget(self.block_count - 1)
        about = {name: x for name, x in self.about.items() if name != "ended"}
        self._put(about | {"size": size})
        self.settle()

    def settle(self) -> None:
        """Give every array its size, which a killed process may have left undone."""
        for name, column in self.columns.items():
            self._resize(name, (self.size, *column.shape))
        self._resize("checksum", (self.block_count, _DIGEST))

    def _resize(self, name: str, shape: tuple[int, ...]) -> None:
        if self._arrays[name].shape != shape:
            self._arrays[name].resize(shape)

    def _put(self, about: dict[str, Any]) -> None:
        """Write what the size follows from, before anything that follows from it."""
        self._group.attrs.put(about)
        self.about = about
        self.size = int(about.get("ended", about["size"]))

    def clear_leftovers(self, blocks: Container[int] | None = None) -> int:
        """Remove what a killed process was writing.

        Args:
            blocks: Only of these blocks, as others write to the rest.

        Returns:
            How many files that were.
        """
        # os.walk minds no file that another process takes away meanwhile
        files = (
            Path(at) / name for at, _, names in os.walk(self.path) for name in names
        )
        left = [p for p in files if self._is_leftover(p, blocks)]
        for path in left:
            path.unlink(missing_ok=True)
        return len(left)

    def _is_leftover(self, path: Path, blocks: Container[int] | None) -> bool:
        if path.suffix != ".partial":
            return False
        if blocks is None:
            return True
        # NAME/c/BLOCK.RANDOM.partial, or NAME/c/BLOCK/0.RANDOM.partial
        parts = path.relative_to(self.path).parts
        number = parts[2].partition(".")[0] if len(parts) > 2 else ""
        return number.isdigit() and int(number) in blocks

    @property
    def times(self) -> np.ndarray:
        """Output times [s], shape (T,)."""
        return np.asarray(self._arrays["time"][:])

    def values(self, name: str) -> np.ndarray:
        """One array of all members."""
        return np.asarray(self._arrays[name][: self.size])

    def to_xarray(self) -> "xarray.Dataset":
        """All arrays, read where they are used, over ``member`` and ``time`` [s]."""
        import xarray

        return xarray.open_zarr(str(self.path), consolidated=False, chunks=None)

    def _chunk(self, name: str, k: int) -> Path:
        behind = 1 if name == "checksum" else len(self.columns[name].shape)
        return self.path / name / "c" / "/".join([str(k), *["0"] * behind])

    def _digest(self, k: int) -> bytes:
        """Of the block's files, one behind the other."""
        found = hashlib.sha256()
        for name in self.columns:
            found.update(self._chunk(name, k).read_bytes())
        return found.digest()

    def _forget(self, k: int) -> None:
        self._chunk("checksum", k).unlink(missing_ok=True)


def create(
    path: str | os.PathLike[str],
    about: Mapping[str, Any],
    columns: Mapping[str, Column],
    size: int,
    block: int,
    times: Sequence[float],
) -> tuple[Store, bool]:
    """Make an empty store; where another process was faster, open that one.

    Args:
        path: Of the folder, which must not be there.
        about: Provenance, as JSON has it.
        columns: What is kept of each member.
        size: How many members.
        block: Members of a block.
        times: Output times [s].

    Returns:
        The store, and whether this call has made it.

    Raises:
        OSError: the folder above does not exist, or the system refuses.
        ImportError: Zarr is not installed.
    """
    target = Path(path)
    if not target.resolve().parent.is_dir():
        raise FileNotFoundError(
            f"folder {target.resolve().parent} does not exist; make it first"
        )
    made = True
    part = target.with_name(f".{target.name}.{uuid.uuid4().hex}.part")
    try:
        _lay_out(part, about, columns, size, block, times)
        try:
            os.rename(part, target)
        except OSError:
            if not target.is_dir():
                raise
            made = False
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return Store(target), made


def _lay_out(
    part: Path,
    about: Mapping[str, Any],
    columns: Mapping[str, Column],
    size: int,
    block: int,
    times: Sequence[float],
) -> None:
    kept = {
        name: {"shape": list(c.shape), "dtype": str(c.dtype), "kind": c.kind}
        for name, c in columns.items()
    }
    known = dict(about) | {"format": _FORMAT, "size": size, "block": block}
    # what is read again is what JSON has
    attributes = json.loads(json.dumps(known | {"columns": kept}))
    group: Any = _zarr().create_group(str(part), attributes=attributes)

    def array(name: str, shape: Any, chunks: Any, dtype: Any, **more: Any) -> Any:
        sizes = {"shape": shape, "chunks": chunks, "dtype": dtype}
        return group.create_array(name, **sizes, **more)

    for name, column in columns.items():
        more = tuple(max(n, 1) for n in column.shape)
        fill = np.nan if column.dtype.kind == "f" else -1
        attrs = {"kind": column.kind}
        unit = _UNITS.get(name) or _UNITS.get(column.kind)
        attrs |= {} if unit is None else {"units": unit}
        array(
            name,
            *((size, *column.shape), (block, *more), column.dtype),
            fill_value=fill,
            dimension_names=dimensions(name, column),
            attributes=attrs,
        )
    blocks = -(-size // block)
    names = {"dimension_names": ["block", "byte"]}
    array("checksum", (blocks, _DIGEST), (1, _DIGEST), "uint8", fill_value=0, **names)
    count = (len(times),)
    names = {"dimension_names": ["time"], "attributes": {"units": "s"}}
    clock = array("time", count, count, float, fill_value=np.nan, **names)
    clock[:] = np.asarray(times)


def dimensions(name: str, column: Column) -> list[str]:
    """Names of the axes of all members' values."""
    first = "time" if column.kind == "series" else f"{name}_0"
    behind = [first, *[f"{name}_{i}" for i in range(1, len(column.shape))]]
    return ["member", *behind[: len(column.shape)]]


def differences(known: Mapping[str, Any], wanted: Mapping[str, Any]) -> Iterator[str]:
    """What two provenances do not share, in words."""
    for name in dict.fromkeys(itertools.chain(known, wanted)):
        one, other = known.get(name), wanted.get(name)
        if one == other:
            continue
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            parts = cast("Mapping[str, Any]", one), cast("Mapping[str, Any]", other)
            yield from (f"{name} {part}" for part in differences(*parts))
        elif _is_short(one) and _is_short(other):
            yield f"{name} ({one}, not {other})"
        else:
            yield name


@contextlib.contextmanager
def _uninterrupted() -> Generator[None, None, None]:
    """Let Ctrl-C wait for a block, whose files other threads are writing."""
    here = threading.current_thread() is threading.main_thread()
    if not here or signal.getsignal(signal.SIGINT) is None:
        yield
        return
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: asked.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if asked:
        signal.raise_signal(signal.SIGINT)


def _is_short(value: Any) -> bool:
    plain = value is None or isinstance(value, (int, float, str))
    return plain and len(str(value)) < 24


def _zarr() -> Any:
    try:
        import zarr
    except ImportError as error:
        problem = "zarr is not installed"
        remedy = "pip install 'rollkane[study]', or leave store out"
        raise FieldError("monte_carlo.store", "...", problem, remedy) from error
    return cast(Any, zarr)
