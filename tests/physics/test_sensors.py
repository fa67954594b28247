"""What sensors read of a motion, against the run's positions and quaternions alone.

Velocities and accelerations are differences of five samples of a run, h = 1e-3 s apart.
Those leave h^4 / 30 of a fifth derivative: the body turns by up to 10 rad/s, and its
motion has harmonics of some 30 rad/s, so 1e-12 / 30 * 30^5 = 1e-6 of the first
derivative, and 1e-12 / 90 * 30^6 = 1e-5 of the second. Rounding of runs at rtol 1e-12,
1e-12 over h^2, adds 1e-6. Readings are of 10: thrice 1e-4.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.identification.fitting import problem_of
from rollkane.simulation.run_options import RunOptions

H = 1e-3
DIFFERS = 3e-4
AXES = np.array([0.06, 0.05, 0.04])
INERTIA = np.array([[4e-4, 2e-5, 1e-5], [2e-5, 6e-4, -3e-5], [1e-5, -3e-5, 7e-4]])
AT = np.array([0.02, -0.01, 0.03])
CENTRE = np.array([0.002, 0.001, -0.003])
G = np.array([0.0, 0.0, -9.81])
BODY = rk.Body(0.5, INERTIA, rk.Ellipsoid(AXES), CENTRE)
SCENE = rk.Scene(BODY)
START = rk.place(SCENE, (1.0, 0.0, 0.0, 0.0), (8.0, 3.0, 2.0), (0.0, 0.0, 0.0))
FINE = H * np.arange(-2, 403)
MIDDLE = slice(2, -2)


@pytest.fixture(scope="module")
def run():
    return rk.simulate(SCENE, START, FINE, rtol=1e-12)


@pytest.fixture(scope="module")
def turn(run):
    """Rotation matrices of the run's quaternions."""
    w, x, y, z = np.asarray(run.orientation).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), -1, 0)


def slope(x):
    return (x[:-4] - 8 * x[1:-3] + 8 * x[3:-1] - x[4:]) / (12 * H)


def curvature(x):
    return (-x[:-4] + 16 * x[1:-3] - 30 * x[2:-2] + 16 * x[3:-1] - x[4:]) / (12 * H * H)


def point(run, turn, at):
    return np.asarray(run.position) + turn @ at


def of_body(turn, vectors):
    return np.einsum("tji,tj->ti", turn, vectors)


def readings(run, turn):
    """What each sensor is to read, by definition, in the middle of the run."""
    spin = np.einsum("tji,tjk->tik", turn[MIDDLE], slope(turn))
    felt = curvature(point(run, turn, AT)) - G
    normal = of_body(turn, np.tile([0.0, 0.0, 1.0], (len(turn), 1)))
    # of an ellipsoid the point with the outward normal -n is -A^2 n / |A n|
    below = -(AXES**2) * normal / np.linalg.norm(AXES * normal, axis=1, keepdims=True)
    touching = np.asarray(run.position) + np.einsum("tij,tj->ti", turn, below)
    lifted = curvature(point(run, turn, CENTRE)) - G
    return {
        "gyro": np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1),
        "accelerometer": of_body(turn[MIDDLE], felt),
        "position": np.asarray(run.position)[MIDDLE],
        "marker": point(run, turn, AT)[MIDDLE],
        "path": touching[MIDDLE],
        "force": 0.5 * lifted[:, 2:],
    }


def channels(read):
    return {
        "gyro": rk.Gyro(read["gyro"], 1.0),
        "accelerometer": rk.Accelerometer(read["accelerometer"], 1.0, at=AT),
        "position": rk.Position(read["position"], 1.0),
        "marker": rk.Marker(read["marker"], 1.0, at=AT),
        "path": rk.ContactPath(read["path"], 1.0),
        "force": rk.NormalForce(read["force"], 1.0),
    }


@pytest.mark.parametrize(
    "name", ["gyro", "accelerometer", "position", "marker", "path", "force"]
)
def test_readings_by_definition(run, turn, name):
    expected = readings(run, turn)[name]
    found = np.asarray(run.each(channels(readings(run, turn))[name].observed))[MIDDLE]
    assert np.ptp(expected, axis=0).max() > 0.01  # it moves
    np.testing.assert_allclose(found, expected, rtol=0, atol=DIFFERS)


