"""Histories, pictures, pages and data sets of moving bases and carried masses."""

import base64
import json
import shutil
import subprocess
from importlib import resources

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.export import to_xarray
from rollkane.files.scene_files import load_scene
from rollkane.geometry.rotations import rotation_matrix
from rollkane.pictures.motion_samples import motion_samples
from rollkane.pictures.plotting import figure_contact_path, figure_overview
from rollkane.pictures.summary import summary
from rollkane.pictures.viewer import view_data

ASSETS = resources.files("rollkane.pictures") / "viewer_assets"
# a product of a dozen roundings of numbers of order 1
ROUNDED = 1e-13


def run_of(name, duration=1.0, count=21, **options):
    file = load_scene(name)
    begin = 0.0 if file.scene.base.motion is None else file.times[0]
    times = begin + np.linspace(0.0, duration, count)
    result = rk.simulate(file.scene, file.start, times, **options)
    assert bool(result.succeeded), result.reason
    return result


@pytest.fixture(scope="module")
def table():
    """Everything moves: a base that translates and turns."""
    return run_of("ellipsoid-on-six-axis-table")


@pytest.fixture(scope="module")
def turntable():
    return run_of("ball-on-turntable", 3.0)


@pytest.fixture(scope="module")
def shell():
    return run_of("shell-with-pendulum")


def turned(quaternions, vectors):
    rotations = np.stack([np.asarray(rotation_matrix(q)) for q in quaternions])
    return np.einsum("tij,tj->ti", rotations, vectors)


@pytest.mark.parametrize(
    "name", [pytest.param("table", marks=pytest.mark.slow), "turntable", "shell"]
)
def test_body_and_base_meet_in_every_frame(name, request):
    drawn = motion_samples(request.getfixturevalue(name))
    by_body = drawn.position + turned(drawn.orientation, drawn.contact_on_body)
    by_base = drawn.base_origin + turned(drawn.base_orientation, drawn.contact_on_base)
    np.testing.assert_allclose(by_body, by_base, atol=ROUNDED)
    np.testing.assert_allclose(drawn.contact, by_base, atol=ROUNDED)
    out = turned(drawn.base_orientation, drawn.base_outward)
    np.testing.assert_allclose(out, drawn.outward, atol=ROUNDED)
    faced = -turned(drawn.orientation, drawn.body_outward)
    np.testing.assert_allclose(out, faced, atol=ROUNDED)


@pytest.mark.slow
def test_velocities_are_the_rates_of_the_poses(table):
    """By differentiating the poses along the motion and in time."""

    @eqx.filter_jit
    @jax.vmap
    def rates(t, state):
        along = rk.rolling_derivative(table.scene, t, state)
        motion = table.scene.base.motion
        body = lambda t, s: rk.contact_of(table.scene, t, s).position
        base = lambda t, s: (motion.at(t).placed(jnp.zeros(3)), motion.at(t).rotation)
        one = jnp.ones_like(t)
        velocity = jax.jvp(body, (t, state), (one, along))[1]
        (_, A), (glide, A_dot) = jax.jvp(base, (t, state), (one, along))
        S = A_dot @ A.T
        return velocity, glide, jnp.stack([S[2, 1], S[0, 2], S[1, 0]])

    drawn = motion_samples(table)
    velocity, glide, turn = rates(table.time, table.state)
    np.testing.assert_allclose(drawn.velocity, velocity, atol=1e-12)
    np.testing.assert_allclose(drawn.base_velocity, glide, atol=1e-12)
    np.testing.assert_allclose(drawn.base_angular_velocity, turn, atol=1e-12)


@pytest.mark.slow
def test_which_energy_is_kept(turntable, table, shell):
    assert motion_samples(turntable).kept == "moving energy"
    assert motion_samples(shell).kept == "energy"
    assert motion_samples(table).kept == ""
    assert np.isnan(motion_samples(table).energy_error).all()
    # the default rtol, 1e-9 a step, over some hundred steps
    for run in (turntable, shell):
        assert motion_samples(run).energy_error.max() < 1e-6
    # a tilted turntable keeps neither: gravity turns on its axes
    tilted = load_scene("ball-on-tilted-turntable").scene
    still = eqx.tree_at(lambda r: r.scene, turntable, tilted)
    assert motion_samples(still).kept == ""


def test_what_is_driven_does_work(shell):
    (pendulum,) = shell.scene.supported
    assert not pendulum.does_work
    damped = rk.PointMasses(1.0, lambda a: a[0] * jnp.ones((1, 3)), lambda t, a, v: -v)
    assert damped.does_work
    driven = rk.Prescribed(damped, lambda t: jnp.stack([jnp.sin(t)]))
    assert driven.does_work


def test_carried_masses_are_where_the_user_put_them(shell):
    drawn = motion_samples(shell)
    (pendulum,) = shell.scene.supported
    assert drawn.masses.tolist() == np.asarray(pendulum.mass).tolist()
    for alpha, places in zip(drawn.alpha, drawn.carried, strict=True):
        expected = np.asarray(
            pendulum.position(jnp.asarray(alpha), pendulum.parameters)
        )
        np.testing.assert_allclose(places, expected, atol=ROUNDED)


