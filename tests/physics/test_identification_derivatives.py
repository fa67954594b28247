"""Derivatives of misfits by every coordinate, against differences of misfits.

Differences of steps h and h / 2, extrapolated: the rest is of order h^4. For h = 1e-4
of a coordinate's size it is 1e-16 of the fifth derivative over its size; of a mass
centre in the origin, whose size is 1 m for want of another and not the body's 1e-1 to
1e-2 m, 1e-8. The rounding of runs at rtol 1e-11 is 1e-11 / 1e-4 of the misfits' size:
below 1e-6 of the largest derivative.
"""

import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import builtin_scenes, load_scene
from rollkane.identification.fitting import problem_of
from rollkane.simulation.run_options import RunOptions

DIFFERS = 1e-6
STEP = 1e-4
TIMES = np.linspace(0.02, 0.4, 20)


def differences(problem, z):
    """Derivatives by extrapolated differences, relative to the coordinates' sizes."""
    misfit = lambda z: problem.evaluate(z).residual
    rows = []
    for way in np.diag(problem.layout.scale):
        slope = lambda h, way=way: (misfit(z + h * way) - misfit(z - h * way)) / (2 * h)
        rows.append((4.0 * slope(0.5 * STEP) - slope(STEP)) / 3.0)
    return np.stack(rows, axis=1)


def agree(problem):
    z = problem.layout.start
    at = problem.evaluate(z)
    assert at.failed == 0
    found = at.jacobian * problem.layout.scale
    expected = differences(problem, z)
    size = np.abs(expected).max()
    assert size > 0.0
    np.testing.assert_allclose(found, expected, rtol=0, atol=DIFFERS * size)
    return found


def channels(count, delay):
    rows = np.zeros((count, 3))
    return {
        "gyro": rk.Gyro(rows, 1.0, misalignment=(0.01, 0.02, -0.01), delay=delay),
        "acceleration": rk.Accelerometer(rows, 10.0, at=(0.01, 0.0, 0.02)),
        "marker": rk.Marker(rows, 0.1, at=(0.01, 0.02, 0.0)),
        "force": rk.NormalForce(rows[:, 0], 10.0),
    }


def problem_for(scene, start, paths, delay=0.0, modes=None):
    record = rk.Record(TIMES, channels(len(TIMES), delay), start_time=0.0)
    bounds = {"gyro.delay": (0.0, 0.015)}
    free = tuple(rk.Free(path, bounds=bounds.get(path)) for path in paths)
    return problem_of(scene, [start], [record], free, modes, RunOptions(rtol=1e-11))


def test_through_delays_and_sensors():
    inertia = 1e-4 * np.array([[4.0, 0.2, 0.1], [0.2, 6.0, -0.3], [0.1, -0.3, 7.0]])
    scene = rk.Scene(rk.Body(0.5, inertia, rk.Ellipsoid((0.06, 0.05, 0.04))))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (8.0, 3.0, 2.0), (0.0, 0.0, 0.0))
    own = "gyro.delay", "gyro.gain", "gyro.misalignment", "marker.at"
    paths = "body.mass", "body.surface.semi_axes", *own
    found = agree(problem_for(scene, start, paths, delay=0.01))
    assert (np.abs(found).max(axis=0) > 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", builtin_scenes())
def test_of_every_scene(name):
    file = load_scene(name)
    paths = [
        "body.mass",
        "body.inertia",
        "body.center_of_mass",
        "start.angular_velocity",
    ]
    agree(problem_for(file.scene, file.start, paths))


@pytest.mark.slow
def test_through_flight_impact_slip_and_grip():
    """A thrown ball; no sample lies where a step of differences moves an event to."""
    ball = rk.Body(6.0, 0.4 * 6.0 * 0.11**2 * np.eye(3), rk.Sphere(0.11))
    scene = rk.Scene(ball)
    upright, above = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.2)
    start = rk.release(scene, upright, (0.0, -5.0, 3.0), above, (1.0, 0.2, 0.0))
    modes = rk.Modes(friction=0.2, restitution=0.4, switches=16)
    times = np.linspace(0.02, 1.2, 41)
    run = rk.simulate(scene, start, times, modes=modes, rtol=1e-11)
    events = np.asarray(run.switches.time)[: int(run.switches.count)]
    assert len(events) >= 3
    # h = 1e-4 of the sizes moves times of some tenths of a second by as much
    assert np.abs(events[:, None] - times).min() > 2 * STEP * times[-1]
    rows = np.zeros((len(times), 3))
    record = rk.Record(
        times,
        {"gyro": rk.Gyro(rows, 1.0), "place": rk.Position(rows, 0.1)},
        start_time=0.0,
    )
    paths = "modes.friction", "modes.restitution", "body.inertia"
    free = tuple(rk.Free(path) for path in (*paths, "start.angular_velocity"))
    options = RunOptions(rtol=1e-11)
    found = agree(problem_of(scene, [start], [record], free, modes, options))
    assert (np.abs(found).max(axis=0) > 0.0).all()
