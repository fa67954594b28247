"""The numbers behind the pictures."""

import equinox as eqx
import jax
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.ready_observables import READY
from rollkane.dynamics.rolling import contact_of, rolling_derivative
from rollkane.pictures.motion_samples import motion_samples
from rollkane.validation.checks import FieldError
from tests.pictures import dropped_disc, rolling_on_plane, rolling_on_sphere


@pytest.fixture(scope="module")
def run():
    return rolling_on_sphere()


def test_columns_are_the_trajectory_s_own(run):
    drawn = motion_samples(run)
    for name in ("position", "orientation", "contact_on_base"):
        np.testing.assert_allclose(
            getattr(drawn, name), np.asarray(getattr(run, name)), atol=1e-12
        )
    np.testing.assert_allclose(drawn.normal_force, np.asarray(run.normal_force))
    np.testing.assert_allclose(drawn.energy, np.asarray(run.energy))
    outward = np.asarray(run.contact_on_base) / 0.5
    np.testing.assert_allclose(drawn.outward, outward, atol=1e-12)
    spin = np.sum(np.asarray(run.angular_velocity) * outward, axis=1)
    np.testing.assert_allclose(drawn.spin, spin, atol=1e-12)


def test_velocity_is_the_rate_of_the_position(run):
    @eqx.filter_jit
    @jax.vmap
    def rate(state):
        rates = rolling_derivative(run.scene, 0.0, state)
        place = lambda state: contact_of(run.scene, 0.0, state).position
        return jax.jvp(place, (state,), (rates,))[1]

    np.testing.assert_allclose(
        motion_samples(run).velocity, rate(run.state), atol=1e-12
    )


def test_rows_that_were_not_reached_are_known(run):
    assert motion_samples(run).reached.all()
    stopped = motion_samples(rolling_on_sphere(reached=4))
    assert stopped.reached.tolist() == [True] * 4 + [False] * 20
    assert np.isnan(stopped.energy_error[4:]).all()
    assert len(stopped.rows(stopped.reached).time) == 4


def test_there_is_no_spin_without_a_contact():
    run = dropped_disc()
    drawn, flies = motion_samples(run), np.asarray(run.mode) == rk.Mode.FLYING
    assert 0 < flies.sum() < flies.size
    np.testing.assert_array_equal(drawn.touches, ~flies)
    assert np.isnan(drawn.spin[flies]).all()
    level = np.asarray(run.angular_velocity)[~flies, 2]  # the base's normal is z
    np.testing.assert_allclose(drawn.spin[~flies], level, rtol=1e-12)
    assert (drawn.normal_force[flies] == 0.0).all()  # nothing touches
    normals = np.asarray(run.each(READY["outward"]))
    assert np.isnan(normals[flies]).all()
    # down, from a quaternion that is of length one to the rtol of the run, 1e-9 a step
    assert np.abs(normals[~flies] - [0.0, 0.0, -1.0]).max() < 1e-6


def test_energy_error_of_no_energy_at_all(run):
    drawn = motion_samples(run)
    zero = drawn._replace(energy=0 * drawn.time)
    assert (zero.energy_error == 0).all()
    unknown = drawn._replace(energy=np.nan * drawn.time)
    assert np.isnan(unknown.energy_error).all()


def test_a_batch_is_refused():
    run = rolling_on_plane()
    batch = jax.tree.map(lambda x: np.stack([x, x]), run)
    with pytest.raises(FieldError, match="one lane"):
        motion_samples(batch)