def test_a_carried_body_is_drawn_with_its_inertia():
    """Six equal masses on its axes have its mass, mass centre and moments."""
    inertia = np.diag([0.02, 0.03, 0.04])
    turn = lambda a: rotation_matrix(
        jnp.stack([jnp.cos(a[0]), 0.6 * jnp.sin(a[0]), 0.0 * a[0], 0.8 * jnp.sin(a[0])])
    )
    place = lambda a: jnp.stack([0.1 * a[0], 0.05 * a[0] ** 2, 0.0 * a[0]])
    part = rk.SupportedBody(0.6, inertia, place, turn)
    body = rk.Body(2.0, 0.1 * np.eye(3), rk.Sphere(0.5))
    scene = rk.Scene(body, supported=part)
    up, still = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    start = rk.place(scene, up, still, still, alpha=[0.4], alpha_dot=[0.0])
    drawn = motion_samples(rk.simulate(scene, start, (0.0, 0.01)))
    (points, _), masses = drawn.carried, drawn.masses
    assert masses.sum() == pytest.approx(0.6)
    centre = masses @ points / masses.sum()
    np.testing.assert_allclose(centre, place(jnp.array([0.4])), atol=ROUNDED)
    arms = points - centre
    R = np.asarray(turn(jnp.array([0.4])))
    found = sum(
        m * (r @ r * np.eye(3) - np.outer(r, r))
        for m, r in zip(masses, arms, strict=True)
    )
    np.testing.assert_allclose(found, R @ inertia @ R.T, atol=ROUNDED)


def unpacked(packed):
    flat = np.frombuffer(base64.b64decode(packed["data"]), packed["type"])
    return flat.reshape(packed["shape"]) * packed["unit"]


@pytest.mark.slow
def test_the_page_has_the_base_s_pose_where_it_moves(table, shell):
    data, drawn = view_data(table), motion_samples(table)
    for name in ("base_origin", "base_orientation", "base_velocity"):
        found = unpacked(data["frames"][name])
        np.testing.assert_allclose(found, getattr(drawn, name), atol=1e-6)
    assert data["energy_label"] == ["energy", "J"]
    np.testing.assert_allclose(
        unpacked(data["frames"]["energy"]), drawn.energy, rtol=1e-6
    )
    assert data["carried"] == []
    assert "carried" not in data["frames"]
    data = view_data(shell)
    assert not [name for name in data["frames"] if name.startswith("base_")]
    assert data["energy_label"] == ["energy error", ""]
    assert len(data["carried"]) == motion_samples(shell).masses.size
    found = unpacked(data["frames"]["carried"])
    np.testing.assert_allclose(found, motion_samples(shell).carried, atol=1e-6)


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
@pytest.mark.slow
def test_between_frames_the_page_moves_the_base_as_it_moves():
    """A base that turns more than a turn between two frames, and glides."""
    spin = rk.Spin(20.0, position=(0.1, 0.2, 0.3))
    scene = rk.Scene(load_scene("ball-on-turntable").scene.body, rk.Base(motion=spin))
    up, still = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    start = rk.place(scene, up, still, still)
    run = rk.simulate(scene, start, np.linspace(0.0, 2.0, 6))
    frames = json.dumps(view_data(run)["frames"])
    times = [0.0, 0.33, 0.9, 1.7]
    program = (ASSETS / "motion.js").read_text() + (
        f"const motion = new rollkane.Motion({frames});"
        f"console.log(JSON.stringify({times}.map((t) => motion.state(t).base)));"
    )
    answer = subprocess.run(
        ["node", "-"], input=program, capture_output=True, text=True, check=True
    )
    for t, base in zip(times, json.loads(answer.stdout), strict=True):
        np.testing.assert_allclose(base["origin"], [0.1, 0.2, 0.3], atol=1e-6)
        turn = np.array([np.cos(10.0 * t), 0.0, 0.0, np.sin(10.0 * t)])
        # single precision of the frames, through turns of 8 rad
        assert abs(np.dot(base["orientation"], turn)) == pytest.approx(1.0, abs=1e-5)


def test_pictures(turntable, table, shell):
    overview = figure_overview(shell)
    assert [panel.get_ylabel() for panel in overview.axes][
        -1
    ] == "carried: α [m or rad]"
    assert len(figure_overview(turntable).axes) == 4
    labels = [panel.get_ylabel() for panel in figure_overview(table).axes]
    assert "energy [J]" in labels
    labels = [panel.get_ylabel() for panel in figure_overview(turntable).axes]
    assert "|E* − E*₀| / |E*₀| [1]" in labels


def test_the_path_is_shown_on_the_base_and_in_fixed_axes(turntable, shell):
    on_base, in_space, *_ = figure_contact_path(turntable).axes
    assert on_base.get_xlabel() == "x of the base [m]"
    assert in_space.get_xlabel() == "x [m]"
    drawn = motion_samples(turntable)
    for panel, path in ((on_base, drawn.contact_on_base), (in_space, drawn.contact)):
        (lines,) = panel.collections
        first = np.array([piece[0] for piece in lines.get_segments()])
        np.testing.assert_allclose(first, path[:-1, :2], atol=ROUNDED)
    assert figure_contact_path(shell).axes[0].get_xlabel().startswith("x [")


@pytest.mark.slow
def test_data_set(table, shell):
    data = to_xarray(table)
    for name in ("base_position", "base_rotation", "moving_energy", "power"):
        np.testing.assert_allclose(data[name], getattr(table, name), atol=1e-12)
        assert data[name].attrs["units"]
    assert data["base_rotation"].dims == ("time", "axis", "base_axis")
    assert "coincide" not in data.attrs["axes_note"]
    data = to_xarray(shell)
    assert "base_position" not in data
    assert data["alpha"].shape == (21, shell.scene.coordinate_count)
    np.testing.assert_allclose(data["power"], 0.0, atol=1e-12)
    assert "coincide" in data.attrs["axes_note"]


@pytest.mark.slow
def test_summary_names_the_energy(turntable, table, shell):
    drift, work = "energy drift", "by the base"
    assert any(drift in line and "moving energy" in line for line in summary(turntable))
    assert any(work in line for line in summary(table))
    assert any(drift in line and "moving" not in line for line in summary(shell))
