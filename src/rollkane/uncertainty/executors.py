"""Where blocks are computed: threads, processes, a Dask cluster, other executors."""

import hashlib
import os
import pickle
import signal
import threading
import time
from collections.abc import Generator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import ExitStack, closing
from multiprocessing import get_context
from typing import Any, NamedTuple, cast

import jax
import jax.experimental
import numpy as np

from ..simulation.ensemble_run import processors
from ..validation.checks import FieldError, whole
from .sampling import Sampler, sampler
from .study import Study
from .unit_runs import Columns, UnitRuns

# how often one after the other a pool of processes may break before it is given up
_BREAKS = 3
_DIED = (
    "worker processes died {} times in a row without a block: memory may be short "
    "(give fewer workers, or a smaller block), or a script begins its work without "
    'if __name__ == "__main__"'
)
_REMEDY = (
    'give None (threads), "processes", "dask", the address of a Dask scheduler, or an '
    "executor of concurrent.futures"
)


class Members(NamedTuple):
    """What a block is computed from, in any process.

    Attributes:
        study: What moves.
        sampling: Kind of the samples.
        seed: Of them.
        size: Of the study.
    """

    study: Study
    sampling: str
    seed: int
    size: int

    def sampler(self) -> Sampler:
        """Uniform numbers of the members."""
        dimension = self.study.draws.dimension
        return sampler(self.sampling, dimension, self.seed, self.size)


class Blocks:
    """Computes blocks of members, several at a time.

    Attributes:
        runs: Of this process.
        workers: How many work at a time.
    """

    def __init__(self, members: Members, runs: UnitRuns, executor: Any, workers: Any):
        """Choose where; nothing begins yet.

        Args:
            members: Of which blocks are parts.
            runs: Of this process.
            executor: None or ``"threads"``, ``"processes"``, ``"dask"`` (a cluster on
                this machine), the address of a scheduler, a Dask client, or an
                executor of ``concurrent.futures``.
            workers: How many work at a time; as many as processors by default.

        Raises:
            FieldError: an executor that is not known, or not installed.
        """
        self.runs, self.workers = runs, _workers(workers)
        self._executor, self._sampler = executor, members.sampler()
        self._size, self._stopped = members.size, threading.Event()
        if _is_client(executor):
            self.workers = max(len(executor.scheduler_info()["workers"]), 1)
        elif not _is_known(executor):
            problem = "is no executor"
            raise FieldError("monte_carlo.executor", executor, problem, _REMEDY)
        here = executor in (None, "threads") or _has_threads(executor)
        self._sent = sent(members) if not here else None

    def computed(
        self, spans: Mapping[int, tuple[int, int]]
    ) -> Generator[tuple[int, Columns], None, None]:
        """Number and members of each span, as they are ready.

        A process that dies costs its blocks only: they are computed again.

        Args:
            spans: First member of each, and one behind its last, by its number.

        Raises:
            RuntimeError: processes die again and again.
        """
        left, breaks = dict(spans), 0
        while left:
            try:
                with closing(self._in_one_pool(left)) as ready:
                    for k, columns in ready:
                        del left[k]
                        breaks = 0
                        yield k, columns
            except BrokenExecutor as error:
                breaks += 1
                # a pool that is the user's own cannot be made anew
                if isinstance(self._executor, Executor) or breaks == _BREAKS:
                    raise RuntimeError(_DIED.format(breaks)) from error

    def _in_one_pool(
        self, spans: Mapping[int, tuple[int, int]]
    ) -> Generator[tuple[int, Columns], None, None]:
        waiting = sorted(spans, reverse=True)
        under_way: dict[Future[Columns], int] = {}
        self._stopped.clear()
        with ExitStack() as opened:
            pool = self._pool(opened)
            try:
                while waiting or under_way:
                    # one more than there are workers, so that none has to wait
                    while waiting and len(under_way) <= self.workers:
                        k = waiting.pop()
                        under_way[self._submitted(pool, *spans[k])] = k
                    ready, _ = wait(under_way, return_when=FIRST_COMPLETED)
                    for future in sorted(ready, key=lambda f: under_way[f]):
                        yield under_way.pop(future), future.result()
            finally:
                self._stopped.set()
                for future in under_way:
                    future.cancel()

    def _uniforms(self, first: int, count: int) -> np.ndarray:
        """Those of a unit; none where its block is not wanted any more."""
        if self._stopped.is_set():
            raise CancelledError
        return self._sampler.uniforms(first, count)

    def _pool(self, opened: ExitStack) -> Any:
        given = self._executor
        if given is None or given == "threads":
            return opened.enter_context(ThreadPoolExecutor(self.workers))
        if given == "processes":
            kind = get_context("spawn")
            made = ProcessPoolExecutor(self.workers, kind, _alone)
            return opened.enter_context(made)
        if isinstance(given, Executor):
            return given
        client = given if _is_client(given) else _dask_client(given, self, opened)
        return client.get_executor()

    def _submitted(self, pool: Any, first: int, last: int) -> "Future[Columns]":
        if _has_threads(pool):
            return pool.submit(self.runs.block, first, last, self._uniforms, self._size)
        return pool.submit(block_elsewhere, self._sent, first, last)


