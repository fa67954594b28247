"""Stores of studies: what is written, what is refused, what is found to be broken."""

import errno
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import zarr

import rollkane as rk
from rollkane.uncertainty import executors
from rollkane.uncertainty.store import Store, StoreError, create
from rollkane.uncertainty.unit_runs import Column
from tests import small_studies as small
from tests.small_studies import compiled_once, equal

__all__ = ["compiled_once"]
pytestmark = pytest.mark.usefixtures("compiled_once")
ROOT = Path(__file__).parents[2]
HOW = {"seed": 1, "block": 50, "workers": 2}
SIZE, BLOCKS = 330, 7


def tree(folder):
    """Digests of all files, by their places."""
    files = sorted(p for p in Path(folder).rglob("*") if p.is_file())
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in files
    }


def run(store, size=SIZE, study=None, **how):
    study = small.rolling() if study is None else study
    return rk.monte_carlo(study, size, store=store, **HOW | how)


@pytest.fixture(scope="module")
def untouched(tmp_path_factory):
    """A store of a run without troubles."""
    store = tmp_path_factory.mktemp("stores") / "whole.zarr"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rollkane.uncertainty.monte_carlo.UnitRuns", small._runs)
        patch.setattr("rollkane.uncertainty.monte_carlo.fingerprint", small._print)
        run(store)
    return store


@pytest.fixture
def copied(untouched, tmp_path):
    return shutil.copytree(untouched, tmp_path / "copy.zarr")


def test_a_store_has_what_memory_has(untouched):
    kept, stored = (
        rk.monte_carlo(small.rolling(), SIZE, **HOW),
        rk.read_study(untouched),
    )
    assert equal(kept, stored)
    assert stored.complete
    assert str(kept) == str(stored)
    np.testing.assert_array_equal(stored.times, small.TIMES)
    left, right = kept.to_xarray(), stored.to_xarray()
    assert left.sizes == {"member": SIZE, "time": 3, "end_0": 3, "passes.time_0": 16}
    for name in left.data_vars:
        np.testing.assert_array_equal(left[name], right[name])
    assert right.sizes["block"] == BLOCKS


def test_any_reader_of_zarr_reads_it(untouched):
    group = zarr.open_group(str(untouched), mode="r")
    assert group["end"].shape == (SIZE, 3)
    assert group["end"].chunks == (50, 3)
    assert group["final_time"].attrs["units"] == "s"
    assert group.attrs["seed"] == 1
    assert set(group.attrs["study"]) >= {"distributions", "times", "scene and start"}
    # of what JSON has, and nothing else: no NaN, no Infinity
    for file in untouched.rglob("zarr.json"):
        json.loads(file.read_text(), parse_constant=_refused)


def _refused(name):
    if name != "NaN":  # as Zarr itself writes a fill value
        raise AssertionError(name)


def test_the_same_study_writes_the_same_bytes(untouched, tmp_path):
    again = run(tmp_path / "again.zarr", workers=1)
    assert tree(tmp_path / "again.zarr") == tree(untouched)
    assert again.rates.members == SIZE
    assert os.listdir(tmp_path) == ["again.zarr"]


def test_what_is_there_is_not_computed_again(copied):
    before = tree(copied)
    again = run(copied, resume=True)
    assert again.rates.members == 0
    assert again.size == SIZE
    assert tree(copied) == before
    assert equal(again, rk.read_study(copied))


def block_files(store, k):
    """Files of a block, of one axis and of more."""
    return [store / "energy" / "c" / f"{k}", store / "end" / "c" / f"{k}" / "0"]


def cut(file):
    file.write_bytes(file.read_bytes()[:-7])


def change(file):
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


def empty(file):
    file.write_bytes(b"")


