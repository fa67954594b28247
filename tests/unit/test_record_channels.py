"""What a fit says of each channel of a record is of that channel."""

import numpy as np

import rollkane as rk
from rollkane.identification.fitting import problem_of
from rollkane.simulation.run_options import RunOptions

from .. import problems


def test_misfits_bear_the_name_of_their_channel():
    """In any order of the names: JAX puts those of a dictionary in its own."""
    scene, start = problems.disc()
    times = np.linspace(0.0, 0.1, 5)
    run = rk.simulate(scene, start, times, rtol=1e-10)
    turning, place = run.state.angular_velocity, run.position
    channels = {
        "turning": rk.Gyro(turning + 0.03, sigma=0.01),
        "place": rk.Position(place - 0.001, sigma=0.001),
    }
    for names in ("turning", "place"), ("place", "turning"):
        record = rk.Record(times, {name: channels[name] for name in names})
        free = (rk.Free("body.mass"),)
        options = RunOptions(1e-10, None, None, "auto")
        problem = problem_of(scene, [start], [record], free, None, options)
        (found,) = problem.channel_misfits(problem.layout.start)
        # the offsets over their deviations; both runs are of the same steps, whose
        # errors of 1e-10 a step over the smaller deviation are 1e-7, of 100 steps 1e-5
        np.testing.assert_allclose(found["turning"], 3.0, rtol=0, atol=1e-5)
        np.testing.assert_allclose(found["place"], -1.0, rtol=0, atol=1e-5)
