"""The commands that run a study, and show what its store holds."""

import functools
import json
import os
import shutil

import pytest
from click.testing import CliRunner

import rollkane as rk
from rollkane.cli import main
from rollkane.uncertainty import monte_carlo as running
from rollkane.uncertainty import study_file
from rollkane.uncertainty.sampling import sampler
from tests.small_studies import compiled_once
from tests.unit.test_store import tree

__all__ = ["compiled_once"]
TEXT = """
title = "A ball that rolls"
scene = "ball-on-plane"
times = [0.0, 0.1]
seed = 1
observe = ["position"]

[vary."start.angular_velocity[1]"]
distribution = "normal"
mean = 4.0
std = 1.0
low = 0.0

[[events]]
name = "fast"
of = "energy"
level = 0.14
"""
SIZE = "--size", "2200"


def run(*arguments):
    return CliRunner().invoke(main, [*map(str, arguments)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("studies")


@pytest.fixture(autouse=True)
def _read_once(monkeypatch, compiled_once):
    """The same study of the same file, so that it compiles once."""
    monkeypatch.setattr(study_file, "load_study", _loaded)


_loaded = functools.cache(study_file.load_study)


@pytest.fixture(scope="module")
def study(folder):
    file = folder / "study.toml"
    file.write_text(TEXT)
    return str(file)


@pytest.fixture
def store(study, tmp_path):
    ran = run("monte-carlo", study, *SIZE, "--store", tmp_path / "s.zarr")
    assert ran.exit_code == 0, ran.output
    return tmp_path / "s.zarr"


def test_a_study_is_run_and_told(study):
    ran = run("monte-carlo", study, *SIZE)
    assert ran.exit_code == 0, ran.output
    assert ran.output.startswith("A ball that rolls\n2,200 members, none failed")
    assert "position[0]" in ran.output
    quiet = run("monte-carlo", study, *SIZE, "--quiet")
    assert (quiet.exit_code, quiet.output) == (0, "")


def test_json_is_what_python_has(study):
    ran = run("monte-carlo", study, *SIZE, "--json", "--seed", "5")
    known = json.loads(ran.stdout)
    file = study_file.load_study(study)
    found = rk.monte_carlo(file.study, 2200, seed=5)
    assert known["mean"]["position"] == found.mean["position"].tolist()
    assert known["members"] == 2200
    assert known["probability"]["fast"] == found.probability["fast"]
    # rolling straight on: 0.1 m of radius, 0.1 s, 4 rad/s; 5 standard errors
    assert abs(known["mean"]["position"][0] - 0.04) < 5 * 0.01 / 2200**0.5


def test_a_store_is_shown_drawn_and_gone_on_with(study, store, tmp_path):
    told = run("monte-carlo", study, *SIZE).output.partition("\n")[2]
    picture = tmp_path / "s.png"
    shown = run("show", store, "--plot", picture)
    assert shown.exit_code == 0, shown.output
    assert shown.output.partition("\n")[2].startswith(told)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert json.loads(run("show", store, "--json").stdout)["computed"] == 0
    before = tree(store)
    again = run("monte-carlo", study, *SIZE, "--store", store, "--resume", "--json")
    assert json.loads(again.stdout)["computed"] == 0
    assert tree(store) == before
    grown = run("monte-carlo", study, "--size", 3000, "--store", store, "--resume")
    assert grown.exit_code == 0, grown.output
    assert grown.output.startswith("A ball that rolls\n3,000 members")


def test_damage_is_shown(study, store):
    before = tree(store)
    (store / "position" / "c" / "1" / "0").unlink()
    shown = run("show", store)
    assert shown.exit_code == 3
    assert "block 1: the chunk of position is missing" in shown.output
    assert "go on with --resume" in shown.output
    assert json.loads(run("show", store, "--json").stdout)["members"] == 1176
    assert run("monte-carlo", study, *SIZE, "--store", store, "--resume").exit_code == 0
    assert tree(store) == before
    assert run("show", store).exit_code == 0


def test_shards_fill_a_store(study, store, tmp_path):
    own = "--store", tmp_path / "shards.zarr"
    first = run("monte-carlo", study, *SIZE, *own, "--shard", "1/2")
    assert first.exit_code == 0, first.output
    assert "1 of 3 blocks are not computed yet" in first.output
    assert run("show", own[1]).exit_code == 3
    last = run("monte-carlo", study, *SIZE, *own, "--shard", "2/2")
    assert last.exit_code == 0
    assert "1,176 members" in first.output
    assert "2,200 members" in last.output
    assert tree(own[1]) == tree(store)


def test_a_precision_ends_it(study, tmp_path):
    """Half width 1.96 * 0.01 m / sqrt(n): 6.1e-4 of 1024, 4.3e-4 of 2048."""
    own = "--store", tmp_path / "s.zarr", "--block", 256, "--json"
    ran = run(
        *("monte-carlo", study, "--size", 9000, *own),
        *("--precision", "position=5e-4"),
    )
    assert ran.exit_code == 0, ran.output
    assert json.loads(ran.stdout)["members"] == 2048
    assert json.loads(run("show", own[1], "--json").stdout)["members"] == 2048


def test_a_precision_that_is_missed_is_told(study):
    """Half width 1.96 * 0.01 m / sqrt(512) = 8.7e-4, to 1 / sqrt(1024) of it."""
    ran = run("monte-carlo", study, "--size", 512, "--precision", "position=5e-4")
    assert ran.exit_code == 0, ran.output
    assert "the precision of position was not reached: half its interval" in ran.output
    told = float(ran.output.split("half its interval is ")[1].split(",")[0])
    assert abs(told / 8.7e-4 - 1.0) < 4.0 / 32.0
    fine = run("monte-carlo", study, "--size", 512, "--precision", "position=5e-3")
    assert "was not reached" not in fine.output


REFUSED = {
    "no size": ((), "is needed"),
    "size": (("--size", "0"), "--size"),
    "resume": ((*SIZE, "--resume"), "needs the --store"),
    "shard": ((*SIZE, "--store", "s.zarr", "--shard", "1"), "is not I/N"),
    "shards": ((*SIZE, "--store", "s.zarr", "--shard", "3/2"), "is not among the"),
    "shard of nothing": ((*SIZE, "--shard", "1/2"), "has no store to share"),
    "precision": ((*SIZE, "--precision", "position"), "is not NAME=HALF_WIDTH"),
    "precisions": (
        (*SIZE, "--precision", "position=1", "--precision", "position=2"),
        "names position twice",
    ),
    "width": ((*SIZE, "--precision", "position=-1"), "--precision"),
    "name": ((*SIZE, "--precision", "nothing=1"), "is not looked at"),
    "cluster": ((*SIZE, "--cluster", "nowhere"), "is no executor"),
    "both": ((*SIZE, "--cluster", "tcp://1:1", "--processes"), "cannot be given with"),
    "folder": ((*SIZE, "--store", "no/where/s.zarr"), "does not exist; make it first"),
    "picture": ((*SIZE, "--plot", "no/where.png"), "does not exist; make it first"),
    "file": ((*SIZE, "--store", "study.toml"), "holds no study"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_input_is_refused_and_leaves_nothing(folder, study, name, monkeypatch):
    monkeypatch.chdir(folder)
    options, said = REFUSED[name]
    ran = run("monte-carlo", study, *options)
    assert ran.exit_code == 2, ran.output
    assert said in " ".join(ran.output.split())
    assert "Traceback" not in ran.output
    assert os.listdir(folder) == ["study.toml"]


def test_a_cluster_that_nobody_runs(folder, study):
    dask = pytest.importorskip("dask")
    pytest.importorskip("distributed")
    with dask.config.set({"distributed.comm.timeouts.connect": "50ms"}):
        for address in ("tcp://127.0.0.1:1", "nothing://127.0.0.1:1"):
            ran = run("monte-carlo", study, *SIZE, "--cluster", address)
            assert ran.exit_code == 2
            assert "cannot be reached" in ran.output
            assert "mend the address" in ran.output
            assert "None" not in ran.output


def test_a_file_with_mistakes_is_refused(tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(TEXT.replace('"position"', '"positron"').replace("0.14", '"x"'))
    ran = run("monte-carlo", file, *SIZE)
    assert ran.exit_code == 2
    assert "did you mean position?" in ran.output
    assert f"2 errors in {file}" in ran.output
    assert run("monte-carlo", tmp_path / "none.toml").exit_code == 2


def test_stores_that_are_not_this_study_s_are_refused(study, store, tmp_path):
    before = tree(store)
    own = "--store", store
    for more, said in (
        ((), "go on with resume=True (--resume)"),
        (("--resume", "--seed", "2"), "store of another study: what differs is"),
        (("--resume", "--size", "2000"), "more than 2000"),
    ):
        ran = run("monte-carlo", study, *SIZE, *own, *more)
        assert ran.exit_code == 2, ran.output
        assert said in ran.output
    assert tree(store) == before
    shutil.rmtree(store / "energy", ignore_errors=True)
    for path in (tmp_path, tmp_path / "none"):
        shown = run("show", path)
        assert shown.exit_code == 2
        assert "holds no study" in shown.output


def test_ctrl_c_is_told(study, tmp_path, monkeypatch):
    def interrupted(*how, **more):
        raise KeyboardInterrupt

    monkeypatch.setattr(running, "monte_carlo", interrupted)
    for own, said in (
        (("--store", tmp_path / "s"), "go on with --resume"),
        ((), "nothing was kept without --store"),
    ):
        ran = run("monte-carlo", study, *SIZE, *own)
        assert ran.exit_code == 130
        assert said in ran.output


def test_a_disk_that_is_full_is_told(study, tmp_path, monkeypatch):
    def full(self, k, columns):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rollkane.uncertainty.store.Store.write", full)
    ran = run("monte-carlo", study, *SIZE, "--store", tmp_path / "s.zarr")
    assert ran.exit_code == 1
    text = " ".join(ran.output.split())
    assert f"cannot write {tmp_path / 's.zarr'}: [Errno 28] No space left" in text


def test_failures_are_told(tmp_path):
    """Of a mass of 0.05 kg in the middle, most are none; of the first three, all."""
    file = tmp_path / "s.toml"
    varied = 'start.angular_velocity[1]"]\ndistribution = "normal"'
    text = TEXT.replace(varied, 'body.mass"]\ndistribution = "uniform"')
    text = text.replace(
        "mean = 4.0\nstd = 1.0\nlow = 0.0", "low = -100.0\nhigh = 100.1"
    )
    file.write_text(text)
    first = lambda seed, n: sampler("plain", 1, seed, n).uniforms(0, n)[:, 0]
    members = first(1, 100)
    seed = next(seed for seed in range(99) if (first(seed, 3) < 0.49).all())
    bad = int((members < 100.0 / 200.1).sum())
    ran = run("monte-carlo", file, "--size", 100)
    assert ran.exit_code == 0, ran.output
    assert f"of which {bad} FAILED" in ran.output
    assert "body.mass is NaN" in ran.output
    ran = run("monte-carlo", file, "--size", 3, "--seed", seed)
    assert ran.exit_code == 3, ran.output
    assert "every motion failed" in ran.output
    # nothing can be made of a middle that is refused
    other = tmp_path / "other.toml"
    other.write_text(text.replace("100.1", "99.9"))
    ran = run("monte-carlo", other, "--size", 3)
    assert ran.exit_code == 2
    assert "Body.mass: " in ran.output
