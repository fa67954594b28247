"""Pictures of a trajectory: what is drawn, in which form, and how files appear."""

import io
import os
import sys

import jax
import jax.numpy as jnp
import matplotlib as mpl
import matplotlib.image
import numpy as np
import pytest
from matplotlib.collections import LineCollection

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.pictures.motion_samples import motion_samples
from rollkane.pictures.plot_path import draw_path
from rollkane.pictures.plot_style import limits, new_figure, png
from rollkane.pictures.plotting import (
    figure_contact_path,
    figure_overview,
    plot_contact_path,
    plot_overview,
    tilt_angle,
)
from rollkane.validation.checks import FieldError
from tests.pictures import (
    dropped_disc,
    rolling_in_bowl,
    rolling_on_plane,
    rolling_on_sphere,
    thrown_disc,
)


@pytest.fixture(scope="module")
def run():
    return rolling_on_plane()


def curves(figure):
    """The first line of each panel."""
    return [panel.get_lines()[0].get_xydata().T for panel in figure.axes]


def drawn(figure):
    """The picture as it is seen; also finds what only fails while drawing."""
    picture = matplotlib.image.imread(io.BytesIO(png(figure, 50)))
    assert picture.std() > 0.01  # not a white sheet
    return picture


def test_overview_shows_the_trajectory_s_numbers(run):
    figure = figure_overview(run, "a ball")
    spin, tilt, error, force = curves(figure)
    time = np.asarray(run.time)
    for line in (spin, tilt, error, force):
        np.testing.assert_array_equal(line[0], time)
    np.testing.assert_allclose(spin[1], np.asarray(run.angular_velocity)[:, 2])
    np.testing.assert_allclose(force[1], np.asarray(run.normal_force))
    energy = np.asarray(run.energy)
    expected = np.abs(energy - energy[0]) / abs(energy[0])
    np.testing.assert_allclose(error[1][1:], expected[1:])
    assert error[1][0] > 0  # zero has no place on this scale
    labels = [panel.get_ylabel() for panel in figure.axes]
    assert [label[label.index("[") :] for label in labels] == [
        "[rad/s]",
        "[deg]",
        "[1]",
        "[N]",
    ]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    assert figure.get_suptitle() == "a ball"
    drawn(figure)


def test_overview_says_where_the_contact_pulls():
    run = rolling_on_plane(spin=25.0)
    force = np.asarray(run.normal_force)
    assert (force < 0).any()  # or this test would show nothing
    panel = figure_overview(run).axes[3]
    assert panel.get_title("right") == f"pulls first at {float(run.first_pull):.6g} s"
    assert len(panel.collections) > 0
    low, high = panel.get_ylim()
    assert low < np.nanmin(force)
    assert high > np.nanmax(force)


def test_tilt_is_that_of_the_axis_nearest_to_the_normal():
    motion = motion_samples(rolling_on_plane()).rows(np.arange(5))
    half = np.radians([10.0, 50.0, 95.0, 100.0, 170.0]) / 2
    about_y = np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], axis=1)
    motion = motion._replace(orientation=about_y)
    tilt, axis = tilt_angle(motion, round_body=False)
    np.testing.assert_allclose(tilt, [10.0, 50.0, 95.0, 100.0, 170.0])
    assert axis == "z"
    lying = motion.rows(np.arange(2, 5))
    tilt, axis = tilt_angle(lying, round_body=False)
    np.testing.assert_allclose(tilt, [5.0, 10.0, 80.0], atol=1e-12)
    assert axis == "−x"
    assert tilt_angle(lying, round_body=True)[1] == "−z"


def test_a_run_that_stopped_is_blank_where_it_was_not():
    run = rolling_on_plane(reached=10)
    figure = figure_overview(run, "stopped")
    for _, values in curves(figure):
        assert np.isfinite(values[:10]).all()
        assert np.isnan(values[10:]).all()
    assert figure.axes[0].get_xlim() == (0.0, 2.0)
    assert "stopped at 0.782609 s: the step became too small" in figure.get_suptitle()
    drawn(figure)
    drawn(figure_contact_path(run))


def test_flights_are_blank_where_there_is_no_contact():
    run = dropped_disc()
    figure, flies = figure_overview(run), np.asarray(run.mode) == rk.Mode.FLYING
    spin, tilt, energy, force = (values for _, values in curves(figure))
    for values in (spin, tilt):
        np.testing.assert_array_equal(np.isnan(values), flies)
    assert np.isfinite(energy).all()
    assert (force[flies] == 0.0).all()
    drawn(figure)
    path = figure_contact_path(run)
    (panel, *_) = path.axes
    (lines,) = panel.collections
    known = [len(piece) == 2 for piece in lines.get_segments()]  # without its NaN
    assert sum(known) == np.sum(~flies[1:] & ~flies[:-1])
    origin = next(x for x in panel.get_lines() if "in flight" in str(x.get_label()))
    np.testing.assert_array_equal(np.isfinite(origin.get_xdata()), flies)
    drawn(path)


