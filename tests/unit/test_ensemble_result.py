"""What an ensemble is asked for: names of its ends, data sets, pictures."""

import dataclasses
import io
import os

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.image
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.observables import energy, position
from rollkane.files.export import write_netcdf
from rollkane.pictures.plot_ensemble import figure_ensemble, quantiles, shown
from rollkane.pictures.plot_style import png

from .. import problems

TIMES = np.linspace(0.0, 0.3, 7)
COUNT = 12
BROKEN = 4  # of which the start is NaN
GONE = rk.Event(lambda *at: position(*at)[0] + 0.3, name="gone / far")


@pytest.fixture(scope="module")
def runs():
    """Discs that roll off, of which some are stopped and one cannot begin."""
    scene, start = problems.disc(6.0)
    faster = jnp.linspace(0.1, 2.0, COUNT)
    spins = start.angular_velocity[None, :] * faster[:, None]
    spins = spins.at[BROKEN].set(jnp.nan)
    repeated = jax.tree.map(lambda x: jnp.stack([x] * COUNT), start)
    starts = rk.State(**{**vars(repeated), "angular_velocity": spins})
    seen = lambda *at: {"energy": energy(*at), "pair": jnp.stack([energy(*at)] * 2)}
    how = {"observe": seen, "keep_states": True, "stop": GONE, "block": 5}
    return rk.ensemble(scene, starts, TIMES, rtol=1e-8, **how)


@pytest.fixture(scope="module")
def dataset(runs):
    return runs.to_xarray()


def test_ends_have_names(runs):
    outcomes = runs.outcomes
    assert outcomes.shape == (COUNT,)
    assert outcomes[BROKEN] == "bad start: start.angular_velocity"
    stopped = runs.code == rk.Code.STOPPED
    assert 0 < stopped.sum() < COUNT - 1
    assert set(outcomes[stopped]) == {"stopped: gone / far"}
    assert set(outcomes[runs.succeeded]) == {"completed"}
    assert sum(runs.reasons.values()) == COUNT


def test_the_end_is_where_the_member_got_to(runs):
    """A stopped member at its event, to 1e-9 of the search; a completed one at T."""
    final, stopped = runs.final, runs.code == rk.Code.STOPPED
    np.testing.assert_allclose(final.position[stopped, 0], -0.3, atol=1e-8)
    done = runs.succeeded
    # another program of the same formulas: a few roundings of lengths of order one
    for name in ("position", "velocity", "orientation", "energy", "contact_force"):
        last = getattr(runs, name)[done, -1]
        np.testing.assert_allclose(getattr(final, name)[done], last, atol=1e-13 * 20)
    np.testing.assert_array_equal(runs.final_position, final.position)
    assert np.isnan(runs.final_position[BROKEN]).all()


def test_what_was_not_kept_is_said():
    scene, starts = problems.disc(6.0)[0], jax.vmap(problems.disc)(jnp.ones(2))[1]
    runs = rk.ensemble(scene, starts, [0.0, 0.1], keep_states=False)
    assert runs.state is None
    assert runs.observed is None
    assert np.isfinite(runs.final_position).all()
    with pytest.raises(rk.FieldError, match=r"Ensemble\.state: .* keep_states=True"):
        _ = runs.position
    assert "position" not in runs.to_xarray()
    with pytest.raises(rk.FieldError, match=r"ensemble\.keep_states: must be True or"):
        rk.ensemble(scene, starts, [0.0, 0.1], keep_states=1)