def test_orientations(run):
    """A quaternion of either sign and any length; small rotations about fixed axes."""
    known = np.asarray(run.orientation)
    signs = np.where(np.arange(len(FINE)) % 2, -1.02, 0.99)[:, None]
    channel = rk.Orientation(signs * known, 1.0)
    np.testing.assert_allclose(run.each(channel.observed), known, atol=1e-12)
    # the misfit to a body that is turned by 1e-4 rad about the fixed y axis: to the
    # third order of 1e-4, which is 1e-12 / 12, and rounding
    angle = 1e-4
    w, x, y, z = known.T
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    turned = np.stack([c * w - s * y, c * x + s * z, c * y + s * w, c * z - s * x], 1)
    misfit = rk.Orientation(signs * turned, 1.0).misfit(jnp.asarray(known))
    expected = np.tile([0.0, angle, 0.0], (len(FINE), 1))
    np.testing.assert_allclose(misfit, expected, rtol=0, atol=1e-12)


def fast(scene, t, state):
    return state.angular_velocity * t


def test_any_function(run):
    channel = rk.Observed(fast, np.zeros((len(FINE), 3)))
    expected = np.asarray(run.state.angular_velocity) * FINE[:, None]
    # the same product
    np.testing.assert_array_equal(run.each(channel.observed), expected)
    # one number was repeated for all columns, and fitted to each
    one = rk.Observed(lambda scene, t, state: t, np.zeros((len(FINE), 2)))
    for channel in (one, rk.Observed(fast, np.zeros((len(FINE), 2)))):
        with pytest.raises(rk.FieldError, match="2 columns") as caught:
            run.each(channel.observed)
        assert caught.value.field == "Observed.function"


def test_sensors_in_flight():
    """A body that falls feels nothing at its mass centre, and has no path."""
    start = rk.release(
        SCENE, (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0), (0.0, 0.0, 1.0), (0.1, 0.0, 0.0)
    )
    falls = rk.simulate(SCENE, start, [0.0, 0.1, 0.2], modes=rk.Modes())
    rows = np.zeros((3, 3))
    felt = falls.each(rk.Accelerometer(rows, at=CENTRE).observed)
    # the rounding of 10 m/s^2
    np.testing.assert_allclose(felt, 0.0, atol=1e-13)
    np.testing.assert_allclose(falls.each(rk.NormalForce(rows[:, 0]).observed), 0.0)
    assert np.isnan(falls.each(rk.ContactPath(rows).observed)).all()


BIAS = np.array([0.3, -0.2, 0.1])
GAIN = np.array([1.1, 0.9, 1.05])
ASKEW = np.array([0.02, -0.03, 0.01])
DELAY = 0.02


def test_a_sensor_as_it_is_built(run, turn):
    """Delay, then misalignment, gain and bias: misfits of what is made so are small."""
    read = readings(run, turn)
    late = round(DELAY / H)
    times = FINE[MIDDLE][late::10]
    shown = {name: values[: -late or None][::10] for name, values in read.items()}
    kept = {name: values[late::10] for name, values in read.items()}
    rates = shown["gyro"] - np.cross(ASKEW, shown["gyro"])
    given = {"bias": BIAS, "gain": GAIN}
    record = rk.Record(
        times,
        {
            "gyro": rk.Gyro(
                GAIN * rates + BIAS, 1.0, misalignment=ASKEW, delay=DELAY, **given
            ),
            "marker": rk.Marker(GAIN * kept["marker"] + BIAS, 1.0, at=AT, **given),
            "force": rk.NormalForce(
                1.1 * shown["force"] - 0.2, 1.0, bias=-0.2, gain=1.1, delay=DELAY
            ),
        },
        start_time=FINE[0],
    )
    free = (rk.Free("body.inertia"),)
    problem = problem_of(SCENE, [START], [record], free, None, RunOptions(rtol=1e-11))
    misfit = problem.evaluate(problem.layout.start).residual
    assert misfit.size == 7 * len(times)
    np.testing.assert_allclose(misfit, 0.0, atol=DIFFERS)
