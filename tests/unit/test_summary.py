"""The summary of a run, and where a sampled function changes its sign."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.pictures.summary import reversals, sign_changes, summary
from rollkane.pictures.summary_by_kind import path_line
from rollkane.simulation.run import simulate
from tests.pictures import dropped_disc, thrown_disc


def test_sign_changes_of_a_cubic_are_exact():
    roots = np.array([0.3, 1.55, 1.6])  # the last two between the same samples
    cubic = np.poly(roots)
    time = np.array([0.0, 1.0, 2.0, 3.0])
    found = sign_changes(
        time, np.polyval(cubic, time), np.polyval(np.polyder(cubic), time)
    )
    np.testing.assert_allclose(found, roots, atol=1e-12)


def test_sign_changes_converge_with_the_fourth_power_of_the_spacing():
    errors = []
    for count in (21, 41):
        time = np.linspace(0, 10, count)
        found = sign_changes(time, np.cos(time), -np.sin(time))
        errors.append(np.max(np.abs(found - np.pi * np.array([0.5, 1.5, 2.5]))))
    assert errors[0] < 2e-4  # h^4/384 of a unit cosine, h = 0.5
    assert errors[1] < errors[0] / 10


def test_a_touch_and_a_sample_at_zero():
    time = np.array([0.0, 1.0, 2.0])
    assert sign_changes(time, (time - 1) ** 2, 2 * (time - 1)).size == 0
    np.testing.assert_array_equal(sign_changes(time, time - 1, np.ones(3)), [1.0])
    assert sign_changes(time, np.zeros(3), np.zeros(3)).size == 0
    # nothing changes its sign before the first or after the last sample
    assert sign_changes(time, time, np.ones(3)).size == 0
    assert sign_changes(time, time - 2, np.ones(3)).size == 0


def test_a_ripple_about_zero_reverses_nothing():
    """A slow turn of 1 with a ripple of 0.15: zeros by the dozen, three reversals."""
    time = np.linspace(0.0, 10.0, 2001)
    slow, fast = 2 * np.pi / 6, 40.0
    value = np.cos(slow * time) + 0.15 * np.cos(fast * time)
    rate = -slow * np.sin(slow * time) - 0.15 * fast * np.sin(fast * time)
    zeros = sign_changes(time, value, rate)
    assert zeros.size > 6
    least = 0.2 * 1.15
    found = reversals(time, value, rate, least)
    assert found.size == 3
    # where the slow turn is as large as the ripple at most: asin(0.15) / slow
    np.testing.assert_allclose(found, [1.5, 4.5, 7.5], rtol=0, atol=0.151 / slow)
    assert set(found) <= set(zeros)
    # each is the last zero before the other side: none lies between it and that side
    for at in found:
        later = time > at
        side = np.sign(value[later][np.abs(value[later]) > least][0])
        until = time[later][np.abs(value[later]) > least][0]
        assert not np.any((zeros > at) & (zeros < until))
        assert side == np.sign(np.cos(slow * until))
    # backwards in time the sides are taken in the other order, as often
    assert reversals(time[::-1], value[::-1], rate[::-1], least).size == 3
    # a spin that never gets far to the other side has not turned
    assert reversals(time, 0.9 + value, rate, 0.2 * 2.05).size == 0
    assert reversals(time, 0 * value, rate, 0.0).size == 0


def listed(text: str, pattern: str) -> list[float]:
    """Numbers of the first match of a pattern."""
    found = re.search(pattern, text)
    assert found, (pattern, text)
    return [float(x) for x in re.split(r",? +", found[1].strip())]


def test_summary():
    """What is told of the stone, against differences of the positions of its run."""
    file = load_scene("rattleback")
    step = 1e-4  # [s]: zeros of the ripple before the last are 2.8 ms apart
    run = simulate(file.scene, file.start, np.arange(35001) * step, rtol=1e-10)
    text = " ".join("\n".join(summary(run)).split())
    time, spin = np.asarray(run.time), np.asarray(run.angular_velocity)[:, 2]
    far = np.nonzero(np.abs(spin) > 0.2 * np.abs(spin).max())[0]
    turned = far[1:][spin[far[1:]] * spin[far[:-1]] < 0]
    (zeros,) = np.nonzero(spin[:-1] * spin[1:] < 0)
    assert zeros.size > turned.size == 1  # of a ripple, and of the stone
    turns = np.array([zeros[zeros < k][-1] for k in turned])
    # linear between samples: off by step^2 w'' / (8 w'), where w'' / w' is 2 / (2.8 ms)
    # between two so near; and rounded to 1e-4 s
    when = time[turns] - spin[turns] * step / (spin[turns + 1] - spin[turns])
    told = listed(text, r"about the normal 1 reversal ([\d., ]+) s")
    np.testing.assert_allclose(told, when, rtol=0, atol=step**2 / 1.12e-2 + 5e-5)
    ends = re.search(r"spin (\S+) -> (\S+) rad/s about the normal", text)
    assert ends
    told = [float(end) for end in ends.groups()]
    np.testing.assert_allclose(told, spin[[0, -1]], rtol=1e-5)
    # the force by second differences over 1 ms, of a mass centre that rocks at less
    # than 120 rad/s with up to 10 m/s^2: off by (w h)^2 / 12 of it
    body, gravity = file.scene.body, np.array([0.0, 0.0, 9.81])
    turned = Rotation.from_quat(np.asarray(run.orientation)[::10, [1, 2, 3, 0]])
    arm = turned.apply(np.array(body.center_of_mass))
    step, mass, centre = 10 * step, float(body.mass), run.position[::10] + arm
    acceleration = np.diff(centre, n=2, axis=0) / step**2
    force = mass * (acceleration + gravity)
    off = mass * 10.0 * (120.0 * step) ** 2 / 12
    (least,) = listed(text, r"normal force ([\d.]+) N at least")
    assert abs(least - force[:, 2].min()) < off + 5e-4
    needed = np.linalg.norm(force[:, :2], axis=1) / force[:, 2]
    (most,) = listed(text, r"friction needed ([\d.]+) at most")
    assert abs(most - needed.max()) < 2 * off / force[needed.argmax(), 2] + 5e-5
    (drift,) = listed(text, r"energy drift ([\de.+-]+)")
    energy = np.asarray(run.energy)
    assert drift == pytest.approx(np.abs(energy / energy[0] - 1).max(), rel=0.05)
    counts = listed(text, r"steps (\d+) accepted"), listed(text, r"(\d+) rejected")
    assert counts == ([int(run.steps)], [int(run.rejected_steps)])
    assert "about body axis z 1 reversal" in text
    assert "more than 20 % of the largest the other way" in text
    place = listed(text, r"end position \(([-\d.e, ]+)\) m")
    np.testing.assert_allclose(place, run.position[-1], rtol=1e-5)  # of six digits
    assert "pull" not in text


# -- what happened, by kind of scene ---------------------------------------------------


def told(run):
    return " ".join("\n".join(summary(run)).split())


def test_a_disc_that_falls():
    """Its tilt falls until it lies flat, and the run ends there."""
    body = rk.Body(1.0, 0.01 * np.diag([0.25, 0.25, 0.5]), rk.DiscEdge(0.1))
    scene, half = rk.Scene(body), np.radians(70.0) / 2
    level = (np.cos(half), np.sin(half), 0.0, 0.0)
    start = rk.place(scene, level, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    times = np.linspace(0.0, 1.0, 1001)
    run = rk.simulate(scene, start, times)
    assert run.code == rk.Code.SURFACE_EDGE
    text = told(run)
    (when,) = listed(text, r"fell flat t = ([\d.e-]+) s")
    assert when == pytest.approx(float(run.final_time), rel=1e-5)
    found = re.search(r"least tilt (\S+) deg to the base, t = (\S+) s", text)
    least, at = map(float, found.groups())
    assert at == pytest.approx(float(run.final_time), rel=1e-3)
    turns = np.asarray(run.with_its_end().orientation)
    turns = turns[np.isfinite(turns).all(axis=1)]
    turned = Rotation.from_quat(turns[:, [1, 2, 3, 0]])
    tilt = np.degrees(np.arccos(turned.apply([0.0, 0.0, 1.0])[:, 2]))
    assert tilt[0] == pytest.approx(70.0, rel=1e-12)
    # a rounding of the cosine is the root of it in the angle, 1e-8 rad
    assert least == pytest.approx(tilt.min(), rel=1e-3, abs=1e-6)


def test_a_ball_that_slips_and_rolls():
    """Slips for 2 v / (7 mu g), and rolls the rest of the time."""
    ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    start = rk.place(
        rk.Scene(ball, contact=rk.Slipping()),
        *((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        velocity=(2.0, 0.0, 0.0),
    )
    modes = rk.Modes(friction=0.3)
    run = rk.simulate(rk.Scene(ball), start, np.linspace(0.0, 1.0, 11), modes=modes)
    text = told(run)
    slips = 2.0 * 2.0 / (7.0 * 0.3 * 9.81)
    (rolled,) = listed(text, r"in all rolls ([\d.]+) s")
    (slipped,) = listed(text, r"slips ([\d.]+) s")
    assert slipped == pytest.approx(slips, rel=1e-3)  # four digits
    assert rolled == pytest.approx(1.0 - slips, rel=1e-3)
    assert "flies" not in text
    assert "in all" not in told(simulate(*level_ball(), [0.0, 0.5]))


def test_what_is_told_of_flights():
    """Spin, tilt and force are those of the contact; by differences of the outputs."""
    run = dropped_disc()
    text, touches = told(run), np.asarray(run.mode) != rk.Mode.FLYING
    spin = np.asarray(run.angular_velocity)[touches, 2]
    ends = re.search(r"spin (\S+) -> (\S+) rad/s about the normal, while", text)
    assert [float(x) for x in ends.groups()] == pytest.approx(spin[[0, -1]], rel=1e-5)
    turned = Rotation.from_quat(np.asarray(run.orientation)[:, [1, 2, 3, 0]])
    tilt = np.degrees(np.arccos(np.abs(turned.as_matrix()[touches, 2, 2])))
    assert listed(text, r"least tilt ([\d.]+) deg") == pytest.approx(
        [tilt.min()], rel=5e-4
    )
    press = np.asarray(run.normal_force)[touches]
    assert listed(text, r"normal force ([\d.]+) N at least") == pytest.approx(
        [press.min()], rel=5e-4
    )
    assert "J, by friction, landings" in text
    assert "assumes that it can" not in text


@pytest.mark.slow
def test_a_run_that_only_flies():
    """It left its base at once, and nothing did work on it."""
    text = told(thrown_disc())
    assert "J, nothing did work" in text
    assert "least tilt 80 deg to the base, t = 0 s" in text
    assert "assumes that it can" not in text
    run = dropped_disc()
    some = np.asarray(run.mode) == rk.Mode.FLYING
    cut = lambda x: x[some] if x.ndim and len(x) == len(some) else x
    flies = dataclasses.replace(
        run, time=run.time[some], state=jax.tree.map(cut, run.state)
    )
    text = told(flies)
    assert "about the normal" not in text
    assert "least tilt" not in text
    assert "normal force none, it flies" in text


def test_reversals_in_flight_are_not_told_of_the_normal():
    """A disc that is thrown turns on about its diameter; its spin had no time to."""
    text = told(thrown_disc())
    assert "about the normal, while there is a contact reversals none" in text
    assert re.search(r"about body axis y \d reversals", text)


def level_ball():
    ball = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)))
    return ball, rk.place(ball, (1, 0, 0, 0), (0.0, 3.0, 0.0), (0.0, 0.0, 0.0))


def test_a_base_that_moves_and_what_is_carried():
    """Against the run's own outputs: on the base, and of its one coordinate."""
    file = load_scene("isolator")
    run = simulate(file.scene, file.start, file.times, rtol=file.rtol)
    text = told(run)
    places = np.asarray(run.contact_on_base)
    far = np.linalg.norm(places - places[0], axis=1)
    (said,) = listed(text, r"over the base ([\d.e-]+) m from its start")
    assert said == pytest.approx(float(far.max()), rel=1e-3)
    (when,) = listed(text, r"over the base [^,]+, t = ([\d.]+) s")
    assert when == pytest.approx(float(run.time[far.argmax()]), rel=1e-3)
    assert re.search(r"carried mass [\d.e-]+ m from its start at most", text)


