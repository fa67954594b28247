"""Run a study: blocks of members, into a store and into statistics."""

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple, cast

from ..validation.checks import FieldError, whole
from .executors import Blocks, Members
from .fingerprint import fingerprint, without_programs
from .member_statistics import MemberStatistics, statistics_of
from .precision import Precision
from .result import MonteCarlo, Rates, read_study
from .sampling import KINDS
from .store import Store, StoreError, create, differences
from .study import Study
from .unit_runs import Columns, UnitRuns

Shard = tuple[int, int]
# of members done and failed, and of those that there will be
Progress = Callable[["Done"], None]
# Blocks of a study, at least, so that a killed one loses little and sizes can double;
# and members of a block, at most, where a store's chunk is some megabytes
_LEAST_BLOCKS, _MOST_IN_BLOCK = 64, 65536
# members before precision is looked at first
_FIRST_LOOK = 1024


class Done(NamedTuple):
    """How far a study is.

    Attributes:
        members: That are done, those found in the store as well.
        failed: How many of them failed.
        size: How many there will be, at most.
        rate: Members a second since it began, those found left out.
    """

    members: int
    failed: int
    size: int
    rate: float


def monte_carlo(
    study: Study,
    size: int,
    seed: int = 0,
    *,
    sampling: str = "plain",
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
    executor: Any = None,
    workers: int | None = None,
    block: int | None = None,
    shard: Shard | None = None,
    stop: Precision | Sequence[Precision] | None = None,
    keep: bool = True,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Run the members of a study, and know their statistics.

    Member i of a seed is the same, bit for bit, whichever block, process or machine of
    the same kind computes it. A member that fails has a code, is counted, and is left
    out of every statistic.

    Args:
        study: What is random, what moves, what is looked at.
        size: Members; with ``stop`` the most.
        seed: Of the random numbers.
        sampling: ``"plain"``, ``"latin"`` or ``"sobol"`` (:func:`sampler`).
        store: Folder of a Zarr store to write; without one, members are kept in memory.
        resume: Whether a store of the same study that is there is gone on with; one of
            plain or Sobol samples also to a larger size.
        executor: Where blocks are computed: None (threads of this process),
            ``"processes"``, ``"dask"``, a scheduler's address, a Dask client, an
            executor of ``concurrent.futures``.
        workers: How many blocks at a time; as many as processors by default.
        block: Members of a block: a chunk of the store, what a killed process loses.
            By default a 64th of the study, 1024 to 65536.
        shard: ``(i, n)``, i from 1 to n: only every n-th block, into one store that n
            processes share; none of them waits for another. The result is of what the
            store has then: the last one to end has all.
        stop: Precision that is enough; looked at after 1024 members and each doubling.
            The result's ``note`` says of one that was not reached.
        keep: Without a store: whether members are kept, or statistics alone.
        progress: Called after each block.

    Returns:
        Statistics [unit of each observable], and the members where they are kept.

    Raises:
        FieldError: arguments that do not fit.
        StoreError: a store that is there and is not to be resumed, or is another
            study's; it is left as it is.
        OSError: the store cannot be written; blocks that were are kept.
    """
    size = whole("monte_carlo.size", size, 1, "give how many members")
    seed = whole("monte_carlo.seed", seed, 0, "give a whole number")
    if sampling not in KINDS:
        remedy = f"use one of {KINDS}"
        raise FieldError("monte_carlo.sampling", sampling, "is not known", remedy)
    wanted = _wanted(stop)
    _check_shard(shard, store, bool(wanted))
    runs = UnitRuns(study)
    _check_names(wanted, runs)
    members = Members(study, sampling, seed, size)
    block, about = _block_size(block, size, runs.unit), _provenance(members, runs)
    blocks = Blocks(members, runs, executor, workers)
    opened = None
    if store is not None:
        plan = _Plan(about, runs, size, block, resume, shard)
        opened = plan.opened(Path(store))
        block = opened.block
    work = _Work(members, blocks, about, opened, block, keep, progress)
    return work.done(wanted, shard)


class _Work:
    """One call under way."""

    def __init__(
        self,
        members: Members,
        blocks: Blocks,
        about: dict[str, Any],
        store: Store | None,
        block: int,
        keep: bool,
        progress: Progress | None,
    ):
        self._members, self._blocks, self._store = members, blocks, store
        self._about = about
        self._size, self._block, self._progress = members.size, block, progress
        self._expected = members.size
        self._sampler = members.sampler()
        self._statistics = MemberStatistics(
            blocks.runs.columns, members.study.ends, self._sampler
        )
        self._kept: list[Columns] | None = [] if keep and store is None else None
        self._began, self._computed = time.monotonic(), 0
        self._said = 0, 0

    def done(self, wanted: Sequence[Precision], shard: Shard | None) -> MonteCarlo:
        """All members, or as many as are precise enough."""
        count = -(-self._size // self._block)
        if shard is not None:
            return self._shard(shard, count)
        first, reached, running = 0, None, self._statistics.running
        for last in _stages(count, self._block, bool(wanted)):
            self._fold(range(first, last))
            first = last
            if wanted and all(one.reached(running) for one in wanted):
                reached = min(last * self._block, self._size)
                break
        missed = [] if reached else [one.missed(running) for one in wanted]
        return self._result(reached, missed)

    def _shard(self, shard: Shard, count: int) -> MonteCarlo:
        """The blocks of one shard; then what the store has, of others, too."""
        numbers = _blocks_of(shard, count)
        spans = [self._span(k) for k in numbers]
        self._expected = sum(last - first for first, last in spans)
        self._fold(numbers)
        assert self._store is not None
        found = read_study(self._store.path)
        found.rates = self._rates
        return found

    def _span(self, k: int) -> tuple[int, int]:
        return k * self._block, min((k + 1) * self._block, self._size)

    def _fold(self, numbers: range) -> None:
        """Statistics of some blocks, in order, whichever is ready first."""
        store = self._store
        missing = {
            k: self._span(k)
            for k in numbers
            if store is None or store.problem(k) is not None
        }
        early: dict[int, Columns] = {}
        # closed where something is raised: nothing is computed for nobody
        with closing(self._blocks.computed(missing)) as computed:
            for k in numbers:
                if store is not None and k not in missing:
                    self._take(k, store.read(k), computed=False)
                    continue
                while k not in early:
                    ready, columns = next(computed)
                    if store is not None:
                        store.write(ready, columns)
                    early[ready] = columns
                self._take(k, early.pop(k), computed=True)

    def _take(self, k: int, columns: Columns, computed: bool) -> None:
        self._statistics.add(k * self._block, columns)
        if self._kept is not None:
            self._kept.append(columns)
        self._tell(columns, computed)

    def _tell(self, columns: Columns, computed: bool) -> None:
        count = len(columns["code"])
        failed = int((~self._statistics.good(columns)).sum())
        self._said = self._said[0] + count, self._said[1] + failed
        self._computed += count if computed else 0
        if self._progress is not None:
            passed = max(time.monotonic() - self._began, 1e-9)
            rate = self._computed / passed
            self._progress(Done(*self._said, self._expected, rate))

    def _result(self, reached: int | None, missed: list[str]) -> MonteCarlo:
        columns, about, store = self._blocks.runs.columns, self._about, self._store
        if reached is not None and reached < self._size and store is not None:
            store.end_at(reached)
        notes = [*missed, self._sampler.note if reached is None else None]
        return MonteCarlo(
            *(self._statistics, columns, self._members.study.times, about),
            store=store,
            kept=self._kept,
            rates=self._rates,
            note="; ".join(filter(None, notes)) or None,
        )

    @property
    def _rates(self) -> Rates:
        runs, seconds = self._blocks.runs, time.monotonic() - self._began
        return Rates(self._computed, seconds, runs.method, runs.why)


def _stages(count: int, block: int, doubling: bool) -> Iterator[int]:
    """Where statistics are looked at: blocks so far."""
    last = max(1, _FIRST_LOOK // block)
    while doubling and last < count:
        yield last
        last *= 2
    yield count


def _wanted(stop: Any) -> tuple[Precision, ...]:
    if stop is None:
        return ()
    listed = isinstance(stop, (tuple, list))
    several = list(cast("tuple[Any, ...]", stop)) if listed else [stop]
    for one in several:
        if not isinstance(one, Precision):
            remedy = 'give for example rollkane.Precision("end", absolute=1e-3)'
            raise FieldError("monte_carlo.stop", one, "is no precision", remedy)
    return tuple(several)


def _check_shard(shard: Any, store: Any, stops: bool) -> None:
    if shard is None:
        return
    remedy = "give (i, n) with 1 <= i <= n"
    field = "monte_carlo.shard"
    try:
        i, n = shard
    except (TypeError, ValueError) as error:
        raise FieldError(field, shard, "is no pair", remedy) from error
    n = whole(field, n, 1, remedy)
    if whole(field, i, 1, remedy) > n:
        raise FieldError(field, shard, "is not among the shards", remedy)
    if store is None:
        raise FieldError(field, shard, "has no store to share", "give store=, too")
    if stops:
        problem = "cannot know when all are precise enough"
        raise FieldError(field, shard, problem, "leave stop out")


def _block_size(block: Any, size: int, unit: int) -> int:
    if block is not None:
        return whole("monte_carlo.block", block, 1, "give members of a block")
    fitting = max(size // _LEAST_BLOCKS, 1)
    fitting = 1 << (fitting.bit_length() - 1)
    return min(max(fitting, unit), _MOST_IN_BLOCK)


def _provenance(members: Members, runs: UnitRuns) -> dict[str, Any]:
    """What members depend on, as JSON has it; and what a reader needs."""
    about = {
        "study": fingerprint(members.study),
        "samples": members.sampler().spec(),
        "sampling": members.sampling,
        "seed": members.seed,
        "dimension": members.study.draws.dimension,
        "ends": members.study.ends,
        "fields": runs.fields._asdict(),
        "unit": runs.unit,
    }
    return cast("dict[str, Any]", json.loads(json.dumps(about)))


def _apart(known: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    """What two provenances do not share, each said once."""
    both = known["study"], wanted["study"]
    # a store of another version may lack any of it
    if all(both) and both[0].get("distributions") != both[1]["distributions"]:
        known, wanted = (
            {**about, "study": without_programs(about["study"])}
            for about in (known, wanted)
        )
    return list(differences(known, wanted))


def _check_names(wanted: Sequence[Precision], runs: UnitRuns) -> None:
    known = statistics_of(runs.columns)
    for one in wanted:
        if one.name not in known:
            remedy = f"use one of {', '.join(known)}"
            raise FieldError("Precision.name", one.name, "is not looked at", remedy)


def _blocks_of(shard: Shard, count: int) -> range:
    return range(shard[0] - 1, count, shard[1])


class _Plan(NamedTuple):
    """What a store shall hold.

    Attributes:
        about: Provenance.
        runs: Of the study.
        size: Members.
        block: Members of a block, in a new store.
        resume: Whether one that is there is gone on with.
        shard: Part of the blocks that is computed; None: all.
    """

    about: dict[str, Any]
    runs: UnitRuns
    size: int
    block: int
    resume: bool
    shard: Shard | None

    def opened(self, path: Path) -> Store:
        """A new store, or the one that is gone on with.

        Raises:
            StoreError: one is there that is another study's, or not to be resumed.
        """
        resume = self.resume or self.shard is not None
        if not path.exists():
            times, sizes = self.runs.study.times.tolist(), (self.size, self.block)
            # another process may have been faster, with another study
            store, resume = create(path, self.about, self.runs.columns, *sizes, times)
            resume = resume or self.shard is not None
        else:
            store = Store(path)
        kept = {name: store.about.get(name) for name in self.about}
        apart = _apart(kept, self.about)
        if apart:
            raise StoreError(
                f"{path} is the store of another study: what differs is "
                f"{', '.join(apart)}. It is left as it is: give another store"
            )
        if not resume:
            raise StoreError(
                f"{path} is there, with {store.block_count} blocks of this study: go "
                "on with resume=True (--resume), or give another store"
            )
        self._fit(store)
        return store

    def _fit(self, store: Store) -> None:
        """Give the store as many places as are wanted now.

        Raises:
            StoreError: it has more, or other processes may write to it.
        """
        if self.size < store.size:
            raise StoreError(
                f"{store.path} has places for {store.size} members, more than "
                f"{self.size}. It is left as it is: give size={store.size} or more"
            )
        if self.shard is not None:
            if self.size > store.size:
                raise StoreError(
                    f"{store.path} ends at {store.size} members, and shards share one "
                    f"size: go on to {self.size} without shard (--shard) first"
                )
            count = -(-self.size // store.block)
            store.clear_leftovers(_blocks_of(self.shard, count))
            return
        store.clear_leftovers()
        if self.size > store.size:
            store.grow_to(self.size)
        else:
            store.settle()