def test_a_contact_that_is_lost_does_not_pull():
    figure = figure_overview(thrown_disc())
    assert figure.axes[3].get_title("right").startswith("lost first at")
    drawn(figure)
    drawn(figure_contact_path(thrown_disc()))


def test_a_run_of_which_nothing_is_known():
    for run in (rolling_on_plane(reached=0), rolling_on_sphere(reached=0)):
        drawn(figure_contact_path(run))
    drawn(figure_overview(run))


def test_two_outputs_and_nothing_moving():
    run = rolling_on_plane(2, spin=0.0)
    drawn(figure_overview(run))
    drawn(figure_contact_path(run))
    still = jax.tree.map(lambda x: jnp.broadcast_to(x[:1], x.shape), run.state)
    still = type(run)(**{**vars(run), "state": still})
    figure = figure_overview(still)
    drawn(figure)
    error = curves(figure)[2][1]
    assert (error == error[0]).all()
    drawn(figure_contact_path(still))


def test_single_precision():
    run = rolling_on_plane(dtype=jnp.float32)
    figure = figure_overview(run)
    low, _ = figure.axes[2].get_ylim()
    assert 1e-10 < low < 1e-7  # the floor is that of single precision
    drawn(figure)
    drawn(figure_contact_path(run))


def test_path_from_above_has_equal_scales(run):
    panel = figure_contact_path(run).axes[0]
    assert panel.get_aspect() == 1.0
    (lines,) = [c for c in panel.collections if isinstance(c, LineCollection)]
    path = np.concatenate([segment[:1] for segment in lines.get_segments()])
    np.testing.assert_allclose(path, np.asarray(run.contact_on_base)[:-1, :2])
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("x [m]", "y [m]")
    names = [text.get_text() for text in panel.get_legend().get_texts()]
    assert names == ["start", "end"]


@pytest.mark.parametrize("base", [rolling_on_plane, rolling_on_sphere])
def test_the_scale_of_times_tells_its_ends(base):
    run = base()
    figure = figure_contact_path(run)
    (bar,) = [x for x in figure.axes if x.get_ylabel() == "time [s]"]
    first, last = float(run.time[0]), float(run.time[-1])
    assert list(bar.get_ylim()) == [first, last]
    np.testing.assert_allclose(bar.get_yticks(), np.linspace(first, last, 5))
    shown = [float(text.get_text()) for text in bar.get_yticklabels()]
    np.testing.assert_allclose(shown, bar.get_yticks(), rtol=1e-2)


def test_carried_coordinates_have_a_unit():
    file = load_scene("shell-with-pendulum")
    run = rk.simulate(file.scene, file.start, [0.0, 0.1, 0.2])
    labels = [panel.get_ylabel() for panel in figure_overview(run).axes]
    assert "carried: α [m or rad]" in labels
    assert all("[" in label for label in labels if label)


def test_small_paths_are_in_millimetres(run):
    motion = motion_samples(run)
    small = motion._replace(contact_on_base=1e-2 * motion.contact_on_base)
    panel = new_figure((4.0, 4.0)).add_subplot()
    draw_path(panel, small)
    assert panel.get_xlabel() == "x [mm]"
    assert panel.get_xlim()[1] > 3.0


def test_path_on_curved_bases():
    bowl = figure_contact_path(rolling_in_bowl())
    drawn(bowl)
    assert bowl.axes[0].name == "rectilinear"
    ball = figure_contact_path(rolling_on_sphere())
    drawn(ball)
    assert ball.axes[0].name == "3d"


def test_titles_are_plain_text(run, tmp_path):
    title = r"cost $5 and $\frac{"
    plot_overview(run, tmp_path / "a.png", title)
    plot_contact_path(run, tmp_path / "b.png", title)
    for name in ("a.png", "b.png"):
        assert matplotlib.image.imread(tmp_path / name).shape[2] == 4


def test_a_failure_leaves_no_file(run, tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError("disc full")

    monkeypatch.setattr(os, "replace", refuse)
    for plot in (plot_overview, plot_contact_path):
        with pytest.raises(OSError, match="disc full"):
            plot(run, tmp_path / "a.png")
    assert os.listdir(tmp_path) == []


def test_a_batch_is_refused(run):
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), run)
    with pytest.raises(FieldError, match="one lane"):
        figure_overview(batch)


def test_missing_matplotlib_is_named(run, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"pip install 'rollkane\[plot\]'"):
        plot_overview(run, tmp_path / "a.png")


def test_no_global_state_of_matplotlib_changes(run):
    before = dict(mpl.rcParams)
    figure = figure_overview(run)
    assert figure.canvas.manager is None
    assert dict(mpl.rcParams) == before


def test_ranges_are_never_empty():
    assert limits(np.array([np.nan]), 0.1) == (0.0, 1.0)
    low, high = limits(np.full(3, 2.0), 0.0)
    assert low < 2.0 < high
    low, high = limits(np.array([1.0, 1.0 + 1e-15]), 0.0)
    assert (low, high) == (pytest.approx(0.95), pytest.approx(1.05))
    assert limits(np.array([-1.0, 3.0]), 0.5) == (-2.0, 4.0)