@pytest.mark.parametrize("harm", [cut, change, empty, Path.unlink])
@pytest.mark.parametrize(
    ("k", "where"),
    [
        (3, 0),
        (BLOCKS - 1, 1),
        (0, "checksum"),
        *(
            pytest.param(k, where, marks=pytest.mark.slow)
            for k, where in ((3, 1), (0, 0), (0, 1), (BLOCKS - 1, "checksum"))
        ),
    ],
)
def test_damage_is_found_told_and_mended(untouched, copied, harm, k, where):
    mark = copied / "checksum" / "c" / f"{k}" / "0"
    harm(mark if where == "checksum" else block_files(copied, k)[where])
    found = rk.read_study(copied)
    assert not found.complete
    last = (k + 1) * 50 > SIZE
    assert found.size == SIZE - (30 if last else 50)
    absent = where == "checksum" and harm is Path.unlink
    said = f"1 of {BLOCKS} blocks are not computed" if absent else f"block {k}: "
    assert said in found.note
    mended = run(copied, resume=True)
    assert mended.rates.members == (30 if last else 50)
    assert tree(copied) == tree(untouched)
    assert rk.read_study(copied).complete


def test_damaged_descriptions_are_refused(copied):
    run(copied, resume=True)
    file = copied / "energy" / "zarr.json"
    cut(file)
    before = tree(copied)
    for read in (rk.read_study, lambda path: run(path, resume=True)):
        with pytest.raises(StoreError, match=r"energy.*zarr\.json is missing or dam"):
            read(copied)
    file.unlink()
    with pytest.raises(StoreError, match=r"zarr\.json is missing or damaged"):
        rk.read_study(copied)
    cut(copied / "zarr.json")
    with pytest.raises(StoreError, match="holds no study"):
        rk.read_study(copied)
    assert {p for p in before if "zarr.json" not in p} < set(tree(copied))


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"seed": 2}, "seed (1, not 2)"),
        ({"sampling": "sobol"}, "sampling (plain, not sobol)"),
        ({"study": small.stopping}, "study observables"),
        # whose programs have the distributions' numbers in them
        ({"study": small.heavier}, "what differs is study distributions mass high ("),
    ],
)
@pytest.mark.parametrize("more", [{"resume": True}, {"shard": (1, 2)}, {}])
def test_the_store_of_another_study_is_refused(untouched, how, said, more):
    before = tree(untouched)
    if "study" in how:
        how = {"study": how["study"]()}
    with pytest.raises(StoreError, match="store of another study") as refused:
        run(untouched, **how, **more)
    assert said in str(refused.value)
    if said.startswith("what differs"):
        assert not any(x in str(refused.value) for x in ("scene", "events", "observ"))
    assert tree(untouched) == before


def test_a_store_is_not_gone_on_with_unasked(untouched):
    before = tree(untouched)
    with pytest.raises(StoreError, match="resume=True"):
        run(untouched)
    assert tree(untouched) == before


def test_a_folder_that_is_no_store_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    before = tree(tmp_path)
    for path in (tmp_path, tmp_path / "notes.txt"):
        for how in ({}, {"resume": True}, {"shard": (1, 1)}):
            with pytest.raises(StoreError, match="holds no study"):
                run(path, **how)
        with pytest.raises(StoreError, match="holds no study"):
            rk.read_study(path)
    group = tmp_path / "other.zarr"
    zarr.create_group(str(group)).create_array("x", shape=(3,), dtype="f8")
    with pytest.raises(StoreError, match="holds no study"):
        run(group, resume=True)
    shutil.rmtree(group)
    with pytest.raises(FileNotFoundError, match="does not exist; make it first"):
        run(tmp_path / "none" / "s.zarr")
    assert tree(tmp_path) == before


def test_what_cannot_begin_leaves_no_store(tmp_path):
    store = tmp_path / "s.zarr"
    refused = [
        {"executor": "nowhere"},
        {"executor": 3},
        {"stop": rk.Precision("nothing", absolute=1.0)},
        {"shard": (3, 2)},
        {"shard": (1, 2), "stop": rk.Precision("fast", absolute=1.0)},
        {"block": 0},
        {"workers": 0},
        {"sampling": "random"},
    ]
    for how in refused:
        with pytest.raises(rk.FieldError):
            run(store, **how)
    assert os.listdir(tmp_path) == []


