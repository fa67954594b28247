"""Data sets and NetCDF files of a trajectory."""

import os
import sys

import jax
import numpy as np
import pytest
import xarray

import rollkane
from rollkane.files.export import to_xarray, write_netcdf
from rollkane.files.scene_files import load_scene
from rollkane.simulation.run import simulate

VECTORS = (
    "position",
    "velocity",
    "angular_velocity",
    "contact_on_body",
    "contact_on_base",
    "contact_force",
)
SCALARS = ("normal_force", "friction_ratio", "energy")


@pytest.fixture(scope="module")
def run():
    file = load_scene("routh-sphere")
    return simulate(file.scene, file.start, np.linspace(0, 0.5, 6), rtol=1e-8)


@pytest.fixture(scope="module")
def dataset(run):
    return to_xarray(run)


@pytest.fixture(scope="module")
def batch():
    """Three lanes; the second has a start that cannot be used."""
    file = load_scene("routh-sphere")
    starts = jax.tree.map(lambda x: np.stack([np.asarray(x)] * 3), file.start)
    starts.angular_velocity[1] = np.nan
    starts.angular_velocity[2] *= 0.5
    starts = jax.tree.map(jax.numpy.asarray, starts)
    times = np.linspace(0, 0.5, 6)
    return jax.vmap(
        lambda start: simulate(file.scene, start, times, rtol=1e-8, max_steps=1000)
    )(starts)


def test_events_of_a_run_and_of_a_batch(tmp_path):
    """By name: how often they happened and when, as the run itself says."""
    file = load_scene("routh-sphere")
    turns = rollkane.Event(lambda scene, t, state: state.angular_velocity[0], name="x")
    rests = rollkane.Event(lambda scene, t, state: t + 1.0, name="never")

    def run_from(start):
        times, events = np.linspace(0, 2.0, 3), (turns, rests)
        return simulate(file.scene, start, times, rtol=1e-8, events=events)

    run = run_from(file.start)
    found = run.events["x"]
    assert found.count == 2
    write_netcdf(run, tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as written:
        assert written["x_time"].dims == ("x_crossing",)
        assert written["x_time"].attrs["units"] == "s"
        np.testing.assert_array_equal(written["x_time"], found.times)
        assert written["x_count"] == found.count
        assert written["never_count"] == 0
        assert written["never_time"].size == 0
    starts = jax.tree.map(lambda x: jax.numpy.stack([x] * 2), file.start)
    batch = to_xarray(jax.vmap(run_from)(starts))
    assert batch["x_time"].dims == ("lane", "x_crossing")
    np.testing.assert_array_equal(batch["x_count"], [found.count] * 2)
    kept = batch["x_time"].values[:, : int(found.count)]
    np.testing.assert_array_equal(kept, [found.times] * 2)
    ends = rollkane.Event(lambda scene, t, state: t - 1.0, name="final")
    lone = simulate(file.scene, file.start, [0.0, 2.0], events=(ends,))
    np.testing.assert_array_equal(
        to_xarray(lone)["final_time"], lone.events["final"].times
    )
    many = jax.vmap(lambda s: simulate(file.scene, s, [0.0, 2.0], events=(ends,)))
    with pytest.raises(rollkane.FieldError, match='another "final_time"'):
        to_xarray(many(starts))


def test_names_shapes_and_values(run, dataset):
    assert set(dataset.data_vars) == {*VECTORS, *SCALARS, "orientation"}
    for name in VECTORS:
        assert dataset[name].dims == ("time", "axis")
    for name in SCALARS:
        assert dataset[name].dims == ("time",)
    assert dataset["orientation"].dims == ("time", "quaternion")
    assert list(dataset["axis"].values) == ["x", "y", "z"]
    assert list(dataset["quaternion"].values) == ["w", "x", "y", "z"]
    np.testing.assert_array_equal(dataset["time"], run.time)
    for name in dataset.data_vars:
        values = np.asarray(getattr(run, name))
        assert dataset[name].dtype == np.float64
        # another program of the same formulas: equal up to rounding
        np.testing.assert_allclose(dataset[name], values, rtol=1e-12, atol=1e-12)


def test_labels(run, dataset):
    for name in dataset.data_vars:
        assert dataset[name].attrs["long_name"]
        assert dataset[name].attrs["units"]
    assert dataset["position"].attrs["axes"] == "fixed"
    assert dataset["contact_on_body"].attrs["axes"] == "body"
    assert dataset["time"].attrs["units"] == "s"
    assert dataset.attrs["rollkane_version"] == rollkane.__version__
    assert dataset.attrs["code"] == 0
    assert dataset.attrs["reason"] == "completed"
    assert dataset.attrs["steps"] == int(run.steps)
    assert dataset.attrs["rejected_steps"] == int(run.rejected_steps)
    assert dataset.attrs["final_time"] == 0.5


def test_batch(batch):
    dataset = to_xarray(batch)
    assert dataset["position"].dims == ("lane", "time", "axis")
    assert dataset["energy"].dims == ("lane", "time")
    assert dataset["time"].dims == ("time",)
    np.testing.assert_array_equal(dataset["code"] == 0, [True, False, True])
    assert dataset["steps"].dims == ("lane",)
    finite = np.isfinite(dataset["position"]).all(dim=("time", "axis"))
    np.testing.assert_array_equal(finite, [True, False, True])
    assert "code" not in dataset.attrs


def test_netcdf_reads_back(dataset, batch, tmp_path):
    import xarray

    path = tmp_path / "run.nc"
    for made in (dataset, to_xarray(batch)):
        write_netcdf(made, path)
        assert os.listdir(tmp_path) == ["run.nc"]
        with xarray.open_dataset(path, engine="h5netcdf") as read:
            xarray.testing.assert_identical(read.load(), made)


def test_a_trajectory_is_written_too(run, dataset, tmp_path):
    import xarray

    write_netcdf(run, tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as read:
        xarray.testing.assert_identical(read.load(), dataset)


def test_a_failed_write_leaves_the_old_file(dataset, tmp_path):
    path = tmp_path / "run.nc"
    path.write_bytes(b"old")
    with pytest.raises(TypeError):
        write_netcdf(dataset.assign_attrs(bad={"a": 1}), path)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["run.nc"]
    with pytest.raises(FileNotFoundError, match="make it, or give another name"):
        write_netcdf(dataset, tmp_path / "none" / "run.nc")


@pytest.mark.parametrize("module", ["xarray", "h5netcdf", "h5py"])
def test_missing_extra_is_named(run, tmp_path, monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=rf"{module} is needed .*rollkane\[results\]"):
        write_netcdf(run, tmp_path / "run.nc")
    assert os.listdir(tmp_path) == []