@pytest.mark.slow
def test_the_farthest_of_several_masses():
    """Of two pendulums at rest, one is let go from the horizontal: by 2 r sin(90/2)."""

    def places(alpha):
        one = jnp.stack([jnp.sin(alpha[0]), 0.0 * alpha[0], -jnp.cos(alpha[0])])
        two = jnp.stack([jnp.sin(alpha[1]), 0.0 * alpha[1], -jnp.cos(alpha[1])])
        return 0.05 * jnp.stack([one, two])

    heavy = rk.Body(1e6, 4e3 * np.eye(3), rk.Sphere(0.1))  # it hardly moves
    scene = rk.Scene(
        heavy, supported=rk.PointMasses([1e-3, 1e-3], places, coordinates=2)
    )
    start = rk.place(
        scene,
        *((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        alpha=[0.0, 0.5 * np.pi],
        alpha_dot=[0.0, 0.0],
    )
    # a quarter of its period and more: it is lowest, or on its way to the other side
    run = simulate(scene, start, np.linspace(0.0, 0.3, 61))
    angle = np.asarray(run.alpha)[:, 1]
    farthest = 2 * 0.05 * np.sin(0.5 * np.max(0.5 * np.pi - angle))
    (said,) = listed(told(run), r"carried mass 1 ([\d.e-]+) m from its start at most")
    assert said == pytest.approx(farthest, rel=1e-3)


def test_a_carried_body_is_told_by_its_mass_centre():
    """Not by the corners that pictures have of it, which turn farther."""
    turned = lambda a: jnp.stack(
        [
            jnp.stack([jnp.cos(a[0]), -jnp.sin(a[0]), 0.0 * a[0]]),
            jnp.stack([jnp.sin(a[0]), jnp.cos(a[0]), 0.0 * a[0]]),
            jnp.stack([0.0 * a[0], 0.0 * a[0], 1.0 + 0.0 * a[0]]),
        ]
    )
    slides = lambda a: jnp.stack([0.02 * a[0], 0.0 * a[0], 0.0 * a[0]])
    inner = rk.SupportedBody(1e-3, 1e-6 * np.eye(3), slides, turned)
    still = rk.PointMasses([1e-3], lambda a: jnp.zeros((1, 3)), coordinates=0)
    heavy = rk.Body(1e6, 4e3 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(heavy, supported=(still, inner))
    zero = (0.0, 0.0, 0.0)
    start = rk.place(
        scene, (1.0, 0.0, 0.0, 0.0), zero, zero, alpha=[0.0], alpha_dot=[3.0]
    )
    run = simulate(scene, start, np.linspace(0.0, 0.5, 11))
    (said,) = listed(told(run), r"carried mass 1 ([\d.e-]+) m from its start at most")
    farthest = 0.02 * float(np.abs(np.asarray(run.alpha)).max())
    assert said == pytest.approx(farthest, rel=1e-3)  # four digits are told


def test_an_end_between_outputs_is_told():
    """A ball rolls down a slope until it has come far enough."""
    slope = rk.Gravity((5.0, 0.0, -8.0))
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(body, loads=(slope,))
    still = (0.0, 0.0, 0.0)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), still, still)
    far = rk.Event(lambda scene, t, state: state.contact_on_base[0] - 0.3, stop=True)
    run = simulate(scene, start, np.linspace(0.0, 3.0, 4), events=[far])
    # by hand: a = 5 / (1 + 0.4)
    when = np.sqrt(2 * 0.3 / (5.0 / 1.4))
    ended = run.with_its_end()
    np.testing.assert_allclose(ended.time[:2], [0.0, when], rtol=1e-9)
    np.testing.assert_allclose(ended.position[1], [0.3, 0.0, 0.1], rtol=0, atol=1e-9)
    assert np.isnan(np.asarray(ended.position[2:])).all()
    assert "end position (0.3, 0, 0.1) m, 0.3 m from the start" in told(run)
    assert "0.0e+00" not in told(run)  # as of a start alone
    whole = simulate(scene, start, [0.0, 0.1])
    assert whole.with_its_end() is whole
    with pytest.raises(rk.FieldError, match="take one run"):
        jax.tree.map(lambda x: jnp.stack([x, x]), run).with_its_end()


@pytest.mark.slow
def test_the_path_of_an_inner_contact():
    """A circle in a hundred chords; in a scene it is told of each rolling body."""
    angle = np.linspace(0.0, 2 * np.pi, 101)
    circle = 0.3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    text = path_line(angle, circle)
    chords = 100 * 2 * 0.3 * np.sin(np.pi / 100)
    assert text == (
        f"    contact path    {chords:.4g} m long (chords), "
        f"0.6 m from its start at most, t = {np.pi:.4g} s"
    )
    file = load_scene("disc-in-hoop")
    run = simulate(file.scene, file.start, np.linspace(0.0, 0.5, 11), rtol=file.rtol)
    places = np.asarray(run.rolling_body(0).contact_on_carrier)
    length = np.sum(np.linalg.norm(np.diff(places, axis=0), axis=1))
    (said,) = listed(told(run), r"contact path ([\d.]+) m long")
    assert said == pytest.approx(length, rel=1e-3)