def test_shards_fill_one_store(untouched, tmp_path):
    """Each has what the store has then: the last one the whole study."""
    store = tmp_path / "s.zarr"
    there = 0
    for i in (3, 1, 2):
        seen = []
        part = run(store, shard=(i, 3), progress=seen.append)
        own = sum(min(50, SIZE - 50 * k) for k in range(i - 1, BLOCKS, 3))
        assert part.rates.members == own == seen[-1].members == seen[-1].size
        there += own
        assert part.size == there == int((part.values("code") >= 0).sum())
        assert part.complete == (there == SIZE)
        assert part.complete or "blocks are not computed yet" in part.note
    assert tree(store) == tree(untouched)
    every = rk.read_study(untouched)
    np.testing.assert_array_equal(part.mean["end"], every.mean["end"])
    assert part.probability == every.probability


def test_shards_at_once_fill_one_store(untouched, tmp_path):
    store = tmp_path / "s.zarr"
    each = [
        threading.Thread(target=run, args=(store,), kwargs={"shard": (i, 3)})
        for i in (1, 2, 3)
    ]
    for one in each:
        one.start()
    for one in each:
        one.join()
    assert tree(store) == tree(untouched)


def test_a_shard_leaves_alone_what_another_one_is_writing(copied):
    own = copied / "energy" / "c" / "1.0123.partial"
    other = copied / "end" / "c" / "2" / "0.0123.partial"
    about = copied / "zarr.0123.partial"
    for file in (own, other, about):
        file.write_bytes(b"half")
    run(copied, shard=(2, 3))
    assert not own.exists()
    assert other.exists()
    assert about.exists()
    run(copied, resume=True)
    assert not list(copied.rglob("*.partial"))


def test_two_studies_that_begin_one_store_at_once(monkeypatch, tmp_path):
    """The slower one finds the other's, and leaves it."""
    store = tmp_path / "s.zarr"
    rename = os.rename

    def late(part, target):
        monkeypatch.setattr(os, "rename", rename)
        run(store, seed=2)
        rename(part, target)

    monkeypatch.setattr(os, "rename", late)
    with pytest.raises(StoreError, match="store of another study"):
        run(store)
    assert rk.read_study(store).about["seed"] == 2
    assert os.listdir(tmp_path) == ["s.zarr"]


def test_ctrl_c_costs_the_blocks_in_hand(untouched, tmp_path):
    store = tmp_path / "s.zarr"

    def stop(done):
        if done.members >= 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(store, progress=stop)
    kept = rk.read_study(store)
    assert not kept.complete
    assert 150 <= kept.size < SIZE
    assert "blocks are not computed yet" in kept.note
    again = run(store, resume=True)
    assert again.rates.members == SIZE - kept.size
    assert tree(store) == tree(untouched)


def test_blocks_that_nobody_wants_any_more_end_at_their_next_unit(monkeypatch):
    """Of 40 units of a block some are done when its first one has been taken."""
    study = small.rolling()
    runs, units = small._runs(study), []

    def counted(u):
        units.append(len(u))
        time.sleep(0.02)
        return {"code": np.zeros(len(u), int)}

    monkeypatch.setattr(runs, "members", counted)
    members = executors.Members(study, "plain", 1, 1024 * 41)
    blocks = executors.Blocks(members, runs, None, 2)
    computed = blocks.computed({0: (0, 1024), 1: (1024, 1024 * 41)})
    assert next(computed)[0] == 0
    computed.close()
    assert len(units) < 20  # after some 0.02 s of 0.8 s


def test_ctrl_c_waits_for_the_block_that_is_being_written(tmp_path, monkeypatch):
    store, digest, calls = tmp_path / "s.zarr", Store._digest, []

    def late(self, k):
        calls.append(k)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return digest(self, k)

    # a process that a shell starts in the background is told to ignore it
    outside = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(Store, "_digest", late)
    try:
        with pytest.raises(KeyboardInterrupt):
            run(store)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, outside)
    monkeypatch.setattr(Store, "_digest", digest)
    assert rk.read_study(store).size == 150