class Sent(NamedTuple):
    """Members as they travel to another process.

    Attributes:
        data: Pickled, functions by their code.
        digest: Of the data: what has come once is not read again.
        double: Whether JAX computes in double precision.
    """

    data: bytes
    digest: str
    double: bool


def sent(members: Members) -> Sent:
    """Members, packed for other processes.

    Raises:
        FieldError: something in the study cannot be packed.
    """
    import cloudpickle  # pyright: ignore[reportMissingTypeStubs]

    try:
        data = cloudpickle.dumps(members)
    except Exception as error:
        problem = f"cannot be sent to another process ({error})"
        remedy = "leave executor out, or hold nothing open in the study's functions"
        raise FieldError("monte_carlo.study", members.study, problem, remedy) from error
    double = bool(jax.config.jax_enable_x64)  # pyright: ignore
    return Sent(data, hashlib.sha256(data).hexdigest(), double)


def block_elsewhere(packed: Sent, first: int, last: int) -> Columns:
    """A block, computed in the process that this is called in."""
    with _precision(packed.double):
        runs, samples = _unpacked(packed)
        return runs.block(first, last, samples.uniforms, samples.size)


def _precision(double: bool) -> Any:
    """A context in which JAX computes so; its place changed with JAX 0.8."""
    known: Any = getattr(jax, "enable_x64", None)
    if known is None:
        known = getattr(jax.experimental, "enable_x64")  # noqa: B009
    return known(double)


_READY: dict[str, tuple[UnitRuns, Sampler]] = {}
_READYING = threading.Lock()


def _unpacked(packed: Sent) -> tuple[UnitRuns, Sampler]:
    """Runs of packed members: compiled once in a process."""
    with _READYING:
        if packed.digest not in _READY:
            members = cast(Members, pickle.loads(packed.data))
            _READY.clear()
            _READY[packed.digest] = UnitRuns(members.study), members.sampler()
        return _READY[packed.digest]


def _has_threads(given: Any) -> bool:
    return isinstance(given, ThreadPoolExecutor)


def _alone() -> None:
    """End without a word by Ctrl-C, and with the process that shares the work out."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as nohup has it
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _is_client(given: Any) -> bool:
    return hasattr(given, "get_executor") and hasattr(given, "scheduler_info")


def _is_known(given: Any) -> bool:
    if isinstance(given, str):
        return given in ("threads", "processes", "dask") or "://" in given
    return given is None or isinstance(given, Executor)


def _dask_client(given: str, blocks: Blocks, opened: ExitStack) -> Any:
    """A client of a cluster by its address, or of one on this machine."""
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        problem, remedy = "needs Dask", "pip install 'rollkane[cluster]'"
        raise FieldError("monte_carlo.executor", given, problem, remedy) from error
    if given != "dask":
        try:
            client: Any = opened.enter_context(cast(Any, Client)(given))
        except (OSError, ValueError) as error:  # nobody answers, or no such protocol
            problem, remedy = (
                f"cannot be reached: {error}",
                "start it, or mend the address",
            )
            raise FieldError("monte_carlo.executor", given, problem, remedy) from error
        blocks.workers = max(len(client.scheduler_info()["workers"]), 1)
        return client
    local: Any = cast(Any, LocalCluster)(
        n_workers=blocks.workers, threads_per_worker=1, dashboard_address=None
    )
    cluster = opened.enter_context(local)
    return opened.enter_context(cast(Any, Client)(cluster))


def _workers(given: Any) -> int:
    if given is None:
        return processors()
    return whole("monte_carlo.workers", given, 1, "give how many work at a time")
