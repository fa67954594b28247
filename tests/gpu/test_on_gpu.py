"""Native runs on the GPU at hand (`make test-gpu`); skipped where there is none."""

import equinox as eqx
import jax
import numpy as np
import pytest

import rollkane as rk
from rollkane.codegen import platform

from .. import gpu_runs, problems

pytestmark = pytest.mark.skipif(
    jax.default_backend() != "gpu", reason="JAX has no GPU here"
)


def test_as_on_the_processor():
    assert platform() == "cuda"
    there = gpu_runs.everything()
    (cpu, *_) = jax.devices("cpu")
    # what is committed to a device is computed there
    with jax.default_device(cpu):
        here = gpu_runs.everything()
    gpu_runs.check(here, there, exact={run.__name__ for run in gpu_runs.ALIKE})


def test_an_ensemble_in_blocks():
    scene, start = problems.disc(6.0)
    spins = start.angular_velocity[None] * np.linspace(0.9, 1.1, 1000)[:, None]
    spun = lambda spin: eqx.tree_at(lambda s: s.angular_velocity, start, spin)
    starts = jax.vmap(spun)(spins)
    times = np.array([0.0, 0.3])
    whole = rk.ensemble(scene, starts, times)
    parts = rk.ensemble(scene, starts, times, block=300)
    assert whole.method == parts.method == "native"
    np.testing.assert_array_equal(whole.final_state.contact, parts.final_state.contact)
    assert (whole.code == rk.Code.COMPLETED).all()