def test_a_full_disk_costs_the_block_in_hand(untouched, tmp_path, monkeypatch):
    store = tmp_path / "s.zarr"
    write, room = Path.open, [60]

    class Full:
        """A file that takes no more bytes."""

        def __init__(self, file):
            self.file = file

        def __enter__(self):
            self.file.__enter__()
            return self

        def __exit__(self, *how):
            return self.file.__exit__(*how)

        def write(self, data):
            room[0] -= 1
            if room[0] < 0:
                self.file.write(bytes(data)[: len(bytes(data)) // 2])
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return self.file.write(data)

    def opened(path, mode="r", *how, **more):
        file = write(path, mode, *how, **more)
        return Full(file) if "w" in mode and store in path.parents else file

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(OSError, match="No space left on device"):
        run(store)
    room[0] = 10**6
    kept = rk.read_study(store)
    assert 0 < kept.size < SIZE
    assert not list(store.rglob("*.partial"))
    run(store, resume=True)
    assert tree(store) == tree(untouched)


def test_clocks_that_jump_change_nothing(untouched, tmp_path, monkeypatch):
    jumps = iter(range(10**6, 0, -1000))
    monkeypatch.setattr(time, "time", lambda: float(next(jumps)))
    seen = []
    run(tmp_path / "s.zarr", progress=seen.append)
    assert tree(tmp_path / "s.zarr") == tree(untouched)
    assert all(done.rate > 0.0 for done in seen)


def test_a_study_that_is_precise_enough_ends(tmp_path):
    """At 1024 members or a doubling of them; what is behind is cut off."""
    store = tmp_path / "s.zarr"
    wanted = rk.Precision("fast", absolute=0.025)
    how = {"stop": wanted, "block": 128}
    # half width 1.96 sqrt(p (1 - p) / n), p near 0.46: 0.0305 of 1024, 0.0216 of 2048
    found = run(store, 9000, **how)
    assert found.size == 2048
    stored = rk.read_study(store)
    assert stored.complete
    assert equal(found, stored)
    assert str(found) == str(stored)
    assert stored.to_xarray().sizes["member"] == 2048
    assert stored.to_xarray().sizes["block"] == 16
    before = tree(store)
    again = run(store, 9000, **how, resume=True)
    assert (again.size, again.rates.members) == (2048, 0)
    assert tree(store) == before
    finer = rk.Precision("fast", absolute=0.018)  # 0.0153 of 4096
    further = run(store, 9000, stop=finer, resume=True)
    assert (further.size, further.rates.members) == (4096, 2048)
    anew = tmp_path / "anew.zarr"
    run(anew, 9000, stop=finer, block=128)
    assert tree(store) == tree(anew)
    # without the rule it goes on to the end
    assert run(store, 9000, resume=True).rates.members == 9000 - 4096
    assert rk.read_study(store).size == 9000


def test_an_end_that_was_killed_half_way(tmp_path, monkeypatch):
    store = tmp_path / "s.zarr"
    how = {"stop": rk.Precision("fast", absolute=0.04), "block": 128}
    resize, left = Store._resize, [5]

    def killed(self, name, shape):
        left[0] -= self._arrays[name].shape != shape
        if left[0] < 0:
            raise KeyboardInterrupt
        resize(self, name, shape)

    monkeypatch.setattr(Store, "_resize", killed)
    with pytest.raises(KeyboardInterrupt):
        run(store, 3000, **how)
    monkeypatch.setattr(Store, "_resize", resize)
    assert rk.read_study(store).size == 1024
    run(store, 3000, **how, resume=True)
    run(tmp_path / "anew.zarr", 3000, **how)
    assert tree(store) == tree(tmp_path / "anew.zarr")


@pytest.mark.parametrize("sampling", ["plain", "sobol", "latin"])
def test_a_store_may_grow(tmp_path, sampling):
    """Latin samples depend on how many there are."""
    store, anew = tmp_path / "s.zarr", tmp_path / "anew.zarr"
    run(store, 120, sampling=sampling)
    before = tree(store)
    if sampling == "latin":
        with pytest.raises(StoreError, match=r"samples size \(120, not 330\)"):
            run(store, resume=True, sampling=sampling)
        assert tree(store) == before
        return
    with pytest.raises(StoreError, match="shards share one size"):
        run(store, shard=(1, 2), sampling=sampling)
    with pytest.raises(StoreError, match="places for 120 members, more than 100"):
        run(store, 100, resume=True, sampling=sampling)
    assert tree(store) == before
    grown = run(store, resume=True, sampling=sampling)
    assert grown.rates.members == SIZE - 100  # the block that was cut at 120 as well
    run(anew, sampling=sampling)
    assert tree(store) == tree(anew)


def test_members_that_are_all_nan_are_there(tmp_path):
    """Chunks of nothing but fill values are files, as others are."""
    store = tmp_path / "s.zarr"
    run(store, 100, study=small.tiring())
    assert all(file.is_file() for file in (store / "energy" / "c").iterdir())
    assert rk.read_study(store).complete
    assert run(store, 100, study=small.tiring(), resume=True).rates.members == 0


def test_a_broken_pool_is_made_anew(untouched, tmp_path, monkeypatch):
    """A worker that dies costs what it was computing; thrice in a row is too much."""
    tries, submitted = [], executors.Blocks._submitted

    def breaking(deaths):
        def submit(self, pool, first, last):
            tries.append(first)
            if len(tries) in deaths:
                raise executors.BrokenExecutor
            return submitted(self, pool, first, last)

        return submit

    monkeypatch.setattr(executors.Blocks, "_submitted", breaking({2, 6, 7}))
    run(tmp_path / "s.zarr")
    assert tree(tmp_path / "s.zarr") == tree(untouched)
    tries.clear()
    monkeypatch.setattr(executors.Blocks, "_submitted", breaking(range(3, 99)))
    with pytest.raises(RuntimeError, match="died 3 times in a row"):
        run(tmp_path / "t.zarr")


def killed_at_random(store, random, *options):
    """Whether the run was still at work when it was killed."""
    command = [sys.executable, "-m", "tests.study_process", str(store), *options]
    with subprocess.Popen(command, cwd=ROOT) as child:
        while not store.exists() and child.poll() is None:
            time.sleep(0.005)
        time.sleep(random.uniform(0.02, 0.8))
        child.send_signal(signal.SIGKILL)
        return child.wait() == -signal.SIGKILL


def test_a_study_killed_three_times_is_the_same_in_the_end(tmp_path):
    """Blocks of 16 of 4096 members: their files take about a second to write."""
    store, random = tmp_path / "s.zarr", np.random.default_rng(0)
    killed = [killed_at_random(store, random) for _ in range(3)]
    assert any(killed)
    how = {"seed": 1, "block": 16}
    before = rk.read_study(store)
    assert not before.complete
    again = rk.monte_carlo(small.rolling(), 4096, store=store, resume=True, **how)
    assert again.rates.members == 4096 - before.size
    rk.monte_carlo(small.rolling(), 4096, store=tmp_path / "anew.zarr", **how)
    assert tree(store) == tree(tmp_path / "anew.zarr")


def test_stores_opened_by_threads_write_chunks_of_fill_values(tmp_path):
    """Zarr's setting is that of all threads: the first to leave took it from others."""
    columns = {f"x{i}": Column((), np.dtype(float), "observed") for i in range(12)}
    create(tmp_path / "study", {}, columns, 64, 8, [0.0, 1.0])
    missing = []

    def write(block):
        for _ in range(20):
            store = Store(tmp_path / "study")
            store.write(block, {name: np.full(8, np.nan) for name in columns})
            missing.append(store.problem(block))

    threads = [threading.Thread(target=write, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert missing == [None] * 80  # a thread that raises leaves some out
