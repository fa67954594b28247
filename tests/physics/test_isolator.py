"""An isolator on a recorded earthquake: its order, told where the record bends or not.

``benchmarks/isolator.py`` draws all of it.
"""

import diffrax
import equinox as eqx
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.kinematics.base_motion import AbstractBaseMotion

TOLERANCES = (1e-8, 1e-9, 1e-10, 1e-11)
END = 3.0  # [s], 150 samples


class Untold(AbstractBaseMotion):
    """The same motion, whose sample times are kept from the integrator."""

    motion: rk.RecordedMotion

    def at(self, t):
        return self.motion.at(t)


@pytest.fixture(scope="module")
def isolator():
    loaded = load_scene("isolator")
    start = float(loaded.scene.base.motion.time[0])
    return loaded.scene, loaded.start, np.array([start, start + END])


def runs(scene, start, times, solver, tolerances):
    results = [
        rk.simulate(scene, start, times, rtol=rtol, solver=solver)
        for rtol in tolerances
    ]
    assert all(bool(result.succeeded) for result in results)
    ends = [np.concatenate([r.position[-1], r.alpha[-1]]) for r in results]
    return ends, [int(r.steps) for r in results]


@pytest.fixture(scope="module")
def exact(isolator):
    """By another method, of order 8, at the smallest tolerance."""
    (end,), _ = runs(*isolator, diffrax.Dopri8(), (1e-13,))
    return end


@pytest.fixture(scope="module")
def told(isolator, exact):
    ends, steps = runs(*isolator, diffrax.Tsit5(), TOLERANCES)
    return [np.abs(end - exact).max() for end in ends], steps


@pytest.mark.slow
def test_told_of_the_samples_the_order_is_kept(told):
    """Tsit5 has order 5; the steps are not all alike, which may cost half an order."""
    errors, steps = told
    order = -np.log(errors[-1] / errors[0]) / np.log(steps[-1] / steps[0])
    assert order > 4.5
    # a step may be wrong by rtol of the state, here of lengths of 0.1 m
    assert all(e < 0.1 * rtol for e, rtol in zip(errors, TOLERANCES, strict=True))


def test_not_told_it_takes_more_steps_for_larger_errors(isolator, exact, told):
    scene, start, times = isolator
    untold = eqx.tree_at(lambda s: s.base.motion, scene, Untold(scene.base.motion))
    ends, steps = runs(untold, start, times, diffrax.Tsit5(), TOLERANCES)
    for end, count, error, fewer in zip(ends, steps, *told, strict=True):
        assert count > fewer
        assert np.abs(end - exact).max() > 10.0 * error