def test_data_set(runs, dataset):
    assert dict(dataset.sizes)["member"] == COUNT
    assert dataset["position"].dims == ("member", "time", "axis")
    assert dataset["energy"].dims == ("member", "time")
    assert dataset["position"].attrs["units"] == "m"
    assert dataset["time"].attrs["units"] == "s"
    np.testing.assert_array_equal(dataset["member"], np.arange(COUNT))
    np.testing.assert_array_equal(dataset["code"], runs.code)
    np.testing.assert_array_equal(dataset["reason"], runs.outcomes)
    explained = dataset["reason"].attrs["explained"].splitlines()
    assert len(explained) == len(set(runs.outcomes))
    assert "start.angular_velocity is NaN" in explained[0]
    # formulas in one program: a few roundings of numbers of order ten
    for name in ("position", "velocity", "normal_force"):
        values = getattr(runs, name)
        np.testing.assert_allclose(dataset[name], values, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(dataset["final_position"], runs.final_position)
    # what was observed has a name of its own where one is taken
    np.testing.assert_array_equal(dataset["observed_energy"], runs.observed["energy"])
    assert dataset["pair"].dims == ("member", "time", "pair_0")
    times = runs.events["gone / far"].times
    np.testing.assert_array_equal(dataset["gone _ far_time"], times)
    np.testing.assert_array_equal(dataset["gone _ far_count"], runs.code == 12)


def test_no_event_hides_anything_in_a_data_set(runs):
    """An event "final" has a ``final_time``, which is the ensemble's."""
    record = dataclasses.replace(runs.event_record, names=("final",))
    runs = dataclasses.replace(runs, event_record=record)
    with pytest.raises(rk.FieldError, match=r"Event\.name.*final.*another name"):
        runs.to_xarray()


def test_what_is_observed_hides_nothing_in_a_data_set(runs):
    """``final_time`` and coordinates keep their names."""
    seen = np.asarray(runs.observed["energy"])
    names = "final_time", "time", "member", "axis", "base_axis"
    data = dataclasses.replace(runs, observed=dict.fromkeys(names, seen)).to_xarray()
    np.testing.assert_array_equal(data["final_time"], runs.final_time)
    np.testing.assert_array_equal(data["time"], runs.time)
    for name in names:
        np.testing.assert_array_equal(data[f"observed_{name}"], seen)
    twice = {"time": seen, "observed_time": seen}
    with pytest.raises(rk.FieldError, match=r"ensemble\.observe.*another name"):
        dataclasses.replace(runs, observed=twice).to_xarray()


def test_netcdf_reads_back(runs, dataset, tmp_path):
    import xarray

    write_netcdf(runs, tmp_path / "runs.nc")
    assert os.listdir(tmp_path) == ["runs.nc"]
    with xarray.open_dataset(tmp_path / "runs.nc", engine="h5netcdf") as read:
        xarray.testing.assert_identical(read.load(), dataset)


def test_a_block_keeps_its_numbers():
    scene, starts = problems.disc(6.0)[0], jax.vmap(problems.disc)(jnp.ones(5))[1]
    *_, last = rk.ensemble_blocks(scene, starts, [0.0, 0.05], block=2)
    assert last.members.tolist() == [4]
    data = last.to_xarray()
    assert data["member"].values.tolist() == [4]
    assert data["position"].shape == (1, 2, 3)
    with pytest.raises(rk.FieldError, match="is traced, or is a batch"):
        jax.jit(lambda runs: runs.to_xarray())(last)


def drawn(figure):
    """The picture as it is seen; also finds what only fails while drawing."""
    picture = matplotlib.image.imread(io.BytesIO(png(figure, 50)))
    assert picture.std() > 0.01  # not a white sheet


def test_quantiles_are_numpy_s():
    """Those of NumPy, without the members that are not there, to one rounding."""
    rng = np.random.default_rng(3)
    values = rng.standard_normal((40, 6))
    values[rng.random((40, 6)) < 0.3] = np.nan
    values[1:, 4] = np.nan  # one is left
    values[:, 5] = np.nan
    shares = (0.05, 0.25, 0.5, 0.95)
    expected = np.nanquantile(values[:, :5], shares, axis=0)
    found = quantiles(values, shares)
    np.testing.assert_allclose(found[:, :5], expected, rtol=1e-14, atol=1e-15)
    assert np.isnan(found[:, 5]).all()


def test_fan(runs):
    figure = runs.plot(of="velocity", title="discs")
    x, y, z, under_way = figure.axes
    line = x.get_lines()[0].get_xydata()
    np.testing.assert_array_equal(line[:, 0], TIMES)
    median = np.nanmedian(runs.velocity[:, :, 0], axis=0)
    np.testing.assert_allclose(line[:, 1], median, rtol=1e-12, atol=1e-12)
    labels = [panel.get_ylabel() for panel in (x, y, z)]
    assert labels == [f"velocity {c} [m/s]" for c in "xyz"]
    outline = under_way.collections[0].get_paths()[0].vertices[:, 1]
    assert outline.max() == COUNT - 1  # but for the broken one
    assert figure.get_suptitle().startswith("discs\n")
    assert "gone / far" in figure.get_suptitle()
    drawn(figure)
    drawn(figure_ensemble(runs, "pair"))


def test_histogram(runs):
    figure = runs.plot(of="normal_force", kind="histogram")
    (panel,) = figure.axes
    heights = [patch.get_height() for patch in panel.patches]
    assert sum(heights) == COUNT - 1
    texts = [text.get_text() for text in panel.get_legend().get_texts()]
    assert texts[-1] == "1 bad start: start.angular_velocity (1 without a value)"
    assert panel.get_xlabel() == "normal force [N]"
    drawn(figure)
    speed = lambda *at: jnp.sum(rk.contact_of(*at).angular_velocity) * 0.0
    drawn(runs.plot(of=speed, kind="histogram"))  # all alike: one bin


def test_scatter(runs):
    figure = runs.plot(kind="scatter")
    (panel,) = figure.axes
    points = np.concatenate([np.asarray(c.get_offsets()) for c in panel.collections])
    ends = runs.final_position[np.arange(COUNT) != BROKEN, :2]
    ranked = lambda x: x[np.lexsort(x.T)]
    np.testing.assert_array_equal(ranked(points), ranked(ends))
    colours = {tuple(c.get_facecolor()[0]) for c in panel.collections}
    assert len(colours) == len(set(runs.outcomes))
    assert panel.get_aspect() == 1.0
    drawn(figure)
    with pytest.raises(rk.FieldError, match="is one number, and a scatter plot needs"):
        runs.plot(of="energy", kind="scatter")


def test_what_was_observed_is_drawn_at_the_last_output(runs):
    seen = shown(runs, "pair", at_end=True)
    np.testing.assert_array_equal(seen.values, runs.observed["pair"][:, -1])
    assert seen.labels == ("pair 0", "pair 1")


def test_pictures_appear_whole_or_not_at_all(runs, tmp_path):
    assert runs.plot(tmp_path / "fan.png", of="energy") is None
    assert (tmp_path / "fan.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(
        rk.FieldError, match=r"plot\.of: is not known.*use one of energy"
    ):
        runs.plot(tmp_path / "other.png", of="speed")
    with pytest.raises(rk.FieldError, match=r"plot\.kind: is not known"):
        runs.plot(tmp_path / "other.png", kind="pie")
    assert os.listdir(tmp_path) == ["fan.png"]


@pytest.mark.slow
def test_data_set_of_runs_with_modes(tmp_path):
    import xarray

    scene = rk.Scene(rk.Body(2.0, 0.008 * np.eye(3), rk.Sphere(0.1)))
    level, spin, flight = (1.0, 0.0, 0.0, 0.0), (0.0, 5.0, 0.0), (0.2, 0.0, 0.0)
    thrown = lambda z: rk.release(scene, level, spin, (0.0, 0.0, z), flight)
    starts = jax.vmap(thrown)(jnp.array([0.12, 0.2]))
    modes = rk.Modes(friction=0.1, restitution=0.5)
    runs = rk.ensemble(scene, starts, [0.0, 0.3], modes=modes)
    write_netcdf(runs, tmp_path / "runs.nc")
    with xarray.open_dataset(tmp_path / "runs.nc", engine="h5netcdf") as read:
        np.testing.assert_array_equal(read["mode"], runs.mode)
        flies = read["mode"] == rk.Mode.FLYING
        assert flies.any()
        np.testing.assert_array_equal(np.isnan(read["contact_on_base"][:, :, 0]), flies)
        slips = np.linalg.norm(read["slip"], axis=-1) > 0.0
        np.testing.assert_array_equal(slips, read["mode"] == rk.Mode.SLIPPING)


def test_a_batch_of_ensembles():
    """The same ensembles, each by itself, to the rounding of another program."""
    scene, starts = problems.disc(6.0)[0], jax.vmap(problems.disc)(jnp.ones(3))[1]
    wider = lambda r: eqx.tree_at(lambda s: s.body.surface.radius, scene, r)
    runs = lambda r: rk.ensemble(wider(r), starts, [0.0, 0.05])
    radii = jnp.array([0.2, 0.25])
    both = jax.vmap(runs)(radii)
    assert both.position.shape == (2, 3, 2, 3)
    assert both.outcomes.shape == (2, 3)
    assert both.reasons == {"completed": 6}
    # some twenty steps of rounding, of lengths below one
    one = runs(radii[0]).position
    np.testing.assert_allclose(both.position[0], one, rtol=0, atol=1e-13)
